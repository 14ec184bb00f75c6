"""Change single settings in the text of a `study.toml`, and keep its comments."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from feel321.files import write_text
from feel321.study.settings.read import read_settings

if TYPE_CHECKING:
    from collections.abc import Mapping


def change_settings(text: str, changes: Mapping[str, object]) -> str:
    r"""Change settings by their dotted names; None takes a setting out, so that its default holds.

    Examples
    --------
    >>> print(change_settings("[rig]\nheadroom = 0.9  # of full scale", {"rig.headroom": 0.5}))
    [rig]
    headroom = 0.5  # of full scale
    """
    for name, value in changes.items():
        wanted = tomllib.loads(text)
        *tables, key = name.split(".")
        inner: Any = wanted
        for table in tables:
            inner = inner.setdefault(table, {}) if isinstance(inner, dict) else None
        if not re.fullmatch(r"[\w-]+(\.[\w-]+)+", name) or not isinstance(inner, dict):
            raise ValueError(f"settings must have names such as 'session.repeats', got {name!r}")
        inner.pop(key, None)
        if value is not None:
            inner[key] = json.loads(json.dumps(value))
        line = None if value is None else f"{key} = {_write(value)}"
        text = _change(text, ".".join(tables), key, line=line)
        if tomllib.loads(text) != wanted:
            raise ValueError(
                f"{name}: not written in a way that can be changed here; edit study.toml"
            )
    return text


def _change(text: str, table: str, key: str, *, line: str | None) -> str:
    lines = text.split("\n")
    heads = [number for number, one in enumerate(lines) if re.match(r"\s*\[", one)]
    begin = next((n for n in heads if re.match(rf"\[{table}\]", lines[n])), None)
    if begin is None:
        return text if line is None else f"{text.rstrip()}\n\n[{table}]\n{line}\n"
    end = min((number for number in heads if number > begin), default=len(lines))
    for number in range(begin + 1, end):
        if re.match(rf"\s*{key}\s*=", lines[number]):
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
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_write, value))}]"
    return json.dumps(value, ensure_ascii=False)


def edit_settings(path: Path, changes: Mapping[str, object]) -> None:
    """Change settings in a `study.toml`, which is left as it is if a setting is refused."""
    text = change_settings(path.read_text(encoding="utf-8-sig"), changes)
    with TemporaryDirectory() as folder:
        trial = Path(folder) / path.name
        trial.write_text(text, encoding="utf-8")
        read_settings(trial)
    write_text(path, text)
