"""The output on every sink, by stand-ins for what no machine here would do: devices and their faults, and files."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.device import (
    STALL_S,
    BlockTimes,
    Device,
    DeviceStream,
    find_devices,
    list_devices,
)
from feel321.study.actuator.output import SENSOR_TAIL_S, Output, Take
from feel321.study.actuator.rig import ActuatorTable, DeviceTable, Rig, SensorTable

LIMITS: Any = {"peak_m_s2": 100, "rms_m_s2": 100, "duration_s": 60}
COILS = Device(0, "USB Audio: coils (hw:1,0)", "ALSA", 4, 0)
JACK = Device(1, "USB Audio: coils (hw:1,0)", "JACK", 4, 0)
PAIR = Device(2, "coils", "ALSA", 2, 1)
SYSTEM = Device(4, "default", "ALSA", 32, 32)
MICROPHONE = Device(3, "microphone", "ALSA", 0, 2)


# Which device it is.


@pytest.mark.parametrize(
    ("devices", "name", "host_api", "found"),
    [
        ([COILS, PAIR], "coils", None, PAIR),  # the whole name, though another has it as a part
        ([COILS, MICROPHONE], "COILS", None, COILS),
        ([COILS, JACK], "coils", "jack", JACK),
        ([COILS, PAIR], "headset", None, r"'headset' not found; name one of 'USB.*'coils' \(ALSA\)$"),
        ([COILS, JACK], "coils", None, r"2 devices have it in their names: .*\(JACK\); name one in full"),
        ([COILS, JACK], COILS.name, None, "2 devices have it"),
        ([MICROPHONE], "microphone", None, "there is no output device at all; plug it in"),
        ([COILS], "coils", "JACK", r"'coils' through JACK not found; name one of .*\(ALSA\)$"),
        ([COILS], " ", None, "device ' ' not found"),
        ([COILS, SYSTEM], "defa", None, "device 'defa' not found; name one of 'USB Audio"),
        ([COILS], "sysdefault", None, r"tomorrow\) not found; name one of 'USB Audio"),
    ],
)  # fmt: skip
def test_a_device_is_the_one_that_is_named_and_no_other(
    devices: Sequence[Device], name: str, host_api: str | None, found: Device | str
) -> None:
    device = DeviceTable().model_copy(update={"name": name, "host_api": host_api})
    rig = Rig(limits=LIMITS).model_copy(update={"device": device})
    if isinstance(found, Device):
        assert find_devices(rig, devices) == (found, found)
        return
    with pytest.raises(OSError, match=found):
        find_devices(rig, devices)


def test_every_channel_that_the_rig_names_has_to_be_there() -> None:
    own = {"limits": LIMITS, "device": DeviceTable(name="coils")}
    third = Rig(**own, actuators=(ActuatorTable(name="third", channel=3),))
    find_devices(third, [COILS])
    with pytest.raises(OSError, match=r"'coils' has 2 output channel\(s\), the rig needs 3; take"):
        find_devices(third, [PAIR])
    sensing = Rig(**own, sensor=SensorTable(channels=(2, 1, 1), full_scale_m_s2=9))
    with pytest.raises(OSError, match=r"has 1 input channel\(s\), the rig needs 2"):
        find_devices(sensing, [PAIR])


@pytest.mark.parametrize(
    ("module", "message"), [(None, r"need sounddevice.*'.\[rig\]'"), ("broken", "libportaudio2")]
)
def test_what_is_not_installed_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, module: str | None, message: str
) -> None:
    if module is None:
        monkeypatch.setitem(sys.modules, "sounddevice", None)
    else:
        (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')")
        monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
        monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(OSError, match=message):
        list_devices()


# One playback, block by block: its times and its recording.

N = 100  # frames of a block
TAKE_HZ = 1000.0
DELAY_S = 0.25  # from a block to its sound


def run(take: Take, *, onset: int, blocks: int = 20, **faults: Any) -> int:
    """Play in blocks as a mixer would; give the number of the block with which all was out."""
    for number in range(blocks):
        frame, now_s = number * N, 5 + number / 10
        if frame + N > onset:
            take.onset_frame = onset
            take.n_played = min(frame + N - onset, len(take.sound))
            take.is_over = take.is_complete
        known = {name: number in numbers for name, numbers in faults.items()}
        take.add_block(BlockTimes(now_s, now_s + DELAY_S, **known), frame=frame)
        take.record(np.arange(frame, frame + N, dtype=np.float32)[:, None], frame=frame)
        if take.is_out:
            return number
    return blocks


def make_take(room: int = 0) -> Take:
    sensor = np.full((room, 1), 9, dtype=np.float32) if room else None
    own = {"rate_hz": TAKE_HZ, "latency_s": DELAY_S, "held_s": DELAY_S, "sensor": sensor}
    return Take(sound=np.zeros((150, 1), dtype=np.float32), **own)


def test_onset_end_and_faults_are_known_to_the_sample_until_all_is_out() -> None:
    take = make_take()
    out = run(take, onset=230, has_run_dry={1, 3, 6, 9}, has_lost_input={2})
    assert take.onset_s == pytest.approx(5.23 + DELAY_S)
    assert take.end_s == pytest.approx(5.38 + DELAY_S)
    assert 5 + out / 10 >= take.end_s > 5 + (out - 1) / 10
    assert take.find_underruns() == [70, 150]  # the one at frame 100 is in the gap
    assert (len(take.dry_frames), take.n_sensor_gaps) == (3, 1)


@pytest.mark.parametrize(("room", "last"), [(1000, None), (120, 350)])
def test_the_sensor_is_kept_from_the_onsets_frame_until_the_ringing_is_over(
    room: int, last: int | None
) -> None:
    take = make_take(room)
    out = run(take, onset=230)
    assert take.sensor is not None
    assert_array_equal(
        take.sensor[: take.n_sensed, 0], np.arange(230, (out + 1) * N if last is None else last)
    )
    assert last is not None or take.n_sensed >= 150 + (DELAY_S + SENSOR_TAIL_S) * TAKE_HZ


# A stream that asks for a block whenever a test says so.

RATE_HZ = 1000
RIG = Rig(device=DeviceTable(name="coils", latency_s=0.1), limits=LIMITS)
SENSING = RIG.model_copy(update={"sensor": SensorTable(channels=(1, 2, 3), full_scale_m_s2=10)})


class StandIn:
    """What sounddevice's streams are."""

    def __init__(self, *, callback: Any, samplerate: float, channels: Any, **_others: Any) -> None:
        self.callback, self.samplerate = callback, samplerate
        self.is_duplex = isinstance(channels, tuple)
        self.latency: Any = (0.02, 0.1) if self.is_duplex else 0.1
        self.active = False
        self.time = 50.0

    def start(self) -> None:
        self.active = True

    def close(self, *, ignore_errors: bool) -> None:
        assert ignore_errors
        self.active = False

    def ask(self, *, dac_s: float | None = None, sensed: float = 0.0, **flags: bool) -> np.ndarray:
        out = np.ones((N, 2), dtype=np.float32)
        times = SimpleNamespace(
            currentTime=self.time, outputBufferDacTime=self.time + 0.1 if dac_s is None else dac_s
        )
        usual = dict.fromkeys(("output_underflow", "input_overflow", "input_underflow"), False)
        given = [np.full((N, 3), sensed, dtype=np.float32)] if self.is_duplex else []
        self.callback(*given, out, N, times, SimpleNamespace(**usual | flags))
        self.time += N / RATE_HZ
        return out


@dataclass
class Clock:
    """The time, which stands still unless a test lets it pass: how busy this machine is does not matter here."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def wait(self, duration_s: float) -> None:
        self.now_s += duration_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("feel321.study.actuator.device.perf_counter", clock)
    return clock


@pytest.fixture
def sounddevice(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> SimpleNamespace:  # noqa: ARG001 - time stands still
    row = {"index": 0, "name": "coils", "hostapi": 0, "max_output_channels": 2}
    module = SimpleNamespace(
        PortAudioError=RuntimeError,
        OutputStream=StandIn,
        Stream=StandIn,
        query_hostapis=lambda: [{"name": "ALSA"}],
        query_devices=lambda: [row | {"max_input_channels": 3}],
        _terminate=lambda: None,
        _initialize=lambda: None,
    )
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    return module


def open_line(rig: Rig = RIG, *, clock: Any = None) -> tuple[DeviceStream, Any, list[BlockTimes]]:
    blocks: list[BlockTimes] = []
    own = {"rate_hz": RATE_HZ, "clock": clock or Clock()}
    line = DeviceStream(rig, fill=lambda _out, block, _sensed: blocks.append(block), **own)
    return line, line._stream, blocks


@pytest.mark.usefixtures("sounddevice")
def test_flags_and_times_are_passed_on() -> None:
    line, stream, blocks = open_line(SENSING)
    stream.ask()
    for flag in ("output_underflow", "input_overflow", "input_underflow"):
        stream.ask(**{flag: True})
    assert [block.has_run_dry for block in blocks] == [False, True, False, False]
    assert [block.has_lost_input for block in blocks] == [False, False, True, True]
    assert line.there_and_back_s == pytest.approx(0.12)
    line.close()
    assert not stream.ask().any()  # should it come back
    assert len(blocks) == 4


@pytest.mark.usefixtures("sounddevice")
@pytest.mark.parametrize("now_s", [50.0, 0.0])
def test_a_device_that_gives_no_times_is_recognised_and_its_latency_counts(now_s: float) -> None:
    _, stream, blocks = open_line()
    for time_s, dac_s in (
        (now_s, now_s),  # DirectSound says now (PortAudio#530), WDM-KS 0
        (now_s, now_s + 0.06),  # the second part of a buffer that wraps around
        (now_s + 1, now_s + 1.03),
    ):
        stream.time = time_s
        stream.ask(dac_s=dac_s)
    assert [block.dac_source for block in blocks] == ["latency", "latency", "device"]
    assert [block.dac_s - now_s for block in blocks] == pytest.approx([0.1, 0.16, 1.03])


@pytest.mark.usefixtures("sounddevice")
@pytest.mark.parametrize(
    ("waits_s", "dry"),
    [
        ((0, 0.05, 0.25), [2]),  # it held 0.1 s in its buffer and 0.1 s in the block
        # It plays 0.1 s in a block: 0.15 s leave 0.15 s, which 0.17 s are too long for.
        ((0.0, 0.15, 0.17, 0.1, 0.1, 0.15, 0.05, 0.15, 0.05), [2]),
        (9000 * (N / RATE_HZ * 1.0005,), []),  # a slow clock
    ],
)
def test_silence_beyond_what_it_held_is_an_underrun_though_no_flag_says_so(
    clock: Clock, waits_s: Sequence[float], dry: list[int]
) -> None:
    _, stream, blocks = open_line()
    for wait_s in waits_s:
        clock.wait(wait_s)
        stream.ask()
    assert [number for number, block in enumerate(blocks) if block.has_run_dry] == dry


@pytest.mark.usefixtures("sounddevice")
def test_a_process_that_stood_still_itself_does_not_take_its_device_for_dead(clock: Clock) -> None:
    line, stream, _ = open_line()
    stream.ask()
    for _ in range(5):
        assert not line.find_fault()
        clock.wait(3 * STALL_S)
    stream.ask()
    faults = []
    for _ in range(30):
        clock.wait(0.1)
        faults.append(line.find_fault())
    assert not any(faults[: round(10 * STALL_S)])
    assert faults[-1].startswith("stands still: it asked for nothing for 2.")


# The output on that stream.

Opened = tuple[Output, Any]


@pytest.fixture
def open_on_stand_in(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    sounddevice: SimpleNamespace,  # noqa: ARG001 - must be there
) -> Callable[..., Opened]:
    """Opens an output on a stand-in, which asks while the output waits for it; with a clock, that time passes."""

    def make(rig: Rig = RIG, clock: Clock | None = None, folder: str = "delivered") -> Opened:
        streams: list[Any] = []
        start, waited = StandIn.start, clock or Clock()
        monkeypatch.setattr(
            StandIn, "start", lambda stream: (start(stream), streams.append(stream))
        )
        monkeypatch.setattr(
            "feel321.study.actuator.output.sleep",
            lambda wait_s: (waited.wait(wait_s), streams[-1].ask()),
        )
        sound = np.full((150, 2), 0.25, dtype=np.float32)
        output = Output(rig, {"a": sound}, rate_hz=RATE_HZ, folder=tmp_path / folder, clock=waited)
        output.open()
        assert not streams[-1].ask().any()
        return output, streams[-1]

    return make


def test_a_playback_is_played_and_sensed(
    open_on_stand_in: Callable[..., Opened], tmp_path: Path
) -> None:
    output, stream = open_on_stand_in(SENSING)
    assert output.collect().error == "nothing was started"
    output.start("a", gap_s=0.03)
    with pytest.raises(ValueError, match="the playback still plays; stop it, or wait"):
        output.collect()
    first = stream.ask(sensed=0.5)
    assert_array_equal(first[:, 0], [0] * 30 + [0.25] * 70)
    while output.is_playing:
        stream.ask(sensed=0.5)
    played = output.collect()
    assert (played.completed, played.error, played.dac_source) == (True, "", "device")
    known = {"n_samples": 150, "file_number": 1, "sensor_gaps": 0}
    assert played.measured.items() >= known.items()
    samples, _ = read_wav(tmp_path / "delivered" / "0001.wav")
    assert np.unique(samples) == pytest.approx(5.0)  # half of the sensor's full scale
    (tmp_path / "delivered" / "0001.wav").unlink()
    (tmp_path / "delivered").rmdir()
    (tmp_path / "delivered").write_text("")
    output.start("a", gap_s=0.0)
    while output.is_playing:
        stream.ask()
    played = output.collect()
    assert "File exists" in played.error
    assert "file_number" not in played.measured


def test_a_device_that_hangs_does_not_hang_the_session(
    open_on_stand_in: Callable[..., Opened], monkeypatch: pytest.MonkeyPatch
) -> None:
    output, stream = open_on_stand_in()
    stream.active = False
    answers = Event()
    monkeypatch.setattr("feel321.study.actuator.output.REVIVING_S", 0.05)
    monkeypatch.setattr("feel321.study.actuator.device.refresh_devices", answers.wait)
    monkeypatch.setattr("feel321.study.actuator.device.join", wait_for)
    output.start("a", gap_s=0.0)
    assert not output.is_playing
    assert "does not answer" in output.collect().error
    answers.set()
    monkeypatch.setattr("feel321.study.actuator.output.REVIVING_S", 60.0)
    output.start("a", gap_s=0.0)
    assert output.is_playing


def wait_for(thread: Any, patience_s: float) -> bool:
    """Wait in real time, where the device's clock stands still."""
    thread.join(patience_s)
    return not thread.is_alive()


def test_what_died_with_a_device_is_not_heard_from_the_next(
    open_on_stand_in: Callable[..., Opened], monkeypatch: pytest.MonkeyPatch
) -> None:
    output, old = open_on_stand_in()
    output.start("a", gap_s=0.0)
    assert old.ask().any()
    old.active = False
    assert not output.is_playing
    dead = output.collect()  # what it still held was not felt
    assert (dead.completed, dead.measured["n_samples"]) == (False, 100)
    assert dead.error.startswith("device 'coils' stopped")
    heard: list[np.ndarray] = []
    opened = StandIn.start
    monkeypatch.setattr(
        StandIn, "start", lambda stream: (opened(stream), heard.append(stream.ask()))
    )
    output.start("a", gap_s=0.0)
    assert output.is_playing
    assert len(heard) == 1
    assert not any(out.any() for out in heard)
    assert not old.ask().any()  # the old one comes back, and is not to play beside the new one


# The output on files, whose clock is set by hand.

FILE_HZ = 8000
NOISE = np.clip(np.random.default_rng(2).normal(0, 0.2, (4000, 2)), -1, 1).astype(np.float32)


def make_output(folder: Path, clock: Clock, check: Any = None, **tables: Any) -> Output:
    rig = Rig(**{"limits": LIMITS, **tables})
    sound = np.zeros((4000, rig.n_channels), dtype=np.float32)
    sound[:, :2] = NOISE
    own = {"folder": folder / "delivered", "clock": clock, "check": check}
    output = Output(rig, {"s": sound}, rate_hz=FILE_HZ, **own)
    output.open()
    return output


def play(output: Output, clock: Clock, *, gap_s: float = 0.1) -> float:
    """Play to the end in steps of a frame of a screen; how long it took."""
    begin = clock.now_s
    output.start("s", gap_s=gap_s)
    while output.is_playing:
        clock.wait(1 / 60)
    return clock.now_s - begin


def test_a_playback_is_a_file_and_takes_its_time(tmp_path: Path) -> None:
    clock = Clock(10.0)
    output = make_output(tmp_path, clock)
    assert 0.6 <= play(output, clock) <= 0.6 + 512 / FILE_HZ + 1 / 60
    played = output.collect()
    assert (played.requested_s, played.onset_s) == (10.1, 10.1)
    assert (played.completed, played.error, played.clipped, played.underruns) == (True, "", 0, 0)
    assert played.measured == {"n_samples": 4000.0, "file_number": 1.0}
    samples, rate = read_wav(tmp_path / "delivered" / "0001.wav")
    assert rate == FILE_HZ
    assert_array_equal(samples[:, 800:4800], NOISE.T)
    assert not samples[:, :800].any()
    assert not samples[:, 4800:].any()
    identity = output.identity
    assert (identity["device"], identity["rate_hz"], identity["channels"]) == ("file", FILE_HZ, 2)
    # Files that are there are kept; what comes after the end changes nothing.
    output = make_output(tmp_path, clock)
    play(output, clock)
    output.stop()
    played = output.collect()
    assert (played.completed, played.measured["file_number"]) == (True, 2)


@pytest.mark.parametrize(("gap_s", "onset_s"), [(0.3, 10.3), (0.05, 10.25)])
def test_a_filter_begins_within_the_gap_and_the_onset_is_that_of_the_vibration(
    gap_s: float, onset_s: float, tmp_path: Path
) -> None:
    clock = Clock(10.0)
    output = make_output(tmp_path, clock)
    output.lead_s = 0.2
    play(output, clock, gap_s=gap_s)
    played = output.collect()
    assert played.requested_s == pytest.approx(10 + gap_s)
    assert played.onset_s == pytest.approx(onset_s)
    samples, _ = read_wav(tmp_path / "delivered/0001.wav")
    first = int(np.flatnonzero(samples.any(axis=0))[0])
    assert first / FILE_HZ == pytest.approx(onset_s - 10 - 0.2, abs=1 / FILE_HZ)


def test_what_spoils_and_what_is_only_said_stay_apart_and_of_a_stopped_one_nothing_is_known(
    tmp_path: Path,
) -> None:
    found = {"level_error_db": 0.5}
    check = SimpleNamespace(diagnose=lambda *_, **__: ("dead", "hum"), describe=lambda *_: found)
    clock = Clock(10.0)
    output = make_output(tmp_path, clock, check)
    play(output, clock)
    played = output.collect()
    assert (played.fault, played.notice, played.delivered) == ("dead", "hum", found)
    output.start("s", gap_s=0.1)
    clock.wait(0.3)
    assert output.is_playing
    output.stop()
    clock.wait(0.1)
    assert not output.is_playing
    played = output.collect()
    assert (played.completed, played.fault, played.notice, played.delivered) == (False, "", "", {})


def test_a_stream_opened_anew_has_no_latency_to_keep(tmp_path: Path) -> None:
    """A sound server's latency differs from opening to opening: the first playback only finds it."""
    kept: list[bool] = []

    def diagnose(*_: object, keeps_latency: bool) -> tuple[str, str]:
        kept.append(keeps_latency)
        return "", ""

    clock = Clock(10.0)
    check = SimpleNamespace(diagnose=diagnose, describe=lambda *_: {})
    for _ in range(2):
        output = make_output(tmp_path, clock, check)
        for _ in range(2):
            play(output, clock)
            output.collect()
    assert kept == [False, True, False, True]
