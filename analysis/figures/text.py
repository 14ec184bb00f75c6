"""Words in figures: broken by measured width, so that no name runs off or into another."""

from __future__ import annotations

import re
from bisect import bisect_right
from typing import TYPE_CHECKING

from analysis.figures.style import CM_PER_INCH, COLUMN_CM, PRINT
from analysis.table.reading import HIGHEST, LOWEST
from analysis.table.scales import tell_measure
from analysis.words import tell_name, wrap_name

if TYPE_CHECKING:
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
    found, parts = [""], _split(text)
    while parts:
        part = parts.pop(0)
        if not part.startswith("\n") and _measure((found[-1] + part).strip(), size) <= room:
            found[-1] += part
        elif len(found) == lines:
            found[-1] = _cut((found[-1] + part + "".join(parts)).replace("\n", " "), room, size)
            break
        elif found[-1]:
            found.append("")
            parts.insert(0, part.strip("\n"))
        else:
            fits = _count_fitting(part, room, size)
            found[-1] = part[:fits]
            parts.insert(0, part[fits:])
    return "\n".join(line.strip() for line in found)


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


def _split(text: str) -> list[str]:
    """Part a text where a line may break: before line breaks, after spaces and underscores."""
    return re.findall(r"\n[^\s_]*_*[^\S\n]*|[^\s_]+_*[^\S\n]*|_+[^\S\n]*|[^\S\n]+", text)


def _count_fitting(text: str, room: float, size: float) -> int:
    """Count the letters of a word that fit into a line, one at least."""
    return max(1, bisect_right(range(1, len(text)), room, key=lambda count: _measure(text[:count], size)))


def _cut(text: str, room: float, size: float) -> str:
    """Leave the middle out."""

    def shorten(kept: int) -> str:
        tail = kept // 2
        return f"{text[: kept - tail].rstrip()}…{text[len(text) - tail :].lstrip()}"

    kept = bisect_right(range(len(text)), room, key=lambda count: _measure(shorten(count), size)) - 1
    return shorten(max(0, kept))


def _measure(text: str, size: float) -> float:
    """Find how wide a text is, in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(family=PRINT["font.family"], size=size)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])
