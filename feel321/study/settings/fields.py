"""Kinds of values and tables of `study.toml`, and TOML parsed with errors that name the place.

Each kind refuses by saying what is allowed; `settings` adds the place and what was got.
"""

from __future__ import annotations

import json
import tomllib
from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated, NoReturn, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    WrapValidator,
)
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from pydantic import ValidatorFunctionWrapHandler
    from pydantic_core import ErrorDetails

# What the tables of `study.toml` are made of: the closed table, and kinds of values.

OFF = "off"
"""What switches something off: TOML has no null."""


class Table(BaseModel):
    """A table of `study.toml`: no unknown keys, no guessing of types, no changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def one_of(names: Collection[str]) -> AfterValidator:
    """Make the rule that a name is one of a registry's."""

    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"allowed: {', '.join(names)}")
        return name

    return AfterValidator(check)


def check_distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand each name once."""
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"allowed is each name once; more than once: {', '.join(doubled)}")
    return names


def check_some(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand one name or more, each once."""
    if not names:
        raise ValueError("allowed is one name or more")
    return check_distinct(names)


def check_words(text: str) -> str:
    """Demand a text that says something."""
    if not text.strip():
        raise ValueError("allowed is a text that is not empty")
    return text


def number_or(names: Collection[str], *, least: float, most: float) -> WrapValidator:
    """Make the rule that a value is a number in a range, or one of some words."""
    number = TypeAdapter(Annotated[float, Field(ge=least, le=most)])

    def check(value: object, _read: ValidatorFunctionWrapHandler) -> object:
        if isinstance(value, str) and value in names:
            return value
        try:
            return number.validate_python(value, strict=True)
        except ValidationError as error:
            raise _refuse(error, names) from None

    return WrapValidator(check)


def _take_off(value: object, read: ValidatorFunctionWrapHandler) -> object:
    if value == OFF:
        return None
    try:
        return read(value)
    except ValidationError as error:
        raise _refuse(error, [OFF]) from None


def _refuse(error: ValidationError, words: Collection[str]) -> PydanticCustomError:
    allowed = {
        "reason": error.errors()[0]["msg"],
        "words": " or ".join(f'"{word}"' for word in words),
    }
    return PydanticCustomError("word_or", "{reason}, or {words}", allowed)


Distinct = AfterValidator(check_distinct)
Some = AfterValidator(check_some)
OrOff = WrapValidator(_take_off)
Words = Annotated[str, AfterValidator(check_words)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
PositiveOrOff = Annotated[Positive | None, OrOff]


# Reading TOML into a closed table; the one place where a mistake in it is put into words.

if TYPE_CHECKING:
    Tables = Mapping[tuple[str, ...], type[Table]]

Whole = TypeVar("Whole", bound=Table)

WRONG_KEY = "[key]"
"""What pydantic adds to the place of a name that is not allowed; the name stands before it."""


def parse_toml(path: Path, model: type[Whole], *, tables: Tables) -> Whole:
    """Read a TOML file into the table that it is to be."""
    try:
        # By way of JSON, where strict reading takes an array for a tuple, but no "5" or true for a number.
        content = json.dumps(
            tomllib.loads(path.read_text(encoding="utf-8-sig")), default=_refuse_time
        )
    except TypeError as error:
        raise ValueError(f"{path.name}: {error}") from None
    except ValueError as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: got no TOML ({error}); mend that place") from None
    except RecursionError:
        raise ValueError(f"{path}: got TOML that is nested too deeply; mend that place") from None
    try:
        return model.model_validate_json(content, strict=True)
    except ValidationError as error:
        lines = (
            f"{path.name}: {_translate(detail, tables)}"
            for detail in error.errors(include_url=False)
        )
        raise ValueError("\n".join(lines)) from None


def _refuse_time(value: object) -> NoReturn:
    # A TypeError is how `json` wants to be told.
    raise TypeError(
        f"got the date or time {value}, allowed are texts, numbers, true and false; put it in quotes"
    )


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
    got = (
        ""
        if "{" in repr(detail["input"]) or reason.startswith("got ")
        else f"got {detail['input']!r}, "
    )
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
