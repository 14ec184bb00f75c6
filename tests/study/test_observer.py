from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from protocols.texts import read_scales
from study.observer import ObserverModel, SimulatedObserver, feel, identify_observer
from study.plan import make_plan

if TYPE_CHECKING:
    from stimuli.manifest import StimulusSet
    from study.plan import Plan

MODEL = ObserverModel(
    intercept=10.0, spectral=45.0, temporal=35.0, bias_sd=6.0, gain_sd=0.15, noise_sd=8.0, noise_spread=0.25
)
EXACT = replace(MODEL, bias_sd=0.0, gain_sd=0.0, noise_sd=0.0)
REALISM = read_scales()["realism"]


def rate(stimuli: StimulusSet, plan: Plan, model: ObserverModel, *, seed: int = 1) -> dict[str, float]:
    observer = SimulatedObserver(model, seed=seed, number=plan.number)
    by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
    ratings = {}
    for trial in plan.trials:
        observer.show(trial, REALISM)
        observer.play(by_id[trial.stimulus_id])
        ratings[trial.stimulus_id] = observer.ask(REALISM).rating
    return ratings


def rate_all(stimuli: StimulusSet, model: ObserverModel, *, n: int) -> np.ndarray:
    plans = [
        make_plan(stimuli, f"p{number}", number=number, seed=1, protocols=("realism",), repeats=1)
        for number in range(1, n + 1)
    ]
    tables = [rate(stimuli, plan, model) for plan in plans]
    return np.array([[table[stimulus.stimulus_id] for stimulus in stimuli.stimuli] for table in tables])


def test_percept_is_the_stated_sum_with_the_spectral_match_cut(stimuli: StimulusSet) -> None:
    by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
    assert feel(by_id["bumps-first"], MODEL) == pytest.approx(10 + 45 * 0.9 + 35 * 0.2)
    assert feel(by_id["bumps-fourth"], MODEL) == pytest.approx(10 + 35 * 0.1)  # its spectral match is -3


def test_without_differences_and_noise_the_rating_is_the_percept(stimuli: StimulusSet, plan: Plan) -> None:
    ratings = rate(stimuli, plan, EXACT)
    for stimulus in stimuli.stimuli:
        assert ratings[stimulus.stimulus_id] == pytest.approx(feel(stimulus, EXACT), abs=0.051)


def test_ratings_stay_on_the_scale(stimuli: StimulusSet, plan: Plan) -> None:
    ratings = rate(stimuli, plan, replace(MODEL, noise_sd=500.0)).values()
    assert (min(ratings), max(ratings)) == (0.0, 100.0)


def test_spread_of_biases_and_noise_is_recovered(stimuli: StimulusSet) -> None:
    # Percepts mid-scale, so that nothing is cut off.
    flat = replace(EXACT, intercept=50.0, spectral=0.0, temporal=0.0)
    biases = rate_all(stimuli, replace(flat, bias_sd=6.0), n=200)
    assert np.ptp(biases, axis=1).max() == 0.0
    assert biases[:, 0].std(ddof=1) == pytest.approx(6.0, rel=0.2)
    noise = rate_all(stimuli, replace(flat, noise_sd=8.0, noise_spread=0.0), n=200)
    assert noise.std(ddof=1) == pytest.approx(8.0, rel=0.1)
    gains = rate_all(stimuli, replace(flat, gain_sd=0.15), n=200)
    assert np.log(gains[:, 0]).std(ddof=1) == pytest.approx(0.15, rel=0.2)


@pytest.mark.parametrize(("spectral", "temporal"), [(60.0, 0.0), (0.0, 60.0)])
def test_a_planted_effect_is_found_in_the_item_means(stimuli: StimulusSet, spectral: float, temporal: float) -> None:
    means = rate_all(stimuli, replace(MODEL, spectral=spectral, temporal=temporal), n=16).mean(axis=0)
    metrics = np.array([[s.spectral_match, s.temporal_match] for s in stimuli.stimuli]).clip(0, 1)
    tests = np.array([s.role == "test" for s in stimuli.stimuli])
    r_spectral, r_temporal = (np.corrcoef(means[tests], column)[0, 1] for column in metrics[tests].T)
    assert (r_spectral > r_temporal + 0.2) == (spectral > 0)
    assert (r_temporal > r_spectral + 0.2) == (temporal > 0)
    assert max(r_spectral, r_temporal) > 0.9


def test_seed_and_number_decide_and_the_clock_does_not(stimuli: StimulusSet, plan: Plan) -> None:
    assert rate(stimuli, plan, MODEL) == rate(stimuli, plan, MODEL)
    assert rate(stimuli, plan, MODEL, seed=2) != rate(stimuli, plan, MODEL)
    late = SimulatedObserver(MODEL, seed=1, number=1, elapsed_s=99.0)
    late.show(plan.trials[0], REALISM)
    late.play(stimuli.stimuli[0])
    early = SimulatedObserver(MODEL, seed=1, number=1)
    early.show(plan.trials[0], REALISM)
    early.play(stimuli.stimuli[0])
    assert late.ask(REALISM).rating == early.ask(REALISM).rating


def test_time_goes_on_by_what_is_played_and_answered(stimuli: StimulusSet, plan: Plan) -> None:
    observer = SimulatedObserver(MODEL, seed=1, number=1, elapsed_s=100.0)
    observer.show(plan.trials[0], REALISM)
    first, second = observer.play(stimuli.stimuli[0]), observer.play(stimuli.stimuli[1])
    answer = observer.ask(REALISM)
    assert (first.onset_s, second.onset_s) == (100.5, 102.0)
    assert answer.time_s == pytest.approx(103.0 + answer.response_time_s)


def test_an_observer_who_felt_nothing_cannot_rate() -> None:
    with pytest.raises(ValueError, match="was asked before anything was played; play first"):
        SimulatedObserver(MODEL, seed=1, number=1).ask(REALISM)


def test_identity_names_everything_that_ratings_depend_on() -> None:
    assert identify_observer(MODEL, seed=3)["seed"] == 3
    assert identify_observer(MODEL, seed=3)["observer"]["noise_sd"] == 8.0
    assert identify_observer(MODEL, seed=3)["simulated"] is True
