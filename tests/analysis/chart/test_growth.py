from __future__ import annotations

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart.cost import fit_growth, list_lengths

N = np.array(list_lengths(1_000_000), dtype=float)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.2, 2.0])
@pytest.mark.parametrize("overhead", [0.0, 5e-5])
def test_a_known_exponent_is_recovered_whatever_the_overhead(
    exponent: float, overhead: float
) -> None:
    found = fit_growth(N, overhead + 1e-8 * N**exponent, reducer="made up")
    assert found["exponent"] == pytest.approx(exponent, abs=2e-3)
    assert found["misfit"] < 1e-3
    if overhead:
        assert found["overhead_us"] == pytest.approx(1e6 * overhead, rel=1e-2)


def test_the_interval_holds_the_exponent_as_often_as_it_says() -> None:
    rng, hits = np.random.default_rng(0), 0
    for _ in range(200):
        noisy = (2e-5 + 1e-8 * N**1.1) * np.exp(rng.normal(0, 0.05, N.size))
        found = fit_growth(N, noisy, reducer="made up")
        hits += found["low"] <= 1.1 <= found["high"]
    assert 0.90 <= hits / 200 <= 0.99


def test_three_lengths_give_an_exponent_without_interval() -> None:
    found = fit_growth([10, 100, 1000], [1.0, 10.0, 100.0], reducer="made up")
    assert found["exponent"] == pytest.approx(1.0, abs=1e-2)
    assert np.isnan([found["low"], found["high"]]).all()
    assert (found["smallest"], found["largest"]) == (10, 1000)


@pytest.mark.parametrize(
    ("n", "seconds", "message"),
    [
        (
            [10, 100],
            [1, 2],
            "n_samples must be 3 or more different lengths, each with its time, got 2",
        ),
        ([10, 100, 100], [1, 2, 2], "n_samples must be 3 or more different lengths"),
        ([10, 100, 1000], [1, 2], "each with its time"),
        ([10, 100, 1000], [0, 1, 2], "seconds must be above 0 and finite, got 0"),
        ([10, 100, 1000], [1, 1, np.inf], "take a finer clock"),
    ],
)
def test_what_cannot_be_fitted_is_refused(
    n: list[float], seconds: list[float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        fit_growth(n, seconds, reducer="made up")
