from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.analysis.contrasts.compare import equivalence


def test_lakens_2017_example() -> None:
    # Moery & Calin-Jageman's study 2 as analysed there (doi 10.1177/1948550617697177): t(182) = -2.69, p = .004
    pooled = math.sqrt((94 * 0.95**2 + 88 * 0.83**2) / 182)
    se = pooled * math.sqrt(1 / 95 + 1 / 89)
    result = equivalence(5.25 - 5.22, se, 182, low=-0.43 * pooled, high=0.43 * pooled)
    assert (round(result.t_high, 2), round(result.p, 3)) == (-2.69, 0.004)
    assert result.p == result.p_high


def test_statsmodels_agrees() -> None:
    from statsmodels.stats.weightstats import ttost_paired

    rng = np.random.default_rng(0)
    x, y = rng.normal(0, 1, 20), rng.normal(0.2, 1, 20)
    p, low, high = ttost_paired(x, y, -0.8, 0.8)
    difference = x - y
    result = equivalence(
        difference.mean(), difference.std(ddof=1) / math.sqrt(20), 19, low=-0.8, high=0.8
    )
    assert (result.p, result.t_low, result.t_high) == pytest.approx((p, low[0], high[0]))
    assert (result.p_low, result.p_high) == pytest.approx((low[1], high[1]))


@settings(deadline=None)  # the first call imports scipy.stats
@given(
    estimate=st.floats(-9, 9), se=st.floats(0.1, 5), df=st.floats(1, 500), low=st.floats(-8, -0.1)
)
def test_the_interval_says_what_p_says(estimate: float, se: float, df: float, low: float) -> None:
    result = equivalence(estimate, se, df, low=low, high=3)
    inside = min(result.low90 - low, 3 - result.high90)
    if abs(inside) > 1e-9:
        assert result.equivalent == (result.p < 0.05) == (inside > 0)
    mirrored = equivalence(-estimate, se, df, low=-3, high=-low)
    assert (mirrored.p_low, mirrored.t_low) == pytest.approx((result.p_high, -result.t_high))


def test_at_the_margin_it_errs_in_five_percent() -> None:
    rng = np.random.default_rng(1)
    samples = rng.normal(2.0, 1, (4000, 30))
    means, errors = samples.mean(axis=1), samples.std(axis=1, ddof=1) / math.sqrt(30)
    hits = [
        equivalence(m, s, 29, low=-2, high=2).equivalent for m, s in zip(means, errors, strict=True)
    ]
    assert 0.04 < np.mean(hits) < 0.06
