"""The quick engine is the primary model, and simulated studies are what they say."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.power import draw, engine
from feel321.analysis.power.draw import Scenario, Stimuli
from feel321.analysis.primary.model import fit_primary

if TYPE_CHECKING:
    from collections.abc import Callable

    Make = Callable[..., Scenario]

STILL = dict.fromkeys(
    ("item_sd", "reducer_sd", "recording_sd", "person_reducer_sd", "person_recording_sd"), 0.0
)
CASES = [
    {},
    {"recordings": 4},
    {"own": (5, 4), "recordings": 7, "reducers": 6, "repeats": 2},
    {"own": (4, 9), "participants": 5},
    {"own": (3, 2), "participants": 4},
    {"own": (2, 4)},
    STILL,
]


@pytest.mark.parametrize("case", CASES)
def test_same_estimates_tests_and_verdicts_as_fit_primary(make_scenario: Make, case: dict) -> None:
    given = make_scenario(**case)
    metrics, fits = given.design.metrics, engine.Engine(given.design.metrics)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        stimuli = given.draw(rng)
        ratings, _ = draw.draw_ratings(given, stimuli, rng)
        fit = fits.fit(stimuli, ratings[0].mean(axis=-1))
        whole = fit_primary(
            draw.tabulate_ratings(stimuli, ratings[0], metrics), metrics, explain=False
        )
        slopes = whole.slopes.reindex(metrics)
        known = fit.outcome != engine.NOT_ESTIMABLE
        assert fit.tests[:2] == pytest.approx(
            slopes[["estimate", "se", "df"]].to_numpy(), rel=1e-4, nan_ok=True
        )
        assert slopes["estimable"].all() == known
        if known:
            assert whole.fit.singular == (fit.outcome == engine.SINGULAR)
            gap = whole.differences.loc[0]
            assert fit.tests[2, 0] / fit.tests[2, 1] == pytest.approx(
                gap["standardised_t"], rel=1e-4
            )


def test_recordings_of_one_source_get_their_terms(make_scenario: Make) -> None:
    given = make_scenario(own=(6, 4), recordings=8)
    items = given.design.items
    halves = items["recording"].str.removeprefix("scene").astype(int) // 2
    given = Scenario(replace(given.design, items=items.assign(source=halves)), given.truth)
    rng = np.random.default_rng(1)
    stimuli = given.draw(rng)
    assert stimuli.has_sources
    ratings, _ = draw.draw_ratings(given, stimuli, rng)
    fit = engine.Engine(given.design.metrics).fit(stimuli, ratings[0].mean(axis=-1))
    table = draw.tabulate_ratings(stimuli, ratings[0], given.design.metrics)
    whole = fit_primary(table, given.design.metrics, explain=False)
    assert "(1 | source:reducer)" in whole.formula
    assert fit.tests[:2] == pytest.approx(
        whole.slopes[["estimate", "se", "df"]].to_numpy(), rel=1e-4
    )


def test_spreads_of_zero_are_singular_fits_not_failures(make_scenario: Make) -> None:
    given = make_scenario(**STILL)
    fits = engine.Engine(given.design.metrics)
    ratings, _ = draw.draw_ratings(given, given.stimuli, np.random.default_rng(1))
    fit = fits.fit(given.stimuli, ratings[0].mean(axis=-1))
    assert fit.outcome == engine.SINGULAR
    assert np.isfinite(fit.tests).all()


def test_what_carries_no_model_is_named(make_scenario: Make) -> None:
    given = make_scenario()
    fits = engine.Engine(given.design.metrics)
    flat = fits.fit(given.stimuli, np.full((10, 36), 50.0))
    assert (flat.outcome, flat.reason) == (engine.FAILED, "all ratings are the same")
    stimuli = given.stimuli
    same = Stimuli(stimuli.scene, stimuli.kind, stimuli.source, np.full((36, 2), 0.5))
    ratings, _ = draw.draw_ratings(given, stimuli, np.random.default_rng(1))
    none = fits.fit(same, ratings[0].mean(axis=-1))
    assert none.outcome == engine.FAILED
    assert "none of which differs" in none.reason
    twice = Stimuli(stimuli.scene, stimuli.kind, stimuli.source, stimuli.metrics[:, [0, 0]])
    one = fits.fit(twice, ratings[0].mean(axis=-1))
    assert one.outcome == engine.NOT_ESTIMABLE
    assert "is a sum of" in one.reason
    assert np.isfinite(one.tests[0]).all()
    assert np.isnan(one.tests[1:, 1]).all()


def test_drawn_studies_have_the_recordings_and_reducers_of_the_set(make_scenario: Make) -> None:
    given = make_scenario(own=(5, 4), recordings=12, reducers=3)
    drawn = [given.draw(np.random.default_rng(seed)) for seed in range(30)]
    own = given.stimuli.metrics.reshape(5, 4, 2)
    for stimuli in drawn:
        metrics = stimuli.metrics.reshape(12, 3, 2)
        # Every recording twice or three times, its reducers in one order.
        whose = [np.flatnonzero(np.isin(own, row).any(axis=(1, 2)))[0] for row in metrics]
        assert sorted(np.bincount(whose)) == [2, 2, 2, 3, 3]
        kinds = {tuple(np.flatnonzero(np.isin(own[who], row).all(axis=1)))
                 for who, row in zip(whose, metrics, strict=True)}  # fmt: skip
        assert len(kinds) == 1
        assert len(np.unique(stimuli.source)) == 12
    assert len({hash(stimuli.metrics.tobytes()) for stimuli in drawn}) > 10


def test_drawn_ratings_have_the_planted_spreads_and_slopes(make_scenario: Make) -> None:
    """Each spread is planted alone and found again in means that nothing else can move."""
    where = {
        "person_sd": (1,), "item_sd": (2,), "person_item_sd": (1, 2), "rating_sd": (1, 2, 3),
    }  # fmt: skip
    spreads = ("recording_sd", "reducer_sd", "person_recording_sd", "person_reducer_sd")
    own = ("slope_points", "recording_slope_points")
    none = dict.fromkeys((*spreads, *where, *own), 0.0) | {"slopes": {}, "bounded": False}
    for name, axes in where.items():
        given = make_scenario(participants=60, repeats=4, **(none | {name: 4.0, "step": 0.0}))
        ratings, _ = draw.draw_ratings(given, given.stimuli, np.random.default_rng(2))
        others = tuple(set(range(1, 4)) - set(axes))
        found = ratings.mean(axis=others) if others else ratings
        assert np.std(found) == pytest.approx(4.0, rel=0.35 if name == "item_sd" else 0.25)
        if others:
            assert np.ptp(ratings, axis=others).max() < 1e-9
    slopes = make_scenario(**(none | {"slopes": {"spectral": 30.0}, "step": 0.0}))
    planted, null = draw.draw_ratings(slopes, slopes.stimuli, np.random.default_rng(2))
    metric = slopes.stimuli.metrics[:, 0]
    assert np.ptp(null) == 0
    assert planted[0, 0, :, 0] == pytest.approx(50 + 30 * (metric - metric.mean()))


def test_the_kept_slope_is_what_the_model_finds_in_means_of_many_people(
    make_scenario: Make,
) -> None:
    steep = make_scenario(slopes={"spectral": 150.0}, lapse_rate=0.1, participants=400, mean=70.0)
    quiet = {"item_sd": 0.0, "recording_sd": 0.0, "reducer_sd": 0.0}
    given = make_scenario(
        slopes={"spectral": 150.0}, lapse_rate=0.1, participants=3000, mean=70.0, **quiet
    )
    kept = draw.keep_slopes(given, given.stimuli)[0]
    ratings, _ = draw.draw_ratings(given, given.stimuli, np.random.default_rng(3))
    stimuli = given.stimuli
    columns = np.column_stack([np.ones(36), stimuli.within, stimuli.between])
    root = np.linalg.cholesky(draw.find_covariance(given, stimuli))
    means = ratings[0].mean(axis=(0, 2))
    found = np.linalg.lstsq(
        np.linalg.solve(root, columns), np.linalg.solve(root, means), rcond=None
    )[0]
    assert found[1:3] == pytest.approx(kept, abs=4.0)
    assert kept[0] < 125
    assert draw.keep_slopes(steep, stimuli)[0, 0] < kept[0]


def test_people_use_the_scale_as_the_truth_says(make_scenario: Make) -> None:
    careless = {"straight_liners": 0.2, "random_clickers": 0.2, "scale_reversers": 0.2}
    given = make_scenario(participants=400, repeats=2, mean=85.0, **careless)
    ratings, _ = draw.draw_ratings(given, given.stimuli, np.random.default_rng(4))
    assert (ratings.min(), ratings.max()) == (0.0, 100.0)
    assert np.abs(ratings * 10 - np.round(ratings * 10)).max() < 1e-6
    own = ratings[0].reshape(400, -1)
    straight = own.std(axis=1) < 2
    reverse = own.mean(axis=1) < 32
    assert straight.mean() == pytest.approx(0.2, abs=0.07)
    assert (reverse & ~straight).mean() == pytest.approx(0.2, abs=0.08)
