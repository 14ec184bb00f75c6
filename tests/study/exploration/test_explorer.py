"""Laws of what the hand's motion makes of a stimulus: identity, silence, bounds, smoothness, any blocks."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.study.exploration.explorer import (
    EXPLORERS,
    MOST_GAIN,
    MOST_RATE,
    RAMP_S,
    Explorer,
    GainExplorer,
    make_explorer,
)
from feel321.study.exploration.motion import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

RATE_HZ, REFERENCE = 8000.0, 0.1
N = 8000
MODES = tuple(EXPLORERS)


class Scripted:
    """A hand whose speed along x is a function of the output's time; a step of the callback's time is a report."""

    def __init__(self, speed: Callable[[float], float]) -> None:
        self._speed, self.time_s = speed, 0.0

    def read(self) -> Motion:
        speed = self._speed(self.time_s)
        return Motion(self.time_s, 0.0, 0.0, abs(speed), speed)

    def begin(self) -> None:
        pass

    def take(self) -> np.ndarray:
        return np.zeros((0, 4))

    def close(self) -> None:
        pass


def make_sound(frequency_hz: float = 120.0, *, peak: float = 0.5, channels: int = 1) -> np.ndarray:
    t = np.arange(N) / RATE_HZ
    fade = np.minimum(1, np.minimum(t, t[-1] - t) / 0.02)
    wave = peak * fade * np.sin(2 * np.pi * frequency_hz * t)
    return np.repeat(wave[:, None], channels, axis=1).astype(np.float32)


def explore(
    mode: str, speed: Callable[[float], float], sound: np.ndarray, *, block: int = 64
) -> np.ndarray:
    hand = Scripted(speed)
    explorer = make_explorer(mode, hand, reference_m_s=REFERENCE, rate_hz=RATE_HZ)
    explorer.prepare(sound)
    out = np.full_like(sound, np.nan)
    for start in range(0, len(sound), block):
        hand.time_s = start / RATE_HZ
        explorer.render(out[start : start + block], sound, start)
    return out


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("block", [1, 64, 480, 1023, N])
def test_constant_motion_at_the_reference_speed_is_the_stimulus_bit_for_bit(
    mode: str, block: int
) -> None:
    rng = np.random.default_rng(1)
    noise = (0.9 * rng.uniform(-1, 1, (N, 2))).astype(np.float32)
    for sound in (make_sound(channels=2), noise):
        np.testing.assert_array_equal(explore(mode, lambda _: REFERENCE, sound, block=block), sound)


@pytest.mark.parametrize("mode", MODES)
def test_a_hand_at_rest_feels_nothing(mode: str) -> None:
    assert not explore(mode, lambda _: 0.0, make_sound()).any()
    assert not explore(mode, lambda _: float("nan"), make_sound()).any()
    out = explore(mode, lambda t: REFERENCE if t < 0.4 else 0.0, make_sound())
    ends = round((0.4 + 2 * RAMP_S) * RATE_HZ)
    assert out[round(0.35 * RATE_HZ) : round(0.4 * RATE_HZ)].any()
    assert not out[ends:].any()


def hand_of(rng: np.random.Generator) -> Callable[[float], float]:
    """A restless hand: a new speed every 8 ms, at rest, back and forth, far too fast."""
    speeds = rng.choice([0.0, 0.0, 0.01, 0.1, 0.1, 0.25, 5.0, -0.1], 200)
    return lambda t: float(speeds[int(t * 125)])


def steepest(mode: str, sound: np.ndarray) -> float:
    """The largest step between two samples that the ramps and the stimulus itself allow."""
    peak = float(np.abs(sound).max())
    own = float(np.abs(np.diff(sound, axis=0)).max())
    gain_step = 1 / (RAMP_S * RATE_HZ)
    if mode == "gain":
        return MOST_GAIN * own + peak * gain_step
    if mode == "speed":
        return 1.1 * MOST_RATE * own + peak * gain_step
    # Two windows of up to the peak fade into each other, half a cosine in half a window.
    return own + peak * gain_step + 2 * peak * np.pi / 2 / (0.025 * RATE_HZ)


@pytest.mark.parametrize("mode", MODES)
@given(seed=st.integers(0, 2**20))
def test_whatever_the_hand_does_nothing_clicks_and_nothing_exceeds_full_scale(
    mode: str, seed: int
) -> None:
    sound = make_sound(peak=0.95)
    out = explore(mode, hand_of(np.random.default_rng(seed)), sound)
    assert np.all(np.isfinite(out))
    assert np.abs(out).max() <= (1.0 if mode != "speed" else 0.95 * 1.01) + 1e-6
    steps = np.abs(np.diff(np.concatenate([[[0.0]], out, [[0.0]]]), axis=0))
    assert steps.max() <= steepest(mode, sound)


def test_a_click_would_be_seen() -> None:
    """The law above is not empty: the same hand without ramps breaks it."""

    class Hard(GainExplorer):
        def _play_louder(self, part: np.ndarray, target: float) -> None:
            part *= np.float32(target)

    sound, rng = make_sound(peak=0.95), np.random.default_rng(0)
    hand = Scripted(hand_of(rng))
    explorer = Hard(hand, reference_m_s=REFERENCE, rate_hz=RATE_HZ)
    explorer.prepare(sound)
    out = np.empty_like(sound)
    for start in range(0, N, 64):
        hand.time_s = start / RATE_HZ
        explorer.render(out[start : start + 64], sound, start)
    assert np.abs(np.diff(out, axis=0)).max() > steepest("gain", sound)


@pytest.mark.parametrize(("ratio", "hz"), [(0.5, 60.0), (2.0, 240.0), (3.0, 360.0)])
def test_speed_moves_the_pitch_and_windows_do_not(ratio: float, hz: float) -> None:
    sound = make_sound(120.0)
    for mode, expected in (("speed", hz), ("window", 120.0)):
        out = explore(mode, lambda _: ratio * REFERENCE, sound)[800:-800, 0]
        power = np.abs(np.fft.rfft(out * np.hanning(len(out))))
        peak = np.argmax(power) * RATE_HZ / len(out)
        # Windows that do not fit together broaden the line by one over their length.
        assert abs(peak - expected) < (2.0 if mode == "speed" else 25.0)


def test_gain_follows_speed() -> None:
    sound = make_sound(peak=0.4)
    for ratio, gain in ((0.25, 0.25), (1.5, 1.5), (7.0, MOST_GAIN)):
        out = explore("gain", lambda _, r=ratio: r * REFERENCE, sound)
        np.testing.assert_allclose(out, gain * sound, atol=1e-6)
    loud = make_sound(peak=0.9)
    assert np.abs(explore("gain", lambda _: 10 * REFERENCE, loud)).max() == pytest.approx(1.0)


def test_speed_runs_through_the_stimulus_as_far_as_the_hand_moves() -> None:
    """A ramp as stimulus tells the place: after the hand's path, the sample that lies there."""
    line = np.linspace(0, 0.9, N, dtype=np.float32)[:, None]
    out = explore("speed", lambda t: REFERENCE * (0.5 if t < 0.5 else 1.5), line)
    k = round(0.45 * RATE_HZ)
    assert out[k, 0] == pytest.approx(line[round(0.5 * k), 0], abs=1e-3)
    # The first sample's neighbour is the last one: a stimulus begins again at its end.
    assert np.all(np.diff(out[5 : round(0.9 * RATE_HZ), 0]) > 0)


def test_a_window_goes_back_where_the_hand_does() -> None:
    line = np.linspace(0, 0.9, N, dtype=np.float32)[:, None]
    out = explore("window", lambda t: REFERENCE * (1.0 if t < 0.5 else -1.0), line)[:, 0]
    assert out[round(0.85 * RATE_HZ)] == pytest.approx(line[round(0.15 * RATE_HZ), 0], abs=0.06)


@pytest.mark.parametrize("mode", MODES)
def test_blocks_do_not_matter_between_reports(mode: str) -> None:
    """Where a report falls on a multiple of all blocks, how the device asks changes nothing."""
    sound = make_sound()

    def hand(time_s: float) -> float:
        return REFERENCE * (0.5 + 0.5 * (int(time_s * RATE_HZ + 0.5) // 960 % 3))

    whole = explore(mode, hand, sound, block=960)
    for block in (1, 60, 320):
        np.testing.assert_allclose(explore(mode, hand, sound, block=block), whole, atol=2e-6)


@pytest.mark.parametrize("mode", MODES)
def test_rendering_keeps_nothing(mode: str) -> None:
    sound, hand = make_sound(channels=2), Scripted(lambda t: 0.1 + 0.05 * np.sin(9 * t))
    explorer: Explorer = make_explorer(mode, hand, reference_m_s=REFERENCE, rate_hz=RATE_HZ)
    explorer.prepare(sound)
    block = np.zeros((64, 2), dtype=np.float32)

    def run(blocks: range) -> None:
        for number in blocks:
            hand.time_s = number * 64 / RATE_HZ
            explorer.render(block, sound, number * 64 % (N - 64))

    run(range(20))
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        run(range(20, 120))
        assert tracemalloc.get_traced_memory()[0] - before < 4096
    finally:
        tracemalloc.stop()


def test_a_mode_that_is_none_is_refused() -> None:
    hand: Any = Scripted(lambda _: 0.0)
    with pytest.raises(ValueError, match="explore must be one of gain, speed, window; got 'gian'"):
        make_explorer("gian", hand, reference_m_s=REFERENCE, rate_hz=RATE_HZ)
