"""Detection thresholds: simulated observers recovered, levels in bounds, replay to the bit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from feel321.protocols import threshold as module
from feel321.protocols.threshold import (
    PROCEDURES,
    Presentation,
    Procedure,
    ThresholdPlan,
    estimate_threshold,
    predict_correct,
)  # fmt: skip

PLAN = ThresholdPlan(lowest_db=-60, highest_db=0, start_db=-10)
NAMES = list(PROCEDURES)


def resume(name: str, plan: ThresholdPlan, *, answers: Sequence[int] = ()) -> Procedure:
    """A procedure as it is after the given answers."""
    procedure = Procedure(name, plan)
    for answer in answers:
        procedure.update(answer)
    return procedure


@dataclass(frozen=True)
class Observer:
    """A participant by a psychometric function; `hint` tells them the interval of silent trials too."""

    threshold_db: float
    slope: float = 3.0
    hint: bool = False

    def answer(self, trial: Presentation, rng: Generator) -> int:
        chance = 1.0 if self.hint else 0.5
        if trial.level_db is not None:
            own = {"threshold_db": self.threshold_db, "slope": self.slope}
            chance = float(predict_correct(trial.level_db, PLAN, **own))
        return trial.interval if rng.random() < chance else 3 - trial.interval


def conduct(
    name: str, observer: Observer, *, seed: int = 1, plan: dict[str, Any] | None = None
) -> Procedure:
    procedure = resume(name, replace(PLAN, seed=seed, **(plan or {})))
    rng = np.random.default_rng([seed, 7])
    while (trial := procedure.next()) is not None:
        procedure.update(observer.answer(trial, rng))
    return procedure


@pytest.mark.parametrize("name", NAMES)
def test_100_observers_lie_in_their_intervals(name: str) -> None:
    """Of 100, 95 are expected, and fewer than 89 about one time in a hundred."""
    rng = np.random.default_rng(14)
    planted = rng.uniform(-45, -15, 100)
    slopes = np.exp(rng.uniform(*np.log((1, 8)), 100))
    observers = [Observer(*pair) for pair in zip(planted, slopes, strict=True)]
    found = [
        estimate_threshold(conduct(name, one, seed=seed)) for seed, one in enumerate(observers)
    ]
    low, high = np.array([(one.threshold_low_db, one.threshold_high_db) for one in found]).T
    slope_low, slope_high = np.array([(one.slope_low, one.slope_high) for one in found]).T
    off = np.array([one.threshold_db for one in found]) - planted
    assert np.mean((low <= planted) & (planted <= high)) >= 0.89
    assert np.mean((slope_low <= slopes) & (slopes <= slope_high)) >= 0.89
    assert abs(np.nanmean(off)) < 0.8
    assert np.nanstd(off) < {"staircase": 4, "bayesian": 2.5}[name]
    assert np.median(high - low) < 10  # an interval that holds everything proves nothing


def test_the_planted_proportion_is_correct_at_the_threshold() -> None:
    for n_down, expected in ((2, 0.7071), (3, 0.7937), (4, 0.8409)):  # Levitt 1971, Table I
        plan = ThresholdPlan(lowest_db=-60, highest_db=0, start_db=0, n_down=n_down)
        levels = np.array([-300.0, -20.0, 100.0])
        chances = predict_correct(levels, plan, threshold_db=-20, slope=2)
        assert chances == pytest.approx([0.5, expected, 0.96], abs=1e-4)


def test_a_staircase_by_hand() -> None:
    """Two correct go down until the first wrong one, then three; steps of 8, 4 and 2 dB."""
    procedure = resume("staircase", ThresholdPlan(-60, 0, -10, catch_every=0, trials=20))
    levels = []
    for correct in map(int, "1111001111110110111"):
        trial = procedure.next()
        assert trial is not None
        levels.append(trial.level_db)
        procedure.update(trial.interval if correct else 3 - trial.interval)
    down = [-10, -10, -18, -18]
    after = [-26, -22, -18, -18, -18, -20, -20, -20, -22, -20, -20, -20, -18, -18, -18]
    assert levels == down + after
    estimate = estimate_threshold(procedure)
    # reversals at -26, -18, -22 and -18, the last two with the last step; a valley alone is no estimate
    valley = estimate_threshold(resume("staircase", procedure.plan, answers=procedure.answers[:14]))
    assert str(valley.threshold_db) == "nan"
    assert valley.notes[0] == "no threshold: too few reversals with the last step"
    assert estimate.threshold_db == -20


def test_questplus_chooses_the_same_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """PsychoPy brings the package; its thresholds are where k = 1, so one slope is compared."""
    questplus = pytest.importorskip("questplus", reason="comes with the rig extra (PsychoPy)")
    monkeypatch.setattr(module, "SLOPES", (3.5, 3.5, 1))
    monkeypatch.setattr(module, "_make_tables", module._make_tables.__wrapped__)  # not kept
    plan = ThresholdPlan(-30, 0, -10, trials=30, catch_every=0)
    scale = -np.log1p(-(plan.proportion - 0.5) / (0.5 - plan.lapse))
    thresholds = module._make_grid(plan)[0][:, 0] - 20 / 3.5 * np.log10(scale)
    oracle = questplus.QuestPlusWeibull(
        intensities=np.arange(-30, 1.0), thresholds=thresholds, slopes=[3.5], lower_asymptotes=[0.5],
        lapse_rates=[plan.lapse], responses=["Yes", "No"], stim_scale="dB",
    )  # fmt: skip
    procedure, rng = resume("bayesian", plan), np.random.default_rng(5)
    while (trial := procedure.next()) is not None:
        assert trial.level_db == oracle.next_intensity
        correct = rng.random() < 0.8
        oracle.update(intensity=trial.level_db, response="Yes" if correct else "No")
        procedure.update(trial.interval if correct else 3 - trial.interval)
    shift = estimate_threshold(procedure).threshold_db - oracle.param_estimate["threshold"]
    assert shift == pytest.approx(20 / 3.5 * np.log10(scale), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("threshold_db", "limit"), [(40, 0), (-120, -60)])
def test_levels_stay_within_the_rig(name: str, threshold_db: float, limit: float) -> None:
    procedure = conduct(name, Observer(threshold_db))
    levels = [one.level_db for one in procedure.shown if one.level_db is not None]
    assert min(levels) >= -60
    assert max(levels) <= 0
    assert limit in levels
    estimate = estimate_threshold(procedure)
    assert levels.count(limit) > 10
    assert "the interval reaches beyond the rig's levels" in " ".join(estimate.notes)


@pytest.mark.parametrize("name", NAMES)
def test_replay_is_identical(name: str) -> None:
    """At every trial: the answers so far give the same next trial to the last bit."""
    whole = conduct(name, Observer(-30), plan={"trials": 30, "lowest_db": -61.3})
    for done in range(0, len(whole.answers) + 1, 3):
        again = resume(name, whole.plan, answers=whole.answers[:done])
        assert again.shown == whole.shown[:done]
        assert again.next() == [*whole.shown, None][done]
    assert estimate_threshold(again) == estimate_threshold(whole)


def test_catch_trials_find_a_leaking_cue() -> None:
    estimate = estimate_threshold(conduct("staircase", Observer(-30, hint=True)))
    assert (estimate.catch_trials, estimate.catch_correct) == (6, 6)
    assert any(note.startswith("6 of 6 silent catch trials correct") for note in estimate.notes)


def test_a_preferred_interval_is_noted_from_5_percent_on() -> None:
    """Two-sided binomial test of 66 answers: p = 0.064 for 41 to one side, 0.036 for 42."""
    for side, other in ((1, 2), (2, 1)):
        for count, noted in ((41, False), (42, True)):
            procedure = resume("staircase", PLAN, answers=[side] * count + [other] * (66 - count))
            notes = " ".join(estimate_threshold(procedure).notes)
            assert ("interval 1 answered in" in notes) == noted


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lowest_db": 5}, "highest_db must be above lowest_db"),
        ({"start_db": 1}, "start_db between them; got 0, -60 and 1"),
        ({"highest_db": float("inf")}, "by 200 dB at most"),
        ({"lowest_db": float("nan")}, "highest_db must be above"),
    ],
)
def test_plans_that_cannot_be_run(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(PLAN, **change)


def test_refused_answers() -> None:
    procedure = resume("staircase", ThresholdPlan(-60, 0, -10, trials=1, catch_every=0))
    for wrong in (0, 3, True, "1"):
        with pytest.raises(ValueError, match="answer must be the interval 1 or 2"):
            procedure.update(wrong)  # type: ignore[arg-type]  # not only whole numbers come
    procedure.update(2)
    assert procedure.next() is None
    with pytest.raises(ValueError, match="all 1 trials are answered"):
        procedure.update(1)
    with pytest.raises(ValueError, match="did you mean 'bayesian'"):
        resume("baysian", PLAN)
