import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.stimuli.reducers.axes import pca321, pca321_matched
from feel321.stimuli.reducers.registry import REDUCERS

RATE = 1000.0
MATCHED = [name for name in REDUCERS if "matched" in name]
WHOLE = [f"sa{axis}321_matched" for axis in "xyz"]
RUNNING = [f"{name}_running" for name in WHOLE]


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@given(seed=st.integers(0, 999), shares=st.tuples(*[st.floats(0.7, 2.0)] * 3))
def test_one_axis_with_the_energy_of_all(seed: int, shares: tuple[float, ...]) -> None:
    acceleration = noise(3, 60, seed=seed) * np.array(shares)[:, None]
    for axis, name in enumerate(WHOLE):
        reduced = REDUCERS[name](acceleration, RATE)
        assert np.sum(reduced**2) == pytest.approx(np.sum(acceleration**2))
        gain = np.sqrt(np.sum(acceleration**2) / np.sum(acceleration[axis] ** 2))
        np.testing.assert_allclose(reduced, gain * acceleration[axis])  # its sign is the axis's own


@given(seed=st.integers(0, 999))
def test_the_principal_axis_with_the_energy_of_all_about_their_means(seed: int) -> None:
    acceleration = noise(3, 60, seed=seed) + np.array([[9.8], [0], [1]])
    reduced, plain = pca321_matched(acceleration, RATE), pca321(acceleration, RATE)
    assert np.var(reduced) == pytest.approx(np.var(acceleration, axis=1).sum())
    gains = reduced / plain
    np.testing.assert_allclose(gains, gains[0])
    assert 1 <= gains[0] <= np.sqrt(3) + 1e-9


@pytest.mark.parametrize("name", MATCHED)
def test_a_motion_along_one_line_comes_out_whole(name: str) -> None:
    wave = noise(2000)
    reduced = REDUCERS[name](np.outer((2.0, 6.0, 3.0), wave), RATE)
    np.testing.assert_allclose(
        reduced, 7 * (wave - wave.mean() * (name == "pca321_matched")), atol=1e-9
    )


@pytest.mark.parametrize("name", RUNNING)
def test_the_running_gain_is_the_one_of_the_forgotten_past(name: str) -> None:
    acceleration = noise(3, 400, seed=4) * np.array([[1.0], [2.0], [0.5]])
    axis, last = "xyz".index(name[2]), 399
    weights = np.exp(-(last - np.arange(400)) / RATE)  # a time constant of 1 s
    energies = (weights * acceleration**2).sum(axis=1)
    expected = np.sqrt(energies.sum() / energies[axis]) * acceleration[axis, last]
    assert REDUCERS[name](acceleration, RATE)[last] == pytest.approx(expected)
