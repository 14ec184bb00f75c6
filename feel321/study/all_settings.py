"""The complete list of settings, made from the schemas; `settings/meanings.toml` holds the sentence of each key."""

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from feel321.records import to_json_value
from feel321.study.actuator.rig import Rig
from feel321.study.settings.fields import MOST, list_fields, list_tables
from feel321.study.settings.schema import Settings

FILES: dict[str, type[BaseModel]] = {"study.toml": Settings, "rig.toml": Rig}
UNITS = {  # end of a key's name -> its unit
    "db_per_min": "dB/min", "mv_per_g": "mV/g", "m_s2": "m/s²", "ms": "ms", "hz": "Hz", "db": "dB", "min": "min",
    "days": "days", "h": "h", "s": "s", "v": "V",
}  # fmt: skip

KINDS = {
    "boolean": "true or false", "integer": "whole number", "number": "number", "string": "text", "array": "list",
    "object": "table",
}  # fmt: skip
LIMITS = {
    "minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below",
}  # fmt: skip
FORMS: dict[Any, str] = {tuple: "list", dict: "named"}  # of tables


class Setting(NamedTuple):
    """A key: its table ([session.breaks], [[recordings]]), what it may be, its default as TOML, unit, meaning."""

    table: str
    key: str
    allowed: str
    default: str
    unit: str
    meaning: str


def read_meanings(file: str) -> dict[str, str]:
    """Read the sentence of each key of a file, by table and key."""
    path = Path(__file__).parent / "settings" / "meanings.toml"
    meanings: dict[str, str] = tomllib.loads(path.read_text(encoding="utf-8"))[file]
    return meanings


def list_settings(file: str) -> list[Setting]:
    """List every key of `study.toml` or `rig.toml` once, table by table."""
    meanings = read_meanings(file)
    found: dict[str, Setting] = {}
    for table, key, field in _walk(FILES[file], "", "table"):
        place = ".".join(filter(None, (table.strip("[]"), key)))
        unit = next((unit for end, unit in UNITS.items() if key.endswith(f"_{end}")), "")
        default = to_json_value(field.get_default(call_default_factory=True))
        shown = "" if default in (None, "", {}) else json.dumps(default)
        shown = "required" if field.is_required() else shown
        one = Setting(table, key, _describe(field), shown, unit, meanings.get(place, ""))
        found.setdefault(place, one)
    tables = list(dict.fromkeys(one.table for one in found.values()))
    return sorted(found.values(), key=lambda one: tables.index(one.table))


def write_list(file: str) -> str:
    """Write the complete list as TOML, each key as a comment with its default."""
    lines, table = [f"# Every setting of {file}, with its default; copy what you change."], None
    for one in list_settings(file):
        if one.table != table:
            lines += ["", f"# {one.table}"] if one.table else [""]
            table = one.table
        default = "..." if one.default in {"", "required"} else one.default
        kind = ", ".join(filter(None, (one.allowed, one.unit)))
        lines.append(f"# {one.key} = {default}  # {one.meaning} ({kind})")
    return "\n".join(lines) + "\n"


def _walk(model: type, where: str, form: str) -> Iterator[tuple[str, str, FieldInfo]]:
    """Give table, key and field of every key, tables within tables included; form: table, list or named."""
    place = f"[[{where}]]" if form == "list" else f"[{where}]" * bool(where)
    for key, field in list_fields(model).items():
        kind: Any = field.annotation
        while kind is not None and get_origin(kind) not in FORMS:
            kind = next(iter(get_args(kind)), None)
        inner_form, inner = FORMS.get(get_origin(kind), "table"), list_tables(field.annotation)
        if not inner and (where or inner_form != "named"):
            yield place, key, field
        elif not inner:  # a table whose keys are the lab's own
            yield f"[{key}]", "NAME", FieldInfo.from_annotated_attribute(get_args(kind)[1], None)
        below = ".".join(filter(None, (where, key, "NAME" * (inner_form == "named"))))
        for each in inner:
            yield from _walk(each, below, inner_form)


def _describe(field: FieldInfo) -> str:
    """Describe what a key may be: the names that a wrong one is refused with, else its kind and limits."""
    kind: Any = field.annotation
    adapter: TypeAdapter[object] = TypeAdapter(
        Annotated[(kind, *field.metadata)] if field.metadata else kind
    )
    for wrong, several in (("?", ""), (["?"], "a list of "), ({"?": "?"}, "a list of ")):
        try:
            adapter.validate_python(wrong)
        except ValidationError as error:
            if names := re.search(r"must be one of ([^;'\]]*)", str(error)):
                return several + names[1].partition(" [")[0]
        except (TypeError, ValueError, AttributeError):
            continue
    return _name_kind(adapter.json_schema())


def _name_kind(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        kinds = [_name_kind(each) for each in schema["anyOf"] if each.get("type") != "null"]
        return " or ".join(dict.fromkeys(filter(None, kinds)))
    if "enum" in schema:
        return ", ".join(schema["enum"])
    limits = [
        f"{words} {schema[key]:.12g}"
        for key, words in LIMITS.items()
        if key in schema and abs(schema[key]) < MOST
    ]
    name = KINDS.get(schema.get("type", ""), "value")
    if name == "list" and "items" in schema:
        name = f"list of: {_name_kind(schema['items'])}"
    return " ".join([name, *limits])
