"""Level and log-spectral distance, against loops and hand numbers."""

import math

import numpy as np
import pytest

from feel321.stimuli.metrics import METRICS

RATE = 4000.0


def brute_bands(acceleration: np.ndarray, reduced: np.ndarray, rate: float) -> list[tuple]:
    """Mean energy per bin of both signals in each band, bin by bin."""
    n = reduced.size
    original = (np.abs(np.fft.rfft(acceleration)) ** 2).sum(axis=0)
    kept = np.abs(np.fft.rfft(reduced)) ** 2
    lowest, highest, ratio = max(20.0, rate / n), min(1000.0, rate / 2), 1.11 / 0.89
    count = max(round(math.log(highest / lowest) / math.log(ratio)), 1)
    bands = []
    for k in range(count):
        low = lowest * (highest / lowest) ** (k / count)
        high = lowest * (highest / lowest) ** ((k + 1) / count)
        centre = (low + high) / 2 * n / rate
        half = max(0.11 * centre, 0.5)
        first, last = max(centre + 0.5 - half, 0), min(centre + 0.5 + half, original.size)
        shares = [max(min(b + 1, last) - max(b, first), 0) for b in range(original.size)]
        bands.append((np.dot(shares, original), np.dot(shares, kept)))
    return bands


@pytest.mark.parametrize("n", [401, 2000, 3001])
@pytest.mark.parametrize("rate", [1600.0, 4000.0])
def test_distances_between_bands_against_loops(n: int, rate: float) -> None:
    rng = np.random.default_rng(n)
    acceleration = rng.standard_normal((3, n)) * [[1.0], [2.0], [0.3]]
    reduced = acceleration.sum(axis=0) + rng.standard_normal(n)
    bands = brute_bands(acceleration, reduced, rate)
    decibels = [10 * math.log10(kept / original) for original, kept in bands]
    expected = math.sqrt(sum(level**2 for level in decibels) / len(bands))
    found = METRICS["log_spectral_distance"](acceleration, reduced, rate)
    assert found == pytest.approx(expected, rel=1e-9)


def test_level_is_that_of_the_felt_range() -> None:
    time = np.arange(8000) / RATE
    inside, outside = np.sin(2 * np.pi * 200 * time), np.sin(2 * np.pi * 1500 * time)
    recording = np.stack([3 * inside, 4 * inside, outside])
    level = METRICS["level_difference"]
    assert level(recording, 5 * inside + 100 * outside, RATE) == pytest.approx(0.0, abs=1e-9)
    assert level(recording, 10 * inside, RATE) == pytest.approx(20 * math.log10(2))
    assert level(recording, 1e-9 * inside, RATE) == 60.0


def test_one_silent_band_counts_as_sixty_decibels() -> None:
    """Two tones in different bands of the 18: one kept, one lost, all other bands without energy."""
    time = np.arange(4000) / RATE
    first, second = np.sin(2 * np.pi * 100 * time), np.sin(2 * np.pi * 400 * time)
    recording = np.stack([first, second, 0 * time])
    found = METRICS["log_spectral_distance"](recording, first, RATE)
    assert found == pytest.approx(math.sqrt((0 + 60**2) / 2), rel=1e-9)


def threshold(frequency_hz: float) -> float:
    """The contactor's, written out: displacement 0.1 µm at 250 Hz, 12 dB per octave to both sides."""
    ratio = frequency_hz / 250
    return (2 * math.pi * frequency_hz) ** 2 * 1e-7 * (ratio**-2 + ratio**2) / 2


@pytest.mark.parametrize("n", [401, 3001])
def test_pacinian_power_against_a_loop_over_frequencies(n: int) -> None:
    *axes, reduced = np.random.default_rng(0).standard_normal((4, n)) * [[1.0], [2.0], [0.3], [1.5]]
    own = kept = 0.0
    for k in range(n // 2 + 1):
        frequency = k * RATE / n
        if 20 <= frequency <= 1000:
            turns = np.exp(-2j * np.pi * k * np.arange(n) / n)
            own += sum(abs(axis @ turns) ** 2 for axis in axes) / threshold(frequency) ** 2
            kept += abs(reduced @ turns) ** 2 / threshold(frequency) ** 2
    found = METRICS["pacinian_power_difference"](np.stack(axes), reduced, RATE)
    assert found == pytest.approx(abs(10 * math.log10(kept / own)), rel=1e-9)
