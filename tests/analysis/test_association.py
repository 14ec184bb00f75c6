"""Correlations with their two-way intervals, and the cluster bootstrap behind them."""

import math
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from feel321.analysis.association import compare_metrics, correlate
from feel321.analysis.resampling import (
    METHODS,
    Averages,
    bootstrap_margin,
    draw_counts,
    weighted_pearson,
    weighted_ranks,
)
from feel321.analysis.table.items import Items, make_items

Tidy = Callable[..., pd.DataFrame]

SPECTRAL, TEMPORAL = "spectral_match", "temporal_match"
REFERENCE = {"pearson": stats.pearsonr, "spearman": stats.spearmanr, "kendall": stats.kendalltau}
WITHIN = {"within": "pearson", "within_spearman": "spearman", "within_kendall": "kendall"}


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def item_means(table: pd.DataFrame) -> pd.DataFrame:
    tests = table[table["role"] == "test"]
    cells = tests.groupby(["stimulus_id", "participant"])["rating"].mean()
    metrics = tests.drop_duplicates("stimulus_id").set_index("stimulus_id")[[SPECTRAL, TEMPORAL]]
    return metrics.assign(mean=cells.groupby("stimulus_id").mean())


@pytest.mark.parametrize("method", REFERENCE)
def test_value_is_the_correlation_of_item_means(tidy: Tidy, method: str) -> None:
    table, reference = tidy(), REFERENCE[method]
    means = item_means(table)
    found = correlate(table, SPECTRAL, method=method, draws=20, rng=rng())
    expected = reference(means[SPECTRAL], means["mean"]).statistic
    assert found.value == pytest.approx(expected, abs=1e-12)
    assert (found.n_items, found.n_participants, found.n_recordings) == (36, 6, 4)


@pytest.mark.parametrize("method", WITHIN)
def test_within_is_the_average_over_recordings(tidy: Tidy, method: str) -> None:
    table, reference = tidy(noise=25), REFERENCE[WITHIN[method]]
    groups = item_means(table).groupby(lambda name: name.split("_")[0])
    z = [math.atanh(reference(part[SPECTRAL], part["mean"]).statistic) for _, part in groups]
    found = correlate(table, SPECTRAL, method=method, draws=200, rng=rng())
    assert found.value == pytest.approx(math.tanh(np.mean(z)), abs=1e-12)
    assert found.low < found.value < found.high


def test_ceiling_within_recovers_a_perfect_metric() -> None:
    generator = rng(6)
    table = simulate(generator, people=10, scenes=40, reducers=30)
    of_recording = generator.normal(0, 40, 40)[table["recording"]]
    table["rating"] = 50 + table["metric"] * 8 + of_recording + generator.normal(0, 20, len(table))
    found = correlate(table, "metric", method="within", draws=50, rng=generator)
    assert found.value < 0.9
    assert found.disattenuated == pytest.approx(1, abs=0.06)


def test_intervals_within_allow_for_the_lean_of_few_stimuli(tidy: Tidy) -> None:
    table = tidy(noise=25)
    groups = item_means(table).groupby(lambda name: name.split("_")[0])
    parts = [(stats.pearsonr(part[SPECTRAL], part["mean"]), len(part)) for _, part in groups]
    lean = np.mean([found.statistic / (2 * (n - 1)) for found, n in parts])
    found = correlate(table, SPECTRAL, method="within", draws=100, rng=rng())
    for ends in ((found.low, found.high), (found.participants_low, found.participants_high)):
        assert np.mean(np.arctanh(ends)) == pytest.approx(math.atanh(found.value) - lean)
    turned = table.assign(other=-table[SPECTRAL])
    compared = compare_metrics(turned, SPECTRAL, "other", method="within", draws=100, rng=rng())
    middle = (compared.z_low + compared.z_high) / 2
    assert middle == pytest.approx(compared.z_value - 2 * lean)


@pytest.mark.soak
def test_interval_within_covers_a_planted_correlation() -> None:
    generator, studies, covered = rng(78), 400, 0
    for _ in range(studies):
        table = simulate(generator)
        # To noise of stimuli, SD 8, and of people, SD 8 / sqrt(12).
        table["rating"] += 8 * table["metric"]
        found = correlate(table, "metric", method="within", draws=400, rng=generator)
        covered += found.low <= 8 / math.sqrt(64 + 64 + 64 / 12) <= found.high
    assert 0.92 <= covered / studies <= 0.985


@pytest.mark.soak
@pytest.mark.parametrize("method", METHODS)
def test_two_way_intervals_cover_what_is_planted(method: str) -> None:
    generator, studies = rng(77), 400
    found = [
        correlate(simulate(generator), "metric", method=method, draws=400, rng=generator)
        for _ in range(studies)
    ]
    covered = sum(result.low <= 0 <= result.high for result in found)
    assert 0.92 <= covered / studies <= 0.985


def simulate(
    generator: np.random.Generator, *, people: int = 12, scenes: int = 8, reducers: int = 6
) -> pd.DataFrame:
    """Make a study whose metric predicts nothing, though metric and ratings both cluster in recordings."""
    scene = np.repeat(np.arange(scenes), reducers)
    metric = generator.normal(size=scenes)[scene] + generator.normal(size=scene.size)
    item = generator.normal(size=scenes)[scene] * 8 + generator.normal(size=scene.size) * 8
    rating = 50 + item + generator.normal(0, 5, (people, 1))
    rating = rating + generator.normal(0, 8, (people, scene.size))
    return pd.DataFrame({
        "participant": np.repeat(np.arange(people), scene.size),
        "recording": np.tile(scene, people),
        "reducer": np.tile(np.tile(np.arange(reducers), scenes), people),
        "metric": np.tile(metric, people),
        "rating": rating.ravel(),
    })


def test_two_way_interval_covers_and_the_narrow_one_does_not() -> None:
    generator, studies = rng(2024), 60
    found = [
        correlate(simulate(generator), "metric", draws=300, rng=generator) for _ in range(studies)
    ]
    two_way = sum(result.low <= 0 <= result.high for result in found)
    narrow = sum(result.participants_low <= 0 <= result.participants_high for result in found)
    # Binomial limits at 0.1 %: of 60 studies a true 95 % interval covers 50 or more; one of .60 covers 48 or fewer.
    assert two_way >= stats.binom.ppf(0.001, studies, 0.95)
    assert narrow <= stats.binom.ppf(0.999, studies, 0.60)


def test_the_interval_of_few_participants_covers_too() -> None:
    generator, studies = rng(2025), 60
    covered = 0
    for _ in range(studies):
        table = simulate(generator, people=3, scenes=10)
        # People differ in what the metric means to them.
        slope = generator.normal(0, 6, 3)[table["participant"]]
        table["rating"] += slope * table["metric"]
        found = correlate(table, "metric", draws=200, rng=generator)
        covered += found.low <= 0 <= found.high
    assert covered >= stats.binom.ppf(0.001, studies, 0.95)


@pytest.mark.parametrize(("people", "scenes"), [(3, 6), (6, 3), (4, 4)])
def test_intervals_are_rebuilt_from_the_draws(tidy: Tidy, people: int, scenes: int) -> None:
    table = tidy(participants=people, recordings=scenes)
    found = correlate(table, SPECTRAL, draws=200, rng=rng())
    same, items = rng(), make_items(table, [SPECTRAL])
    drawn = draw_counts(people, 200, rng=same), draw_counts(scenes, 200, rng=same)
    intervals = (found.low, found.high), (found.participants_low, found.participants_high)
    counted, sizes = (drawn[1], np.ones((200, scenes))), (min(people, scenes), people)
    for counts, units, interval in zip(counted, sizes, intervals, strict=True):
        averages = Averages.of(items, drawn[0])
        z = np.arctanh(averages.correlate(items, METHODS["pearson"], counts=(counts,))[0][0])
        margin = stats.t.ppf(0.975, units - 1) * math.sqrt(units / (units - 1)) * z.std(ddof=1)
        ends = math.atanh(found.value) + margin * np.array([-1, 1])
        assert np.arctanh(interval) == pytest.approx(ends)


def test_reference_and_anchors_do_not_count(tidy: Tidy) -> None:
    table = tidy()
    tests = table[table["role"] == "test"]
    whole, own = (correlate(rows, SPECTRAL, draws=50, rng=rng()) for rows in (table, tests))
    assert whole == own


def test_ceiling_and_disattenuation_recover_a_perfect_metric() -> None:
    generator = rng(4)
    table = simulate(generator, people=10, scenes=20)
    truth = table["metric"] * 6
    table["rating"] = 50 + truth + generator.normal(0, 20, len(table))
    found = correlate(table, "metric", draws=50, rng=generator)
    assert found.value < 0.9
    assert found.disattenuated == pytest.approx(1, abs=0.08)
    assert found.ceiling == pytest.approx(found.value / found.disattenuated)


def test_difference_is_told_in_both_units(tidy: Tidy) -> None:
    table = tidy()
    one, two = (correlate(table, name, draws=20, rng=rng()).value for name in (SPECTRAL, TEMPORAL))
    found = compare_metrics(table, SPECTRAL, TEMPORAL, draws=200, rng=rng())
    turned = compare_metrics(table, TEMPORAL, SPECTRAL, draws=200, rng=rng())
    assert found.value == pytest.approx(one - two)
    assert (found.first_value, found.second_value) == pytest.approx((one, two))
    assert found.z_value == pytest.approx(math.atanh(one) - math.atanh(two))
    assert np.sign(found.low) == np.sign(found.z_low)
    ends = -found.value, -found.high, -found.low
    assert (turned.value, turned.low, turned.high) == pytest.approx(ends)


def make_coarse(rng: np.random.Generator, *, missing: float = 0.0) -> Items:
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
    items = make_coarse(rng, missing=missing)
    people, scenes = draw_counts(5, 60, rng=rng), draw_counts(4, 60, rng=rng)
    (fast,) = Averages.of(items, people).correlate(items, METHODS[method], counts=(scenes,))
    pairs = zip(people, scenes, strict=True)
    slow = [correlate_slowly(items, method, *pair) for pair in pairs]
    np.testing.assert_allclose(fast, np.array(slow).T, rtol=0, atol=1e-12)


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
        found = METHODS[name].correlation(x, y, weights=weights.astype(float))
        assert found == pytest.approx(reference(many_x, many_y).statistic, abs=1e-12)


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
    names, ratings, metrics = tuple("a" * 60), rng.normal(size=(6, 60)), rng.normal(size=(1, 60))
    items = Items(names, ratings, metrics, np.repeat([0, 1, 2], 20))
    people, scenes = draw_counts(6, 40, rng=rng), draw_counts(3, 40, rng=rng)
    (fast,) = Averages.of(items, people).correlate(items, METHODS[method], counts=(scenes,))
    pairs = zip(people, scenes, strict=True)
    slow = [correlate_within_slowly(items, method, *pair) for pair in pairs]
    np.testing.assert_allclose(fast[0], slow, rtol=0, atol=1e-12)
