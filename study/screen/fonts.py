"""The font of the screen, and how wide its words are.

matplotlib brings the file, so participants of every lab see the same letters whatever fonts are installed.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from study.screen.shapes import LEADING

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

FONT = "DejaVu Sans"
FONT_FILES = ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf")
SLACK = 1.04
"""How much wider the window's own text engine sets a line at most: it rounds letters to whole pixels."""


def find_font_files() -> tuple[Path, Path]:
    """Find the files of the font.

    Returns
    -------
    tuple of Path
        Regular and bold.
    """
    folder = Path(str(files("matplotlib"))) / "mpl-data" / "fonts" / "ttf"
    regular, bold = (folder / name for name in FONT_FILES)
    return regular, bold


def measure(words: str, size: float, *, bold: bool = False) -> float:
    """Measure a line of text.

    Parameters
    ----------
    words : str
        The line.
    size : float
        Height of its letters (em), in pixels.
    bold : bool
        Whether it is bold.

    Returns
    -------
    float
        Its width in pixels.

    Examples
    --------
    >>> round(measure("Continue", 100.0))
    468
    """
    return _measure_em(words, bold=bold) * size * SLACK


@cache
def _measure_em(words: str, *, bold: bool) -> float:
    font = _open_face(bold=bold)
    font.set_text(words, 0.0)
    width, _ = font.get_width_height()
    return float(width) / 64 / 1000


@cache
def _open_face(*, bold: bool) -> FT2Font:
    from matplotlib.ft2font import FT2Font

    font = FT2Font(str(find_font_files()[bold]))
    font.set_size(1000.0, 72.0)
    return font


def wrap(words: str, width: float, *, size: float, bold: bool = False) -> list[str]:
    """Break a text into lines; line breaks of its author stay.

    Parameters
    ----------
    words : str
        The text.
    width : float
        How wide lines may be, in pixels.
    size : float
        Height of the letters (em), in pixels.
    bold : bool
        Whether it is bold.

    Returns
    -------
    list of str
        The lines.

    Examples
    --------
    >>> wrap("one two three", 70.0, size=10.0)
    ['one two', 'three']
    """
    lines: list[str] = []
    for paragraph in words.strip().splitlines():
        lines.append("")
        for word in paragraph.split():
            longer = f"{lines[-1]} {word}".strip()
            if lines[-1] and measure(longer, size, bold=bold) > width:
                lines.append(word)
            else:
                lines[-1] = longer
    return lines


def find_height(lines: list[str], size: float) -> float:
    """Tell how high lines of text are.

    Parameters
    ----------
    lines : list of str
        The lines.
    size : float
        Height of the letters (em), in pixels.

    Returns
    -------
    float
        Their height in pixels.
    """
    return len(lines) * size * LEADING
