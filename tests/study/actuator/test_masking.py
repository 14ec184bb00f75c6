from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from feel321.study.actuator.mixer import Masker, make_pink

RAMP, LEAD = 20, 50
COLUMNS = [1, 2]


def pink(n: int = 480_000, seed: int = 1) -> np.ndarray:
    return make_pink(np.random.default_rng(seed), n_samples=n, rate_hz=48000.0)


def test_pink_falls_by_ten_decibels_per_decade() -> None:
    noise = np.stack([pink(seed=seed) for seed in range(4)])
    power = np.mean(np.abs(np.fft.rfft(noise)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(480_000, 1 / 48000)
    edges = np.geomspace(25, 20000, 25)
    bands = [(frequencies >= low) & (frequencies < high) for low, high in pairwise(edges)]
    levels = [10 * np.log10(power[band].mean()) for band in bands]
    middles = [np.log10(frequencies[band].mean()) for band in bands]
    slope = np.polyfit(middles, levels, 1)[0]
    assert slope == pytest.approx(-10, abs=0.15)
    assert power[frequencies < 19].max() < 1e-9 * power.max()


@pytest.mark.parametrize("n", [480_000, 9_999])
def test_the_loop_does_not_click(n: int) -> None:
    """The step from the last sample to the first is like all others, in the first and the second difference."""
    noise = pink(n)
    for order in (1, 2):
        steps = np.abs(np.diff(noise, n=order))
        seam = np.abs(np.diff(np.concatenate([noise[-order:], noise[:order]]), n=order))
        assert seam.max() < 5 * np.sqrt(np.mean(steps**2))


def masker(ramp: int = RAMP, lead: int = LEAD, noise: np.ndarray | None = None) -> Masker:
    ones = np.ones(4096, dtype=np.float32)
    own: Any = {"ramp_frames": ramp, "lead_frames": lead, "max_frames": 4096}
    return Masker(ones if noise is None else noise, columns=COLUMNS, **own)


def run(watch: Masker, n: int, *, frame: int = 0, size: int = 64) -> np.ndarray:
    out = np.zeros((n, 3), dtype=np.float32)
    for start in range(0, n, size):
        watch.fill(out[start : start + size], frame + start)
    assert not out[:, 0].any()
    assert_array_equal(out[:, 1], out[:, 2])
    return out[:, 1]


@given(gap=st.integers(0, 200), length=st.integers(1, 300), size=st.integers(1, 400))
def test_it_begins_before_and_ends_after(gap: int, length: int, size: int) -> None:
    watch = masker()
    onset = watch.cover(0, gap)
    assert onset == max(gap, LEAD)
    heard = run(watch, onset + length, size=size)
    watch.release(onset + length)
    tail = run(watch, 200, frame=onset + length, size=size)
    begin = onset - LEAD
    assert not heard[:begin].any()
    assert heard[begin] > 0
    assert np.all(np.diff(heard[begin : begin + RAMP]) > 0)
    assert_array_equal(heard[begin + RAMP - 1 :], 1)
    assert_array_equal(tail[: LEAD - RAMP], 1)
    assert np.all(np.diff(tail[LEAD - RAMP - 1 : LEAD - 1]) < 0)
    assert not tail[LEAD - 1 :].any()


@pytest.mark.parametrize(
    ("gap", "is_gone"),
    [(0, False), (LEAD + 5, False), (500, True)],
    ids=["it stays", "it stays where it would be back at once", "it comes again"],
)
def test_the_next_stimulus_decides_whether_it_goes(gap: int, is_gone: bool) -> None:
    watch = masker()
    end = watch.cover(0, 0) + 10
    run(watch, end)
    watch.release(end)
    onset = watch.cover(end, gap)
    heard = run(watch, 600, frame=end)
    assert onset == end + gap
    if is_gone:
        assert not heard[LEAD : gap - LEAD].any()
        assert_array_equal(heard[gap - LEAD + RAMP :], 1)
    else:
        assert_array_equal(heard, 1)
