"""What the stream does with what sounddevice says, by a stand-in: what no machine here would say."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from threading import Event
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.device import (
    STALL_S,
    Device,
    DeviceStream,
    join,
    list_devices,
    refresh_devices,
)
from feel321.study.actuator.output import StreamOutput
from feel321.study.actuator.rig import DeviceTable, LimitsTable, Rig, SensorTable

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.actuator.device import BlockTimes

RATE_HZ = 1000
N = 100
DEVICE = Device(0, "coils", "ALSA", 2, 1)
LIMITS = LimitsTable(peak_m_s2=100, rms_m_s2=50, duration_s=60)
RIG = Rig(device=DeviceTable(name="coils", latency_s=0.1), limits=LIMITS)
SENSING = RIG.model_copy(update={"sensor": SensorTable(channel=1, full_scale_m_s2=10)})


class StandIn:
    """A stream that asks for a block whenever a test says so."""

    def __init__(
        self, *, callback: Any, samplerate: float, channels: Any, **_settings: Any
    ) -> None:
        self.callback = callback
        self.is_duplex = isinstance(channels, tuple)
        self.latency: Any = (0.02, 0.1) if self.is_duplex else 0.1
        self.samplerate = samplerate
        self.active = False
        self.time_s = 50.0

    @property
    def time(self) -> float:
        return self.time_s

    def start(self) -> None:
        self.active = True

    def close(self, *, ignore_errors: bool) -> None:
        assert ignore_errors
        self.active = False

    def ask(
        self,
        *,
        dac_s: float | None = None,
        adc_s: float | None = None,
        sensed: float = 0.0,
        **flags: bool,
    ) -> np.ndarray:
        out = np.ones((N, 2), dtype=np.float32)
        times = SimpleNamespace(
            currentTime=self.time_s,
            outputBufferDacTime=self.time_s + 0.1 if dac_s is None else dac_s,
            inputBufferAdcTime=self.time_s - 0.02 if adc_s is None else adc_s,
        )
        known = {
            "output_underflow": False,
            "input_overflow": False,
            "input_underflow": False,
            **flags,
        }
        given = [np.full((N, 1), sensed, dtype=np.float32)] if self.is_duplex else []
        self.callback(*given, out, N, times, SimpleNamespace(**known))
        self.time_s += N / RATE_HZ
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
    row = {
        "index": 0,
        "name": "coils",
        "hostapi": 0,
        "max_output_channels": 2,
        "max_input_channels": 1,
    }
    module = SimpleNamespace(
        PortAudioError=RuntimeError,
        OutputStream=StandIn,
        Stream=StandIn,
        query_hostapis=lambda: [{"name": "ALSA"}],
        query_devices=lambda: [row | {"default_samplerate": 48000.0}],
        _terminate=lambda: None,
        _initialize=lambda: None,
    )
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    return module


@pytest.fixture
def blocks() -> list[BlockTimes]:
    return []


def open_line(blocks: list[BlockTimes], rig: Rig = RIG) -> tuple[DeviceStream, Any]:
    line = DeviceStream(
        DEVICE, rig, rate_hz=RATE_HZ, fill=lambda _out, block, _sensed: blocks.append(block)
    )
    return line, line._stream


@pytest.mark.usefixtures("sounddevice")
def test_flags_and_times_are_passed_on(blocks: list[BlockTimes]) -> None:
    line, stream = open_line(blocks, SENSING)
    stream.ask()
    stream.ask(output_underflow=True)
    stream.ask(input_overflow=True)
    stream.ask(input_underflow=True)
    assert [block.has_run_dry for block in blocks] == [False, True, False, False]
    assert [block.has_lost_input for block in blocks] == [False, False, True, True]
    assert blocks[0].dac_s - blocks[0].adc_s == pytest.approx(0.12)
    assert line.there_and_back_s == pytest.approx(0.12)


@pytest.mark.usefixtures("sounddevice")
@pytest.mark.parametrize("now_s", [50.0, 0.0])
def test_a_device_that_gives_no_times_is_recognised_and_its_latency_counts(
    blocks: list[BlockTimes], now_s: float
) -> None:
    _line, stream = open_line(blocks)
    stream.time_s = now_s
    stream.ask(dac_s=now_s)  # DirectSound says now (PortAudio#530), WDM-KS 0
    stream.time_s = now_s
    stream.ask(dac_s=now_s + 0.06)  # the second part of a buffer that wraps around
    stream.time_s = now_s + 1
    stream.ask(dac_s=now_s + 1.03)
    assert [block.dac_source for block in blocks] == ["latency", "latency", "device"]
    assert [block.dac_s - now_s for block in blocks] == pytest.approx([0.1, 0.16, 1.03])


@pytest.mark.usefixtures("sounddevice")
def test_an_input_without_times_is_late_by_its_latency(blocks: list[BlockTimes]) -> None:
    _line, stream = open_line(blocks, SENSING)
    stream.ask(adc_s=0.0)  # PortAudio#121
    assert blocks[0].now_s - blocks[0].adc_s == pytest.approx(0.02)


@pytest.mark.usefixtures("sounddevice")
def test_a_line_that_was_closed_is_silent_should_it_come_back(blocks: list[BlockTimes]) -> None:
    line, stream = open_line(blocks, SENSING)
    line.close()
    assert not stream.ask().any()
    assert blocks == []


@pytest.mark.usefixtures("sounddevice")
def test_a_device_that_tells_no_times_is_taken_at_its_latency(blocks: list[BlockTimes]) -> None:
    _, stream = open_line(blocks)
    stream.ask(dac_s=0.0)
    assert blocks[0].dac_s == pytest.approx(50.1)


@pytest.mark.usefixtures("sounddevice")
def test_silence_beyond_what_it_held_is_an_underrun_though_no_flag_says_so(
    blocks: list[BlockTimes], clock: Clock
) -> None:
    _, stream = open_line(blocks)
    stream.ask()
    clock.wait(0.05)
    stream.ask()
    clock.wait(0.25)  # it held 0.1 s in its buffer and 0.1 s in the block
    stream.ask()
    assert [block.has_run_dry for block in blocks] == [False, False, True]


@pytest.mark.usefixtures("sounddevice")
def test_delays_that_follow_each_other_add_up(blocks: list[BlockTimes], clock: Clock) -> None:
    _, stream = open_line(blocks)
    # It holds 0.2 s when it is full and plays 0.1 s in a block: 0.15 s leave 0.15 s, which 0.17 s are too long for.
    for wait_s in (0.0, 0.15, 0.17, 0.1, 0.1, 0.15, 0.05, 0.15, 0.05):
        clock.wait(wait_s)
        stream.ask()
    assert [block.has_run_dry for block in blocks] == [False, False, True] + 6 * [False]


@pytest.mark.usefixtures("sounddevice")
def test_a_device_with_a_slow_clock_does_not_run_dry(
    blocks: list[BlockTimes], clock: Clock
) -> None:
    _, stream = open_line(blocks)
    for _ in range(9000):
        clock.wait(N / RATE_HZ * 1.0005)
        stream.ask()
    assert not any(block.has_run_dry for block in blocks)


@pytest.mark.usefixtures("sounddevice")
def test_clocks_are_compared_by_the_fastest_reading(blocks: list[BlockTimes]) -> None:
    line, _ = open_line(blocks)
    readings = iter([0, 1, 10, 10.1, 20, 30, 40, 50, 60, 70])
    assert line.compare_clocks(lambda: next(readings)) == pytest.approx(10.05 - 50)


@pytest.mark.usefixtures("sounddevice")
def test_the_clock_of_a_device_that_has_died_tells_nothing(
    blocks: list[BlockTimes], monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    line, stream = open_line(blocks)
    monkeypatch.setattr(StandIn, "time", property(lambda _: stream.nothing()))
    monkeypatch.setattr(StandIn, "nothing", raise_foreign, raising=False)
    assert np.isnan(line.compare_clocks(clock))


def raise_foreign(*_: object) -> None:
    raise RuntimeError("Error getting stream time")


def test_portaudio_that_does_not_begin_again_is_one_line(
    sounddevice: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sounddevice, "_terminate", raise_foreign)
    refresh_devices()
    monkeypatch.setattr(sounddevice, "_initialize", raise_foreign)
    with pytest.raises(
        OSError, match=r"device: PortAudio does not start \(Error getting stream time\)"
    ):
        refresh_devices()


def test_another_rate_than_was_asked_for_is_refused(
    sounddevice: SimpleNamespace, blocks: list[BlockTimes]
) -> None:
    sounddevice.OutputStream = lambda **settings: StandIn(**{**settings, "samplerate": 44100.0})
    with pytest.raises(
        OSError, match="device 'coils' runs at 44100 Hz, the stimuli are at 1000 Hz"
    ):
        open_line(blocks)


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (None, r"need sounddevice.*pip install -c constraints.txt '.\[rig\]'"),
        ("broken", "libportaudio2"),
    ],
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


def open_output(
    monkeypatch: pytest.MonkeyPatch, folder: Path, *, rig: Rig = RIG, clock: Clock | None = None
) -> tuple[StreamOutput, Any]:
    """Open an output on a stand-in, which asks while the output waits for it; with a clock, that time passes."""
    streams: list[Any] = []
    start = StandIn.start
    monkeypatch.setattr(StandIn, "start", lambda stream: (start(stream), streams.append(stream)))
    waited = clock or Clock()
    monkeypatch.setattr(
        "feel321.study.actuator.output.sleep",
        lambda wait_s: (waited.wait(wait_s), streams[-1].ask()),
    )
    sound = np.full((150, 2), 0.25, dtype=np.float32)
    output = StreamOutput(rig, {"a": sound}, rate_hz=RATE_HZ, folder=folder, clock=waited)
    output.open()
    assert not streams[-1].ask().any()
    return output, streams[-1]


@pytest.mark.usefixtures("sounddevice")
def test_a_playback_is_played_and_sensed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    output, stream = open_output(monkeypatch, tmp_path / "delivered", rig=SENSING)
    output.start("a", gap_s=0.03)
    with pytest.raises(ValueError, match="the playback still plays; stop it, or wait"):
        output.collect()
    first = stream.ask(sensed=0.5)
    assert np.array_equal(first[:, 0], [0] * 30 + [0.25] * 70)
    while output.is_playing:
        stream.ask(sensed=0.5)
    delivery = output.collect()
    assert (delivery.completed, delivery.error, delivery.measured["n_samples"]) == (True, "", 150)
    assert delivery.measured["file_number"] == 1
    samples, _ = read_wav(tmp_path / "delivered" / "0001.wav")
    assert np.unique(samples) == pytest.approx(5.0)  # half of the sensor's full scale
    assert delivery.measured["sensor_onset_sample"] == 120
    assert delivery.dac_source == "device"


@pytest.mark.usefixtures("sounddevice")
def test_an_onset_of_a_device_without_times_is_told_as_estimated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, stream = open_output(monkeypatch, tmp_path)
    output.start("a", gap_s=0.03)
    begin_s = stream.time_s
    while output.is_playing:
        stream.ask(dac_s=stream.time_s)
    delivery = output.collect()
    assert delivery.completed
    assert delivery.dac_source == "latency"
    assert delivery.measured["dac_time_s"] == pytest.approx(begin_s + 0.03 + 0.1)


@pytest.mark.usefixtures("sounddevice")
def test_a_recording_that_cannot_be_written_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "taken").write_text("")
    output, stream = open_output(monkeypatch, tmp_path / "taken", rig=SENSING)
    output.start("a", gap_s=0.0)
    while output.is_playing:
        stream.ask()
    delivery = output.collect()
    assert "File exists" in delivery.error
    assert "file_number" not in delivery.measured


@pytest.mark.usefixtures("sounddevice")
def test_a_device_that_hangs_does_not_hang_the_session(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, stream = open_output(monkeypatch, tmp_path)
    stream.active = False
    answers = Event()
    monkeypatch.setattr("feel321.study.actuator.output.REVIVING_S", 0.05)
    monkeypatch.setattr("feel321.study.actuator.device.refresh_devices", answers.wait)
    output.start("a", gap_s=0.0)
    assert not output.is_playing
    assert "does not answer" in output.collect().error
    answers.set()
    monkeypatch.setattr("feel321.study.actuator.output.REVIVING_S", 60.0)
    output.start("a", gap_s=0.0)
    assert output.is_playing


@pytest.mark.usefixtures("sounddevice")
def test_what_died_with_a_device_is_not_heard_from_the_next(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, old = open_output(monkeypatch, tmp_path)
    output.start("a", gap_s=0.0)
    assert old.ask().any()
    old.active = False
    assert not output.is_playing
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


@pytest.mark.usefixtures("sounddevice")
def test_a_stop_is_measured_and_told_though_the_device_is_slow(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, stream = open_output(monkeypatch, tmp_path)
    output.start("a", gap_s=0.0)
    stream.ask()
    output.stop()
    assert output.is_playing  # what it holds is still to come
    early = output.collect()
    assert (early.completed, early.error) == (False, "")
    while output.is_playing:
        stream.ask()
    delivery = output.collect()
    assert (delivery.completed, delivery.error, delivery.measured["n_samples"]) == (False, "", 104)
    assert delivery.onset_s is not None
    # The session's clock stands still meanwhile; the device's says 100 samples, a fade, and its latency.
    assert delivery.measured["stop_s"] == pytest.approx(0.104 + 0.1)


@pytest.mark.usefixtures("sounddevice")
def test_a_stop_is_measured_from_the_first_of_several(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    session = Clock()
    output, stream = open_output(monkeypatch, tmp_path, clock=session)
    output.start("a", gap_s=0.0)
    stream.ask()
    output.stop()
    session.wait(0.05)
    output.stop()
    while output.is_playing:
        stream.ask()
    assert output.collect().measured["stop_s"] == pytest.approx(0.104 + 0.1)


@pytest.mark.usefixtures("sounddevice")
def test_what_a_device_still_held_when_it_died_was_not_felt(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, stream = open_output(monkeypatch, tmp_path)
    output.start("a", gap_s=0.0)
    stream.ask()
    stream.ask()
    stream.active = False
    assert not output.is_playing
    delivery = output.collect()
    assert (delivery.completed, delivery.measured["n_samples"]) == (False, 150)
    assert delivery.error.startswith("device 'coils' stopped")


@pytest.mark.usefixtures("sounddevice")
def test_a_device_that_dies_while_clocks_are_compared_leaves_no_nan(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    output, stream = open_output(monkeypatch, tmp_path)
    monkeypatch.setattr(
        "feel321.study.actuator.device.DeviceStream.compare_clocks", lambda *_: float("nan")
    )
    output.start("a", gap_s=0.0)
    while output.is_playing:
        stream.ask()
    onset_s = output.collect().onset_s
    assert onset_s is not None
    assert np.isfinite(onset_s)


@pytest.mark.usefixtures("sounddevice")
def test_nothing_started_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    output, _ = open_output(monkeypatch, tmp_path)
    assert output.collect().error == "nothing was started"


@pytest.mark.usefixtures("sounddevice")
def test_a_stream_that_never_runs_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, clock: Clock
) -> None:
    monkeypatch.setattr("feel321.study.actuator.output.sleep", clock.wait)
    output = StreamOutput(RIG, {}, rate_hz=RATE_HZ, folder=tmp_path, clock=clock)
    begin_s = clock.now_s
    with pytest.raises(OSError, match="'coils' does not run; is it in use elsewhere"):
        output.open()
    assert clock.now_s - begin_s < 20


@pytest.mark.usefixtures("sounddevice")
def test_a_stream_that_stands_at_first_is_opened_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    starts: list[StandIn] = []

    def start(stream: StandIn) -> None:
        starts.append(stream)
        stream.active = len(starts) == 3

    monkeypatch.setattr(StandIn, "start", start)
    output, stream = open_output(monkeypatch, tmp_path)
    assert len(starts) == 3
    assert stream is starts[2]
    output.start("a", gap_s=0.0)
    assert output.is_playing
    assert stream.ask().any()


@pytest.mark.usefixtures("sounddevice")
def test_a_device_may_be_slow_to_open(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, clock: Clock
) -> None:
    made: list[StandIn] = []
    make = StandIn.__init__

    def make_slowly(stream: StandIn, **settings: Any) -> None:
        made.append(stream)
        clock.wait(2 * STALL_S)
        make(stream, **settings)

    monkeypatch.setattr(StandIn, "__init__", make_slowly)
    open_output(monkeypatch, tmp_path)
    assert len(made) == 1


@pytest.mark.usefixtures("sounddevice")
def test_a_device_may_be_slow_to_ask_for_its_first_block(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, clock: Clock
) -> None:
    streams: list[StandIn] = []
    start = StandIn.start
    monkeypatch.setattr(StandIn, "start", lambda stream: (start(stream), streams.append(stream)))
    first_s = clock.now_s + STALL_S + 1.0

    def wait(wait_s: float) -> None:
        clock.wait(wait_s)
        if clock.now_s > first_s:
            streams[-1].ask()

    monkeypatch.setattr("feel321.study.actuator.output.sleep", wait)
    StreamOutput(RIG, {}, rate_hz=RATE_HZ, folder=tmp_path, clock=clock).open()
    assert len(streams) == 1


@pytest.mark.usefixtures("sounddevice")
def test_a_process_that_stood_still_itself_does_not_take_its_device_for_dead(
    blocks: list[BlockTimes], clock: Clock
) -> None:
    line, stream = open_line(blocks)
    stream.ask()
    for _ in range(5):
        assert not line.find_fault()
        clock.wait(3 * STALL_S)
    assert line.is_silent
    stream.ask()
    faults = []
    for _ in range(30):
        clock.wait(0.1)
        faults.append(line.find_fault())
    assert not any(faults[: round(10 * STALL_S)])
    assert faults[-1].startswith("stands still: it asked for nothing for 2.")


@pytest.mark.usefixtures("sounddevice")
@pytest.mark.parametrize("is_hanging", [False, True])
def test_a_device_that_nobody_looked_at_is_given_a_moment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, clock: Clock, is_hanging: bool
) -> None:
    output, stream = open_output(monkeypatch, tmp_path, clock=clock)
    clock.wait(60.0)
    if is_hanging:
        ask = StandIn.ask
        monkeypatch.setattr(
            StandIn, "ask", lambda s, **told: None if s is stream else ask(s, **told)
        )
    output.start("a", gap_s=0.0)
    assert output.is_playing
    assert stream.active != is_hanging  # another one was opened in its place


class Slow:
    """A thread that ends after so many joins, however long each of them takes."""

    def __init__(self, n_joins: int) -> None:
        self.n_joins = n_joins

    def join(self, timeout: float) -> None:
        assert timeout <= 0.25
        self.n_joins -= 1

    def is_alive(self) -> bool:
        return self.n_joins > 0


@pytest.mark.parametrize(("n_joins", "has_ended"), [(1, True), (8, True), (9, False)])
def test_what_is_waited_for_has_its_time_though_this_process_stood_still(
    n_joins: int, has_ended: bool
) -> None:
    thread: Any = Slow(n_joins)
    assert join(thread, patience_s=2.0) is has_ended
