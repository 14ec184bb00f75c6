"""The bounded spectral match: brute force over frequencies, and its laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.stimuli.match import (
    OriginalSpectrum,
    spectral_match,
    spectral_match_bounded,
    spectral_match_details,
)
from feel321.stimuli.reducers.registry import REDUCERS

RATE = 4000.0
SIZES = st.floats(-9.0, 9.0).map(lambda exponent: 10.0**exponent)


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def tone(frequency_hz: float, n: int = 4000) -> np.ndarray:
    return np.sin(2 * np.pi * frequency_hz * np.arange(n) / RATE)


def stand_in(energy_of: np.ndarray) -> np.ndarray:
    """Three axes, two of them silent: E is the spectrum of this one signal."""
    return np.array([energy_of, 0 * energy_of, 0 * energy_of])


def brute_force(acceleration: np.ndarray, reduced: np.ndarray, rate_hz: float) -> float:
    """Go through the frequencies one by one, with the smoothing window bin by bin."""
    n = reduced.size
    original = (np.abs(np.fft.rfft(acceleration)) ** 2).sum(axis=0)
    kept = np.abs(np.fft.rfft(reduced)) ** 2
    energy, energies = (acceleration**2).sum(), max((acceleration**2).sum(), (reduced**2).sum())
    bins, deviations = np.arange(original.size), []
    for k in bins:
        if not 20 <= k * rate_hz / n <= 1000:
            continue
        half = max(0.11 * k, 0.5)
        low, high = max(k + 0.5 - half, 0), min(k + 0.5 + half, original.size)
        covered = np.clip(np.minimum(bins + 1, high) - np.maximum(bins, low), 0, 1) / (high - low)
        e, s = covered @ original, covered @ kept
        if e > 1e-12 * energy or s > 1e-12 * energies:
            deviations.append(abs(e - s) / max(e, s))
    return 1 - sum(deviations) / len(deviations)


@pytest.mark.parametrize("n", [401, 2000, 3001])
@pytest.mark.parametrize("name", ["sax321", "soc321", "mag321", "pca321", "dft321_windowed"])
def test_it_is_the_mean_over_frequencies(name: str, n: int) -> None:
    acceleration = noise(3, n, seed=n) * np.array([[1.0], [2.0], [0.3]])
    reduced = REDUCERS[name](acceleration, RATE)
    expected = brute_force(acceleration, reduced, RATE)
    assert spectral_match_bounded(acceleration, reduced, RATE) == pytest.approx(expected, abs=1e-12)
    assert spectral_match_details(acceleration, reduced, RATE).bounded == pytest.approx(
        expected, abs=1e-12
    )


@settings(deadline=None, max_examples=60)
@given(SIZES, SIZES, st.integers(40, 300), st.integers(0, 9), st.floats(100.0, 50_000.0))
def test_it_lies_between_0_and_1_and_one_factor_changes_nothing(
    size: float, factor: float, n: int, seed: int, rate_hz: float
) -> None:
    acceleration, reduced = noise(3, n, seed=seed), size * noise(n, seed=seed + 10)
    match = spectral_match_bounded(acceleration, reduced, rate_hz)
    scaled = spectral_match_bounded(factor * acceleration, factor * reduced, rate_hz)
    if np.isnan(match):
        assert not len(OriginalSpectrum(acceleration, rate_hz).frequencies_hz)
        assert np.isnan(scaled)
    else:
        assert 0.0 <= match <= 1.0
        assert scaled == pytest.approx(match, abs=1e-9)


def test_energy_in_bands_that_the_recording_left_empty_is_seen() -> None:
    recording = stand_in(tone(100.0))
    assert spectral_match_bounded(recording, tone(100.0), RATE) == 1.0
    # A tone fills 89 to 113 Hz of the smoothed spectrum; another one, 100 times weaker, 10 times as many frequencies.
    added = tone(100.0) + 0.01 * tone(900.0)
    assert spectral_match(recording, added, RATE) == pytest.approx(1.0, abs=1e-9)
    n_own = spectral_match_details(recording, tone(100.0), RATE).n_frequencies
    n_added = spectral_match_details(stand_in(tone(900.0)), tone(900.0), RATE).n_frequencies
    assert spectral_match_bounded(recording, added, RATE) == pytest.approx(
        n_own / (n_own + n_added), abs=1e-9
    )
    assert spectral_match_bounded(recording, tone(900.0), RATE) == 0.0
