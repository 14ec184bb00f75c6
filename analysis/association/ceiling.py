"""The noise ceiling of item means: over all stimuli, or over those of one recording at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.agreement.reliability import SMALLEST, noise_ceiling
from analysis.resampling.bootstrap import FLAT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.table.items import Items

    Values = NDArray[np.float64]

COMPLETE = 0.5
"""Share of the stimuli that everyone must have rated for a ceiling to speak of them all."""


def find_ceiling(items: Items, *, within: bool) -> tuple[float, list[str]]:
    """Noise ceiling of the mean ratings, as far as everyone rated the same stimuli.

    Parameters
    ----------
    items : Items
        Ratings.
    within : bool
        Whether only differences between stimuli of the same recording count.

    Returns
    -------
    ceiling : float
        sqrt(ICC(C,k)); NaN where there is none.
    notes : list of str
        Why there is none, or on what it rests.
    """
    complete = np.isfinite(items.ratings).all(axis=0)
    if items.n_participants < SMALLEST or complete.sum() < SMALLEST:
        return float("nan"), ["No noise ceiling: it needs two participants who rated the same two stimuli."]
    if complete.mean() < COMPLETE:
        few = f"only {complete.sum()} of {items.n_items} stimuli were rated by everyone"
        return float("nan"), [f"No noise ceiling: {few}."]
    notes = []
    if not complete.all():
        rests = f"The noise ceiling rests on the {complete.sum()} stimuli that every participant rated"
        notes.append(f"{rests}, r on all {items.n_items}; r / ceiling is left out.")
    table, groups = items.ratings[:, complete].T, items.recordings[complete]
    ceiling = noise_ceiling_within(table, groups) if within else noise_ceiling(table)
    if np.isnan(ceiling):
        where = " of the same recording" if within else ""
        notes.append(f"No noise ceiling: mean ratings do not differ between stimuli{where} beyond noise.")
    return ceiling, notes


def noise_ceiling_within(table: Values, groups: NDArray[np.intp]) -> float:
    """Correlation within groups of targets that a perfect predictor would reach with mean ratings as noisy as these.

    Parameters
    ----------
    table : ndarray, shape (targets, raters)
        Ratings, no cell missing.
    groups : ndarray of int, shape (targets,)
        Number of the group, as the recording, that each target belongs to.

    Returns
    -------
    float
        sqrt((R - E) / R), 0 to 1; NaN where targets of the same group do not differ beyond noise.

    Notes
    -----
    Each group has its own two-way analysis of variance, targets x raters, and the sums of squares are pooled:
    with n_g targets and k raters, R has Σ (n_g - 1) degrees of freedom and the residual E k - 1 times as many. What
    lifts all targets of a group, for everyone or for one rater, is neither signal nor noise here. With one group it
    is `noise_ceiling`.

    Examples
    --------
    >>> table = np.array([[1.0, 2], [3, 5], [6, 6]])
    >>> round(noise_ceiling_within(table, np.zeros(3, int)), 3)
    0.975
    """
    by_target, n_raters = np.zeros(table.shape), table.shape[1]
    for number in np.unique(groups):
        own = table[groups == number]
        by_target[groups == number] = own - own.mean(axis=0)
    targets = by_target.mean(axis=1, keepdims=True)
    signal, noise = float((targets**2).sum()) * n_raters, float(((by_target - targets) ** 2).sum())
    if signal <= FLAT * float((table**2).sum()):
        return float("nan")
    reliability = 1 - noise / (n_raters - 1) / signal
    return float(np.sqrt(reliability)) if reliability > 0 else float("nan")
