"""The reducers along a leading axis: what must hold for any motion, and where other reducers fail."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.reducers import fourier
from feel321.stimuli.reducers.fourier import (
    TrackingFrames,
    dft321,
    dft321_principal,
    dft321_principal_windowed,
)
from feel321.stimuli.rotation import random_rotations, temporal_match_invariant
from feel321.stimuli.synthesis import SCENES, make_scene

RATE = 4000.0
SEEDS = st.integers(0, 2**32 - 1)
BOTH = pytest.mark.parametrize("reduce", [dft321_principal, dft321_principal_windowed])
MIRRORS = [np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, -1.0]), -np.eye(3), np.eye(3)[[2, 0, 1]]]


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def uneven(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((3, 3)) @ (rng.standard_normal((3, n)) * rng.uniform(0.1, 3, (3, 1)))


def change(one: np.ndarray, other: np.ndarray) -> float:
    """Relative difference, whichever the sign."""
    return min(np.linalg.norm(one - other), np.linalg.norm(one + other)) / np.linalg.norm(one)


def gain(reduce: Callable[..., np.ndarray], acceleration: np.ndarray) -> float:
    """Median relative change of the output over that of the input, under noise at -60 dB."""
    once, found = reduce(acceleration, RATE), []
    for seed in range(9):
        hiss = noise(*acceleration.shape, seed=100 + seed)
        hiss *= 1e-3 * np.linalg.norm(acceleration) / np.linalg.norm(hiss)
        found.append(change(once, reduce(acceleration + hiss, RATE)) / 1e-3)
    return float(np.median(found))


def scene(name: str) -> np.ndarray:
    return condition(make_scene(name, duration_s=2.0), Conditioning()).acceleration


# --- what turning the sensor cannot change -------------------------------------------------------------------------


@BOTH
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, n=st.integers(1, 500))
def test_turning_or_mirroring_the_sensor_changes_at_most_the_sign(
    reduce: Callable[..., np.ndarray], seed: int, n: int
) -> None:
    acceleration = uneven(n, seed)
    once = reduce(acceleration, RATE)
    for turn in (*random_rotations(3, np.random.default_rng(seed)), *MIRRORS):
        changed = change(once, reduce(turn @ acceleration, RATE))
        assert changed < 1e-9


# --- what it keeps ---------------------------------------------------------------------------------------------------


@BOTH
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, n=st.integers(1, 400))
def test_motion_along_one_line_is_that_motion(
    reduce: Callable[..., np.ndarray], seed: int, n: int
) -> None:
    wave, line = noise(n, seed=seed), noise(3, seed=seed + 1)
    assert change(np.linalg.norm(line) * wave, reduce(np.outer(line, wave), RATE)) < 1e-9


def test_anti_phase_axes_keep_their_waveform() -> None:
    wave = noise(3000)
    wave -= wave.mean()
    acceleration = np.array([wave, -wave, 0 * wave]) + 1e-3 * noise(3, 3000, seed=1)
    for reduce in (dft321_principal, dft321_principal_windowed):
        assert change(np.sqrt(2) * wave, reduce(acceleration, RATE)) < 2e-3
        assert gain(reduce, acceleration) < 1.5
    assert gain(dft321, acceleration) > 100


# --- the axis --------------------------------------------------------------------------------------------------------


# --- conditioning and match on the scenes --------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
def test_on_every_scene_the_gain_is_small_and_the_match_at_least_that_of_dft321(name: str) -> None:
    acceleration = scene(name)
    values = np.linalg.eigvalsh(np.cov(acceleration))
    own = temporal_match_invariant(acceleration, dft321_principal(acceleration, RATE))
    # dft321 is taken over random mountings: on one of them its diagonal may happen to lie well.
    turned = [turn @ acceleration for turn in random_rotations(20, np.random.default_rng(2))]
    others = [temporal_match_invariant(one, dft321(one, RATE)) for one in turned]
    assert own >= np.mean(others)
    if values[-1] >= 1.2 * values[-2]:
        assert gain(dft321_principal, acceleration) <= 3


@BOTH
def test_weak_directions_are_looked_at(
    reduce: Callable[..., np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise of 2 % across two tones: its phase must be its own, not that of what is added at -60 dB."""
    time = 2 * np.pi * np.arange(8000) / RATE
    tones = np.array([np.sin(100 * time), 0.6 * np.sin(231.7 * time + 0.4), 0.02 * noise(8000)])
    assert gain(reduce, tones) < 3
    monkeypatch.setattr(fourier, "TILT", 0.0)
    assert gain(reduce, tones) > 10


# --- frames ----------------------------------------------------------------------------------------------------------


def test_the_axis_follows_motion_that_turns_slowly() -> None:
    n = 60_000
    angle = np.linspace(0, np.pi, n)  # half a turn in 15 s
    wave = np.sin(2 * np.pi * 123.4 * np.arange(n) / RATE)
    reduced = dft321_principal_windowed(
        np.array([np.cos(angle), np.sin(angle), 0 * angle]) * wave, RATE
    )
    np.testing.assert_allclose(np.abs(reduced[8000:-200]), np.abs(wave[8000:-200]), atol=0.1)
    kept = [
        reduced[start : start + 200] @ wave[start : start + 200]
        for start in range(8000, n - 200, 200)
    ]
    assert min(kept) > 0 or max(kept) < 0


@pytest.mark.parametrize("seed", range(8))
def test_silence_before_the_first_sound_takes_no_part_in_the_sign(seed: int) -> None:
    motion = noise(3, 8, 20, seed=seed)
    motion[:, :3] = 0
    whole = TrackingFrames((), 20).push(motion, np.ones((8, 20), dtype=bool))
    alone = TrackingFrames((), 20).push(motion[:, 2:], np.ones((6, 20), dtype=bool))
    np.testing.assert_allclose(whole[2:], alone, atol=1e-12)
    for turn in random_rotations(4, np.random.default_rng(seed)):
        turned = TrackingFrames((), 20).push(
            np.einsum("ij,jmk->imk", turn, motion), np.ones((8, 20), dtype=bool)
        )
        np.testing.assert_allclose(turned, whole, atol=1e-9)
    other = TrackingFrames((), 20)
    parts = [other.push(motion[:, at : at + 1], np.ones((1, 20), dtype=bool)) for at in range(8)]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12, atol=1e-12)
