from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from feel321.study.actuator.mixer import Limiter

RATE = 1000.0  # a window of 1000 samples, a pause of 100
BLOCK = 100


def limiter(peak: float = 1.0, rms: float = 1.0, duration_s: float = 100.0) -> Limiter:
    return Limiter(RATE, peak=peak, rms=rms, duration_s=duration_s, max_frames=BLOCK)


def run(
    watch: Limiter, samples: np.ndarray, sizes: list[int] | None = None
) -> tuple[np.ndarray, int]:
    """What comes out if the blocks have the given sizes, over and over, and how many samples were changed."""
    out, place, changed = samples.astype(np.float32), 0, 0
    sizes = sizes or [BLOCK]
    number = 0
    while place < len(out):
        size = sizes[number % len(sizes)]
        changed += watch.limit(out[place : place + size])
        place, number = place + size, number + 1
    return out, changed


def noise(seed: int, n: int, rms: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, rms, n).astype(np.float32)


def largest_rms(samples: np.ndarray) -> float:
    """The RMS of every second, one by one."""
    padded = np.concatenate([np.zeros(999), samples.astype(np.float64)])
    return max(float(np.sqrt(np.mean(padded[i : i + 1000] ** 2))) for i in range(len(samples)))


@given(st.integers(0, 99), st.lists(st.integers(1, BLOCK), min_size=1, max_size=5))
def test_within_the_limits_nothing_changes(seed: int, sizes: list[int]) -> None:
    samples = noise(seed, 3000, 0.1)
    out, changed = run(limiter(peak=1.0, rms=0.2), samples, sizes)
    assert_array_equal(out, samples)
    assert changed == 0


@pytest.mark.parametrize("level", [0.3, 1.0])
def test_what_just_meets_the_limits_passes(level: float) -> None:
    """For hours, in the limiter's measure: rounding does not add up."""
    samples = np.full(BLOCK, level, dtype=np.float32)
    samples[1::2] *= -1
    watch = limiter(peak=level, rms=float(np.float32(level)), duration_s=1e9)
    assert sum(watch.limit(samples) for _ in range(5000)) == 0


@given(
    st.integers(0, 99),
    st.lists(st.integers(1, BLOCK), min_size=1, max_size=5),
    st.sampled_from([0.05, 0.2, 0.6]),
    st.sampled_from([0.05, 0.2]),
    st.sampled_from([0.5, 100.0]),
)
def test_the_blocks_make_no_difference(
    seed: int, sizes: list[int], peak: float, rms: float, duration_s: float
) -> None:
    samples = noise(seed, 2500, 0.3)
    samples[1200:1400] = 0
    whole, n_whole = run(limiter(peak, rms, duration_s), samples)
    parts, n_parts = run(limiter(peak, rms, duration_s), samples, sizes)
    assert_array_equal(whole, parts)
    assert n_whole == n_parts


@pytest.mark.parametrize("rms", [0.05, 0.2])
def test_no_second_is_louder_than_allowed(rms: float) -> None:
    parts = [noise(1, 900, 0.1), noise(2, 1500, 0.4), np.zeros(300), noise(3, 900, 0.4)]
    samples = np.concatenate(parts)
    out, changed = run(limiter(rms=rms), samples)
    assert largest_rms(out) <= rms * (1 + 1e-7)
    assert largest_rms(out) > 0.999 * rms
    assert changed == np.count_nonzero(out != samples.astype(np.float32))
    assert np.all(np.abs(out) <= np.abs(samples))
    assert np.all(out * samples >= 0)


def greedy(samples: np.ndarray, rms: float) -> np.ndarray:
    """Sample by sample: each gets at most what the last second leaves."""
    out = samples.astype(np.float64)
    for i in range(len(out)):
        before = np.sum(out[max(i - 999, 0) : i] ** 2)
        out[i] = np.copysign(min(abs(out[i]), max(rms**2 * 1000 - before, 0) ** 0.5), out[i])
    return out


@pytest.mark.parametrize("seed", range(2))
def test_each_sample_gets_what_the_last_second_leaves(seed: int) -> None:
    samples = np.clip(noise(seed, 3500, 0.3), -1, 1)
    samples[1000:1600] *= 0.1
    out, _ = run(limiter(rms=0.25), samples, [37])
    np.testing.assert_allclose(out, greedy(samples, 0.25), atol=2e-3)
    np.testing.assert_allclose(
        np.cumsum(out**2.0), np.cumsum(greedy(samples, 0.25) ** 2), rtol=1e-5
    )


@pytest.mark.parametrize(("gap", "is_shared"), [(200, True), (350, True), (370, False)])
def test_a_second_is_watched_across_silence(gap: int, is_shared: bool) -> None:
    """Two bursts share it if both are loud in one, however the silence between them is cut into blocks."""
    burst = np.full(400, 0.5)
    samples = np.concatenate([burst, np.zeros(gap), burst])
    for sizes in ([BLOCK], [37], [1, 99]):
        out, changed = run(limiter(rms=0.4), samples, sizes)
        assert (changed > 0) is is_shared
        assert largest_rms(out) <= 0.4 * (1 + 1e-7)


def test_what_is_no_number_is_silence_and_blinds_nothing() -> None:
    samples = np.full(3000, 0.5, dtype=np.float32)
    samples[[0, 150, 151, 1999]] = np.nan
    samples[700] = np.inf
    out, changed = run(limiter(peak=0.6, rms=0.3), samples)
    assert np.isfinite(out).all()
    assert largest_rms(out) <= 0.3 * (1 + 1e-7)
    assert changed == np.count_nonzero(out != samples)
    assert not out[[0, 150, 151]].any()


def test_what_lasts_too_long_is_muted_until_a_pause() -> None:
    long = np.full(1500, 0.1)
    short_rest, pause = np.zeros(99), np.zeros(100)
    out, changed = run(
        limiter(duration_s=1.0), np.concatenate([long, short_rest, long, pause, long]), [70]
    )
    expected = np.zeros_like(out)
    expected[:1000] = 0.1
    expected[3199:4199] = 0.1
    assert_array_equal(out, expected.astype(np.float32))
    assert changed == 500 + 1500 + 500
