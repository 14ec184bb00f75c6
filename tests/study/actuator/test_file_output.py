from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.output import FileOutput
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, MaskingTable, Rig

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.actuator.output import Output

RATE = 8000
COILS = (ActuatorTable(name="left", channel=1), ActuatorTable(name="right", channel=2))
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)
SOUND = np.clip(np.random.default_rng(2).normal(0, 0.2, (4000, 2)), -1, 1).astype(np.float32)
STIMULUS = Stimulus(
    "s", "r", "d", "as_is", "test", "s.wav", RATE, 4000, 0.5, 1, 1, 1, 1, 1, 0, "", ""
)


@dataclass
class Hand:
    """A clock that is set by hand."""

    now: float = 10.0

    def __call__(self) -> float:
        return self.now


def make_output(folder: Path, clock: Hand, **tables: Any) -> FileOutput:
    rig = Rig(**{"actuators": COILS, "limits": LIMITS, **tables})
    sound = np.zeros((4000, rig.n_channels), dtype=np.float32)
    sound[:, :2] = SOUND
    return FileOutput(rig, {"s": sound}, rate_hz=RATE, folder=folder / "delivered", clock=clock)


def play(output: Output, clock: Hand, *, gap_s: float = 0.1) -> float:
    """Play to the end in steps of a frame of a screen; how long it took."""
    begin = clock.now
    output.start(STIMULUS, gap_s=gap_s)
    while output.is_playing:
        clock.now += 1 / 60
    return clock.now - begin


def test_a_playback_is_a_file_and_takes_its_time(tmp_path: Path) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock)
    took = play(output, clock)
    assert 0.6 <= took <= 0.6 + 512 / RATE + 1 / 60
    delivery = output.collect()
    assert (delivery.requested_s, delivery.onset_s) == (10.1, 10.1)
    assert (delivery.completed, delivery.error, delivery.clipped, delivery.underruns) == (
        True,
        "",
        0,
        0,
    )
    assert delivery.measured == {"n_samples": 4000.0, "file_number": 1.0}
    samples, rate = read_wav(tmp_path / "delivered" / "0001.wav")
    assert rate == RATE
    assert_array_equal(samples[:, 800:4800], SOUND.T)
    assert not samples[:, :800].any()
    assert not samples[:, 4800:].any()


def test_files_that_are_there_are_kept(tmp_path: Path) -> None:
    clock = Hand()
    numbers = []
    for _ in range(2):
        output = make_output(tmp_path, clock)
        for _ in range(2):
            play(output, clock)
            numbers.append(output.collect().measured["file_number"])
    assert numbers == [1, 2, 3, 4]
    assert [path.name for path in sorted((tmp_path / "delivered").iterdir())] == [
        f"000{n}.wav" for n in range(1, 5)
    ]


def test_a_stop_ends_it_within_a_block(tmp_path: Path) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock)
    output.start(STIMULUS, gap_s=0.1)
    clock.now += 0.4
    assert output.is_playing
    output.stop()
    assert not output.is_playing
    delivery = output.collect()
    assert (delivery.completed, delivery.onset_s) == (False, 10.1)
    samples, _ = read_wav(tmp_path / "delivered" / "0001.wav")
    n = int(delivery.measured["n_samples"])
    assert abs(800 + n - 0.4 * RATE) <= 512
    assert_array_equal(samples[:, 800 : 800 + n - 40], SOUND[: n - 40].T)
    assert not samples[:, 800 + n :].any()


def test_a_stop_in_the_gap_leaves_no_onset(tmp_path: Path) -> None:
    output = make_output(tmp_path, Hand())
    output.start(STIMULUS, gap_s=0.1)
    output.stop()
    delivery = output.collect()
    assert (delivery.completed, delivery.onset_s) == (False, None)


def test_a_stop_after_the_end_changes_nothing(tmp_path: Path) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock)
    play(output, clock)
    output.stop()
    assert output.collect().completed


def test_masking_moves_the_onset(tmp_path: Path) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock, masking=MaskingTable(channels=(3,), rms=0.1))
    play(output, clock)
    delivery = output.collect()
    assert (delivery.requested_s, delivery.onset_s) == (10.1, 10.5)


def test_what_was_limited_is_counted(tmp_path: Path) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock, limits=LIMITS.model_copy(update={"peak_m_s2": 25.0}))
    play(output, clock)
    assert output.collect().clipped == np.count_nonzero(np.abs(SOUND) > 0.25)


def test_a_folder_that_cannot_be_written_is_an_error_of_the_device(tmp_path: Path) -> None:
    (tmp_path / "delivered").write_text("in the way", encoding="utf-8")
    clock = Hand()
    output = make_output(tmp_path, clock)
    play(output, clock)
    delivery = output.collect()
    assert "delivered" in delivery.error
    assert delivery.measured == {"n_samples": 4000.0}


def test_nothing_is_collected_too_early(tmp_path: Path) -> None:
    output = make_output(tmp_path, Hand())
    for _ in range(2):
        with pytest.raises(
            ValueError, match="no playback is over; start one and wait until is_playing"
        ):
            output.collect()
        output.start(STIMULUS, gap_s=0)


def test_the_identity_tells_rig_and_rate(tmp_path: Path) -> None:
    identity = make_output(tmp_path, Hand()).identity
    assert (identity["device"], identity["rate_hz"], identity["channels"]) == ("file", RATE, 2)
    assert identity["rig"]["actuators"][0]["name"] == "left"


@pytest.mark.parametrize(("gap_s", "onset_s"), [(0.3, 10.3), (0.05, 10.25)])
def test_a_filter_begins_within_the_gap_and_the_onset_is_that_of_the_vibration(
    gap_s: float, onset_s: float, tmp_path: Path
) -> None:
    clock = Hand()
    output = make_output(tmp_path, clock)
    output.lead_s = 0.2
    play(output, clock, gap_s=gap_s)
    delivery = output.collect()
    assert delivery.requested_s == pytest.approx(10 + gap_s)
    assert delivery.onset_s == pytest.approx(onset_s)
    samples, _ = read_wav(tmp_path / "delivered/0001.wav")
    first = int(np.flatnonzero(samples.any(axis=0))[0])
    assert first / RATE == pytest.approx(onset_s - 10 - 0.2, abs=1 / RATE)
