import numpy as np
import pytest

from feel321.stimuli.match import WeberSmoothing, energy_spectrum, linear_grid


def smoothed_at(frequencies: np.ndarray, spacing: float, spectrum: np.ndarray) -> np.ndarray:
    smooth = WeberSmoothing(frequencies, spacing, spectrum.size)
    return smooth(spectrum[smooth.bins])


def test_one_line_becomes_a_rectangle_as_wide_as_the_weber_fraction() -> None:
    line = np.zeros(2001)
    line[500] = 1.0
    frequencies = linear_grid(4000, 4000.0)
    smoothed = smoothed_at(frequencies, 1.0, line)
    lit = frequencies[smoothed > 0]
    # 0.22 f wide around f: seen from f when 500 Hz lies within 0.11 f, one bin of slack at either edge.
    assert lit[0] == pytest.approx(500 / 1.11, abs=1)
    assert lit[-1] == pytest.approx(500 / 0.89, abs=1)
    assert smoothed[frequencies == 500] == pytest.approx(1 / 110)


def test_a_strong_tone_costs_its_weak_neighbours_no_accuracy() -> None:
    n, rate = 40_000, 10_000.0
    noise = np.random.default_rng(0).standard_normal(n)
    # Noise at -97 dB.
    spectrum = energy_spectrum(1e5 * np.sin(2 * np.pi * 50 * np.arange(n) / rate) + noise)
    frequencies = linear_grid(n, rate)
    smoothed = smoothed_at(frequencies, rate / n, spectrum)
    bins = np.arange(spectrum.size)
    for wanted in (400.0, 700.0, 950.0):
        k = wanted / (rate / n)
        covered = np.clip(
            np.minimum(bins + 1, k * 1.11 + 0.5) - np.maximum(bins, k * 0.89 + 0.5), 0, 1
        )
        expected = covered @ spectrum / (0.22 * k)
        # Extended precision gives 1e-7; where the platform has none (Windows), the running sum's rounding shows.
        tolerance = 1e-6 if np.finfo(np.longdouble).eps < np.finfo(np.float64).eps else 1e-2
        assert smoothed[np.argmin(abs(frequencies - wanted))] == pytest.approx(
            expected, rel=tolerance
        )


def test_energy_is_parsevals() -> None:
    samples = np.random.default_rng(1).standard_normal((2, 64))
    energy = energy_spectrum(samples)
    energy[:, 1:-1] *= 2
    np.testing.assert_allclose(energy.sum(axis=1) / 64, (samples**2).sum(axis=1))
