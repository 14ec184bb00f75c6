"""The texts for participants: one TOML file per language in `catalog/`, or a file of the lab's own.

Every language has the keys, lists and {placeholders} of the English one; a lab's own file is checked against it when
it is read, so that no gap turns up in the middle of a session.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any

from feel321.doors import check_name
from feel321.protocols.trial import Scale

if TYPE_CHECKING:
    from feel321.types import PathLike

CATALOG = files("feel321.protocols") / "catalog"

MODEL = "en"
"""The language that every other one is compared with."""


@dataclass(frozen=True, slots=True)
class PageText:
    """Headline and text of a page; `{done}` and `{total}` stand for numbers of trials."""

    key: str
    title: str
    text: str


def list_languages() -> tuple[str, ...]:
    """List the language codes of the catalogue."""
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in CATALOG.iterdir()))


def read_scales(language: str | PathLike = MODEL) -> dict[str, Scale]:
    """Read the texts of all scales.

    Parameters
    ----------
    language : str or path
        Language code of the catalogue, or a TOML file of the same form.

    Returns
    -------
    dict of str to Scale
        The scales by name.

    Raises
    ------
    ValueError
        If there is no such language, or the file is not complete.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> from feel321 import protocols
    >>> protocols.read_scales("en")["similarity"].high_label
    'Identical'
    """
    scales = {}
    for name, own in read_texts(language)["scales"].items():
        texts: dict[str, Any] = {k: tuple(t) if isinstance(t, list) else t for k, t in own.items()}
        scales[name] = Scale(name, **texts)
    return scales


def read_pages(language: str | PathLike = MODEL) -> dict[str, PageText]:
    """Read the texts of all pages, by key."""
    return {key: PageText(key, **entry) for key, entry in read_texts(language)["pages"].items()}


def read_refusals(language: str | PathLike = MODEL) -> dict[str, str]:
    """Read the messages for acts that are not accepted, by reason; `{parts}` stands for the parts concerned."""
    return dict(read_texts(language)["refusals"])


def read_texts(language: str | PathLike = MODEL) -> dict[str, Any]:
    """Read all texts of a language, by kind: scales, pages, refusals, prompts, parts, keys."""
    if isinstance(language, os.PathLike) or str(language).endswith(".toml"):
        return _read_own(Path(language))
    check_name(language, list_languages(), "language")
    return tomllib.loads((CATALOG / f"{language}.toml").read_text(encoding="utf-8"))


def find_gaps(texts: dict[str, Any], model: dict[str, Any]) -> list[str]:
    """Compare the texts of a language with those of another."""
    own, wanted = dict(_flatten(texts)), dict(_flatten(model))
    gaps = [
        fault
        for place in wanted
        if place in own and (fault := _find_fault(place, own[place], wanted[place]))
    ]
    gaps += [f"{place} is missing" for place in wanted if place not in own]
    return gaps + [f"{place} is not a known text" for place in own if place not in wanted]


def _read_own(path: Path) -> dict[str, Any]:
    try:
        texts = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: not valid TOML ({error}); fix it there") from None
    if gaps := find_gaps(texts, read_texts()):
        raise ValueError(
            "\n".join(f"{path}: {gap}; compare protocols/catalog/{MODEL}.toml" for gap in gaps)
        )
    return texts


def _flatten(texts: object, place: str = "") -> Iterator[tuple[str, object]]:
    """Name every text by its keys as TOML does, and lists and tables that are empty; lists are counted from 1."""
    if isinstance(texts, dict) and texts:
        for key, entry in texts.items():
            name = f'"{key}"' if "." in key else key
            yield from _flatten(entry, f"{place}.{name}".removeprefix("."))
    elif isinstance(texts, list) and texts:
        for number, entry in enumerate(texts, start=1):
            yield from _flatten(entry, f"{place}[{number}]")
    else:
        yield place, texts


def _find_fault(place: str, text: object, model: object) -> str:
    if not isinstance(text, str) or not text.strip():
        return f"{place} must be a text, got {text!r}"
    if ".choices[" in place and text != model:
        return f"{place} must be {model!r}, got {text!r}: choices are names of parts, the same in every language"
    got, wanted = _list_placeholders(text), _list_placeholders(str(model))
    if got == wanted:
        return ""
    return f"{place} must have {f'the placeholders {wanted}' if wanted else 'no placeholders'}, got {got or 'none'}"


def _list_placeholders(text: str) -> str:
    try:
        names = {name for _, name, _, _ in Formatter().parse(text) if name is not None}
    except ValueError as error:
        return str(error)
    return ", ".join(sorted(f"{{{name}}}" for name in names))
