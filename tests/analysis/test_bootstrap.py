from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from feel321.analysis.resampling import (
    METHODS,
    Averages,
    bootstrap_margin,
    draw_counts,
    weighted_pearson,
    weighted_ranks,
)
from feel321.analysis.table.items import Items

REFERENCE = {"pearson": stats.pearsonr, "spearman": stats.spearmanr, "kendall": stats.kendalltau}
WITHIN = {"within": "pearson", "within_spearman": "spearman", "within_kendall": "kendall"}


def make_items(rng: np.random.Generator, *, missing: float = 0.0) -> Items:
    ratings = rng.integers(0, 11, (5, 12)).astype(float) * 10  # coarse, so that ties occur
    ratings[rng.random(ratings.shape) < missing] = np.nan
    metrics = np.round(rng.normal(size=(2, 12)), 1)
    return Items(tuple(map(str, range(12))), ratings, metrics, np.repeat(np.arange(4), 3))


def correlate_slowly(
    items: Items, method: str, people: np.ndarray, scenes: np.ndarray
) -> np.ndarray:
    """Write every drawn participant and item out, then ask scipy."""
    drawn_people = np.repeat(np.arange(len(people)), people.astype(int))
    means = {}
    for item in range(items.n_items):
        given = items.ratings[drawn_people, item]
        if np.isfinite(given).any():
            means[item] = np.nanmean(given)
    drawn = [
        item
        for scene, times in enumerate(scenes.astype(int))
        for _ in range(times)
        for item in np.flatnonzero(items.recordings == scene)
        if item in means
    ]
    y = np.array([means[item] for item in drawn])
    return np.array([REFERENCE[method](metric[drawn], y).statistic for metric in items.metrics])


@pytest.mark.parametrize("method", REFERENCE)
@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_draws_equal_a_loop_over_the_written_out_samples(method: str, missing: float) -> None:
    rng = np.random.default_rng(11)
    items = make_items(rng, missing=missing)
    people, scenes = draw_counts(5, 60, rng=rng), draw_counts(4, 60, rng=rng)
    (fast,) = Averages.of(items, people).correlate(items, METHODS[method], counts=(scenes,))
    slow = np.array([
        correlate_slowly(items, method, *pair) for pair in zip(people, scenes, strict=True)
    ]).T
    np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-12)


@given(seed=st.integers(0, 10_000))
def test_weights_mean_repetition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 5, 8).astype(float), rng.integers(0, 5, 8).astype(float)
    weights = rng.integers(0, 4, 8)
    many_x, many_y = np.repeat(x, weights), np.repeat(y, weights)
    if len(many_x) == 0 or np.ptp(many_x) == 0 or np.ptp(many_y) == 0:
        assert math.isnan(weighted_pearson(x, y, weights=weights.astype(float)))
        return
    ranks = np.repeat(weighted_ranks(x, weights.astype(float)), weights)
    np.testing.assert_array_equal(ranks, stats.rankdata(many_x))
    for name, reference in REFERENCE.items():
        expected = reference(many_x, many_y).statistic
        assert METHODS[name].correlation(x, y, weights=weights.astype(float)) == pytest.approx(
            expected, abs=1e-12
        )


@pytest.mark.parametrize("constant", [0.0, 0.1, 1e6, -3.3e-7])
def test_a_constant_is_undefined_whatever_its_rounding(constant: float) -> None:
    x = np.full(7, constant)
    y, weights = np.arange(7.0), np.array([1.0, 2, 3, 1, 2, 3, 1])
    assert math.isnan(weighted_pearson(x, y, weights=weights))
    assert math.isnan(weighted_pearson(y, x, weights=weights))


def test_margin_is_the_corrected_t_interval() -> None:
    drawn = np.arange(20.0) ** 2
    expected = stats.t.ppf(0.975, 7) * math.sqrt(8 / 7) * np.std(drawn[2:], ddof=1)
    drawn[:2] = np.nan
    assert bootstrap_margin(drawn, 8) == pytest.approx(expected)
    drawn[2] = np.nan  # more than a tenth is too many
    assert math.isnan(bootstrap_margin(drawn, 8))


def correlate_within_slowly(
    items: Items, method: str, people: np.ndarray, scenes: np.ndarray
) -> float:
    """Average Fisher's z of scipy's correlations, recording by recording, none of them perfect."""
    drawn = np.repeat(items.ratings, people.astype(int), axis=0)
    z = []
    for scene, times in enumerate(scenes.astype(int)):
        own = items.recordings == scene
        r = REFERENCE[WITHIN[method]](items.metrics[0, own], drawn[:, own].mean(axis=0)).statistic
        z += [math.atanh(r)] * times
    return math.tanh(np.mean(z))


@pytest.mark.parametrize("method", WITHIN)
def test_within_averages_the_recordings_over_fishers_z(method: str) -> None:
    rng = np.random.default_rng(5)
    items = Items(
        tuple(map(str, range(60))),
        rng.normal(size=(6, 60)),
        rng.normal(size=(1, 60)),
        np.repeat([0, 1, 2], 20),
    )
    people, scenes = draw_counts(6, 40, rng=rng), draw_counts(3, 40, rng=rng)
    (fast,) = Averages.of(items, people).correlate(items, METHODS[method], counts=(scenes,))
    fast = fast[0]
    slow = [
        correlate_within_slowly(items, method, *pair) for pair in zip(people, scenes, strict=True)
    ]
    np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-12)
