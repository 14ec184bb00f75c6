"""Kinds of values and tables of `study.toml` and `rig.toml`, and TOML read with errors that name the place.

A rule refuses with "must be ...; what to do"; `parse_toml` adds the place and the value that was found there.
"""

import json
import re
import tomllib
from collections.abc import Callable, Collection, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, Field, ValidationError, WrapValidator
from pydantic_core import ErrorDetails, PydanticCustomError
from pydantic_core.core_schema import ValidationInfo

from feel321 import intake
from feel321.extensions import is_given

OFF = "off"  # switches a setting off: TOML has no null
MOST = 1e9
"""Beyond this no setting means anything, whatever its unit; what costs time or memory has a ceiling of its own."""


class TomlTable(BaseModel):
    """A table of a TOML file: no unknown keys, no guessing of types, no changes after reading."""

    model_config = {"extra": "forbid", "frozen": True}


def one_of(names: Collection[str]) -> AfterValidator:
    """Make the rule that a name is one of a registry's."""
    return AfterValidator(lambda name: check_one_of(name, names))


def check_one_of(name: str, names: Collection[str]) -> str:
    """Demand one of several names."""
    if name not in names:
        near = get_close_matches(name, list(names), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"must be one of {', '.join(names)}{hint}")
    return name


def own_or_one_of(names: Collection[str], kind: str, table: str) -> AfterValidator:
    """Make the rule that a name is one of a registry's, or one of the lab's own methods; they are not imported yet."""

    def check(name: str, info: ValidationInfo) -> str:
        declared = (info.context or {}).get(table)
        known = declared if isinstance(declared, dict) else {}
        return name if is_given(kind, name, known) else check_one_of(name, names)

    return AfterValidator(check)


def like(pattern: str, words: str) -> AfterValidator:
    """Make the rule that a text is of a form; its first group is kept."""

    def check(text: str) -> str:
        if (found := re.fullmatch(pattern, text)) is None:
            raise ValueError(f"must be {words}")
        return found[1]

    return AfterValidator(check)


def check_distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand each name once."""
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"must hold each name once; more than once: {', '.join(doubled)}")
    return names


def check_some(names: tuple[str, ...]) -> tuple[str, ...]:
    """Demand one name or more, each once."""
    if not names:
        raise ValueError("must hold at least one name")
    return check_distinct(names)


def _check_words(text: str) -> str:
    if not text.strip():
        raise ValueError("must not be empty")
    return text


def _take_off(value: object, read: Callable[[object], object]) -> object:
    if value == OFF:
        return None
    try:
        return read(value)
    except ValidationError as error:
        reason = {"reason": error.errors()[0]["msg"]}
        raise PydanticCustomError("or_off", '{reason} or "off"', reason) from None


Distinct = AfterValidator(check_distinct)
Some = AfterValidator(check_some)
OrOff = WrapValidator(_take_off)
Words = Annotated[str, AfterValidator(_check_words)]
Count = Annotated[int, Field(ge=0, le=10**6)]
AtLeastOne = Annotated[int, Field(ge=1, le=10**6)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Positive = Annotated[float, Field(gt=0, le=MOST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=MOST, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-MOST, le=MOST, allow_inf_nan=False)]
Rate = Annotated[Positive, Field(le=10**6)]
Seconds = Annotated[NotNegative, Field(le=86400)]
Share = Annotated[float, Field(ge=0, le=1)]
PositiveOrOff = Annotated[Positive | None, OrOff]

Whole = TypeVar("Whole", bound=TomlTable)


def parse_toml(path: Path, model: type[Whole]) -> Whole:
    """Read a TOML file into the table that it is to be."""
    try:
        # By way of JSON, where strict reading takes an array for a tuple, but no "5" or true for a number.
        tables = tomllib.loads(intake.read_small(path))
        content = json.dumps(tables, default=_refuse_time)
    except TypeError as error:
        raise ValueError(f"{path.name}: {error}") from None
    except ValueError as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: not valid TOML ({error}); fix that place") from None
    except RecursionError:
        raise ValueError(f"{path}: TOML nested too deeply; use fewer levels") from None
    try:
        return model.model_validate_json(content, strict=True, context=tables)
    except ValidationError as error:
        details = error.errors(include_url=False)
        lines = (f"{path.name}: {_translate(detail, model)}" for detail in details)
        raise ValueError("\n".join(lines)) from None


def _refuse_time(value: object) -> NoReturn:
    # A TypeError is how `json` wants to be told.
    raise TypeError(
        f"values must be texts, numbers, true or false, got the date or time {value}; put it in quotes"
    )


def _translate(detail: ErrorDetails, model: type[TomlTable]) -> str:
    place, table = _locate(detail["loc"], model)
    match detail["type"]:
        case "json_invalid":  # We wrote the JSON: only its depth can be wrong.
            return "TOML nested too deeply; use fewer levels"
        case "extra_forbidden":
            names = table.model_fields
            near = get_close_matches(str(detail["loc"][-1]), names, n=1)
            known = f"did you mean {near[0]}?" if near else f"known: {', '.join(names)}"
            return f"{place}: unknown setting; {known}"
        case "missing":
            return f"{place}: missing; add it"
        case "value_error":
            reason = str(detail["ctx"]["error"])
        case _:  # What JSON calls an object is a table in TOML.
            reason = detail["msg"].replace("Input should", "must").replace("an object", "a table")
    # Whole tables are too long to repeat, and some reasons say themselves what was found.
    value = repr(detail["input"])
    got = "" if "{" in value or "got " in reason else f"got {intake.clip(value)}"
    if not reason.startswith("must "):
        return f"{place}: {got}{', ' if got else ''}{reason}"
    rule, _, remedy = reason.partition("; ")
    return f"{place} {rule}{', ' if got else ''}{got}{'; ' if remedy else ''}{remedy}"


def _locate(location: Sequence[int | str], model: type[TomlTable]) -> tuple[str, type[TomlTable]]:
    """Write a place as the file's author counts, `recordings[1].unit`, and find the table that it lies in."""
    place, tables = "", [model]
    for part in location:
        if isinstance(part, int):
            place += f"[{part + 1}]"
        elif len(tables) > 1:  # the kind of a table, which is no key
            tables = [table for table in tables if part in table.model_fields][:1]
        elif part != "[key]":  # what pydantic adds to a name that is not allowed
            place += f".{part}" if place else part
            field = tables[0].model_fields.get(part)
            tables = (list_tables(field.annotation) if field else []) or tables
    return place, tables[0]


def list_tables(kind: Any) -> list[type[TomlTable]]:  # noqa: ANN401 - any annotation
    """List the tables that an annotation speaks of."""
    if isinstance(kind, type) and issubclass(kind, TomlTable):
        return [kind]
    return [table for inner in get_args(kind) for table in list_tables(inner)]
