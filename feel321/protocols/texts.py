"""What participants read: one TOML file per language in `catalog/`, or a file of the lab's own.

Every language has the keys, lists and {placeholders} of the English one; a lab's own file is held to that when it is
read, so that nobody finds a gap in the middle of a session.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any

from feel321.protocols.trial import Scale

if TYPE_CHECKING:
    from collections.abc import Iterator

    Place = tuple[str | int, ...]

CATALOG = files("feel321.protocols") / "catalog"

MODEL = "en"
"""The language that every other one is held to."""


@dataclass(frozen=True, slots=True)
class PageText:
    """What a page says.

    Parameters
    ----------
    key : str
        Which page it is.
    title : str
        Its headline.
    text : str
        Its text; line breaks are the author's. `{done}` and `{total}` stand for numbers of trials.
    """

    key: str
    title: str
    text: str


def list_languages() -> tuple[str, ...]:
    """Name the languages that the catalogue holds.

    Returns
    -------
    tuple of str
        Language codes, sorted.

    Examples
    --------
    >>> list_languages()
    ('de', 'en')
    """
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in CATALOG.iterdir()))


def read_scales(language: str | Path = MODEL) -> dict[str, Scale]:
    """Read the texts of all scales.

    Parameters
    ----------
    language : str or Path
        Language code of the catalogue, or a file of the same form.

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
    >>> read_scales()["similarity"].high_label
    'Identical'
    """
    return {
        name: _make_scale(name, entry) for name, entry in read_texts(language)["scales"].items()
    }


def read_pages(language: str | Path = MODEL) -> dict[str, PageText]:
    """Read the texts of all pages.

    Parameters
    ----------
    language : str or Path
        Language code of the catalogue, or a file of the same form.

    Returns
    -------
    dict of str to PageText
        The pages by key.

    Raises
    ------
    ValueError
        If there is no such language, or the file is not complete.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> read_pages("de")["end"].title
    'Vielen Dank'
    """
    return {key: PageText(key, **entry) for key, entry in read_texts(language)["pages"].items()}


def read_refusals(language: str | Path = MODEL) -> dict[str, str]:
    """Read what participants are told when an act is not accepted.

    Parameters
    ----------
    language : str or Path
        Language code of the catalogue, or a file of the same form.

    Returns
    -------
    dict of str to str
        The texts by reason; `{parts}` stands for the parts that it is about.

    Raises
    ------
    ValueError
        If there is no such language, or the file is not complete.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> read_refusals()["unknown_part"]
    'There is nothing to feel under that key.'
    """
    return dict(read_texts(language)["refusals"])


def read_part_names(language: str | Path = MODEL) -> dict[str, str]:
    """Read what the parts of trials are called; those that are numbered are called by their numbers.

    Examples
    --------
    >>> read_part_names("de")["surface"]
    'Echte Oberfläche'
    """
    return dict(read_texts(language)["parts"])


def read_texts(language: str | Path = MODEL) -> dict[str, Any]:
    """Read all texts of a language; those that no other function gives are `prompts` and `keys` of the screen.

    Examples
    --------
    >>> list(read_texts())
    ['scales', 'pages', 'refusals', 'prompts', 'parts', 'keys']
    """
    if isinstance(language, Path):
        return _read_own(language)
    if language not in list_languages():
        raise ValueError(f"language: got {language!r}, allowed: {', '.join(list_languages())}")
    return tomllib.loads((CATALOG / f"{language}.toml").read_text(encoding="utf-8"))


def find_gaps(texts: dict[str, Any], model: dict[str, Any]) -> list[str]:
    """Compare the texts of a language with those of another.

    Examples
    --------
    >>> find_gaps({"a": "un", "c": "x"}, {"a": "one {n}", "b": ["yes", "no"]})
    ['a: got no placeholders, allowed is {n}', 'b[1]: is missing', 'b[2]: is missing', 'c: is no known text']
    """
    own, wanted = dict(_flatten(texts)), dict(_flatten(model))
    faults = {
        place: _find_fault(place, own[place], wanted[place]) for place in wanted if place in own
    }
    gaps = [f"{_write_place(place)}: {fault}" for place, fault in faults.items() if fault]
    gaps += [f"{_write_place(place)}: is missing" for place in wanted if place not in own]
    return gaps + [
        f"{_write_place(place)}: is no known text" for place in own if place not in wanted
    ]


def _make_scale(name: str, entry: dict[str, Any]) -> Scale:
    """Make a scale of what TOML holds, which has lists for tuples."""
    texts: dict[str, Any] = {
        key: tuple(text) if isinstance(text, list) else text for key, text in entry.items()
    }
    return Scale(name, **texts)


def _read_own(path: Path) -> dict[str, Any]:
    try:
        texts = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: got no TOML ({error}); mend that place") from None
    if gaps := find_gaps(texts, read_texts()):
        raise ValueError(
            "\n".join(f"{path}: {gap}; compare protocols/catalog/{MODEL}.toml" for gap in gaps)
        )
    return texts


def _flatten(texts: object, place: Place = ()) -> Iterator[tuple[Place, object]]:
    """Name every text by its keys, and lists and tables that are empty; lists are counted from 1."""
    if isinstance(texts, dict) and texts:
        for key, entry in texts.items():
            yield from _flatten(entry, (*place, key))
    elif isinstance(texts, list) and texts:
        for number, entry in enumerate(texts, start=1):
            yield from _flatten(entry, (*place, number))
    else:
        yield place, texts


def _write_place(place: Place) -> str:
    """Write a place as it stands in TOML, where a key that holds dots is quoted."""
    keys = (
        f"[{key}]" if isinstance(key, int) else f'."{key}"' if "." in key else f".{key}"
        for key in place
    )
    return "".join(keys).removeprefix(".")


def _find_fault(place: Place, text: object, model: object) -> str:
    if not isinstance(text, str) or not text.strip():
        return f"got {text!r}, allowed is a text"
    if "choices" in place and text != model:
        return f"got {text!r}, allowed is {model!r}: choices are names of parts, the same in every language"
    got, allowed = _list_placeholders(text), _list_placeholders(str(model))
    return (
        "" if got == allowed else f"got {got or 'no placeholders'}, allowed is {allowed or 'none'}"
    )


def _list_placeholders(text: str) -> str:
    try:
        return ", ".join(
            sorted({f"{{{name}}}" for _, name, _, _ in Formatter().parse(text) if name is not None})
        )
    except ValueError as error:
        return str(error)
