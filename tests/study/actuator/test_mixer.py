"""The mixer and its parts: limiter, masking noise, and what comes out on every channel, whatever the blocks."""

import threading
import tracemalloc
from collections.abc import Iterator
from itertools import cycle, pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from feel321.study.actuator.mixer import Cue, Limiter, Masker, Mixer, make_pink
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, MaskingTable, Rig, SyncTable

# The limiter.

LIMITER_HZ = 1000.0  # a window of 1000 samples, a pause of 100
BLOCK = 100
BLOCKS = st.lists(st.integers(1, BLOCK), min_size=1, max_size=5)


def cut(out: np.ndarray, sizes: list[int]) -> Iterator[np.ndarray]:
    """Cut samples into blocks of the given sizes, over and over."""
    place = 0
    for size in cycle(sizes):
        if place >= len(out):
            return
        yield out[place : place + size]
        place += size


def limiter(peak: float = 1.0, rms: float = 1.0, duration_s: float = 100.0) -> Limiter:
    return Limiter(LIMITER_HZ, peak=peak, rms=rms, duration_s=duration_s, max_frames=BLOCK)


def run(
    watch: Limiter, samples: np.ndarray, sizes: list[int] | None = None
) -> tuple[np.ndarray, int]:
    """What comes out if the blocks have the given sizes, over and over, and how many samples were changed."""
    out = samples.astype(np.float32)
    return out, sum(watch.limit(block) for block in cut(out, sizes or [BLOCK]))


def noise(seed: int, n: int, rms: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, rms, n).astype(np.float32)


def largest_rms(samples: np.ndarray) -> float:
    """The RMS of every second, one by one."""
    padded = np.concatenate([np.zeros(999), samples.astype(np.float64)])
    return max(float(np.sqrt(np.mean(padded[i : i + 1000] ** 2))) for i in range(len(samples)))


@given(st.integers(0, 99), BLOCKS)
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


# Masking noise.

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


def hear(watch: Masker, n: int, *, frame: int = 0, size: int = 64) -> np.ndarray:
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
    heard = hear(watch, onset + length, size=size)
    watch.release(onset + length)
    tail = hear(watch, 200, frame=onset + length, size=size)
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
    hear(watch, end)
    watch.release(end)
    onset = watch.cover(end, gap)
    heard = hear(watch, 600, frame=end)
    assert onset == end + gap
    if is_gone:
        assert not heard[LEAD : gap - LEAD].any()
        assert_array_equal(heard[gap - LEAD + RAMP :], 1)
    else:
        assert_array_equal(heard, 1)


# The mixer.

RATE = 8000.0
MASKED = MaskingTable(channels=(3, 4), rms=0.1, ramp_s=0.02, lead_s=0.05, seed=3)
SYNC = SyncTable(channel=5, level=0.25, duration_s=0.01)
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)
COILS = (ActuatorTable(name="left", channel=1), ActuatorTable(name="right", channel=2))


def make_rig(**tables: Any) -> Rig:
    return Rig(**{"actuators": COILS, "limits": LIMITS, **tables})


def make_sounds(rig: Rig, n: int = 3000, *, rms: float = 0.2) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    sounds = {}
    for name in ("a", "b"):
        sound = np.zeros((n, rig.n_channels), dtype=np.float32)
        sound[:, :2] = np.clip(rng.normal(0, rms, (n, 2)), -1, 1)
        sounds[name] = sound
    return sounds


def make_mixer(
    *, preroll_s: float = 0.0, n: int = 3000, **tables: Any
) -> tuple[Mixer, dict[str, np.ndarray]]:
    rig = make_rig(**tables)
    sounds = make_sounds(rig, n)
    return Mixer(rig, sounds, rate_hz=RATE, preroll_s=preroll_s), sounds


def fill(mixer: Mixer, n: int, sizes: list[int], channels: int) -> np.ndarray:
    """What comes out in blocks of the given sizes, over and over; each block comes with rubbish in it."""
    out = np.full((n, channels), 9.0, dtype=np.float32)
    for block in cut(out, sizes):
        mixer.fill(block)
    return out


@settings(deadline=None)
@given(sizes=st.lists(st.integers(1, 5000), min_size=1, max_size=6), gap=st.integers(0, 700))
def test_what_comes_out_is_the_stimulus(sizes: list[int], gap: int) -> None:
    mixer, sounds = make_mixer()
    cue = mixer.start("a", gap_s=gap / RATE)
    out = fill(mixer, 5000, sizes, 2)
    assert_array_equal(out[gap : gap + 3000], sounds["a"])
    assert not out[:gap].any()
    assert not out[gap + 3000 :].any()
    assert (cue.onset_frame, cue.n_played, cue.clipped) == (gap, 3000, 0)
    assert cue.is_over
    assert cue.is_complete
    assert mixer.frame == 5000


@settings(deadline=None, max_examples=30)
@given(sizes=st.lists(st.integers(1, 5000), min_size=1, max_size=6), gap=st.integers(0, 700))
def test_the_blocks_make_no_difference(sizes: list[int], gap: int) -> None:
    """Not with masking, sync and a limiter that is at work either."""
    limits = LimitsTable(peak_m_s2=40.0, rms_m_s2=10.0, duration_s=0.3)
    outs = []
    for partition in ([800], sizes):
        mixer, _ = make_mixer(masking=MASKED, sync=SYNC, limits=limits)
        cue = mixer.start("a", gap_s=gap / RATE)
        outs.append((fill(mixer, 5000, partition, 5), cue.clipped, cue.onset_frame))
    assert_array_equal(outs[0][0], outs[1][0])
    assert outs[0][1:] == outs[1][1:]
    assert outs[0][1] > 500


@pytest.mark.parametrize("gap_s", [0.0, 0.02, 0.3])
def test_masking_leads_and_follows_and_the_sync_pulse_stands_at_the_onset(gap_s: float) -> None:
    """The silence that the masking's lead needs is made if the gap is too short; the pulse is one, at its level."""
    mixer, sounds = make_mixer(masking=MASKED, sync=SYNC)
    cue = mixer.start("a", gap_s=gap_s)
    out = fill(mixer, 9000, [300], 5)
    lead, onset = round(MASKED.lead_s * RATE), cue.onset_frame
    assert onset >= max(lead, round(gap_s * RATE))
    assert_array_equal(out[onset : onset + 3000, :2], sounds["a"][:, :2])
    assert np.count_nonzero(out[:, :2].any(axis=1)) == 3000
    heard = np.flatnonzero(out[:, 2:4].any(axis=1))
    assert abs(onset - lead - heard[0]) <= 2
    assert abs(onset + 3000 + lead - heard[-1]) <= 2
    pulse = np.zeros(9000, dtype=np.float32)
    pulse[onset : onset + round(SYNC.duration_s * RATE)] = SYNC.level
    assert_array_equal(out[:, 4], pulse)


@pytest.mark.parametrize(
    ("gap_s", "silence_s"), [(0.5, 0.3), (0.25, 0.1), (0.05, 0.05), (0.0, 0.0)]
)
def test_a_filters_lead_takes_up_the_gap_but_for_a_pause(gap_s: float, silence_s: float) -> None:
    """The limiter needs 0.1 s of silence between stimuli; the sync pulse marks the vibration, not the first sample."""
    mixer, sounds = make_mixer(sync=SYNC)
    cue = mixer.start("a", gap_s=gap_s, lead_s=0.2)
    out = fill(mixer, 9000, [300], 5)
    onset, end = round(silence_s * RATE), round(silence_s * RATE) + 3000
    assert cue.onset_frame == onset
    assert not out[:onset, :2].any()
    assert_array_equal(out[onset:end, :2], sounds["a"][:, :2])
    assert not out[end:, :2].any()
    pulse = np.flatnonzero(out[:, 4])
    assert (pulse[0], len(pulse)) == (onset + round(0.2 * RATE), round(SYNC.duration_s * RATE))


def test_nothing_is_scheduled_in_the_preroll() -> None:
    mixer, sounds = make_mixer(preroll_s=0.1)
    cue = mixer.start("a", gap_s=0)
    out = fill(mixer, 4000, [300], 2)
    assert cue.onset_frame == 900  # the first block that begins after it
    assert_array_equal(out[900:3900], sounds["a"])
    assert not out[:900].any()


@settings(deadline=None)
@given(size=st.integers(1, 2000), before=st.integers(1, 20))
def test_a_stop_is_silence_within_a_block(size: int, before: int) -> None:
    mixer, sounds = make_mixer(n=50_000)
    cue = mixer.start("a", gap_s=0)
    out = fill(mixer, size * before, [size], 2)
    assert_array_equal(out, sounds["a"][: len(out)])
    mixer.stop()
    last = fill(mixer, size, [size], 2)
    fade = min(size, 40, 800)
    assert not last[fade - 1 :].any()
    assert np.all(np.abs(last[: fade - 1]) <= np.abs(sounds["a"][len(out) : len(out) + fade - 1]))
    assert not mixer.is_playing
    assert cue.is_over
    assert not cue.is_complete
    assert cue.n_played == len(out) + fade - 1
    assert not fill(mixer, 500, [size], 2).any()


def test_a_device_that_begins_anew_begins_in_silence() -> None:
    """Neither what was cut off nor what waits comes out of it, nor noise; what is started then is whole."""
    mixer, sounds = make_mixer(masking=MASKED, sync=SYNC)
    cut = mixer.start("a", gap_s=0)
    fill(mixer, 1000, [100], 5)
    waiting = mixer.start("b", gap_s=0)
    mixer.reset()
    assert (cut.is_over, cut.is_complete, waiting.is_over) == (True, False, True)
    assert not mixer.is_playing
    assert not fill(mixer, 2000, [100], 5).any()
    cue = mixer.start("b", gap_s=0)
    out = fill(mixer, 4000, [100], 5)
    assert cue.onset_frame == 3000 + 400
    assert_array_equal(out[400:3400], sounds["b"] + out[400:3400] * [0, 0, 1, 1, 1])
    assert 0 < abs(out[:10, 2]).max() < 0.01  # the noise comes in its ramp again


def test_what_is_started_stops_what_plays() -> None:
    """Free switching: the old one fades within a block, the new one begins with the next, whole."""
    mixer, sounds = make_mixer()
    first = mixer.start("a", gap_s=0)
    fill(mixer, 200, [100], 2)
    second = mixer.start("b", gap_s=0)
    out = fill(mixer, 3300, [100], 2)
    assert first.is_over
    assert not first.is_complete
    assert not out[40:100].any()
    assert_array_equal(out[100:3100], sounds["b"])
    assert second.onset_frame == 300
    assert second.is_complete


def test_free_switching_cannot_outwit_the_limiter() -> None:
    """Two stimuli that are harmless each, in turn without a pause, stay within the RMS of any second."""
    limits = LimitsTable(peak_m_s2=100.0, rms_m_s2=15.0, duration_s=60.0)
    rig = make_rig(limits=limits)
    sounds = make_sounds(rig, 4000)
    mixer = Mixer(rig, sounds, rate_hz=RATE, preroll_s=0)
    outs, clipped = [], []
    for number in range(12):
        cue = mixer.start("ab"[number % 2], gap_s=0)
        outs.append(fill(mixer, 4000, [100], 2))
        clipped.append(cue.clipped)
    assert clipped[0] == 0
    assert clipped[1] > 0
    energy = np.cumsum(
        np.concatenate([np.zeros((1, 2)), np.concatenate(outs).astype(float) ** 2]), axis=0
    )
    seconds = np.sqrt((energy[8000:] - energy[:-8000]) / 8000)
    assert seconds.max() <= 0.15 * (1 + 1e-6)


def test_filling_allocates_nothing_that_lasts() -> None:
    mixer, _ = make_mixer(masking=MASKED, sync=SYNC)
    block = np.zeros((512, 5), dtype=np.float32)

    def play() -> None:
        for number in range(200):
            if number % 20 == 0:
                mixer.start("a", gap_s=0.01)
            mixer.fill(block)

    play()
    tracemalloc.start()
    try:
        play()
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for _ in range(5):
            play()
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 1000
    assert peak - before < 8000  # less than a channel of a block: views, no samples


def test_starts_and_stops_from_another_thread_lose_no_cue() -> None:
    mixer, _ = make_mixer(n=200)
    cues: list[Cue] = []
    done = threading.Event()

    def hurry() -> None:
        rng = np.random.default_rng(1)
        for _ in range(2000):
            cues.append(mixer.start("ab"[int(rng.integers(2))], gap_s=0))
            if rng.random() < 0.3:
                mixer.stop()
        done.set()

    thread = threading.Thread(target=hurry)
    block = np.zeros((64, 2), dtype=np.float32)
    thread.start()
    while not done.is_set() or mixer.is_playing:
        mixer.fill(block)
    thread.join()
    assert all(cue.is_over for cue in cues)


@pytest.mark.parametrize("n_before", [700, 2999])
def test_what_goes_on_begins_where_the_last_one_was_stopped(n_before: int) -> None:
    """To the sample, faded in over 5 ms; it is no whole playback, and the next one is one again."""
    mixer, sounds = make_mixer()
    last = mixer.start("a", gap_s=0.0)
    fill(mixer, n_before, [100], 2)
    mixer.stop()
    fill(mixer, 100, [100], 2)
    cue = mixer.start("b", gap_s=0.0, goes_on=True)
    out = fill(mixer, 4000, [64], 2)
    assert last.is_over
    assert cue.first_frame == last.n_played % 3000
    rest, n_fade = sounds["b"][cue.first_frame :], min(40, 3000 - cue.first_frame)
    assert_array_equal(out[n_fade : len(rest)], rest[n_fade:])
    ramp = np.arange(1, n_fade + 1, dtype=np.float32) / np.float32(n_fade)
    assert_array_equal(out[:n_fade], rest[:n_fade] * ramp[:, None])
    assert (cue.is_over, cue.is_at_end, cue.is_complete) == (True, True, False)
    assert not out[len(rest) :].any()
    assert not mixer.start("b", gap_s=0.0, goes_on=True).first_frame  # it had come to its end


def test_a_sync_pulse_is_a_sample_at_least_and_ends_with_a_stop() -> None:
    mixer, _ = make_mixer(sync=SYNC.model_copy(update={"duration_s": 1e-9}))
    mixer.start("a", gap_s=0)
    assert_array_equal(np.flatnonzero(fill(mixer, 3000, [70], 5)[:, 4]), [0])
    mixer, _ = make_mixer(sync=SYNC.model_copy(update={"duration_s": 0.2}))
    mixer.start("a", gap_s=0)
    assert_array_equal(np.unique(fill(mixer, 100, [100], 5)[:, 4]), [0.25])
    mixer.stop()
    out = fill(mixer, 500, [100], 5)
    assert out[:100, 4].all()
    assert not out[100:, 4].any()


def test_a_lead_leaves_a_pause_that_the_limiter_counts_as_one() -> None:
    """Stimuli of 0.375 s with pauses of 0.1 s, again and again, are each shorter than the longest allowed."""
    limits = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=0.4)
    mixer, _ = make_mixer(limits=limits)
    for _ in range(4):
        cue = mixer.start("a", gap_s=0.1, lead_s=0.2)
        while not cue.is_over:
            fill(mixer, 100, [100], 2)
        assert cue.clipped == 0
