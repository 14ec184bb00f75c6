import numpy as np
import pytest

from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import random_rotations, rotation_statistics

RATE = 2000.0


def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def test_rotations_are_proper_and_uniform() -> None:
    turns = random_rotations(4000, rng())
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    # Of a uniform rotation every entry has mean 0 and mean square 1/3.
    np.testing.assert_allclose(turns.mean(axis=0), 0.0, atol=0.04)
    np.testing.assert_allclose((turns**2).mean(axis=0), 1 / 3, atol=0.03)


@pytest.mark.parametrize("name", ["say321", "dft321_windowed", "pca321"])
def test_against_one_rotation_after_the_other(name: str) -> None:
    acceleration = np.random.default_rng(0).standard_normal((3, 700)) * np.array([
        [1.0],
        [4.0],
        [0.2],
    ])
    statistics = rotation_statistics(acceleration, [name], rng=rng(), rate_hz=RATE)
    found = statistics.loc[name]
    turned = [turn @ acceleration for turn in random_rotations(200, rng())]
    reduced = [REDUCERS[name](one, RATE) for one in turned]
    spectral = [spectral_match(a, s, RATE) for a, s in zip(turned, reduced, strict=True)]
    temporal = [temporal_match(a, s) for a, s in zip(turned, reduced, strict=True)]
    expected = (
        np.mean(spectral),
        np.std(spectral, ddof=1),
        np.mean(temporal),
        np.std(temporal, ddof=1),
    )
    got = (found.spectral_mean, found.spectral_sd, found.temporal_mean, found.temporal_sd)
    np.testing.assert_allclose(got, expected, atol=1e-9)
