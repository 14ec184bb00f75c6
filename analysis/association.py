"""Does a metric go with what people feel? Item-level correlations with intervals that may be believed.

Stimuli are a sample too: metrics vary only between stimuli, and stimuli cluster in recordings. An interval
over participants alone treats these recordings as the only ones there will ever be; it covers the truth about
half the time. Conclusions therefore come from the two-way interval, for which participants and recordings are
both drawn anew; the narrower one is reported beside it, by name, for comparison with the literature.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.bootstrap import (
    FEWEST_ITEMS,
    METHODS,
    MOST_UNDEFINED,
    bootstrap_margin,
    correlate_draws,
    draw_counts,
    fisher_z,
)
from analysis.items import Items, make_items
from analysis.reliability import SMALLEST, noise_ceiling

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

COMPLETE = 0.5
"""Share of the stimuli that everyone must have rated for a ceiling to speak of them all."""


@dataclass(frozen=True, slots=True)
class Association:
    """How a metric goes with mean ratings over stimuli.

    Parameters
    ----------
    value : float
        Correlation of the stimuli's mean ratings with the metric; NaN where it is not defined.
    low, high : float
        95 % two-way bootstrap interval, over participants and recordings: the one to conclude from. NaN where
        more than a tenth of the draws are undefined.
    n_items : int
        Number of stimuli.
    ceiling : float
        Noise ceiling, sqrt(ICC(C,k)): what a perfect metric would reach with ratings as noisy as these. NaN
        where fewer than half of the stimuli were rated by everyone.
    disattenuated : float
        value / ceiling; may exceed 1 by chance. NaN for ranks, whose ceiling this is not, and where the
        ceiling rests on fewer stimuli than the value.
    draws : int
        Two-way draws in which the correlation was defined.
    participants_low, participants_high : float
        95 % bootstrap interval over participants only: it treats these stimuli as the only ones.
    n_participants, n_recordings, n_missing : int
        Size of the data; participant x stimulus cells without a rating.
    metric, method : str
        What was correlated, and how.
    notes : tuple of str
        Why anything is NaN or reduced, one sentence each.
    """

    value: float
    low: float
    high: float
    n_items: int
    ceiling: float
    disattenuated: float
    draws: int
    participants_low: float
    participants_high: float
    n_participants: int
    n_recordings: int
    n_missing: int
    metric: str
    method: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Difference:
    """How much better one metric goes with mean ratings than another.

    Parameters
    ----------
    value : float
        Correlation with the first metric minus correlation with the second.
    low, high : float
        95 % two-way bootstrap interval of the difference of Fisher's z, expressed as a difference of
        correlations about the same mean z; covers 0 exactly if that does.
    z_value, z_low, z_high : float
        The same as a difference of Fisher's z.
    first_value, second_value : float
        The two correlations.
    n_items, n_participants, n_recordings, n_missing : int
        Size of the data; participant x stimulus cells without a rating.
    draws : int
        Two-way draws in which the difference was defined.
    first, second, method : str
        What was compared, and how.
    notes : tuple of str
        Why anything is NaN or reduced, one sentence each.
    """

    value: float
    low: float
    high: float
    z_value: float
    z_low: float
    z_high: float
    first_value: float
    second_value: float
    n_items: int
    n_participants: int
    n_recordings: int
    n_missing: int
    draws: int
    first: str
    second: str
    method: str
    notes: tuple[str, ...] = ()


class _Draws(NamedTuple):
    """The correlation with each metric, and Fisher's z of its draws."""

    point: NDArray[np.float64]
    two_way: NDArray[np.float64]
    participants: NDArray[np.float64]


def correlate(
    ratings: DataFrame,
    metric: str,
    *,
    method: str = "pearson",
    draws: int = 2000,
    rng: np.random.Generator,
) -> Association:
    """Correlate mean ratings with a metric over test stimuli.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table of one scale, one row per judgement: participant, recording, rating, the metric's column,
        and stimulus_id or reducer (and level). Rows whose role is not ``test`` are left out.
    metric : str
        Column to correlate with.
    method : str
        ``pearson`` or ``spearman``.
    draws : int
        Number of bootstrap draws, at least 2; 2000 or more for results to be published.
    rng : Generator
        Source of randomness; the same state gives the same result to the last bit.

    Returns
    -------
    Association
        The correlation, its intervals, and its ceiling.

    Raises
    ------
    ValueError
        If the table lacks a column, mixes scales or holds values that are not finite, or an argument is not
        allowed.

    Notes
    -----
    A stimulus's rating is the mean over participants of each participant's mean over repeats. With R
    recordings, T the correlation and T* its bootstrap draws, the interval is tanh(atanh T ± t(.975, R - 1)
    sqrt(R / (R - 1)) SD(atanh T*)). Averaging the stimuli first keeps the many rows of one stimulus from
    posing as independent evidence. Missing cells are allowed; a stimulus then rests on the participants who
    rated it.

    With P participants, fewer than R, P takes the place of R. The formula with R was made for studies with
    more people than recordings; two or three people know their spread on P - 1 degrees of freedom only, and
    with R in both places the interval covered the truth in 67 % (P = 2) and 76 % (P = 3) of simulated studies.

    A draw is undefined, and left out, if it has fewer than three different stimuli, a constant, or all points
    on one line.

    References
    ----------
    Owen (2007), The pigeonhole bootstrap, Annals of Applied Statistics 1, 386-411, doi 10.1214/07-AOAS122.

    Examples
    --------
    >>> import pandas as pd
    >>> tidy = pd.DataFrame({"participant": list("aaaabbbb"), "recording": list("rrssrrss"),
    ...     "reducer": ["mag321", "dft321"] * 4, "spectral_match": [0.2, 1, 0.4, 1] * 2,
    ...     "rating": [20, 70, 35, 90, 25, 80, 30, 75]})
    >>> result = correlate(tidy, "spectral_match", rng=np.random.default_rng(1))
    >>> round(result.value, 2), result.n_items
    (0.99, 4)
    """
    _check_request(method, draws)
    items = make_items(ratings, [metric])
    notes = _explain_size(items)
    drawn = _draw(items, method, draws=draws, rng=rng)
    value = float(drawn.point[0])
    if np.isnan(value):
        notes.append(_explain_undefined(items, metric))
    else:
        notes += _explain_draws(drawn.two_way[0], "two-way")
        notes += _explain_draws(drawn.participants[0], "participants-only")
    low, high = _interval(value, drawn.two_way[0], n_units=_scarcest(items))
    narrow_low, narrow_high = _interval(value, drawn.participants[0], n_units=items.n_participants)
    ceiling = _ceiling(items, notes)
    divisible = method == "pearson" and not items.n_missing
    return Association(
        value=value, low=low, high=high, n_items=items.n_items, ceiling=ceiling,
        disattenuated=value / ceiling if divisible else float("nan"), draws=int(np.isfinite(drawn.two_way[0]).sum()),
        participants_low=narrow_low, participants_high=narrow_high,
        n_participants=items.n_participants, n_recordings=items.n_recordings, n_missing=items.n_missing,
        metric=metric, method=method, notes=tuple(notes),
    )  # fmt: skip


def compare_metrics(
    ratings: DataFrame,
    first: str,
    second: str,
    *,
    method: str = "pearson",
    draws: int = 2000,
    rng: np.random.Generator,
) -> Difference:
    """Compare two metrics by how strongly mean ratings go with each.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table of one scale, as for `correlate`.
    first, second : str
        Columns to compare.
    method : str
        ``pearson`` or ``spearman``.
    draws : int
        Number of bootstrap draws, at least 2.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Difference
        The first correlation minus the second, with the two-way interval.

    Raises
    ------
    ValueError
        If the table lacks a column, mixes scales or holds values that are not finite, or an argument is not
        allowed.

    Notes
    -----
    Both correlations are recomputed in every draw, so their dependence is accounted for. With d = atanh r1 -
    atanh r2, the interval is d ± t(.975, R - 1) sqrt(R / (R - 1)) SD(d*), P in the place of R as for
    `correlate`. It is told as a difference of
    correlations by d -> tanh(m + d / 2) - tanh(m - d / 2), m the mean of the two z.
    """
    _check_request(method, draws)
    if first == second:
        raise ValueError(f"second: got {second!r} twice, allowed is another metric than the first")
    items = make_items(ratings, [first, second])
    notes = _explain_size(items)
    drawn = _draw(items, method, draws=draws, rng=rng)
    undefined = np.flatnonzero(np.isnan(drawn.point))
    notes += [_explain_undefined(items, (first, second)[row], row=int(row)) for row in undefined]
    z_first, z_second = fisher_z(drawn.point)
    differences = np.subtract(*drawn.two_way)
    if not undefined.size:
        notes += _explain_draws(differences, "two-way")
    z, margin = z_first - z_second, bootstrap_margin(differences, _scarcest(items))
    z_range = np.array([z, z - margin, z + margin])
    middle = (z_first + z_second) / 2
    _, low, high = np.tanh(middle + z_range / 2) - np.tanh(middle - z_range / 2)
    return Difference(
        value=float(drawn.point[0] - drawn.point[1]), low=float(low), high=float(high),
        z_value=float(z), z_low=float(z - margin), z_high=float(z + margin),
        first_value=float(drawn.point[0]), second_value=float(drawn.point[1]),
        n_items=items.n_items, n_participants=items.n_participants, n_recordings=items.n_recordings,
        n_missing=items.n_missing, draws=int(np.isfinite(differences).sum()),
        first=first, second=second, method=method, notes=tuple(notes),
    )  # fmt: skip


def _check_request(method: str, draws: int) -> None:
    if method not in METHODS:
        raise ValueError(f"method: got {method!r}, allowed is one of {', '.join(METHODS)}")
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"draws: got {draws}, allowed is 2 or more; use 2000 for results to be published")


def _draw(items: Items, method: str, *, draws: int, rng: np.random.Generator) -> _Draws:
    # Participants are drawn first and recordings second, so that both intervals share the same participants.
    people = draw_counts(items.n_participants, draws, rng=rng)
    scenes = draw_counts(items.n_recordings, draws, rng=rng)
    everyone, everything = np.ones((1, items.n_participants)), np.ones((1, items.n_recordings))
    return _Draws(
        point=correlate_draws(items, method, participants=everyone, recordings=everything)[:, 0],
        two_way=fisher_z(correlate_draws(items, method, participants=people, recordings=scenes)),
        participants=fisher_z(correlate_draws(items, method, participants=people, recordings=np.ones_like(scenes))),
    )


def _scarcest(items: Items) -> int:
    """Count the units that limit a two-way interval: whichever there are fewer of is known less well."""
    return min(items.n_participants, items.n_recordings)


def _interval(value: float, drawn: NDArray[np.float64], *, n_units: int) -> tuple[float, float]:
    z, margin = float(fisher_z(np.asarray(value))), bootstrap_margin(drawn, n_units)
    return float(np.tanh(z - margin)), float(np.tanh(z + margin))


def _ceiling(items: Items, notes: list[str]) -> float:
    complete = np.isfinite(items.ratings).all(axis=0)
    if items.n_participants < SMALLEST or complete.sum() < SMALLEST:
        notes.append("No noise ceiling: it needs two participants who rated the same two stimuli.")
        return float("nan")
    if complete.mean() < COMPLETE:
        notes.append(f"No noise ceiling: only {complete.sum()} of {items.n_items} stimuli were rated by everyone.")
        return float("nan")
    if not complete.all():
        rests = f"The noise ceiling rests on the {complete.sum()} stimuli that every participant rated"
        notes.append(f"{rests}, r on all {items.n_items}; r / ceiling is left out.")
    ceiling = noise_ceiling(items.ratings[:, complete].T)
    if np.isnan(ceiling):
        notes.append("No noise ceiling: mean ratings do not differ between stimuli beyond noise.")
    return ceiling


def _explain_size(items: Items) -> list[str]:
    notes = []
    if items.n_missing:
        cells = items.ratings.size
        notes.append(f"{items.n_missing} of {cells} participant x stimulus cells hold no rating.")
    if items.n_participants < SMALLEST:
        notes.append("One participant only: no interval, the spread between people is unknown.")
    if items.n_recordings < SMALLEST:
        notes.append("One recording only: no two-way interval, the spread between recordings is unknown.")
    return notes


def _explain_draws(drawn: NDArray[np.float64], kind: str) -> list[str]:
    undefined = int(np.isnan(drawn).sum())
    if not undefined:
        return []
    why = "fewer than three stimuli, a constant, or all points on a line"
    note = f"{undefined} of {drawn.size} {kind} draws gave no correlation ({why}) and are left out"
    return [f"{note}: too many for an interval." if undefined > MOST_UNDEFINED * drawn.size else f"{note}."]


def _explain_undefined(items: Items, metric: str, *, row: int = 0) -> str:
    if items.n_items < FEWEST_ITEMS:
        return f"No correlation: it needs {FEWEST_ITEMS} test stimuli, got {items.n_items}."
    if np.ptp(items.metrics[row]) == 0:
        return f"No correlation: '{metric}' is the same for every stimulus."
    return "No correlation: the mean rating is the same for every stimulus."
