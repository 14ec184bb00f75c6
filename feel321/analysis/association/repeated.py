"""Repeated-measures correlation: the association within participants, pooled over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import (
    FLAT,
    PERFECT,
    Values,
    check_labels,
    fisher_interval,
    read_array,
    read_groups,
)
from feel321.analysis.table.items import is_tidy, open_tests
from feel321.records import Result

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from feel321.analysis.table.items import Table


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class RepeatedMeasures(Result):
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


def repeated_measures_correlation(
    x: Table | ArrayLike, y: str | ArrayLike, participant: ArrayLike | None = None
) -> RepeatedMeasures:
    """Correlate x and y within participants.

    Parameters
    ----------
    x : Table, DataFrame or array_like, shape (n,)
        Ratings of test stimuli; or the values of one variable, one row per judgement.
    y : str or array_like, shape (n,)
        The metric that ratings are correlated with; or the other variable.
    participant : array_like, shape (n,), optional
        Who each row belongs to, unless x holds ratings. A participant with a single row does not vary, and leaves r
        as it is.

    Returns
    -------
    RepeatedMeasures
        The correlation with its test and interval.

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
    Both participants rate better matches higher, though the one who felt the better matches rates lower overall:

    >>> x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    >>> from feel321 import analysis
    >>> result = analysis.repeated_measures_correlation(x, y, ["a", "a", "a", "b", "b", "b"])
    >>> round(result.r, 3), result.df, round(result.p, 4)
    (0.987, 3, 0.0018)
    """
    if is_tidy(x) and isinstance(y, str):
        rows, _ = open_tests(x, (y,))
        x, y, participant = rows[y].to_numpy(), rows["rating"].to_numpy(), rows["participant"]
    first, second, number = _read_rows(x, y, participant)
    n, n_participants = len(first), int(number.max()) + 1
    df = n - n_participants - 1
    if df < 1:
        raise ValueError(
            f"participant must have at least participants + 2 rows, got {n} rows of {n_participants} participants"
        )
    inside = [_remove_means(values, number) for values in (first, second)]
    if flat := [name for name, values in zip("xy", inside, strict=True) if not values.any()]:
        nan, note = float("nan"), f"No correlation: {flat[0]} does not vary within any participant."
        return RepeatedMeasures(nan, df, nan, nan, nan, n, n_participants, (note,))
    one, other = inside
    r = float(np.clip(one @ other / np.sqrt((one @ one) * (other @ other)), -1, 1))
    low, high = fisher_interval(r, df - 1)
    missing = (
        "No interval: the correlation is perfect, or fewer than 2 degrees of freedom are left."
    )
    notes = (missing,) if np.isnan(low) else ()
    return RepeatedMeasures(r, df, _find_p(r, df), low, high, n, n_participants, notes)


def _read_rows(
    x: object, y: object, participant: object
) -> tuple[Values, Values, NDArray[np.intp]]:
    check_labels(x, y, what="y")
    first, second = (read_array(one, what=name, axes=("n",)) for one, name in ((x, "x"), (y, "y")))
    names = np.asarray(participant).ravel()
    if not first.shape == second.shape == names.shape:
        raise ValueError(
            f"x, y and participant must have one length, got {len(first)}, {len(second)} and {names.size}"
        )
    number, distinct = read_groups(names, n=len(names), what="row", of="participant")
    if not distinct:
        raise ValueError("x must have at least participants + 2 rows, got none")
    return first, second, number


def _remove_means(values: Values, number: NDArray[np.intp]) -> Values:
    """Remove participants' means; all 0 where what is left is rounding only."""
    rest = values - (np.bincount(number, values) / np.bincount(number))[number]
    flat = (rest**2).sum() <= FLAT * (values**2).sum()
    return np.zeros_like(rest) if flat else rest


def _find_p(r: float, df: int) -> float:
    from scipy.stats import t

    if abs(r) >= PERFECT:
        return 0.0
    return float(2 * t.sf(abs(r) * np.sqrt(df / (1 - r**2)), df))
