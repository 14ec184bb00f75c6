"""Reading TOML into a closed table; the one place where a mistake in it is put into words."""

from __future__ import annotations

import json
import tomllib
from difflib import get_close_matches
from typing import TYPE_CHECKING, NoReturn, TypeVar

from pydantic import ValidationError

from study.settings.fields import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pydantic_core import ErrorDetails

    Tables = Mapping[tuple[str, ...], type[Table]]

Whole = TypeVar("Whole", bound=Table)

WRONG_KEY = "[key]"
"""What pydantic adds to the place of a name that is not allowed; the name stands before it."""


def parse_toml(path: Path, model: type[Whole], *, tables: Tables) -> Whole:
    """Read a TOML file into the table that it is to be.

    Parameters
    ----------
    path : Path
        The file.
    model : type of Table
        What may stand in it.
    tables : mapping of tuple of str to type of Table
        Its tables by their names, its own being (); a table of several kinds stands once per kind. Tables that any
        name is given to stand under what they are in.

    Returns
    -------
    Table
        What stands in it, defaults filled in.

    Raises
    ------
    ValueError
        If the file is not TOML, or anything in it is not allowed: one line per mistake, all of them.
    OSError
        If the file cannot be read.
    """
    try:
        # By way of JSON, where strict reading takes an array for a tuple, but no "5" or true for a number.
        content = json.dumps(tomllib.loads(path.read_text(encoding="utf-8-sig")), default=_refuse_time)
    except TypeError as error:
        raise ValueError(f"{path.name}: {error}") from None
    except ValueError as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: got no TOML ({error}); mend that place") from None
    except RecursionError:
        raise ValueError(f"{path}: got TOML that is nested too deeply; mend that place") from None
    try:
        return model.model_validate_json(content, strict=True)
    except ValidationError as error:
        lines = (f"{path.name}: {_translate(detail, tables)}" for detail in error.errors(include_url=False))
        raise ValueError("\n".join(lines)) from None


def _refuse_time(value: object) -> NoReturn:
    # A TypeError is how `json` wants to be told.
    raise TypeError(f"got the date or time {value}, allowed are texts, numbers, true and false; put it in quotes")


def _translate(detail: ErrorDetails, tables: Tables) -> str:
    place = _write_place(detail["loc"], tables)
    if detail["type"] == "json_invalid":  # We wrote the JSON: only its depth can be wrong.
        return "got TOML that is nested too deeply; mend that place"
    if detail["type"] == "extra_forbidden":
        return f"{place}: is no setting; {_suggest(detail['loc'], tables)}"
    if detail["type"] == "missing":
        return f"{place}: is missing; add it"
    if detail["type"] == "value_error":
        reason = str(detail["ctx"]["error"])
    else:
        # What JSON calls an object is a table in TOML.
        reason = f"allowed: {detail['msg'].removeprefix('Input should be ').replace('an object', 'a table')}"
    # Whole tables are too long an answer to what was got, and some reasons say it themselves.
    got = "" if "{" in repr(detail["input"]) or reason.startswith("got ") else f"got {detail['input']!r}, "
    return f"{place}: {got}{reason}"


def _write_place(location: Sequence[int | str], tables: Tables) -> str:
    """Write a place as the file's author counts, `recordings[1].unit`; the kind of a table is no key."""
    place, names = "", list[str]()
    for before, part in zip((None, *location), location, strict=False):
        if isinstance(part, int):
            place += f"[{part + 1}]"
            continue
        names.append(part)
        is_kind = isinstance(before, int) and tuple(names) in tables
        if not is_kind and part != WRONG_KEY:
            place += f".{part}" if place else part
    return place


def _suggest(location: Sequence[int | str], tables: Tables) -> str:
    *names, key = (part for part in location if isinstance(part, str))
    table = tables.get(tuple(names)) or tables[tuple(names[:1])]
    near = get_close_matches(key, table.model_fields, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed: {', '.join(table.model_fields)}"
