"""The page of settings: every key of `study.toml` and `rig.toml`."""

from __future__ import annotations

from pathlib import Path

from docsite.text import quiet, table, title, write
from feel321.study.all_settings import FILES, list_settings

MOST_NAMES = 12
"""Of what a key may be; more of them are reducers, which have a page of their own."""


def write_settings(path: Path) -> None:
    """Write a table for each table."""
    parts = [
        title("Settings"),
        "Every key of ``study.toml`` and ``rig.toml``; ``feel321 new --all-settings`` prints the same list. A key that"
        " is left out has its default; a key that does not exist is refused, with the nearest name as a hint.\n",
    ]
    for file in FILES:
        parts.append(title(file, "-"))
        listed = list_settings(file)
        for where in dict.fromkeys(each.table for each in listed):
            rows = [
                (
                    f"``{one.key}``",
                    _shorten(one.allowed),
                    _show(one.default),
                    one.unit,
                    quiet(one.meaning),
                )
                for one in listed
                if one.table == where
            ]
            header = ("name", "type", "default", "unit", "meaning")
            parts += [
                title(where or "At the top", "~"),
                table(header, rows, widths="18 22 18 8 34"),
            ]
    write(path, *parts)


def _show(default: str) -> str:
    return default if default in {"", "required"} else f"``{default}``"


def _shorten(allowed: str) -> str:
    names = allowed.split(", ")
    if len(names) <= MOST_NAMES:
        return quiet(allowed)
    return f"{', '.join(names[:4])} and others: :doc:`reducers`"
