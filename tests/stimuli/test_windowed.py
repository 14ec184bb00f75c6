"""The temporal match in windows: its laws, and planted motions whose axis turns."""

import numpy as np
import pytest

from feel321.stimuli.match import temporal_match, temporal_match_windowed

RATE = 1000.0
N = 4000


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def turning(wave: np.ndarray, turns: float = 2.0) -> np.ndarray:
    """A motion along an axis that turns in the plane of x and y."""
    angle = np.linspace(0, 2 * np.pi * turns, wave.size)
    return np.array([np.cos(angle), np.sin(angle), 0 * angle]) * wave


def windowed(acceleration: np.ndarray, reduced: np.ndarray) -> float:
    return temporal_match_windowed(acceleration, reduced, RATE)


def brute_force(acceleration: np.ndarray, reduced: np.ndarray, count: int) -> float:
    parts = [
        (a, r)
        for a, r in zip(
            np.array_split(acceleration, count, axis=1), np.array_split(reduced, count), strict=True
        )
        if a.any()
    ]
    weights = [float((a**2).sum()) for a, _ in parts]
    return float(np.average([temporal_match(a, r) for a, r in parts], weights=weights))


def test_it_is_the_mean_over_windows_by_energy() -> None:
    acceleration = noise(3, N) * np.exp(-np.arange(N) / 700) * [[1.0], [0.3], [0.0]]
    reduced = noise(N, seed=1) + acceleration[0]
    reduced[:700] = acceleration[:, 1500:2000] = 0.0
    expected = brute_force(acceleration, reduced, 40)
    assert windowed(acceleration, reduced) == pytest.approx(expected, rel=1e-12)


def test_a_turning_axis_matches_in_windows_and_not_as_a_whole() -> None:
    wave = noise(N)
    followed = turning(wave)
    assert temporal_match(followed, wave) < 0.05
    assert windowed(followed, wave) > 0.95
    unrelated = noise(N, seed=9)
    assert windowed(followed, unrelated) < 0.15
