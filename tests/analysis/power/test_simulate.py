"""Simulated studies are fitted as the primary model fits, and are drawn as they say."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.power import draw, simulate
from feel321.analysis.power.draw import Scenario
from feel321.analysis.primary.model import fit_primary

if TYPE_CHECKING:
    from collections.abc import Callable

    Make = Callable[..., Scenario]

STILL = dict.fromkeys(
    ("item_sd", "reducer_sd", "recording_sd", "person_reducer_sd", "person_recording_sd"), 0.0
)


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"own": (5, 4), "recordings": 7, "reducers": 6, "repeats": 2},
        {"own": (3, 2), "participants": 4},
        {"own": (6, 4), "recordings": 8, "sources": True},
        STILL,
    ],
)
def test_same_estimates_tests_and_verdicts_as_fit_primary(make_scenario: Make, case: dict) -> None:
    sources = case.get("sources", False)
    given = make_scenario(**{name: value for name, value in case.items() if name != "sources"})
    if sources:
        halves = given.design.items["recording"].str.removeprefix("scene").astype(int) // 2
        items = given.design.items.assign(source=halves)
        given = Scenario(replace(given.design, items=items), given.truth)
    metrics, engine = given.design.metrics, simulate.Engine(given.design.metrics)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        stimuli = given.draw(rng)
        assert stimuli.has_sources == sources
        ratings = draw.draw_ratings(given, stimuli, rng)[0]
        fit = engine.fit(stimuli, ratings.mean(axis=-1))
        whole = fit_primary(
            draw.tabulate_ratings(stimuli, ratings, metrics), metrics, explain=False
        )
        slopes = whole.slopes.reindex(metrics)
        wanted = slopes[["estimate", "se", "df"]].to_numpy()
        assert np.array(fit["tests"]) == pytest.approx(wanted, rel=1e-4, nan_ok=True)
        known = fit["outcome"][0] != simulate.NOT_ESTIMABLE
        assert slopes["estimable"].all() == known
        if known:
            assert whole.fit.singular == (fit["outcome"][0] == simulate.SINGULAR)


def test_what_carries_no_model_is_named(make_scenario: Make) -> None:
    given = make_scenario()
    stimuli, engine = given.stimuli, simulate.Engine(given.design.metrics)
    flat = engine.fit(stimuli, np.full((10, 36), 50.0))
    assert flat["outcome"] == (simulate.FAILED, "all ratings are the same")
    ratings = draw.draw_ratings(given, stimuli, np.random.default_rng(1))[0].mean(axis=-1)
    none = engine.fit(replace(stimuli, metrics=np.full((36, 2), 0.5)), ratings)
    assert none["outcome"][0] == simulate.FAILED
    assert "none of which differs" in none["outcome"][1]
    one = engine.fit(replace(stimuli, metrics=stimuli.metrics[:, [0, 0]]), ratings)
    assert one["outcome"][0] == simulate.NOT_ESTIMABLE
    assert "is a sum of" in one["outcome"][1]
    assert np.isfinite(one["tests"][0]).all()
    assert np.isnan(one["tests"][1][1])


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
        ratings = draw.draw_ratings(given, given.stimuli, np.random.default_rng(2))
        others = tuple(set(range(1, 4)) - set(axes))
        found = ratings.mean(axis=others) if others else ratings
        assert np.std(found) == pytest.approx(4.0, rel=0.35 if name == "item_sd" else 0.25)
        if others:
            assert np.ptp(ratings, axis=others).max() < 1e-9
    slopes = make_scenario(**(none | {"slopes": {"spectral": 30.0}, "step": 0.0}))
    planted = draw.draw_ratings(slopes, slopes.stimuli, np.random.default_rng(2))
    metric = slopes.stimuli.metrics[:, 0]
    assert planted[0, 0, :, 0] == pytest.approx(50 + 30 * (metric - metric.mean()))


def test_people_use_the_scale_as_the_truth_says(make_scenario: Make) -> None:
    careless = {"straight_liners": 0.2, "random_clickers": 0.2, "scale_reversers": 0.2}
    given = make_scenario(participants=400, repeats=2, mean=85.0, **careless)
    ratings = draw.draw_ratings(given, given.stimuli, np.random.default_rng(4))
    assert (ratings.min(), ratings.max()) == (0.0, 100.0)
    assert np.abs(ratings * 10 - np.round(ratings * 10)).max() < 1e-6
    own = ratings[0].reshape(400, -1)
    straight = own.std(axis=1) < 2
    reverse = own.mean(axis=1) < 32
    assert straight.mean() == pytest.approx(0.2, abs=0.07)
    assert (reverse & ~straight).mean() == pytest.approx(0.2, abs=0.08)
