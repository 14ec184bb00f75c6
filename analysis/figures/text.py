"""Words in figures: broken by measured width, so that no name runs off or into another."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from analysis.figures.style import CM_PER_INCH, COLUMN_CM, PRINT
from analysis.scales import tell_measure
from analysis.table import HIGHEST, LOWEST
from analysis.words import tell_name, wrap_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

AXIS_LETTERS, SCALE_LETTERS = 30, 60
"""Letters per line of an axis's label, and of a scale's name within it."""

SIZE = float(PRINT["font.size"])
POINTS_PER_CM = 72 / CM_PER_INCH
MARGIN_CM = 0.2
LONGEST = 200
"""Letters of a name that are looked at, from its start and from its end."""

TITLE_LINES = 10


def tell_scale(scale: str) -> str:
    """Label an axis by the scale that was rated.

    Parameters
    ----------
    scale : str
        Its name.

    Returns
    -------
    str
        What its points measure, and from where to where.
    """
    name = wrap_name(tell_name(scale), SCALE_LETTERS, lines=1)
    return wrap_name(f"Mean {tell_measure(name)} ({LOWEST:.0f}–{HIGHEST:.0f})", AXIS_LETTERS, lines=3)


def fit_text(text: str, width_cm: float, *, lines: int = 2, size: float = SIZE) -> str:
    """Break a text into lines that are no wider than their place.

    Parameters
    ----------
    text : str
        Any text.
    width_cm : float
        Width of the place in cm.
    lines : int
        How many lines at most; what does not fit is cut out of the last, whose end stays: it tells names apart.
    size : float
        Of the letters, in points.

    Returns
    -------
    str
        Lines parted by a line break; an ellipsis stands for what was cut.

    Examples
    --------
    >>> fit_text("dft321_windowed_by_its_authors_2026", 2.0).splitlines()
    ['dft321_', 'window…_2026']
    """
    if len(text) > 2 * LONGEST:
        text = f"{text[:LONGEST]}…{text[-LONGEST:]}"
    room = width_cm * POINTS_PER_CM
    found: list[str] = []
    for part in _split(text, room, size):
        if found and not part.startswith("\n") and _measure(found[-1] + part.rstrip(), size) <= room:
            found[-1] += part
        else:
            found.append(part.lstrip())
    if len(found) > lines:
        found[lines - 1 :] = [_cut("".join(found[lines - 1 :]), room, size)]
    return "\n".join(line.rstrip() for line in found)


def add_title(figure: Figure, text: str) -> None:
    """Write what a figure shows above it, and give the figure the height that this takes.

    Parameters
    ----------
    figure : Figure
        Where to.
    text : str
        Sentences; line breaks are kept.
    """
    fitted = fit_text(text, COLUMN_CM - 2 * MARGIN_CM, lines=TITLE_LINES)
    title = figure.suptitle(fitted, x=MARGIN_CM / COLUMN_CM, ha="left")
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + title.get_window_extent().height / figure.dpi)


def _split(text: str, room: float, size: float) -> Iterator[str]:
    """Part a text where a line may break: after spaces and underscores, and within words wider than a line."""
    for part in re.findall(r"\n?[^\s_]*(?:_+|[^\S\n]+)?", text):
        rest = part
        while rest and _measure(rest.strip(), size) > room:
            fits = max((n for n in range(1, len(rest)) if _measure(rest[:n].strip(), size) <= room), default=1)
            yield rest[:fits]
            rest = rest[fits:]
        if rest:
            yield rest


def _cut(text: str, room: float, size: float) -> str:
    for kept in range(len(text) - 1, 1, -1):
        tail = kept // 2
        short = f"{text[: kept - tail].rstrip()}…{text[-tail:].lstrip()}"
        if _measure(short, size) <= room:
            return short
    return "…"


def _measure(text: str, size: float) -> float:
    """Find how wide a text is, in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(family=PRINT["font.family"], size=size)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])
