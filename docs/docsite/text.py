"""Building blocks of generated pages, in reStructuredText."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

ASIDE = ":orphan:\n"
"""Keeps a page out of the sidebar: with a hundred more entries nobody finds anything, and Sphinx takes a minute."""


def title(text: str, line: str = "=") -> str:
    """Underline a heading."""
    return f"{text}\n{line * len(text)}\n"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, widths: str = "auto") -> str:
    """Make a table whose cells hold text of any length."""
    lines = [".. list-table::", "   :header-rows: 1", f"   :widths: {widths}", ""]
    for row in [header, *rows]:
        for number, cell in enumerate(row):
            first, *rest = cell.splitlines() or [""]
            lines.append(f"   {' ' if number else '*'} - {first}".rstrip())
            lines += [f"       {line}".rstrip() for line in rest]
    return "\n".join(lines) + "\n"


def contents(names: Iterable[str], *, hidden: bool = True) -> str:
    """List the pages that lie below one."""
    options = "   :hidden:\n" if hidden else ""
    return f".. toctree::\n   :maxdepth: 1\n{options}\n" + "".join(f"   {name}\n" for name in names)


def write(path: Path, *parts: str) -> None:
    """Write a page unless it is there already, so that Sphinx reads again only what has changed."""
    text = "\n".join(part.rstrip("\n") + "\n" for part in parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
