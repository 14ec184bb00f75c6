"""Can two stimuli be discriminated? ABX trials: share correct, d' and the chance of guessing as well."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from feel321.analysis.arrays import CONFIDENCE, check_columns
from feel321.analysis.table.items import Table, open_ratings
from feel321.analysis.table.schema import ANSWERED, HIGHEST
from feel321.doors import check_name
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

GUESSING = 0.5
"""Share that comes out right by guessing."""

LARGEST = 12.0
"""From here on a d' is perfect to rounding: an error in 10^6 trials or fewer."""

SPREADS: Mapping[str, float] = MappingProxyType({
    "independent": 2.0,
    "differencing": float(np.sqrt(6)),
})
"""Observer's model -> divisor of d' in the second factor of the share correct; the first is always √2."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Discrimination(Result):
    """How well two stimuli are discriminated in ABX trials.

    Parameters
    ----------
    share : float
        Correct answers over trials.
    wilson_low, wilson_high : float
        95 % Wilson interval of the share.
    exact_low, exact_high : float
        95 % Clopper-Pearson interval of the share: never too narrow, usually wider than needed.
    p : float
        Chance of as many correct answers or more by guessing; exact, one-sided.
    d_independent, d_independent_low, d_independent_high : float
        d' of an observer who judges A, B and X each on its own, and what the Wilson interval translates to;
        0 for a share of .5 or less, infinity for 1.
    d_differencing, d_differencing_low, d_differencing_high : float
        d' of an observer who compares X with A and with B; larger for the same share.
    n_correct, n_trials : int
        What it rests on.
    notes : tuple of str
        What is to be read with care, one sentence each.
    """

    share: float
    wilson_low: float
    wilson_high: float
    exact_low: float
    exact_high: float
    p: float
    d_independent: float
    d_independent_low: float
    d_independent_high: float
    d_differencing: float
    d_differencing_low: float
    d_differencing_high: float
    n_correct: int
    n_trials: int
    notes: tuple[str, ...] = ()


@overload
def discriminate(n_correct: int, n_trials: int) -> Discrimination: ...


@overload
def discriminate(n_correct: Table | DataFrame) -> DataFrame: ...


def discriminate(
    n_correct: int | Table | DataFrame, n_trials: int | None = None
) -> Discrimination | DataFrame:
    """Evaluate ABX trials.

    Parameters
    ----------
    n_correct : int, Table or DataFrame
        Trials of one pair of stimuli answered correctly; or ratings, whose ABX answers are taken per level and reducer,
        each against its reference; or trials with the columns ``first`` and ``second``, the stimuli in either order,
        and ``correct``.
    n_trials : int, optional
        Trials, at least 1; half of them with X = A, so that no bias for a button can pose as discrimination.

    Returns
    -------
    Discrimination or DataFrame
        Share, intervals, test and d' under two models of the observer; of a table, a row per pair (and pooled).

    Notes
    -----
    Model: an unbiased observer, A and B normal with equal spread and d' apart. With Φ the normal distribution
    function the share correct is ::

        independent observations   Φ(d'/√2) Φ(d'/2)  + Φ(-d'/√2) Φ(-d'/2)
        differencing               Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6)

    Which of the two people use is not known from shares alone; with A and B fixed over many trials the first
    is likely, when the pair roves the second. Ends of the interval of d' are the d' of the ends of Wilson's
    interval. Trials are taken for independent: pooled over people, the interval is about these people. A
    share below .5 has d' 0: chance, or answers mixed up. The pooled d' is that of the pooled share, which is smaller
    than the mean d' when pairs differ in difficulty.

    References
    ----------
    Macmillan & Creelman (2005), Detection Theory: A User's Guide, 2nd ed., chapter 9, table A5.3.
    Hautus & Meng (2002), Perception & Psychophysics 64, 89-106, doi 10.3758/BF03194559.
    Wilson (1927), JASA 22, 209-212, doi 10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> from feel321 import analysis
    >>> result = analysis.discriminate(18, 24)
    >>> round(result.share, 2), round(result.p, 4), round(result.d_independent, 2), round(result.d_differencing, 2)
    (0.75, 0.0113, 1.79, 2.02)
    >>> round(result.wilson_low, 3), round(result.wilson_high, 3)
    (0.551, 0.88)
    """
    from scipy.stats import binomtest

    if not isinstance(n_correct, int | float | np.number):
        return _tabulate(n_correct)
    n_trials = 0 if n_trials is None else n_trials
    whole = all(float(count).is_integer() for count in (n_correct, n_trials))
    if not whole or not 0 <= n_correct <= n_trials or n_trials < 1:
        raise ValueError(
            f"n_correct must be 0 to n_trials, of 1 or more trials, got {n_correct} of {n_trials}"
        )
    test = binomtest(int(n_correct), int(n_trials), GUESSING, alternative="greater")
    both = binomtest(int(n_correct), int(n_trials), GUESSING)
    wilson, exact = (both.proportion_ci(CONFIDENCE, method) for method in ("wilson", "exact"))
    share = n_correct / n_trials
    shares = (share, float(wilson.low), float(wilson.high))
    alone, compared = ([abx_d_prime(value, model=model) for value in shares] for model in SPREADS)
    return Discrimination(
        *shares, float(exact.low), float(exact.high), float(test.pvalue), alone[0], alone[1], alone[2],
        compared[0], compared[1], compared[2], int(n_correct), int(n_trials), _explain(share),
    )  # fmt: skip


def _tabulate(trials: Table | DataFrame) -> DataFrame:
    import pandas as pd

    keys: list[dict[str, Any]] = []
    found: list[Discrimination] = []
    rows = open_ratings(trials, what="trials")
    if "scale" not in rows:
        for pair, one in discriminate_pairs(rows).items():
            keys.append(dict(zip(("first", "second"), pair or ("all", "all"), strict=True)))
            found.append(one)
    else:
        check_columns(rows, ["level", "reducer", "role", "rating"], "ratings")
        answers = rows[(rows["scale"] == ANSWERED) & (rows["role"] != "reference")]
        for (level, reducer), part in answers.groupby(["level", "reducer"], observed=True):
            keys.append({"level": level, "reducer": reducer})
            found.append(discriminate(int((part["rating"] == HIGHEST).sum()), len(part)))
    names = [field.name for field in fields(Discrimination)]
    records = ({name: getattr(one, name) for name in names} for one in found)
    return pd.DataFrame([key | record for key, record in zip(keys, records, strict=True)])


def discriminate_pairs(trials: DataFrame) -> dict[tuple[str, str] | None, Discrimination]:
    """Evaluate ABX trials pair by pair, in alphabetical order; None -> all trials pooled."""
    check_columns(trials, ["first", "second", "correct"], "trials")
    if trials.empty:
        raise ValueError("trials must have a row or more, got none")
    if unnamed := int(trials[["first", "second"]].isna().any(axis=1).sum()):
        raise ValueError(
            f"trials must name first and second, got {unnamed} rows that do not; name or leave them out"
        )
    names = np.sort(trials[["first", "second"]].astype(str).to_numpy(dtype=np.str_), axis=1)
    if len(alike := names[names[:, 0] == names[:, 1]]):
        raise ValueError(
            f"trials must be of two stimuli, got '{alike[0, 0]}' against itself; leave such rows out"
        )
    odd = trials.loc[~trials["correct"].isin([True, False]), "correct"]
    if len(odd):
        raise ValueError(
            f"trials must hold true or false in column 'correct', got {odd.iloc[0]!r}; leave lapses out"
        )
    correct = trials["correct"].to_numpy().astype(np.int64)
    pairs, number = np.unique(names, axis=0, return_inverse=True)
    parts = [correct[number.ravel() == place] for place in range(len(pairs))]
    keys: list[tuple[str, str] | None] = [(str(first), str(second)) for first, second in pairs]
    return {
        key: discriminate(int(part.sum()), len(part))
        for key, part in zip([*keys, None], [*parts, correct], strict=True)
    }


def abx_d_prime(share: float, *, model: str = "independent") -> float:
    """Distance in standard deviations at which an unbiased observer reaches a share correct in ABX trials.

    0 for a share of .5 or less, infinity for 1.

    Examples
    --------
    An observer with hits .75 and false alarms .3, freed of bias:

    >>> from scipy.stats import norm
    >>> unbiased = norm.cdf((norm.ppf(0.75) - norm.ppf(0.3)) / 2)
    >>> round(abx_d_prime(unbiased), 2), round(abx_d_prime(unbiased, model="differencing"), 2)
    (1.66, 1.87)
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    check_name(model, SPREADS, "model")
    if not 0 <= share <= 1:
        raise ValueError(f"share must be 0 to 1, got {share}")

    def surplus(d_prime: float) -> float:
        scaled = d_prime / np.array([np.sqrt(2), SPREADS[model]])
        return float(norm.cdf(scaled).prod() + norm.cdf(-scaled).prod()) - share

    if share <= GUESSING:
        return 0.0
    if surplus(LARGEST) <= 0:
        return float("inf")
    return float(brentq(surplus, 0, LARGEST, xtol=1e-12))


def _explain(share: float) -> tuple[str, ...]:
    if share < GUESSING:
        return ("Fewer than half are correct: d' is 0; chance, or answers mixed up.",)
    return ("All are correct: d' is unbounded, only its lower end is known.",) if share == 1 else ()
