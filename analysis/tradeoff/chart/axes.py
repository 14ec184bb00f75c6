"""What the axes of the chart's figures share: names, limits, plain numbers, each reducer's look."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from analysis.figures.style import Look, assign_looks
from analysis.tradeoff.chart.equal import list_members
from analysis.words import start

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axis import Axis

    from analysis.tradeoff.chart.chart import Chart

CUT = -1.0
"""Accuracies below this stand at the edge: spectral match knows no bottom."""

FEW_DECADES = 2.5


def look_up(chart: Chart) -> dict[str, Look]:
    """Give every reducer of a chart its look.

    Parameters
    ----------
    chart : Chart
        Its points name the reducers.

    Returns
    -------
    dict of str to Look
        In the order of the chart; methods merged to one point have the look of the first.
    """
    names = list(dict.fromkeys(point.reducer for point in chart.points))
    looks = assign_looks([member for name in names for member in list_members(name)])
    return {name: looks[list_members(name)[0]] for name in names}


def find_size(look: Look, points: float) -> float:
    """Find the size at which a marker looks as large as others.

    Parameters
    ----------
    look : Look
        With the marker.
    points : float
        Size of the others.

    Returns
    -------
    float
        A star, which is mostly corners, must be larger.
    """
    return 1.6 * points if look.marker == "*" else points


def tell_measure(measure: str) -> str:
    """Label an axis by its measure.

    Parameters
    ----------
    measure : str
        One of `MEASURES`.

    Returns
    -------
    str
        Its name in words.

    Examples
    --------
    >>> tell_measure("temporal_match_invariant")
    'Temporal match, invariant'
    """
    metric, _, kind = measure.partition("_match")
    return start(f"{metric} match") + (f", {kind.strip('_').replace('_', '-')}" if kind else "")


def limit_accuracy(values: Iterable[float]) -> tuple[float, float]:
    """Find the ends of an axis of accuracy.

    Parameters
    ----------
    values : iterable of float
        What it shows.

    Returns
    -------
    tuple of float
        Lowest and highest: from `CUT` or above to 1, with a margin.

    Examples
    --------
    >>> limit_accuracy([0.3, 0.9]), limit_accuracy([-283.0])
    ((-0.04, 1.04), (-1.08, 1.08))
    """
    lowest = max(CUT, min(0.0, *values, 0.0))
    return lowest - 0.04 * (1 - lowest), 1 + 0.04 * (1 - lowest)


def write_plainly(axis: Axis) -> None:
    """Write whole decades on a logarithmic axis as plain numbers; where there are too few, the halves between too.

    Parameters
    ----------
    axis : Axis
        Of either direction.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    parts = (1.0,) if math.log10(high / low) > FEW_DECADES else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=parts))
    axis.set_major_formatter(FuncFormatter(lambda value, _: tell_plainly(value)))
    axis.set_minor_formatter(NullFormatter())


def tell_plainly(value: float) -> str:
    """Write a number of any size without powers.

    Parameters
    ----------
    value : float
        Above 0.

    Returns
    -------
    str
        Its digits, thousands apart.

    Examples
    --------
    >>> tell_plainly(0.001), tell_plainly(20_000)
    ('0.001', '20\u202f000')
    """
    return f"{value:,.0f}".replace(",", "\u202f") if value >= 1 else f"{value:.10f}".rstrip("0")
