"""Repeated-measures correlation: the association within participants, pooled over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.arrays import check_labels, read_numbers
from feel321.analysis.resampling import FLAT, PERFECT
from feel321.analysis.words import CONFIDENCE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RepeatedMeasures:
    """A repeated-measures correlation.

    Parameters
    ----------
    r : float
        The correlation; NaN where x or y does not vary within any participant.
    df : int
        n - participants - 1, for n rows.
    p : float
        Two-sided.
    low, high : float
        95 % interval; NaN where r is perfect, or df is below 2.
    n, n_participants : int
        Rows and participants.
    notes : tuple of str
        Why anything is NaN, one sentence each.
    """

    r: float
    df: int
    p: float
    low: float
    high: float
    n: int
    n_participants: int
    notes: tuple[str, ...] = ()


class _Within(NamedTuple):
    """What is left of x and y without their participants' means; all 0 where that is rounding only."""

    x: Values
    y: Values


def repeated_measures_correlation(
    x: ArrayLike, y: ArrayLike, participant: ArrayLike
) -> RepeatedMeasures:
    """Correlate x and y within participants.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Paired values, one row per judgement.
    participant : array_like, shape (n,)
        Who each row belongs to. A participant with a single row says nothing about the inside and leaves r
        as it is.

    Returns
    -------
    RepeatedMeasures
        The correlation with its test and interval.

    Raises
    ------
    ValueError
        If lengths differ, pandas' labels are in different orders, a value is not finite, a participant is not named,
        or there are too few rows.

    Notes
    -----
    Model: y = a line with one common slope and an intercept per participant, plus independent errors of equal
    spread. r is the correlation of x and y, each with its participant's mean taken off; with N rows and P
    participants df = N - P - 1, t = r √(df / (1 - r²)), and the interval is tanh(atanh r ± 1.96 / √(df - 1)):
    Fisher's z with n = df + 2 (rmcorr from 0.5 on; earlier releases and the paper took n = df).

    **Its p is not for conclusions here.** Rows of one stimulus are taken for independent evidence on the
    metric; when they are not, this test finds a relation in half of the studies where there is none. Use
    `correlate`, or the mixed model.

    References
    ----------
    Bland & Altman (1995), BMJ 310, 446, doi 10.1136/bmj.310.6977.446.
    Bakdash & Marusich (2017), Frontiers in Psychology 8, 456, doi 10.3389/fpsyg.2017.00456.

    Examples
    --------
    Both participants rate higher what matches better, though the one who felt the better matches rates lower:

    >>> x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    >>> result = repeated_measures_correlation(x, y, ["a", "a", "a", "b", "b", "b"])
    >>> round(result.r, 3), result.df, round(result.p, 4)
    (0.987, 3, 0.0018)
    """
    first, second, number = _check_rows(x, y, participant)
    n, n_participants = len(first), int(number.max()) + 1
    df = n - n_participants - 1
    if df < 1:
        raise ValueError(
            f"participant: got {n} rows of {n_participants} participants, allowed is at least participants + 2 rows"
        )
    inside = _Within(_take_off_means(first, number), _take_off_means(second, number))
    r, notes = _correlate(inside)
    low, high = _interval(r, df)
    if np.isnan(low) and np.isfinite(r):
        notes = [
            "No interval: the correlation is perfect, or fewer than 2 degrees of freedom are left."
        ]
    return RepeatedMeasures(r, df, _p(r, df), low, high, n, n_participants, tuple(notes))


def _check_rows(
    x: ArrayLike, y: ArrayLike, participant: ArrayLike
) -> tuple[Values, Values, NDArray[np.intp]]:
    from pandas import factorize

    check_labels(x, y, what="y")
    first, second = read_numbers(x, what="x"), read_numbers(y, what="y")
    number = factorize(np.asarray(participant).ravel())[0]
    if not first.shape == second.shape == (len(number),):
        raise ValueError(
            f"x: got shapes {first.shape}, {second.shape} and {len(number)} names; allowed is one length"
        )
    for name, values in (("x", first), ("y", second)):
        if not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).sum())
            raise ValueError(f"{name}: got {bad} values that are not finite; leave their rows out")
    if (number < 0).any():
        raise ValueError(
            f"participant: got {int((number < 0).sum())} rows without a name; name or leave them out"
        )
    if not len(number):
        raise ValueError("x: got no row, allowed is at least participants + 2")
    return first, second, number


def _take_off_means(values: Values, number: NDArray[np.intp]) -> Values:
    rest = values - (np.bincount(number, values) / np.bincount(number))[number]
    flat = (rest**2).sum() <= FLAT * (values**2).sum()
    return np.zeros_like(rest) if flat else rest


def _correlate(inside: _Within) -> tuple[float, list[str]]:
    for name, values in zip("xy", inside, strict=True):
        if not values.any():
            return float("nan"), [f"No correlation: {name} does not vary within any participant."]
    x, y = inside
    return float(np.clip(x @ y / np.sqrt((x @ x) * (y @ y)), -1, 1)), []


def _p(r: float, df: int) -> float:
    from scipy.stats import t

    if abs(r) >= PERFECT:
        return 0.0
    return float(2 * t.sf(abs(r) * np.sqrt(df / (1 - r**2)), df))


def _interval(r: float, df: int) -> tuple[float, float]:
    from scipy.stats import norm

    if df < 2 or not abs(r) < PERFECT:  # noqa: PLR2004 - the standard error divides by df - 1
        return float("nan"), float("nan")
    z, margin = np.arctanh(r), norm.ppf((1 + CONFIDENCE) / 2) / np.sqrt(df - 1)
    return float(np.tanh(z - margin)), float(np.tanh(z + margin))
