"""Mean ratings over the bit rate, with a mapping."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import Polynomial

from feel321.analysis.figures import style
from feel321.analysis.table.schema import BIT_RATE, HIGHEST, LOWEST

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure


def draw_rates(
    rows: Sequence[Mapping[str, Any]], coefficients: Sequence[float], *, scale: str
) -> Figure:
    """Draw the means of rows with `bit_rate_kbps`, `mean`, `low` and `high`; those without a bit rate as bands."""
    points = np.array([[row[key] for key in (BIT_RATE, "mean", "low", "high")] for row in rows])
    coded, plain = points[np.isfinite(points[:, 0])], points[~np.isfinite(points[:, 0])]
    rates = np.geomspace(coded[:, 0].min(), coded[:, 0].max(), 200)
    with style.print_style():
        figure, axes = style.new_figure(height_cm=7.0)
        for _, mean, low, high in plain:
            if np.isfinite(low + high):
                axes.axhspan(low, high, color=style.PALE, linewidth=0, zorder=0)
            axes.axhline(mean, color=style.GREY, linewidth=0.8, zorder=1)
        axes.plot(rates, Polynomial(coefficients)(np.log2(rates)), color=style.BLACK, linewidth=1.0)
        axes.vlines(coded[:, 0], coded[:, 2], coded[:, 3], colors=style.GREY, linewidths=1.0)
        style.plot_marks(axes, coded[:, 0], coded[:, 1], look=style.Look(style.BLACK, "o"))
        axes.set_xscale("log", base=2)
        axes.set_xticks(np.unique(coded[:, 0]), [f"{rate:g}" for rate in np.unique(coded[:, 0])])
        axes.set(xlabel="Bit rate (kbit/s)", ylabel=style.label_scale(scale))
        axes.set_ylim(LOWEST - 3, HIGHEST + 3)
    return figure
