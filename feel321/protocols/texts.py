"""The texts for participants: one TOML file per language in `catalog/`, or a file of the lab's own.

Every language has the keys, lists and {placeholders} of the English one. A lab's own file may hold only the texts that
it changes; it is checked when it is read, so that no gap turns up in the middle of a session.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.doors import check_name
from feel321.protocols.trial import Scale

if TYPE_CHECKING:
    from feel321.types import PathLike

CATALOG = files("feel321.protocols") / "catalog"

MODEL = "en"
"""The language that every other one is compared with."""

COPY_FILE = "texts.toml"
"""A study's own texts, as `write_copy` writes them."""

MOST_GUESSES = 20
"""So many unknown texts are told what they may have meant: each takes some milliseconds."""

SCALE = {"question", "low_label", "high_label"}
"""The texts of a scale; it may have `anchors` too."""


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
    return make_scales(read_texts(language))


def make_scales(texts: Mapping[str, Any]) -> dict[str, Scale]:
    """Make the scales of all texts of a language, by name."""
    scales = {}
    for name, own in texts["scales"].items():
        words: dict[str, Any] = {k: tuple(t) if isinstance(t, list) else t for k, t in own.items()}
        scales[name] = Scale(name, **words)
    return scales


def read_texts(language: str | PathLike = MODEL) -> dict[str, Any]:
    """Read all texts of a language, by kind: scales, pages, refusals, prompts, parts, keys."""
    if not (isinstance(language, os.PathLike) or str(language).endswith(".toml")):
        check_name(language, list_languages(), "language")
        return tomllib.loads((CATALOG / f"{language}.toml").read_text(encoding="utf-8"))
    path = Path(language)
    own, base = _parse_own(path)
    texts = _merge(base, own)
    if gaps := find_gaps(_leave_out_own_scales(texts), read_texts()):
        known = [place for place, _ in _flatten(base)]
        unknown = [gap for gap in gaps if " is not a known text" in gap][:MOST_GUESSES]
        lines = []
        for gap in gaps:
            place = gap.partition(" is not a known text")[0]
            near = get_close_matches(place, known, n=1, cutoff=0.5) if gap in unknown else []
            hint = f", did you mean {near[0]}?" if near else ""
            lines.append(f"{path}: {gap}{hint}; compare protocols/catalog/{MODEL}.toml")
        raise ValueError("\n".join(lines))
    return texts


def find_gaps(texts: dict[str, Any], model: dict[str, Any]) -> list[str]:
    """Compare the texts of a language with those of another."""
    own, wanted = dict(_flatten(texts)), dict(_flatten(model))
    faults = (_find_fault(place, own[place], wanted[place]) for place in wanted if place in own)
    return [
        *filter(None, faults),
        *(f"{place} is missing" for place in wanted if place not in own),
        *(f"{place} is not a known text" for place in own if place not in wanted),
    ]


def list_borrowed(path: Path) -> list[str]:
    """List the texts of the catalogue that an own file does without, if it has most of its own: a translation."""
    own, base = _parse_own(path)
    known, places = dict(_flatten(own)), [place for place, _ in _flatten(base)]
    borrowed = [place for place in places if place not in known]
    return borrowed if 2 * len(borrowed) < len(places) else []


def write_copy(language: str) -> str:
    """Write the texts of a language as a file of a study's own in which every text is still a comment."""
    source = (CATALOG / f"{language}.toml").read_text(encoding="utf-8")
    head = f"""# The texts of this study, where they are not those of feel321. Take the # from the lines to change;
# delete the others if you like: what this file does not say stays as it is. In study.toml, under [session]:
# language = "{COPY_FILE}". Then: feel321 check
language = "{language}"  # of all that is not changed here
"""
    lines = (
        line if not line or line.startswith(("[", "#")) else f"# {line}"
        for line in source.splitlines()
    )
    return "\n".join([head, *lines, ""])


def _leave_out_own_scales(texts: dict[str, Any]) -> dict[str, Any]:
    """Leave out scales of a lab's own that have all their texts, and the pages of its own protocols."""
    scales, pages = texts["scales"], texts["pages"]
    if not isinstance(scales, dict) or not isinstance(pages, dict):
        return texts
    known = read_texts()["scales"]
    own = {name for name, entry in scales.items() if name not in known and _is_scale(entry)}
    own_pages = {
        key
        for key, entry in pages.items()
        if key.removeprefix("instructions.") in own
        and isinstance(entry, dict)
        and entry.keys() == {"title", "text"}
        and not any(_find_fault("", text, "") for text in entry.values())
    }
    return texts | {
        "scales": {name: entry for name, entry in scales.items() if name not in own},
        "pages": {key: entry for key, entry in pages.items() if key not in own_pages},
    }


def _is_scale(entry: object) -> bool:
    if not isinstance(entry, dict) or not SCALE <= entry.keys() <= SCALE | {"anchors"}:
        return False
    anchors = entry.get("anchors", ["-"])
    words = [*(entry[name] for name in SCALE), *(anchors if isinstance(anchors, list) else [0])]
    return all(isinstance(word, str) and word.strip() for word in words)


def _parse_own(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read an own file, and the texts of the language that it changes."""
    try:
        own = tomllib.loads(intake.read_small(path))
        dict(_flatten(own))  # tables in tables without end exceed the recursion here
    except (ValueError, RecursionError) as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: not valid TOML ({error}); fix it there") from None
    language = own.pop("language", MODEL)
    if language not in list_languages():
        raise ValueError(
            f"{path}: language must be one of {', '.join(list_languages())}, got {language!r}; "
            "it gives the texts that the file leaves out"
        )
    return own, read_texts(language)


def _merge(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Put texts into tables in place of those of the same name; lists are replaced as a whole."""
    merged = base | own
    for key in base.keys() & own.keys():
        if isinstance(base[key], dict) and isinstance(own[key], dict):
            merged[key] = _merge(base[key], own[key])
    return merged


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
