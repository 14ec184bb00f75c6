"""Measurements: against public functions, in closed form, and on reducers with planted faults."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff import cost
from feel321.analysis.tradeoff.measure import measure_tradeoff, spread_turns
from feel321.stimuli.match import temporal_match
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import INVARIANTS
from feel321.stimuli.thresholds import felt_level

KEY = ["kind", "recording", "reducer", "condition", "measure"]


def read(frame: pd.DataFrame, reducer: str, condition: str, measure: str) -> float:
    own = frame[frame["reducer"].eq(reducer) & frame["condition"].eq(condition)]
    return float(own[own["measure"] == measure]["value"].iloc[0])


def to_db(ratio: float) -> float:
    return float(10 * np.log10(np.clip(ratio, 1e-6, 1e6)))


@pytest.mark.parametrize("name", REDUCERS)
def test_numbers_are_those_of_the_public_functions(
    name: str, frame: pd.DataFrame, recordings: list[Recording]
) -> None:
    scene = recordings[0]
    output = REDUCERS[name](scene.acceleration, scene.rate_hz)
    own = frame[frame["recording"] == scene.name]
    given = scene.acceleration, output, scene.rate_hz
    level = felt_level(output, scene.rate_hz) / felt_level(scene)
    expected = {
        "spectral_match": METRICS["spectral_match"](*given),
        "spectral_match_bounded": METRICS["spectral_match_bounded"](*given),
        "temporal_match": METRICS["temporal_match"](*given),
        "temporal_match_windowed": METRICS["temporal_match_windowed"](*given),
        "level_db": to_db(level**2),
        "spectrum_db": -to_db(INVARIANTS["spectral_match"](*given)),
        "motion_db": -to_db(INVARIANTS["temporal_match"](*given) ** 2),
        "envelope_db": 2 * to_db(1 + METRICS["modulation_distance"](*given)),
    }
    found = {measure: read(own, name, "as recorded", measure) for measure in expected}
    assert found == pytest.approx(expected, abs=1e-8)
    turned = [
        temporal_match(turn @ scene.acceleration, REDUCERS[name](turn @ scene.acceleration, 4000.0))
        for turn in spread_turns(8)
    ]
    assert read(own, name, "mounting", "temporal_match") == pytest.approx(np.mean(turned), abs=1e-6)


def tap() -> Recording:
    time = np.arange(2000) / 4000 - 0.25
    shape = np.where(time >= 0, np.exp(-np.maximum(time, 0) / 0.02), 0) * np.sin(800 * time)
    return Recording(np.outer([0.6, 0.64, 0.48], 20 * shape), 4000.0, "tap")


FAULTS: dict[str, tuple[Callable[..., Any], str]] = {
    "saturates": (lambda a, _: np.clip(a.sum(axis=0), -1, 1), "gain"),
    "rings": (lambda a, _: a[0] + a[0, ::-1] + np.roll(a[0], -30), "pre-echo"),
    "gives up": (
        lambda a, _: a[0] * np.cumprod((a != 0).any(axis=0) | (np.arange(a.shape[1]) < 1002)),
        "gaps",
    ),
    "is deaf": (lambda a, _: 0.1 * a[0], "level"),
    "flips": (lambda a, _: a[0] * np.sign(np.sin(1e5 * a)).mean(axis=0), "noise"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_are_found(fault: str) -> None:
    from feel321.analysis.tradeoff.page import advise_tradeoff

    method, kind = FAULTS[fault]
    given = {fault: method, "sound": lambda a, _: a[0]}
    verdicts = advise_tradeoff(measure_tradeoff(tap(), reducers=given)).verdicts
    found = dict(zip(verdicts["reducer"], verdicts["fails"], strict=True))
    assert kind in found[fault].split()
    assert found["sound"] == ""


def test_windows_are_candidates(recordings: list[Recording]) -> None:
    some = ["dft321", "dft321_windowed"]
    frame = measure_tradeoff(recordings[1], reducers=some, windows_ms=(20,))
    names = [*some, "dft321_windowed@20ms"]
    assert list(frame[frame["measure"] == "operations"]["reducer"]) == names
    assert read(frame, "dft321_windowed@20ms", "", "latency_ms") < 20


def test_a_labs_own_reducers_and_metrics_take_part(recordings: list[Recording]) -> None:
    def doubled(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
        return 2 * acceleration[0]

    def loudness(_acceleration: np.ndarray, reduced: np.ndarray, _rate_hz: float) -> float:
        return float(np.sqrt(np.mean(reduced**2)))

    frame = measure_tradeoff(recordings[0], reducers=[doubled, "sax321"], metrics=[loudness])
    once, twice = (read(frame, name, "as recorded", "loudness") for name in ("sax321", "doubled"))
    assert twice == pytest.approx(2 * once)
    level = [read(frame, name, "as recorded", "level_db") for name in ("doubled", "sax321")]
    assert level[0] - level[1] == pytest.approx(20 * np.log10(2))
    # Nothing is known of it, so that it counts as less simple than what is known.
    assert read(frame, "doubled", "", "operations") == np.inf


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        ("bumps.wav", {}, "must be Recordings, got 'bumps.wav'; make one with"),
        (None, {}, "must be Recordings, got None"),
        ([], {}, "one or more with different names, got none; name some"),
        ([tap(), tap()], {}, "with different names, got 'tap' twice; rename one"),
        (tap(), {"reducers": []}, "reducers must be one or more, got none"),
        (tap(), {"reducers": {"mine": lambda a, _: a}}, r"shape \(2000,\), got float64 of shape"),
    ],
)
def test_what_cannot_be_measured_is_refused(given: Any, options: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        measure_tradeoff(given, **options)


class Clock:
    """A clock that tasks move."""

    now = 0.0

    def thread_time(self) -> float:
        return self.now

    perf_counter = thread_time

    def take(self, seconds: float, samples: np.ndarray) -> np.ndarray:
        self.now += seconds
        return samples[0]


def test_time_is_relative_to_the_floor_of_the_same_run(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(cost, "time", clock)
    monkeypatch.setattr(cost, "time_floor", lambda samples: clock.take(0.002, samples))
    candidates = cost.list_candidates({"slow": lambda a, _: clock.take(0.005, a)})
    found = cost.time_reducers(candidates, tap(), rounds=3, rng=np.random.default_rng(0))
    ((_, times),) = found
    assert times == pytest.approx([2.5, 2.5, 2.5])
