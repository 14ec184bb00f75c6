"""Change single settings in a `study.toml`; its comments and everything else stay as they are."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from feel321 import intake
from feel321.doors import describe
from feel321.files import temporary_folder, write_text
from feel321.study.settings.read import read_settings


def change_settings(text: str, changes: Mapping[str, object]) -> str:
    r"""Change settings by their dotted names; None takes a setting out, so that its default holds.

    Examples
    --------
    >>> print(change_settings("[rig]\nheadroom = 0.9  # of full scale", {"rig.headroom": 0.5}))
    [rig]
    headroom = 0.5  # of full scale
    """
    for name, value in changes.items():
        if not re.fullmatch(r"[\w-]+(\.[\w-]+)+", name):
            raise ValueError(f"settings must have names such as 'session.repeats', got {name!r}")
        try:
            wanted = tomllib.loads(text)
        except RecursionError:
            raise ValueError("study.toml: nested too deeply; use fewer levels") from None
        *tables, key = name.split(".")
        inner: Any = wanted
        try:
            for table in tables:
                inner = inner.get(table, {}) if value is None else inner.setdefault(table, {})
            inner.pop(key, None)
        except (AttributeError, TypeError):
            raise ValueError(
                f"{name}: {'.'.join(tables)} is not a table of settings; edit study.toml"
            ) from None
        line = None
        if value is not None:
            inner[key] = _as_toml(name, value)
            line = f"{key} = {_write(inner[key])}"
        text = _change(text, ".".join(tables), key, line=line)
        if not _holds(text, wanted):
            raise ValueError(
                f"{name}: not written in a way that can be changed here; edit study.toml"
            )
    return text


def _as_toml(name: str, value: object) -> Any:  # noqa: ANN401 - whatever TOML holds
    """Turn tuples into lists and numpy's numbers into Python's; refuse what TOML cannot hold."""
    try:
        return json.loads(json.dumps(value, allow_nan=False, default=lambda one: one.tolist()))
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            f"{name} must be text, a number, true or false, or a list or table of these; got {describe(value)}"
        ) from None


def _holds(text: str, wanted: Mapping[str, Any]) -> bool:
    try:
        return tomllib.loads(text) == wanted
    except (tomllib.TOMLDecodeError, RecursionError):
        return False


def _change(text: str, table: str, key: str, *, line: str | None) -> str:
    lines = text.split("\n")
    heads = [number for number, one in enumerate(lines) if re.match(r"\s*\[", one)]
    begin = next((n for n in heads if re.match(rf"\s*\[\s*{table}\s*\]", lines[n])), None)
    if begin is None:
        return text if line is None else f"{text.rstrip()}\n\n[{table}]\n{line}\n"
    end = min((number for number in heads if number > begin), default=len(lines))
    for number in range(begin + 1, end):
        if re.match(rf"\s*(['\"]?){key}\1\s*=", lines[number]):
            last, comment = _find_end(lines, number, end)
            kept = [] if line is None else [f"{line}{comment}"]
            return "\n".join([*lines[:number], *kept, *lines[last + 1 :]])
    if line is None:
        return text
    while not lines[end - 1].strip() or lines[end - 1].startswith("#"):
        end -= 1
    return "\n".join([*lines[:end], line, *lines[end:]])


def _find_end(lines: list[str], begin: int, end: int) -> tuple[int, str]:
    """Find the last line of a value that may take several, and the comment behind it."""
    for last in range(begin, end):
        value = "\n".join(lines[begin : last + 1])
        for mark in [*re.finditer(r"\s*#", lines[last]), None]:
            start = len(value) if mark is None else len(value) - len(lines[last]) + mark.start()
            try:
                tomllib.loads(value[:start])
            except tomllib.TOMLDecodeError:
                continue
            return last, value[start:]
    return begin, ""


def _write(value: object) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(key)} = {_write(one)}" for key, one in value.items())
        return f"{{ {inner} }}"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def edit_settings(path: Path, changes: Mapping[str, object]) -> None:
    """Change settings in a `study.toml`, which is left as it is if a setting is refused."""
    before = intake.read_small(path)
    newline = "\r\n" if "\r\n" in before else "\n"
    try:
        text = change_settings(before.replace("\r\n", "\n"), changes).replace("\n", newline)
    except tomllib.TOMLDecodeError:
        read_settings(path)  # which names the file and the line
        raise
    with temporary_folder() as folder:
        trial = folder / path.name
        write_text(trial, text)
        read_settings(trial, path.parent)
    write_text(path, text)
