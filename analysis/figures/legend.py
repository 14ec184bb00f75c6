"""Legends below a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.figures.style import THIN
from analysis.words import wrap_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

    from analysis.figures.style import Look

COLUMNS, LETTERS = 3, 30


def add_legend(figure: Figure, shown: Mapping[str, Artist]) -> None:
    """Give the legend as many columns as its names leave room for, and the figure the height that it takes.

    Parameters
    ----------
    figure : Figure
        Where to.
    shown : Mapping of str to Artist
        Name -> what stands for it.
    """
    tight: dict[str, Any] = {"loc": "outside lower center", "handletextpad": 0, "columnspacing": 0.6, "frameon": False}
    labels = [wrap_name(name, LETTERS) for name in shown]
    for columns in range(COLUMNS, 0, -1):
        legend = figure.legend(list(shown.values()), labels, ncols=columns, **tight)
        size = legend.get_window_extent()
        if size.width <= figure.bbox.width or columns == 1:
            break
        legend.remove()
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + size.height / figure.dpi)


def make_handles(looks: Mapping[str, Look]) -> dict[str, Artist]:
    """Make what stands for each name in a legend.

    Parameters
    ----------
    looks : Mapping of str to Look
        Name -> its look.

    Returns
    -------
    dict of str to Artist
        In the same order.
    """
    from matplotlib.lines import Line2D

    def handle(look: Look) -> Line2D:
        return Line2D([], [], color=look.colour, marker=look.marker, linestyle="none", markeredgecolor="white",
                      markeredgewidth=THIN)  # fmt: skip

    return {name: handle(look) for name, look in looks.items()}
