"""How figures look: made for print.

Conventions: one column wide (8.5 cm), so that text keeps its size in a paper and on a telephone; every
reducer has a colour and a marker of its own, the same in all figures, so that colour is never alone.
"""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN_CM = 8.5
CM_PER_INCH = 2.54
THIN, GREY, BLACK = 0.5, "#8A8A8A", "#000000"
BLUE, RED, PALE = "#0072B2", "#D55E00", "#D6E6F2"
"""For figures that tell two kinds apart: Okabe and Ito's blue and vermilion, and a background."""

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colour-blind safe; its yellow is left out because it fades on white paper."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "p")
"""As many as can be told apart in print; a pair of colour and marker comes again only after 77 reducers."""

PRINT: Any = {
    "font.family": "DejaVu Sans", "font.size": 7, "axes.labelsize": 7.5, "axes.titlesize": 7,
    "figure.titlesize": 7, "figure.labelsize": 7.5,
    "xtick.labelsize": 7, "ytick.labelsize": 7, "legend.fontsize": 7, "axes.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.titlelocation": "left",
    "lines.markersize": 4, "lines.linewidth": 0.8, "text.parse_math": False,
    "svg.fonttype": "path", "svg.hashsalt": "feel321",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Look:
    """Colour and marker of a reducer.

    Parameters
    ----------
    colour : str
        Hexadecimal.
    marker : str
        One of matplotlib's letters.
    """

    colour: str
    marker: str


def assign_looks(reducers: Sequence[str]) -> dict[str, Look]:
    """Give every reducer a look.

    Parameters
    ----------
    reducers : sequence of str
        All names of a study, in order.

    Returns
    -------
    dict of str to Look
        In the same order, no two alike.
    """
    colours, markers = len(OKABE_ITO), len(MARKERS)
    return {name: Look(OKABE_ITO[i % colours], MARKERS[i % markers]) for i, name in enumerate(reducers)}


@contextmanager
def print_style() -> Iterator[None]:
    """Set fonts and lines for print while figures are drawn or saved.

    Yields
    ------
    None
        matplotlib's own settings come back at the end.
    """
    from matplotlib import rc_context, rcParamsDefault

    # All settings but the window's start from the library's own: a matplotlibrc in the working folder must not
    # change a byte.
    plain = {name: value for name, value in rcParamsDefault.items() if not name.startswith(("backend", "_"))}
    with rc_context({**plain, **PRINT}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")  # `list_undrawable` tells of them once
        yield


def list_undrawable(names: Iterable[str]) -> str:
    """List the characters that the figures' font does not have.

    Parameters
    ----------
    names : iterable of str
        What is to be written.

    Returns
    -------
    str
        Each such character once, in order; figures show a box for them.
    """
    from matplotlib.font_manager import findfont, get_font

    known = get_font(findfont(PRINT["font.family"])).get_charmap()
    return "".join(sorted({letter for name in names for letter in name if ord(letter) not in known}))


def new_canvas(height_cm: float) -> Figure:
    """Make a figure without axes, one column wide.

    Parameters
    ----------
    height_cm : float
        Height in cm.

    Returns
    -------
    Figure
        Laid out so that nothing overlaps; belongs to no window.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(COLUMN_CM / CM_PER_INCH, height_cm / CM_PER_INCH), layout="constrained")


def new_figure(height_cm: float) -> tuple[Figure, Axes]:
    """Make an empty figure, one column wide.

    Parameters
    ----------
    height_cm : float
        Height in cm.

    Returns
    -------
    figure : Figure
        As `new_canvas` makes it.
    axes : Axes
        Its only axes.
    """
    figure = new_canvas(height_cm)
    return figure, figure.add_subplot()
