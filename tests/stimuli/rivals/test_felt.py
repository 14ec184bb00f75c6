"""Pacinian power, spectral intensity, high/low balance and segments, against loops and hand numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from feel321.stimuli.metrics import METRICS
from feel321.stimuli.thresholds import acceleration_threshold

RATE = 4000.0
TIME = np.arange(4000) / RATE


def tone(frequency_hz: float) -> np.ndarray:
    return np.asarray(np.sin(2 * np.pi * frequency_hz * TIME))


def threshold(frequency_hz: float) -> float:
    """The contactor's, written out: displacement 0.1 µm at 250 Hz, 12 dB per octave to both sides."""
    ratio = frequency_hz / 250
    return (2 * math.pi * frequency_hz) ** 2 * 1e-7 * (ratio**-2 + ratio**2) / 2


def noise(n: int, *, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((4, n)) * [[1.0], [2.0], [0.3], [1.5]]


@pytest.mark.parametrize("n", [401, 3001])
def test_pacinian_power_against_a_loop_over_frequencies(n: int) -> None:
    *axes, reduced = noise(n)
    own = kept = 0.0
    for k in range(n // 2 + 1):
        frequency = k * RATE / n
        if 20 <= frequency <= 1000:
            turns = np.exp(-2j * np.pi * k * np.arange(n) / n)
            own += sum(abs(axis @ turns) ** 2 for axis in axes) / threshold(frequency) ** 2
            kept += abs(reduced @ turns) ** 2 / threshold(frequency) ** 2
    found = METRICS["pacinian_power_difference"](np.stack(axes), reduced, RATE)
    assert found == pytest.approx(abs(10 * math.log10(kept / own)), rel=1e-9)


def test_spectral_intensity_of_tones_is_known() -> None:
    """Bands with amplitudes (3, 4) and (3, 1) times the threshold at their middles: |4 - 1| / (3 + 4)."""
    edges = np.geomspace(20, 1000, 19)
    first, second = (float(edges[k : k + 2].mean()) for k in (6, 14))
    # A band's mean per bin, times its middle, stands for its energy: the same for both tones.
    strong = float(acceleration_threshold(first)) * tone(round(first))
    other = float(acceleration_threshold(second)) * tone(round(second))
    recording = np.stack([3 * strong, 4 * other, 0 * TIME])
    found = METRICS["spectral_intensity_distance"](recording, 3 * strong + other, RATE)
    assert found == pytest.approx(3 / 7, rel=1e-6)
    for gain, expected in ((0.25, 0.75), (1.0, 0.0), (4.0, 0.75)):
        reduced = gain * (3 * strong + 4 * other)
        found = METRICS["spectral_intensity_distance"](recording, reduced, RATE)
        assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("n", [401, 3001])
def test_balance_against_a_loop_over_frequencies(n: int) -> None:
    *axes, reduced = noise(n)
    sides = np.zeros((2, 2))
    for k in range(n // 2 + 1):
        frequency = k * RATE / n
        if 20 <= frequency <= 1000:
            turns = np.exp(-2j * np.pi * k * np.arange(n) / n)
            high = int(frequency >= math.sqrt(20_000))
            sides[0, high] += sum(abs(axis @ turns) ** 2 for axis in axes)
            sides[1, high] += abs(reduced @ turns) ** 2
    balance = 10 * np.log10(sides[:, 1] / sides[:, 0])
    found = METRICS["balance_difference"](np.stack(axes), reduced, RATE)
    assert found == pytest.approx(abs(balance[1] - balance[0]), rel=1e-9)


def brute_segments(acceleration: np.ndarray, reduced: np.ndarray) -> float:
    """The analytic signal at the full rate, filtered over the threshold; segments of exactly 40 samples."""
    n = reduced.size
    weights = np.array([
        2 / threshold(f) if 20 <= f <= 1000 else 0.0 for f in np.arange(n // 2 + 1) * RATE / n
    ])

    def intensity(signal: np.ndarray) -> np.ndarray:
        whole = np.zeros(n, complex)
        whole[: n // 2 + 1] = np.fft.rfft(signal) * weights
        return np.array([
            np.mean(np.abs(one) ** 2) for one in np.split(np.fft.ifft(whole), n // 40)
        ])

    own, kept = sum(intensity(axis) for axis in acceleration), intensity(reduced)
    floor = own.max() / 1e4
    return float(np.sqrt(np.mean((10 * np.log10((kept + floor) / (own + floor))) ** 2)))


def test_segments_against_the_analytic_signal_at_the_full_rate() -> None:
    rng = np.random.default_rng(1)
    steps = np.repeat(rng.uniform(0.02, 2, 25), 160)
    acceleration = steps * rng.standard_normal((3, 4000))
    reduced = acceleration[0] + np.roll(acceleration[1], 300)
    found = METRICS["segment_intensity_difference"](acceleration, reduced, RATE)
    # Ours samples the intensity at some 1.96 kHz, so that a segment's edges fall within half of such a step.
    assert found == pytest.approx(brute_segments(acceleration, reduced), rel=0.05)


def test_silence_is_forty_decibels_below_a_steady_tone_and_a_pause_counts_as_that() -> None:
    segments = METRICS["segment_intensity_difference"]
    recording = np.stack([tone(200), 0 * TIME, 0 * TIME])
    assert segments(recording, 0 * TIME, RATE) == pytest.approx(40.0, abs=0.01)
    assert segments(recording, 1e-4 * tone(200), RATE) == pytest.approx(40.0, abs=0.01)
