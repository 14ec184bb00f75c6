"""Change single settings in a `study.toml`; its comments and everything else stay as they are."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Item, Table

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
    document = tomlkit.parse(text)
    for name, value in changes.items():
        if not re.fullmatch(r"[\w-]+(\.[\w-]+)+", name):
            raise ValueError(f"settings must have names such as 'session.repeats', got {name!r}")
        *tables, key = name.split(".")
        place: Any = document
        for table in tables:
            if value is not None and table not in place:
                place[table] = tomlkit.table()
            place = place.get(table, {})
            if not isinstance(place, dict):
                where = ".".join(tables)
                raise ValueError(f"{name}: {where} is not a table of settings; edit study.toml")  # noqa: TRY004 - of the file
        _put(place, key, None if value is None else _as_toml(name, value))
    return tomlkit.dumps(document)


def _put(table: Any, key: str, item: Item | None) -> None:  # noqa: ANN401 - any table of tomlkit's
    """Put a value into a table: the comment behind the one before stays, a new one goes before trailing comments."""
    if item is None:
        table.pop(key, None)
        return
    before = table.get(key)
    tail: list[Any] = []
    if isinstance(before, Item):
        item.trivia.comment, item.trivia.comment_ws = (
            before.trivia.comment,
            before.trivia.comment_ws,
        )
    elif isinstance(table, Table):
        body = table.value.body
        while body and body[-1][0] is None:
            tail.insert(0, body.pop())
        table[key] = item
        body += tail
        return
    table[key] = item


def _as_toml(name: str, value: object) -> Item:
    """Turn tuples into lists and numpy's numbers into Python's; refuse what TOML cannot hold."""
    try:
        plain = json.dumps(value, allow_nan=False, default=lambda one: one.tolist())
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            f"{name} must be text, a number, true or false, or a list or table of these; got {describe(value)}"
        ) from None
    item: Item = tomlkit.item(json.loads(plain))
    return item


def edit_settings(path: Path, changes: Mapping[str, object]) -> None:
    """Change settings in a `study.toml`, which is left as it is if a setting is refused."""
    before = intake.read_small(path)
    newline = "\r\n" if "\r\n" in before else "\n"
    try:
        text = change_settings(before.replace("\r\n", "\n"), changes).replace("\n", newline)
    except (TOMLKitError, RecursionError):
        read_settings(path)  # which names the file and the line
        raise
    with temporary_folder() as folder:
        trial = folder / path.name
        write_text(trial, text)
        read_settings(trial, path.parent)
    write_text(path, text)
