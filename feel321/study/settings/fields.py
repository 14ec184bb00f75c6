"""Kinds of values and tables of `study.toml` and `rig.toml`, and TOML read with errors that name the place.

A table is a `TomlTable`, or a record that the engine uses: a dataclass or a named tuple. A rule refuses with "must be
...; what to do"; `parse_toml` adds the place and the value that was found there.
"""

import json
import re
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, NoReturn, TypeVar, get_args, get_origin, get_type_hints

from pydantic import AfterValidator, BaseModel, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ValidationInfo

from feel321.extensions import is_given
from feel321.files import clip, read_small

UNSAID = re.compile(r"str|int|float|constrained-\w+|tuple\[.*|\[key\]")
"""What pydantic adds to a place, and is no key: the kind of a value, or that a name is not allowed."""

OFF = "off"  # switches a number off that may be left out: TOML has no null

MOST = 1e9
"""Beyond this no setting means anything, whatever its unit; what costs time or memory has a ceiling of its own."""


OTHER_NAMES = {
    "break_trials": "every_trials", "break_min": "every_min",
    "training_pass": "pass_share", "training_rounds": "rounds",
}  # fmt: skip
"""Fields of records that the plan names otherwise than `study.toml`, and their names there."""


def name_setting(name: str) -> str:
    """Name a field of a table as TOML does."""
    return OTHER_NAMES.get(name, name)


class TomlTable(BaseModel):
    """A table of a TOML file: no unknown keys, no guessing of types, no changes after reading."""

    model_config = {"extra": "forbid", "frozen": True, "alias_generator": name_setting}


def word_choice(name: str, names: Collection[str]) -> str:
    """Word the rule that a name must be one of several."""
    near = get_close_matches(name, list(names), n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"must be one of {', '.join(names)}{hint}"


def check_one_of(name: str, names: Collection[str]) -> str:
    """Demand one of several names."""
    if name not in names:
        raise ValueError(word_choice(name, names))
    return name


def one_of(names: Collection[str]) -> AfterValidator:
    """Make the rule that a name is one of a registry's."""
    return AfterValidator(lambda name: check_one_of(name, names))


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


Distinct = AfterValidator(check_distinct)
Some = AfterValidator(check_some)
Words = Annotated[str, AfterValidator(_check_words)]
Count = Annotated[int, Field(ge=0, le=10**6)]
AtLeastOne = Annotated[int, Field(ge=1, le=10**6)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Positive = Annotated[float, Field(gt=0, le=MOST)]
NotNegative = Annotated[float, Field(ge=0, le=MOST)]
Finite = Annotated[float, Field(ge=-MOST, le=MOST)]
Rate = Annotated[Positive, Field(le=10**6)]
Seconds = Annotated[NotNegative, Field(le=86400)]
Share = Annotated[float, Field(ge=0, le=1)]

Whole = TypeVar("Whole", bound=TomlTable)


def list_tables(kind: Any) -> list[type]:  # noqa: ANN401 - any annotation
    """List the tables that an annotation speaks of."""
    if isinstance(kind, type) and (
        issubclass(kind, TomlTable) or is_dataclass(kind) or hasattr(kind, "_fields")
    ):
        return [kind]
    return [table for inner in get_args(kind) for table in list_tables(inner)]


def list_fields(table: Any) -> dict[str, FieldInfo]:  # noqa: ANN401 - a model, a dataclass, a named tuple
    """List the keys of a table."""
    if issubclass(table, BaseModel):
        return dict(table.model_fields)
    defaults = table.__dataclass_fields__ if is_dataclass(table) else table._field_defaults
    return {
        name_setting(name): FieldInfo.from_annotated_attribute(hint, defaults[name])
        for name, hint in get_type_hints(table, include_extras=True).items()
    }


def parse_toml(path: Path, model: type[Whole]) -> Whole:
    """Read a TOML file into the table that it is to be."""
    try:
        # By way of JSON, where strict reading takes an array for a tuple, but no "5" or true for a number.
        tables = tomllib.loads(read_small(path))
        _switch_off(tables, [model])
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
        lines: dict[str, str] = {}  # of what may be of several kinds, the first says enough
        for detail in error.errors(include_url=False):
            lines.setdefault(_locate(detail["loc"], model)[0], _translate(detail, model))
        raise ValueError("\n".join(f"{path.name}: {line}" for line in lines.values())) from None


def _refuse_time(value: object) -> NoReturn:
    # A TypeError is how `json` wants to be told.
    raise TypeError(
        f"values must be texts, numbers, true or false, got the date or time {value}; put it in quotes"
    )


def _may_be_off(kind: object) -> bool:
    bases = [getattr(one, "__origin__", one) for one in get_args(kind)]
    return NoneType in bases and bool({int, float} & set(bases))


def _switch_off(entry: dict[str, Any], tables: Sequence[type]) -> None:
    """Put nothing in the place of each "off"."""
    known = {name: one.annotation for table in tables for name, one in list_fields(table).items()}
    for key, value in entry.items():
        kind = known.get(key)
        if value == OFF and _may_be_off(kind):
            entry[key] = None
        inner = list_tables(kind)
        is_named = get_origin(kind) is dict and isinstance(value, dict)
        several = value.values() if is_named else value if isinstance(value, list) else [value]
        for one in several if inner else ():
            if isinstance(one, dict):
                _switch_off(one, inner)


def _translate(detail: ErrorDetails, model: type[TomlTable]) -> str:
    place, table, kind = _locate(detail["loc"], model)
    match detail["type"]:
        case "json_invalid":  # We wrote the JSON: only its depth can be wrong.
            return "TOML nested too deeply; use fewer levels"
        case "extra_forbidden" | "unexpected_keyword_argument":
            names = list_fields(table)
            near = get_close_matches(str(detail["loc"][-1]), names, n=1)
            known = f"did you mean {near[0]}?" if near else f"known: {', '.join(names)}"
            return f"{place}: unknown setting; {known}"
        case "missing":
            return f"{place}: missing; add it"
        case "value_error":
            reason = str(detail["ctx"]["error"])
        case "literal_error":
            allowed = re.findall("'(.*?)'", detail["ctx"]["expected"])
            reason = word_choice(str(detail["input"]), allowed)
        case _:  # What JSON calls an object is a table in TOML.
            reason = detail["msg"].replace("Input should", "must").replace("an object", "a table")
            reason += ' or "off"' * _may_be_off(kind)
    # Whole tables are too long to repeat, and some reasons say themselves what was found.
    value = repr(detail["input"])
    got = "" if "{" in value or "got " in reason else f"got {clip(value)}"
    if not reason.startswith("must "):
        return f"{place}: {got}{', ' if got else ''}{reason}"
    rule, _, remedy = reason.partition("; ")
    return f"{place} {rule}{', ' if got else ''}{got}{'; ' if remedy else ''}{remedy}"


def _locate(location: Sequence[int | str], model: type) -> tuple[str, type, object]:
    """Write a place as the file's author counts, `recordings[1].unit`; find its table, and what may stand there."""
    place, tables, kind = "", [model], None
    for part in location:
        if isinstance(part, int):
            place += f"[{part + 1}]"
        elif not UNSAID.fullmatch(part):
            place += f".{part}" if place else part
            field = list_fields(tables[0]).get(part)
            kind = field.annotation if field else None
            tables = list_tables(kind) or tables
    return place, tables[0], kind
