"""Why a correlation or its interval is not defined, or less than it seems, told in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.agreement.reliability import SMALLEST
from analysis.resampling.bootstrap import FEWEST_ITEMS, MOST_UNDEFINED, PERFECT, STILL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.resampling.draws import Draws
    from analysis.table.items import Items


def explain_size(items: Items) -> list[str]:
    """Say what was left out, what cells are missing, and which interval one of a kind does not allow.

    Parameters
    ----------
    items : Items
        Ratings.

    Returns
    -------
    list of str
        One sentence each; none if there is nothing to say.
    """
    notes = list(items.notes)
    if items.n_missing:
        cells = items.ratings.size
        notes.append(f"{items.n_missing} of {cells} participant x stimulus cells hold no rating.")
    if items.n_participants < SMALLEST:
        notes.append("One participant only: no interval, the spread between people is unknown.")
    if items.n_recordings < SMALLEST:
        notes.append("One recording only: no two-way interval, the spread between recordings is unknown.")
    elif items.n_sources < SMALLEST:
        notes.append("All recordings come from one source: no two-way interval, the spread between sources is unknown.")
    elif items.n_sources < items.n_recordings:
        notes.append(f"Two-way intervals draw the {items.n_sources} sources of the {items.n_recordings} recordings.")
    return notes


def explain_value(items: Items, drawn: Draws, metrics: tuple[str, ...]) -> list[str]:
    """Say why a correlation is not defined, or what it rests on.

    Parameters
    ----------
    items : Items
        Ratings and metrics.
    drawn : Draws
        Their correlations.
    metrics : tuple of str
        Names of the metrics.

    Returns
    -------
    list of str
        One sentence each; none if there is nothing to say.
    """
    notes = []
    for row, metric in enumerate(metrics):
        if drawn.of_recordings.size:
            notes += _explain_recordings(drawn.of_recordings[row], metric)
        elif np.isnan(drawn.point[row]):
            notes.append(_explain_undefined(items, metric, row=row))
        if abs(drawn.point[row]) >= PERFECT:
            notes.append(f"No interval: the correlation with '{metric}' is perfect, and Fisher's z of that infinite.")
    return notes


def _explain_recordings(correlations: NDArray[np.float64], metric: str) -> list[str]:
    """Say which recordings a correlation within recordings does not rest on, or not as they are."""
    n, defined = len(correlations), int(np.isfinite(correlations).sum())
    perfect = int((np.abs(correlations) >= PERFECT).sum())
    why = f"where it takes three rated stimuli that differ in mean rating and in '{metric}'"
    if not defined:
        return [f"No correlation within any of {n} recordings, {why}."]
    notes = [f"{n - defined} of {n} recordings are left out {why}."] if defined < n else []
    if defined < SMALLEST <= n:
        notes.append("One recording only has a correlation within: no two-way interval.")
    if 0 < perfect < n:
        notes.append(f"In {perfect} of {n} recordings the correlation with '{metric}' is perfect: Fisher's z is held.")
    return notes


def explain_draws(drawn: Draws) -> list[str]:
    """Say how many draws of one metric gave no correlation, both ways of drawing.

    Parameters
    ----------
    drawn : Draws
        The draws; nothing is said of them if the data have no correlation to begin with.

    Returns
    -------
    list of str
        One sentence each; none if there is nothing to say.
    """
    if np.isnan(drawn.point[0]):
        return []
    two_way = explain_undrawn(drawn.two_way[0], "two-way")
    return [*two_way, *explain_undrawn(drawn.participants[0], "participants-only")]


def explain_undrawn(drawn: NDArray[np.float64], kind: str) -> list[str]:
    """Say how many draws gave no result, or that all gave the same.

    Parameters
    ----------
    drawn : ndarray, shape (draws,)
        Results; NaN where there is none.
    kind : str
        What the draws are called.

    Returns
    -------
    list of str
        One sentence; none if there is nothing to say.
    """
    undefined = int(np.isnan(drawn).sum())
    if not undefined:
        same = np.ptp(drawn) <= STILL
        return [f"All {drawn.size} {kind} draws gave the same: no interval without spread."] if same else []
    why = "fewer than three stimuli, a constant, or all points on a line"
    note = f"{undefined} of {drawn.size} {kind} draws gave no correlation ({why}) and are left out"
    return [f"{note}: too many for an interval." if undefined > MOST_UNDEFINED * drawn.size else f"{note}."]


def _explain_undefined(items: Items, metric: str, *, row: int = 0) -> str:
    if items.n_items < FEWEST_ITEMS:
        return f"No correlation: it needs {FEWEST_ITEMS} test stimuli, got {items.n_items}."
    if np.ptp(items.metrics[row]) == 0:
        return f"No correlation: '{metric}' is the same for every stimulus."
    return "No correlation: the mean rating is the same for every stimulus."
