"""Laws that every rival metric obeys."""

import numpy as np
import pytest

from feel321.stimuli.metrics import METRICS
from feel321.stimuli.rivals import RIVALS
from feel321.stimuli.rotation import random_rotations
from feel321.types import METRIC_INFO

RATE = 4000.0
EVERY = pytest.mark.parametrize("name", list(RIVALS))
"""Rivals that depend on the unit: they compare with a threshold in m/s²."""


def make_burst(n: int = 6000, *, seed: int = 0) -> np.ndarray:
    """Noise in bursts, whose envelope and spectrum both have something to lose."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.uniform(0.1, 2.0, -(-n // 400)), 400)[:n]
    return np.asarray(steps * rng.standard_normal(n))


def measure(name: str, acceleration: np.ndarray, reduced: np.ndarray, rate: float = RATE) -> float:
    return METRICS[name](acceleration, reduced, rate)


def on_one_axis(signal: np.ndarray) -> np.ndarray:
    return np.stack([0 * signal, signal, 0 * signal])


def perfect(name: str) -> float:
    return METRIC_INFO[name].low if METRIC_INFO[name].higher == "worse" else METRIC_INFO[name].high


@EVERY
def test_a_signal_is_a_perfect_match_of_itself(name: str) -> None:
    signal = make_burst()
    assert measure(name, on_one_axis(signal), signal) == pytest.approx(perfect(name), abs=1e-9)
    assert measure(name, on_one_axis(signal), -signal) == pytest.approx(perfect(name), abs=1e-9)


@EVERY
def test_the_mounting_of_the_sensor_and_the_order_of_axes_change_nothing(name: str) -> None:
    signal = make_burst()
    recording = np.stack([signal, make_burst(seed=1), make_burst(seed=2)])
    own = measure(name, recording, signal)
    for turn in random_rotations(3, np.random.default_rng(0)):
        assert measure(name, turn @ recording, signal) == pytest.approx(own, rel=1e-7, abs=1e-7)
    assert measure(name, recording[[2, 0, 1]], signal) == pytest.approx(own, rel=1e-9)


@EVERY
@pytest.mark.parametrize("reduced", [np.zeros(4000), np.ones(4000)])
def test_a_silent_recording_leaves_nothing_to_compare(name: str, reduced: np.ndarray) -> None:
    assert np.isnan(measure(name, np.zeros((3, 4000)), reduced))
    assert np.isnan(measure(name, np.outer((0, 9.81, 1), np.ones(4000)), reduced))
    assert RIVALS[name].reason


@EVERY
@pytest.mark.parametrize("rate", [20.0, 39.0, 41.0, 977.3, 1600.0, 25600.0, 51200.7])
@pytest.mark.parametrize("n", [1, 2, 3, 17, 256, 1009])
def test_short_signals_and_odd_rates_are_within_bounds_or_nothing(
    name: str, rate: float, n: int
) -> None:
    recording = np.random.default_rng(n).standard_normal((3, n))
    info = METRIC_INFO[name]
    for reduced in (recording[1], 1e9 * recording[1], 1e-9 * recording[1], 0 * recording[1]):
        value = measure(name, recording, reduced, rate)
        assert np.isnan(value) or info.low <= value <= info.high
        assert not (np.isnan(value) and n > 1000 and rate in {977.3, 1600.0})
