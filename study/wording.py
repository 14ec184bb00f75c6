"""The words of a study: a language of the catalogue or a file of the lab's own, and its own consent."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from protocols.texts import read_pages
from study.session_tables import LANGUAGE_FILE

if TYPE_CHECKING:
    from pathlib import Path

    from protocols.texts import PageText
    from study.tables import Settings

CONSENT = "consent"
"""The page whose text a lab can set by itself."""


def find_language(settings: Settings, folder: Path) -> str | Path:
    """Tell where the texts of a study stand.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder; a file of its own is named relative to it.

    Returns
    -------
    str or Path
        A language of the catalogue, or the file.
    """
    language = settings.session.language
    return folder / language if language.endswith(LANGUAGE_FILE) else language


def read_study_pages(settings: Settings, folder: Path) -> dict[str, PageText]:
    """Read the pages of a study, the lab's own consent among them.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder.

    Returns
    -------
    dict of str to PageText
        The pages by key.

    Raises
    ------
    ValueError
        If the texts are not complete.
    OSError
        If they cannot be read.
    """
    pages = read_pages(find_language(settings, folder))
    if own := settings.session.consent:
        pages[CONSENT] = replace(pages[CONSENT], text=own)
    return pages
