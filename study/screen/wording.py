"""The texts that the screen shows, as records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from protocols.texts import PageText

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class ScreenTexts:
    """What participants read besides the scales, in their language.

    Parameters
    ----------
    pages : mapping of str to PageText
        Texts of the pages by key.
    refusals : mapping of str to str
        Why an act is refused, by reason.
    prompts, parts, keys : mapping of str to str
        What is asked for and said, what parts are called, what keys do.
    """

    pages: Mapping[str, PageText]
    refusals: Mapping[str, str]
    prompts: Mapping[str, str]
    parts: Mapping[str, str]
    keys: Mapping[str, str]


def make_screen_texts(tables: Mapping[str, Any]) -> ScreenTexts:
    """Pick the screen's texts from those of a language.

    Parameters
    ----------
    tables : mapping
        The tables of a language, as `study.settings.wording.read_study_texts` gives them.

    Returns
    -------
    ScreenTexts
        The texts.

    Examples
    --------
    >>> from protocols.texts import read_texts
    >>> make_screen_texts(read_texts("de")).pages["pause"].title
    'Pause'
    """
    pages = {key: PageText(key, **entry) for key, entry in tables["pages"].items()}
    return ScreenTexts(pages, tables["refusals"], tables["prompts"], tables["parts"], tables["keys"])
