"""`manifest.json`, written and read entry by entry: that of a large set is never in memory as a whole.

What is said of the whole set comes first, then the tables with one entry per recording or stimulus. The layout is that
of `json.dumps(..., indent=1)`.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from feel321.files import write_chunks

NAME = "manifest.json"
LONG = ("conditioning", "keys", "measured", "sensation_levels_db", "stimuli")
"""Tables with an entry per recording or stimulus."""

_SECTION = re.compile(r' "(\w+)": (.*)')

MISREAD = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError)
"""Errors of reading a file that is missing, damaged, or not ours."""


def write_details(
    folder: Path,
    *,
    head: Mapping[str, Any],
    tables: Mapping[str, Iterable[tuple[str, Any]]],
    rows: Iterable[Mapping[str, Any]],
) -> None:
    """Write `manifest.json`, whole or not at all: what is said of the set, its tables, and its rows."""
    write_chunks(folder / NAME, _list_lines(head, tables, rows))


def _list_lines(
    head: Mapping[str, Any],
    tables: Mapping[str, Iterable[tuple[str, Any]]],
    rows: Iterable[Mapping[str, Any]],
) -> Iterator[str]:
    yield "{\n"
    for name in sorted(head):
        yield f" {json.dumps(name)}: {_dump(head[name], 1)},\n"
    for name in sorted(tables):
        entries = (f"{json.dumps(key)}: {_dump(value, 2)}" for key, value in tables[name])
        yield from (f" {json.dumps(name)}: {{", *_separate(entries), "\n },\n")
    yield from (' "stimuli": [', *_separate(_dump(row, 2) for row in rows), "\n ]\n}\n")


def _dump(value: object, level: int) -> str:
    return json.dumps(value, indent=1, sort_keys=True).replace("\n", "\n" + " " * level)


def _separate(entries: Iterable[str]) -> Iterator[str]:
    for place, entry in enumerate(entries):
        yield f"{',' if place else ''}\n  {entry}"


def read_head(folder: Path) -> dict[str, Any]:
    """Read what is said of the whole set."""
    head: dict[str, Any] = {}
    for section, _, value in _scan(folder / NAME, skip=LONG):
        if section in LONG:
            break
        head[section] = value
    return head


def iterate_tables(folder: Path, *names: str) -> Iterator[tuple[str, str, Any]]:
    """Iterate over the entries of some tables: name, key (empty for a row), value."""
    skip = [name for name in LONG if name not in names]
    for section, key, value in _scan(folder / NAME, skip=skip):
        if section in names:
            yield section, key, value


def iterate_rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Iterate over the rows of the stimuli."""
    return (dict(value) for _, _, value in iterate_tables(folder, "stimuli"))


def _scan(path: Path, *, skip: Iterable[str]) -> Iterator[tuple[str, str, Any]]:
    """Iterate over sections, and over the entries of those that are long; of those to skip only the name is given."""
    with path.open(encoding="utf-8", newline="\n") as file:
        if file.readline() != "{\n":
            raise ValueError(f"{path}: not as feel321 wrote it; build the set again")
        lines = iter(file)
        for line in lines:
            if line.rstrip("\n") == "}":
                return
            found = _SECTION.match(line)
            if found is None:
                raise ValueError(f"{path}: damaged at {line[:40]!r}")
            yield from _read_section(found[1], found[2], lines, is_skipped=found[1] in skip)
    raise ValueError(f"{path}: ends before its end")


def _read_section(
    name: str, first: str, lines: Iterator[str], *, is_skipped: bool
) -> Iterator[tuple[str, str, Any]]:
    """Read a section up to its end, which stands in a line of its own unless it begins and ends in one."""
    rest = () if first.rstrip(",") not in {"{", "["} else _until_end(lines)
    if is_skipped:
        yield name, "", None
        for _ in rest:
            pass
    elif name not in LONG:
        body = "".join(rest)
        yield name, "", json.loads(first + body if body else first.rstrip(","))
    else:
        for text in _split(rest):
            is_row = name == "stimuli"
            entry = json.loads(text if is_row else f"{{{text}}}")
            yield from [(name, "", entry)] if is_row else [(name, *one) for one in entry.items()]


def _until_end(lines: Iterator[str]) -> Iterator[str]:
    """Give the lines of a section with the bracket that ends it, without the comma behind that."""
    for line in lines:
        if line[:2] in {" }", " ]"}:
            yield line[:2]
            return
        yield line


def _split(lines: Iterable[str]) -> Iterator[str]:
    """Split the lines of a table at its entries, which begin with two spaces."""
    entry: list[str] = []
    for line in lines:
        begins = line[:2] != "  " or line[2:3] not in {" ", "}", "]"}
        if begins and entry:
            yield "".join(entry).rstrip().removesuffix(",")
            entry = []
        entry.append(line)
