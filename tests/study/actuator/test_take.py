from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feel321.study.actuator.device import SENSOR_TAIL_S, BlockTimes, Take
from feel321.study.actuator.mixer import Cue

RATE_HZ = 1000.0
N = 100  # frames of a block, which take 0.1 s
DELAY_S = 0.25  # from a block to its sound


def run(take: Take, cue: Cue, *, onset: int, blocks: int = 20, **faults: Any) -> int:
    """Play a cue in blocks as a mixer would; give the number of the block with which all was out."""
    for number in range(blocks):
        frame = number * N
        if frame + N > onset:
            cue.onset_frame = onset
            cue.n_played = min(frame + N - onset, len(cue.sound))
            cue.is_over = cue.is_complete
        known = {name: number in numbers for name, numbers in faults.items()}
        take.add_block(
            BlockTimes(5 + number / 10, 5 + number / 10 + DELAY_S, 5 + number / 10 - 0.1, **known),
            frame=frame,
        )
        take.record(np.arange(frame, frame + N, dtype=np.float32), frame=frame)
        if take.is_out:
            return number
    return blocks


@pytest.fixture
def cue() -> Cue:
    return Cue(np.zeros((150, 1), dtype=np.float32), gap_frames=0)


def test_onset_and_end_are_told_to_the_sample(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S)
    take.cue = cue
    out = run(take, cue, onset=230)
    assert take.onset_s == pytest.approx(5.23 + DELAY_S)
    assert take.end_s == pytest.approx(5.38 + DELAY_S)
    assert 5 + out / 10 >= take.end_s > 5 + (out - 1) / 10
    assert len(take.sensed) == 0


def test_an_onset_is_told_from_any_later_block(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S)
    cue.onset_frame, cue.n_played = 230, 100
    take.add_block(
        BlockTimes(5.2, 5.2 + DELAY_S), frame=200
    )  # the session had not yet said which cue it is
    take.cue = cue
    take.add_block(BlockTimes(5.3, 5.3 + DELAY_S), frame=300)
    assert take.onset_s == pytest.approx(5.23 + DELAY_S)


def test_faults_count_until_all_is_out(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S)
    take.cue = cue
    out = run(take, cue, onset=230, has_run_dry={1, 3, 6}, has_lost_input={2})
    assert out == 7
    assert (take.n_underruns, take.n_sensor_gaps, take.n_blocks) == (3, 1, 8)


def test_a_device_without_times_is_out_by_frames(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S)
    take.cue = cue
    cue.onset_frame, cue.n_played, cue.is_over = 0, 150, True
    frames = [
        frame
        for frame in range(0, 2000, N)
        if take.add_block(BlockTimes(0, 1.0), frame=frame) or take.is_out
    ]
    assert frames[0] == 700  # the first block that begins two latencies after the end


def test_a_stop_in_the_gap_has_no_onset(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S)
    take.cue = cue
    cue.is_over = True
    take.add_block(BlockTimes(5.0, 5.25), frame=0)
    take.add_block(BlockTimes(5.1, 5.35), frame=100)
    assert not take.is_out  # what the device holds is still to come
    take.add_block(BlockTimes(5.3, 5.55), frame=200)
    assert take.is_out
    assert take.onset_s is None


def test_the_sensor_is_kept_from_the_frame_of_the_onset_until_the_ringing_is_over(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S, sensor=np.zeros(1000, dtype=np.float32))
    take.cue = cue
    out = run(take, cue, onset=230)
    assert take.sensor_latency_s == pytest.approx(DELAY_S + 0.1)
    assert np.array_equal(take.sensed, np.arange(230, (out + 1) * N))
    assert take.n_sensed >= 150 + (DELAY_S + SENSOR_TAIL_S) * RATE_HZ


def test_a_sensor_without_room_keeps_what_fits(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S, sensor=np.zeros(120, dtype=np.float32))
    take.cue = cue
    run(take, cue, onset=230)
    assert np.array_equal(take.sensed, np.arange(230, 350))


def test_what_is_sensed_stays_in_its_place_if_the_onsets_block_was_missed(cue: Cue) -> None:
    take = Take(RATE_HZ, DELAY_S, sensor=np.full(1000, 9, dtype=np.float32))
    cue.onset_frame, cue.n_played = 230, 100
    for frame in (200, 300, 400):
        take.add_block(BlockTimes(frame / 100, frame / 100 + DELAY_S), frame=frame)
        take.record(np.arange(frame, frame + N, dtype=np.float32), frame=frame)
        take.cue = cue  # the session says which cue it is after the first block
    np.testing.assert_array_equal(take.sensed, [0.0] * 70 + list(range(300, 500)))
