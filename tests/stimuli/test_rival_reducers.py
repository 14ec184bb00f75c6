"""Reducers to compare others with: their laws, against sums written out and closed forms."""

import itertools
import math

import numpy as np
import pytest

from feel321.stimuli.reducers.bands import EDGES_HZ, FASTEST_S, SPLITS_HZ
from feel321.stimuli.reducers.registry import REDUCERS, StreamingReducer
from feel321.stimuli.rotation import random_rotations
from feel321.stimuli.synthesis import make_scene

RATE = 4000.0
RIVALS = ("dft321_bands", "dft321_filtered")
TIME = np.arange(4000) / RATE


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def reduce(name: str, acceleration: np.ndarray) -> np.ndarray:
    return REDUCERS[name](acceleration, RATE)


@pytest.mark.parametrize("name", RIVALS)
def test_motion_along_one_line_is_kept(name: str) -> None:
    wave = np.convolve(noise(4000), np.ones(5), "same")
    reduced = reduce(name, np.outer((2.0, 6.0, 3.0), wave))
    assert np.abs(np.abs(reduced) - 7 * np.abs(wave)).max() < 1e-9 * np.abs(wave).max()
    assert np.ptp(np.sign(reduced * wave)[np.abs(wave) > 1e-6]) == 0


def test_turning_the_sensor_changes_at_most_the_sign_of_bands() -> None:
    recording = make_scene("hard_taps", rate_hz=RATE, duration_s=1).acceleration
    once = reduce("dft321_bands", recording)
    for turn in random_rotations(3, np.random.default_rng(1)):
        other = reduce("dft321_bands", turn @ recording)
        apart = min(np.abs(other - once).max(), np.abs(other + once).max())
        assert apart < 1e-6 * np.abs(once).max()


@pytest.mark.parametrize("n", [999, 4000])
def test_bands_keep_the_energy_of_all_axes_band_by_band(n: int) -> None:
    recording = noise(3, n) * [[1.0], [0.4], [2.0]]
    reduced = reduce("dft321_bands", recording)
    frequencies = np.fft.fftfreq(n, 1 / RATE)
    edges = (*EDGES_HZ, math.inf)
    for low, high in itertools.pairwise(edges):
        band = (np.abs(frequencies) >= low) & (np.abs(frequencies) < high)
        total = (np.abs(np.fft.fft(recording)[:, band]) ** 2).sum()
        assert (np.abs(np.fft.fft(reduced)[band]) ** 2).sum() == pytest.approx(total, rel=1e-9)


def brute_filter_bank(acceleration: np.ndarray) -> np.ndarray:
    """Sample by sample, with all its state in the open."""
    reduced = np.zeros(acceleration.shape[1])
    lows = np.zeros((len(SPLITS_HZ), 3))
    energies = np.zeros((len(SPLITS_HZ) + 1, 2))
    for k, sample in enumerate(acceleration.T):
        for i, split in enumerate(SPLITS_HZ):
            pole = math.exp(-2 * math.pi * split / RATE)
            lows[i] = pole * lows[i] + (1 - pole) * sample
        for i, band in enumerate(np.diff([np.zeros(3), *lows, sample], axis=0)):
            top = SPLITS_HZ[i] if i < len(SPLITS_HZ) else math.inf
            memory = math.exp(-1 / (max(FASTEST_S, 1 / top) * RATE))
            energies[i] = memory * energies[i] + [band @ band, band.sum() ** 2]
            total, kept = energies[i]
            reduced[k] += math.sqrt(total / max(kept, total / 100)) * band.sum()
    return reduced


def test_the_filter_bank_against_a_loop_over_samples() -> None:
    recording = noise(3, 500) * [[1.0], [0.5], [-2.0]]
    np.testing.assert_allclose(
        reduce("dft321_filtered", recording), brute_filter_bank(recording), atol=1e-11
    )


def test_the_filter_bank_has_the_energy_of_all_axes_and_no_delay() -> None:
    recording = noise(3, 40_000) * [[1.0], [0.5], [0.8]]
    reduced = reduce("dft321_filtered", recording)
    assert np.sum(reduced**2) == pytest.approx(np.sum(recording**2), rel=0.1)
    late = np.zeros((3, 100))
    late[:, 60] = 1.0
    assert np.flatnonzero(reduce("dft321_filtered", late))[0] == 60
    assert StreamingReducer("dft321_filtered", RATE).latency_samples == 0
