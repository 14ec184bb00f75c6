"""Is one axis felt to differ from three? Dissimilarities from the original against those of identical pairs.

Conventions: an identical pair is noise, a reduction beside its original is signal; both are rated on the same slider,
so that whoever cannot feel a difference rates both alike. Each participant is compared with himself or herself.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.table.items import TEST
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import PAIRED
from feel321.names import REDUCER_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame

    from feel321.analysis.arrays import Values

EVERY = "all reducers"
LEAST = 2
"""Participants that an interval needs."""


@dataclass(frozen=True, slots=True)
class ToldApart:
    """How far a reducer's stimuli feel from the original, beyond identical pairs.

    difference: mean dissimilarity from the original less that of identical pairs, in points, over participants, with a
    95 % t interval, t, df and two-sided p. area: chance that a participant rates a pair with the original above an
    identical one (ties count half), mean over participants, with a t interval cut to 0..1; d_prime: √2 Φ⁻¹(area), and
    what the interval translates to; infinite for an area of 1.
    """

    difference: float
    low: float
    high: float
    t: float
    df: float
    p: float
    area: float
    area_low: float
    area_high: float
    d_prime: float
    d_prime_low: float
    d_prime_high: float
    n_participants: int
    n_judgements: int
    n_identical: int


def compare_with_original(rows: DataFrame) -> DataFrame:
    """Compare every reducer's dissimilarities from the original with identical pairs; a row per reducer, all last."""
    from pandas import DataFrame

    apart, same = _split(rows[rows["scale"] == PAIRED])
    names = order_reducers(apart["reducer"])
    found = {name: tell_apart(apart[apart["reducer"] == name], same) for name in names}
    holm = adjust_holm([one.p for one in found.values()])
    listed = [
        {"reducer": name, **asdict(one), "p_holm": p}
        for (name, one), p in zip(found.items(), holm, strict=True)
    ]
    if len(found) > 1:
        whole = tell_apart(apart, same)
        listed.append({"reducer": EVERY, **asdict(whole), "p_holm": whole.p})
    return DataFrame(listed)


def _split(paired: DataFrame) -> tuple[DataFrame, DataFrame]:
    """Split dissimilarities into those from a three-axis original and those of identical pairs."""
    is_same = paired["reducer"] == paired["reference_reducer"]
    same = paired[(paired["role"] == "reference") & is_same]
    whole = (paired["reference_reducer"] != "") & ~paired["reference_reducer"].isin(REDUCER_NAMES)
    apart = paired[(paired["role"] == TEST) & whole]
    if same.empty or apart.empty:
        lack = "identical pairs" if same.empty else "pairs with the original"
        raise ValueError(
            f"dissimilarities must hold pairs with the original and identical ones, got no {lack}"
        )
    return apart, same


def tell_apart(apart: DataFrame, same: DataFrame) -> ToldApart:
    """Compare ratings of different pairs with those of identical ones, participant by participant."""
    people = sorted(set(apart["participant"]) & set(same["participant"]))
    if len(people) < LEAST:
        raise ValueError(
            f"a comparison with identical pairs needs {LEAST} participants who rated both, got {len(people)}"
        )
    ratings = [
        tuple(part.loc[part["participant"] == who, "rating"].to_numpy(np.float64) for part in (apart, same))
        for who in people
    ]  # fmt: skip
    mean, error, reach, p = _test([far.mean() - near.mean() for far, near in ratings])
    area, spread, _, _ = _test([find_area(far, near) for far, near in ratings])
    ends = (area, max(0.0, area - reach * spread), min(1.0, area + reach * spread))
    one, two, three = (area_d_prime(end) for end in ends)
    statistic = mean / error if error else math.copysign(math.inf, mean) if mean else math.nan
    return ToldApart(
        mean, mean - reach * error, mean + reach * error, statistic, float(len(people) - 1), p, *ends, one, two, three,
        len(people), len(apart), len(same),
    )  # fmt: skip


def _test(values: Sequence[float]) -> tuple[float, float, float, float]:
    """Average over participants: mean, standard error, their number in a 95 % interval, p of a mean of 0."""
    from scipy.stats import t as student

    n, mean = len(values), float(np.mean(values))
    error = float(np.std(values, ddof=1)) / math.sqrt(n)
    p = float(2 * student.sf(abs(mean) / error, n - 1)) if error else float(mean == 0)
    return mean, error, float(student.ppf(0.975, n - 1)), p


def find_area(far: Values, near: Values) -> float:
    """Find the area under the ROC curve: the chance that one of `far` is above one of `near`; ties count half.

    Examples
    --------
    >>> import numpy as np
    >>> find_area(np.array([2.0, 3.0]), np.array([1.0, 2.0]))
    0.875
    """
    sign = np.sign(far[:, None] - near[None, :])
    return float(0.5 + sign.mean() / 2)


def area_d_prime(area: float) -> float:
    """Turn the area under a ROC curve into d' of two normal distributions of equal spread: √2 Φ⁻¹(area).

    Source: Macmillan & Creelman (2005), Detection Theory, chapter 3.
    """
    from scipy.stats import norm

    return float(math.sqrt(2) * norm.ppf(area))
