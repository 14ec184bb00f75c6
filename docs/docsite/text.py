"""Building blocks of generated pages, in reStructuredText."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path


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


def block(language: str, text: str) -> str:
    """Show text as it stands."""
    lines = "\n".join(f"   {line}".rstrip() for line in text.splitlines())
    return f".. code-block:: {language}\n\n{lines}\n"


def quiet(text: str) -> str:
    """Show characters that reStructuredText would read as its own."""
    for mark in ("\\", "*", "|", "`"):
        text = text.replace(mark, f"\\{mark}")
    return text.replace("_ ", "\\_ ")


def write(path: Path, *parts: str) -> None:
    """Write a page unless it is there already, so that Sphinx reads again only what has changed."""
    text = "\n".join(part.rstrip("\n") + "\n" for part in parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
