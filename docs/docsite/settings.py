"""The reference of `study.toml` and `rig.toml`: every key, what it may be, its default, and what it means."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import PydanticUndefined

from docsite.text import table, title, write
from feel321.study.actuator.rig import Rig
from feel321.study.settings.paper import Condition
from feel321.study.settings.schema import Settings

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

TEMPLATES = Path(__file__).parents[2] / "feel321" / "study" / "settings"
FILES = {"study.toml": (Settings, "all_settings.toml"), "rig.toml": (Rig, "all_rig_settings.toml")}
WORDS = tomllib.loads((Path(__file__).parent / "settings.toml").read_text(encoding="utf-8"))
"""Meanings that no comment of the templates gives, by file and place."""

SIMPLE = {bool: "true or false", int: "whole number", float: "number", str: "text"}


class Setting(NamedTuple):
    """A key: its table ([session.breaks], [[recordings]]), what it may be, its default as TOML, what it means."""

    table: str
    key: str
    allowed: str
    default: str
    meaning: str

    @property
    def place(self) -> str:
        """Table and key, without brackets."""
        return ".".join(filter(None, (self.table.strip("[]"), self.key)))


def list_settings(file: str) -> list[Setting]:
    """List every key of a file."""
    model, template = FILES[file]
    said = read_comments((TEMPLATES / template).read_text(encoding="utf-8")) | WORDS[file]
    found = []
    for where, key, field in _walk(model, "", ""):
        place = ".".join(filter(None, (where.strip("[]"), key)))
        default = _show(field.get_default(call_default_factory=True))
        found.append(Setting(where, key, describe(field), default, said.get(place, "")))
    unknown = WORDS[file].keys() - {each.place for each in found}
    if unknown:
        raise ValueError(
            f"settings.toml: {', '.join(sorted(unknown))}: not a key of {file}; remove it"
        )
    return list(dict.fromkeys(found))


def read_comments(template: str) -> dict[str, str]:
    """Read the comments behind the keys of a template, by place; lines that are commented out count as well."""
    where, last, said = "", "", {}
    for line in template.splitlines():
        text = re.sub(r"^# ?", "", line)
        if head := re.match(r"^\[+([\w.]+)\]+", text):
            where = re.sub(r"^(reducers|metrics|tasks|scales)\.\w+", r"\1.NAME", head[1])
        elif pair := re.match(r"^(\w+) = (?:\"[^\"]*\"|[^#\"])*(?:#\s*(.*))?", text):
            last = f"{where}.{pair[1]}"
            if pair[2] and last not in said:
                said[last] = pair[2]
        elif (more := re.match(r"^ {12,}#\s*(.*)", line)) and last in said:
            said[last] += f" {more[1]}"
    return said


def _walk(model: type[BaseModel], where: str, brackets: str) -> Iterator[tuple[str, str, Any]]:
    """Give table, key and field of every key, tables within tables included."""
    for key, field in model.model_fields.items():
        if field.exclude:  # no key of the file
            continue
        inner, form = _find_tables(field.annotation)
        if not inner:
            yield (
                f"{brackets[:1] * (brackets.count('['))}{where}{']' * brackets.count('[')}",
                key,
                field,
            )
            continue
        if issubclass(inner[0], Condition):  # a value and its source, alike for every condition
            yield f"[{where}]", key, inner[0].model_fields["value"]
            continue
        below = ".".join(filter(None, (where, key, "NAME" if form == "named" else "")))
        for each in inner:
            yield from _walk(each, below, "[[" if form == "list" else "[")


def _find_tables(annotation: object) -> tuple[list[type[BaseModel]], str]:
    """Find the tables that a field holds: one, a list of them, or named ones."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation], ""
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _find_tables(inside[0])
    found = [table for each in inside if each is not NoneType for table in _find_tables(each)[0]]
    if origin in {tuple, list}:
        return found, "list"
    return found, "named" if origin is dict else _find_tables(inside[0])[1] if inside else ""


def describe(field: FieldInfo) -> str:
    """Describe what a key may be: the names that a wrong one is refused with, else its kind and limits."""
    adapter = TypeAdapter(
        Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
    )
    for wrong, kind in (("?", ""), (["?"], "a list of "), ({"?": "?"}, "a list of ")):
        if names := re.search(r"must be one of ([^;]*)", _refuse(adapter, wrong)):
            return kind + names[1]
    return _name_kind(adapter.json_schema() if not _is_wrapped(field) else {}, field)


def _refuse(adapter: TypeAdapter[object], wrong: object) -> str:
    """Give the words with which a value is refused, none if it is not."""
    try:
        adapter.validate_python(wrong)
    except ValidationError as error:
        return "\n".join(each["msg"] for each in error.errors())
    except (TypeError, ValueError, AttributeError):
        pass
    return ""


def _is_wrapped(field: FieldInfo) -> bool:
    try:
        TypeAdapter(field.annotation).json_schema()
    except Exception:  # noqa: BLE001 - pydantic has several for what no schema can say
        return True
    return False


def _name_kind(schema: dict[str, Any], field: FieldInfo) -> str:
    if "anyOf" in schema:
        kinds = [_name_kind(each, field) for each in schema["anyOf"] if each.get("type") != "null"]
        return " or ".join(dict.fromkeys(filter(None, kinds)))
    kinds = {
        "boolean": "true or false",
        "integer": "whole number",
        "number": "number",
        "string": "text",
        "array": "list",
        "object": "table",
    }
    limits = [
        f"{words} {schema[key]:g}"
        for key, words in (
            ("minimum", "from"),
            ("exclusiveMinimum", "above"),
            ("maximum", "to"),
            ("exclusiveMaximum", "below"),
        )
        if key in schema
    ]
    name = kinds.get(schema.get("type", ""), "")
    if name == "list" and "items" in schema:
        name = f"list of: {_name_kind(schema['items'], field)}"
    return " ".join([name, *limits]).strip() or SIMPLE.get(field.annotation, "value")


def _show(value: object) -> str:
    """Show a default as TOML has it."""
    if value is PydanticUndefined:
        return "required"
    if isinstance(value, bool):
        return str(value).lower()
    if value is None or value in ((), {}):
        return ""
    if isinstance(value, str):
        return f'"{value}"' if value else ""
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_show(each) for each in value) + "]"
    return f"{value:g}" if isinstance(value, int | float) else ""


def write_settings(path: Path) -> None:
    """Write the page of all settings, a table for each table."""
    parts = [
        title("Settings"),
        "Every key of ``study.toml`` and ``rig.toml``. A key that is left out has its default; a key that does not"
        " exist is refused, with the nearest name as a hint. ``feel321 new`` writes both files with comments.",
    ]
    for file in FILES:
        parts.append(title(file, "-"))
        listed = list_settings(file)
        for where in dict.fromkeys(each.table for each in listed):
            rows = [
                (
                    f"``{each.key}``",
                    _shorten(each.allowed),
                    f"``{each.default}``" if each.default else "",
                    find_unit(each.place),
                    _capital(each.meaning),
                )
                for each in listed
                if each.table == where
            ]
            parts += [
                title(where or "At the top", "~"),
                table(
                    ("key", "may be", "default", "unit", "meaning"), rows, widths="18 24 18 8 32"
                ),
            ]
    write(path, *parts)


UNITS = {
    "db_per_min": "dB/min", "mm_per_pixel": "mm/pixel", "mv_per_g": "mV/g", "m_s2": "m/s²", "m_s": "m/s", "ms": "ms",
    "kbps": "kbit/s", "hz": "Hz", "db": "dB", "min": "min", "months": "months", "days": "days",
    "h": "h", "s": "s", "v": "V",
}  # fmt: skip
"""End of a key's name -> its unit."""


def find_unit(place: str) -> str:
    """Find the unit of a setting: the end of its name, the longest that there is."""
    return next((unit for end, unit in UNITS.items() if place.endswith(f"_{end}")), "")


MOST_NAMES = 12
"""Of what a key may be; more of them are reducers, which have pages of their own."""


def _shorten(allowed: str) -> str:
    names = allowed.split(", ")
    return (
        allowed
        if len(names) <= MOST_NAMES
        else f"{', '.join(names[:4])} and others: :doc:`reducers`"
    )


def _capital(text: str) -> str:
    text = text.replace("*", "\\*").replace("`", "``")
    return text[:1].upper() + text[1:]
