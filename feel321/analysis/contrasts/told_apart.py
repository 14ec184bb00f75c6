"""Are stimuli told apart? ABX trials (share correct, d'), and dissimilarities against those of identical pairs.

An identical pair is noise, a reduction beside its original is signal; both are rated on the same slider, so that
whoever cannot feel a difference rates both alike. Each participant is compared with himself or herself.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, overload

import numpy as np

from feel321.analysis.arrays import CONFIDENCE, check_columns
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.items import TEST, Table, open_ratings
from feel321.analysis.table.schema import ANSWERED, HIGHEST, PAIRED
from feel321.doors import check_name
from feel321.names import REDUCER_NAMES
from feel321.records import Statistic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

GUESSING = 0.5  # Share that comes out right by guessing
LARGEST = 12.0  # From here on a d' is perfect to rounding: an error in 10^6 trials or fewer
SPREADS: Mapping[str, float] = MappingProxyType({
    "independent": 2.0, "differencing": float(np.sqrt(6)),
})  # fmt: skip
"""Observer's model -> divisor of d' in the second factor of the share correct; the first is always √2."""

EVERY = "all reducers"
LEAST = 2  # Participants that an interval needs


@overload
def discriminate(n_correct: int, n_trials: int) -> Statistic: ...


@overload
def discriminate(n_correct: Table | DataFrame) -> DataFrame: ...


def discriminate(
    n_correct: int | Table | DataFrame, n_trials: int | None = None
) -> Statistic | DataFrame:
    """Evaluate ABX trials.

    Parameters
    ----------
    n_correct : int, Table or DataFrame
        Trials of one pair of stimuli answered correctly; or ratings, whose ABX answers are taken per level and reducer,
        each against its reference.
    n_trials : int, optional
        Trials, at least 1; half of them with X = A, so that no bias for a button can pose as discrimination.

    Returns
    -------
    Statistic or DataFrame
        ``share`` correct, its 95 % intervals ``wilson_low wilson_high`` and ``exact_low exact_high``
        (Clopper-Pearson); ``p`` of as many or more by guessing; d' under two models of the observer,
        ``d_independent`` and ``d_differencing``, each with ``_low`` and ``_high``; ``n_correct n_trials notes``. Of
        ratings, a row per level and reducer.

    Notes
    -----
    Model: an unbiased observer, A and B normal with equal spread and d' apart. With Φ the normal distribution
    function the share correct is ::

        independent observations   Φ(d'/√2) Φ(d'/2)  + Φ(-d'/√2) Φ(-d'/2)
        differencing               Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6)

    Which of the two people use is not known from shares alone; with A and B fixed over many trials the first is likely,
    when the pair roves the second. Ends of the interval of d' are the d' of the ends of Wilson's interval. Trials are
    taken for independent: pooled over people, the interval is about these people. A share below .5 has d' 0.

    References
    ----------
    Macmillan & Creelman (2005), Detection Theory: A User's Guide, 2nd ed., chapter 9, table A5.3; Hautus & Meng
    (2002), doi 10.3758/BF03194559; Wilson (1927), doi 10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> from feel321 import analysis
    >>> result = analysis.discriminate(18, 24)
    >>> round(result.share, 2), round(result.p, 4), round(result.d_independent, 2), round(result.d_differencing, 2)
    (0.75, 0.0113, 1.79, 2.02)
    >>> round(result.wilson_low, 3), round(result.wilson_high, 3)
    (0.551, 0.88)
    """
    from pandas import DataFrame
    from scipy.stats import binomtest

    if not isinstance(n_correct, int | float | np.number):
        rows = open_ratings(n_correct)
        check_columns(rows, ["scale", "level", "reducer", "role", "rating"], "ratings")
        answers = rows[(rows["scale"] == ANSWERED) & (rows["role"] != "reference")]
        return DataFrame([
            {"level": level, "reducer": reducer}
            | dict(discriminate(int((part["rating"] == HIGHEST).sum()), len(part)))
            for (level, reducer), part in answers.groupby(["level", "reducer"], observed=True)
        ])
    n_trials = 0 if n_trials is None else n_trials
    whole = all(float(count).is_integer() for count in (n_correct, n_trials))
    if not whole or not 0 <= n_correct <= n_trials or n_trials < 1:
        got = f"got {n_correct} of {n_trials}"
        raise ValueError(f"n_correct must be 0 to n_trials, of 1 or more trials, {got}")
    test = binomtest(int(n_correct), int(n_trials), GUESSING, alternative="greater")
    both = binomtest(int(n_correct), int(n_trials), GUESSING)
    wilson, exact = (both.proportion_ci(CONFIDENCE, method) for method in ("wilson", "exact"))
    share = n_correct / n_trials
    ends = {"": share, "_low": float(wilson.low), "_high": float(wilson.high)}
    d_primes = {
        f"d_{model}{end}": abx_d_prime(value, model=model)
        for model in SPREADS
        for end, value in ends.items()
    }
    notes = ["All are correct: d' is unbounded, only its lower end is known."] * (share == 1)
    if share < GUESSING:
        notes = ["Fewer than half are correct: d' is 0; chance, or answers mixed up."]
    return Statistic(
        "Discrimination", share=share, wilson_low=ends["_low"], wilson_high=ends["_high"],
        exact_low=float(exact.low), exact_high=float(exact.high), p=float(test.pvalue), **d_primes,
        n_correct=int(n_correct), n_trials=int(n_trials), notes=tuple(notes),
    )  # fmt: skip


def abx_d_prime(share: float, *, model: str = "independent") -> float:
    """Find d' at which an unbiased observer reaches a share correct in ABX trials; 0 for .5 or less, infinity for 1."""
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


def compare_with_original(rows: DataFrame) -> DataFrame:
    """Compare every reducer's dissimilarities from the original with identical pairs; a row per reducer, all last."""
    from pandas import DataFrame

    paired = rows[rows["scale"] == PAIRED]
    is_same = paired["reducer"] == paired["reference_reducer"]
    same = paired[(paired["role"] == "reference") & is_same]
    whole = (paired["reference_reducer"] != "") & ~paired["reference_reducer"].isin(REDUCER_NAMES)
    apart = paired[(paired["role"] == TEST) & whole]
    if same.empty or apart.empty:
        lack = "identical pairs" if same.empty else "pairs with the original"
        must = "dissimilarities must hold pairs with the original and identical ones"
        raise ValueError(f"{must}, got no {lack}")
    names = order_reducers(apart["reducer"])
    told = {name: tell_apart(apart[apart["reducer"] == name], same) for name in names}
    holm = adjust_holm([one["p"] for one in told.values()])
    found = [{"reducer": k, **told[k], "p_holm": p} for k, p in zip(names, holm, strict=True)]
    if len(found) > 1:
        every = tell_apart(apart, same)
        found.append({"reducer": EVERY, **every, "p_holm": every.p})
    return DataFrame(found)


def tell_apart(apart: DataFrame, same: DataFrame) -> Statistic:
    """Compare ratings of different pairs with those of identical ones, participant by participant.

    difference: mean dissimilarity from the original less that of identical pairs, in points, over participants, with a
    95 % t interval, t, df and two-sided p. area: chance that a participant rates a pair with the original above an
    identical one (ties count half), mean over participants, with a t interval cut to 0..1; d_prime: √2 Φ⁻¹(area)
    (Macmillan & Creelman 2005, chapter 3), and what the interval translates to; infinite for an area of 1.
    """
    from scipy.stats import norm

    people = sorted(set(apart["participant"]) & set(same["participant"]))
    if len(people) < LEAST:
        must = f"a comparison with identical pairs needs {LEAST} participants who rated both"
        raise ValueError(f"{must}, got {len(people)}")
    gaps, areas = [], []
    for who in people:
        rated = (part.loc[part["participant"] == who, "rating"] for part in (apart, same))
        far, near = (ratings.to_numpy(np.float64) for ratings in rated)
        gaps.append(far.mean() - near.mean())
        # The area under the ROC curve: the chance that one of far is above one of near.
        areas.append(0.5 + np.sign(far[:, None] - near[None, :]).mean() / 2)
    mean, error, reach, p = _test(gaps)
    area, spread, _, _ = _test(areas)
    low, high = max(0.0, area - reach * spread), min(1.0, area + reach * spread)
    d_prime, d_low, d_high = (float(math.sqrt(2) * norm.ppf(end)) for end in (area, low, high))
    statistic = mean / error if error else math.copysign(math.inf, mean) if mean else math.nan
    return Statistic(
        "ToldApart", difference=mean, low=mean - reach * error, high=mean + reach * error, t=statistic,
        df=float(len(people) - 1), p=p, area=area, area_low=low, area_high=high, d_prime=d_prime, d_prime_low=d_low,
        d_prime_high=d_high, n_participants=len(people), n_judgements=len(apart), n_identical=len(same),
    )  # fmt: skip


def _test(values: Sequence[float]) -> tuple[float, float, float, float]:
    """Average over participants: mean, standard error, their number in a 95 % interval, p of a mean of 0."""
    from scipy.stats import t as student

    n, mean = len(values), float(np.mean(values))
    error = float(np.std(values, ddof=1)) / math.sqrt(n)
    p = float(2 * student.sf(abs(mean) / error, n - 1)) if error else float(mean == 0)
    return mean, error, float(student.ppf(0.975, n - 1)), p
