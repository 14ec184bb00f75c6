"""PortAudio: its devices, and one open stream to one of them. Only this module knows sounddevice.

All times are the device's own, in s.
"""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import ModuleType

    from numpy.typing import NDArray

    from feel321.study.actuator.mixer import Cue
    from feel321.study.actuator.output import Clock
    from feel321.study.actuator.rig import Rig

    Samples = NDArray[np.float32]
    Foreign = Any  # sounddevice has no types

# Finding the one device that a rig names, among those that PortAudio lists.

FALLBACKS = ("default", "sysdefault")
"""Names of whatever the system prefers today: not always the same device, so none that a study can rest on."""


ALSA = "ALSA"
HARDWARE = "(hw:"
"""What ALSA's names have in them where there is a card behind them, not a program."""

PROGRAMS = ("JACK Audio Connection Kit", "PulseAudio", "MME", "Windows DirectSound")
"""Interfaces that are programs themselves."""


@dataclass(frozen=True, slots=True)
class Device:
    """A device as PortAudio lists it.

    n_outputs, n_inputs: how many channels it has at most.
    """

    index: int
    name: str
    host_api: str
    n_outputs: int
    n_inputs: int
    default_rate_hz: float

    @property
    def is_program(self) -> bool:
        """Whether a program stands before the hardware, a sound server say.

        It may convert the rate, and play the rig's channels on others too where its sink has more of them; PortAudio
        learns of neither.
        """
        return self.host_api in PROGRAMS or (self.host_api == ALSA and HARDWARE not in self.name)


def find_device(devices: Sequence[Device], name: str, *, host_api: str | None = None) -> Device:
    """Find an output device by its name, never another one in its stead.

    Examples
    --------
    >>> coils = Device(3, "USB Audio: coils (hw:1,0)", "ALSA", 4, 2, 48000.0)
    >>> find_device([coils], "coils").index
    3
    """
    outputs = [
        device for device in devices if device.n_outputs and device.name.lower() not in FALLBACKS
    ]
    if not outputs:
        raise OSError(f"device: got {name!r}, there is no output device at all; plug it in")
    through = f" through {host_api}" if host_api else ""
    if name.lower() in FALLBACKS:
        raise OSError(
            f"device: got {name!r}, which may be another one tomorrow; allowed: {_list(outputs)}"
        )
    heard = [
        device for device in outputs if not host_api or device.host_api.lower() == host_api.lower()
    ]
    found = [device for device in heard if device.name == name]
    found = found or [
        device for device in heard if name.strip() and name.lower() in device.name.lower()
    ]
    if not found:
        raise OSError(
            f"device: got {name!r}{through}, which is not there; allowed: {_list(outputs)}"
        )
    if len(found) > 1:
        raise OSError(
            f"device: got {name!r}{through}, which {len(found)} devices have in their names: {_list(found)}; "
            "name one in full, and its host_api in rig.toml"
        )
    return found[0]


def check_channels(device: Device, rig: Rig) -> None:
    """Demand every channel that a rig names."""
    n_inputs = rig.sensor.channel if rig.sensor else 0
    for kind, needed, there in (
        ("output", rig.n_channels, device.n_outputs),
        ("input", n_inputs, device.n_inputs),
    ):
        if needed > there:
            raise OSError(
                f"device: got {device.name!r} with {there} {kind} channel(s), the rig needs {needed}; "
                "take another device, or other channels in rig.toml"
            )


def _list(devices: Sequence[Device]) -> str:
    return ", ".join(f"{device.name!r} ({device.host_api})" for device in devices)


# How long somebody has waited, as far as they were there to see it.

GLANCE_S = 0.25
"""So much at most counts between two looks: whoever was away for longer stood still, not what is waited for."""


class Patience:
    """Adds up the time between looks at something that is waited for.

    On a busy machine this process itself may stand still for seconds, and what it waits for could not do anything
    either: a device is not dead because nobody looked.
    """

    def __init__(self) -> None:
        self._looked_s = perf_counter()
        self._waited_s = 0.0

    def look(self) -> float:
        """Look, and tell how long was waited.

        Returns time in s.
        """
        now_s = perf_counter()
        self._waited_s += min(now_s - self._looked_s, GLANCE_S)
        self._looked_s = now_s
        return self._waited_s


def join(thread: Thread, *, patience_s: float) -> bool:
    """Wait for the end of a thread, as long as this process is there to wait."""
    for _ in range(max(round(patience_s / GLANCE_S), 1)):
        thread.join(min(GLANCE_S, patience_s))
        if not thread.is_alive():
            return True
    return False


# What a stream notices about one playback, block by block: when it really began and ended, and what went wrong.

SENSOR_TAIL_S = 0.05
"""So long after the vibration the sensor is listened to: what hangs on an actuator rings on."""


@dataclass(frozen=True, slots=True)
class Block:
    """What a stream says of itself as it asks for a block."""

    now_s: float
    dac_s: float
    adc_s: float = 0.0
    has_run_dry: bool = False
    has_lost_input: bool = False


class Take:
    """The record of one playback; the callback writes it, the session reads it once it is out.

    sensor: (n,).
    """

    def __init__(
        self, rate_hz: float, latency_s: float, *, sensor: NDArray[np.float32] | None = None
    ) -> None:
        self.cue: Cue | None = None
        self.onset_s: float | None = None
        self.end_s: float | None = None
        self.is_out = False
        self.n_blocks = 0
        self.n_underruns = 0
        self.n_sensor_gaps = 0
        self.longest_s = 0.0
        self.sensor_latency_s = 0.0
        self.n_sensed = 0
        self._rate_hz = rate_hz
        self._sensor = sensor
        # Some host interfaces tell no times: then what the device says of itself counts, twice to be safe.
        self._late_frames = round(2 * latency_s * rate_hz)
        # Times that are told of inputs are less true than those of outputs, so the sensor is listened to by frames.
        self._sensed_frames = round((latency_s + SENSOR_TAIL_S) * rate_hz)
        self._end_frame = 0

    def note(self, block: Block, *, frame: int) -> None:
        """Note a block that the mixer has filled."""
        self.n_blocks += 1
        self.n_underruns += block.has_run_dry
        self.n_sensor_gaps += block.has_lost_input
        if self.cue is None:
            return
        if self.end_s is not None:
            n_since = frame - self._end_frame
            is_heard = block.now_s >= self.end_s or n_since >= self._late_frames
            self.is_out = is_heard and (self._sensor is None or n_since >= self._sensed_frames)
            return
        if self.onset_s is None and self.cue.n_played:
            self.onset_s = block.dac_s + (self.cue.onset_frame - frame) / self._rate_hz
            self.sensor_latency_s = block.dac_s - block.adc_s
        if self.cue.is_over:
            self._end_frame = (
                self.cue.onset_frame + self.cue.n_played if self.cue.n_played else frame
            )
            self.end_s = block.dac_s + (self._end_frame - frame) / self._rate_hz

    def sense(self, samples: NDArray[np.float32], *, frame: int) -> None:
        """Keep what the sensor measured since the frame of the onset went out; it comes back later.

        samples: (n,).
        """
        if self._sensor is None or self.cue is None or self.onset_s is None:
            return
        first = max(self.cue.onset_frame - frame, 0)
        piece = samples[first : first + len(self._sensor) - self.n_sensed]
        self._sensor[self.n_sensed : self.n_sensed + len(piece)] = piece
        self.n_sensed += len(piece)

    @property
    def sensed(self) -> NDArray[np.float32]:
        """What the sensor measured, in fractions of its full scale."""
        return (
            np.zeros(0, dtype=np.float32) if self._sensor is None else self._sensor[: self.n_sensed]
        )


if TYPE_CHECKING:
    Fill = Callable[[Samples, Block, Samples | None], None]

STALL_S = 2.5
"""A device that asked for nothing for so long, while it was looked at, is taken for dead."""

OPENED_S = 60.0
"""So long the first block may stand; nothing is played by then."""

DRIFT = 1.001
"""By so much a device's own clock may be slow without being taken for one that runs dry in the end."""

CLOSING_S = 2.0
"""So long a dead device is waited for; then it is left to itself."""

CLOCK_READS = 5
"""How often the device's clock is read beside the session's; the fastest reading is the truest."""


def list_devices() -> list[Device]:
    """List the audio devices of this machine."""
    sounddevice = _load()
    apis = [api["name"] for api in sounddevice.query_hostapis()]
    return [
        Device(
            index=row["index"],
            name=row["name"],
            host_api=apis[row["hostapi"]],
            n_outputs=row["max_output_channels"],
            n_inputs=row["max_input_channels"],
            default_rate_hz=row["default_samplerate"],
        )
        for row in sounddevice.query_devices()
    ]


def list_rates(device: Device, *, n_channels: int, rates_hz: Sequence[float]) -> list[float]:
    """Try at which rates a device would play."""
    sounddevice = _load()

    def is_taken(rate_hz: float) -> bool:
        try:
            sounddevice.check_output_settings(
                device=device.index, channels=n_channels, samplerate=rate_hz, dtype="float32"
            )
        except sounddevice.PortAudioError:
            return False
        return True

    with _hushed():
        return [rate_hz for rate_hz in rates_hz if is_taken(rate_hz)]


class Line:
    """One open stream, from its opening to its closing; it runs at once."""

    def __init__(self, device: Device, rig: Rig, *, rate_hz: float, fill: Fill) -> None:
        self.device = device
        self._fill = fill
        self._column = rig.sensor.channel - 1 if rig.sensor else None
        self._rate_hz = rate_hz
        self._store = _Store()
        self._is_closed = False
        self._seen_s, self._patience = 0.0, Patience()
        try:
            with _hushed():
                self._stream = self._open(rig, rate_hz=rate_hz)
                latency = self._stream.latency
                self.latency_s = float(latency if self._column is None else latency[1])
                self.there_and_back_s = float(latency if self._column is None else sum(latency))
                self._check_rate()
                # Opening may have taken long; only from here on it can stand still.
                self._last_s = perf_counter()
                self._stream.start()
        except _load().PortAudioError as error:
            raise OSError(_describe(error, self.device, rate_hz=rate_hz)) from None

    def find_fault(self) -> str:
        """Find out whether the stream still runs."""
        if not self.is_active:
            return "stopped: unplugged, or its server ended"
        if self._last_s != self._seen_s:
            self._seen_s, self._patience = self._last_s, Patience()
        silent_s = self._patience.look()
        return (
            f"stands still: it asked for nothing for {silent_s:.1f} s" if silent_s > STALL_S else ""
        )

    @property
    def is_active(self) -> bool:
        """Whether the stream was not stopped; it may stand still nevertheless."""
        return bool(self._stream.active)

    @property
    def is_silent(self) -> bool:
        """Whether it asked for nothing for long; if nobody looked meanwhile, it may just go on."""
        return perf_counter() - self._last_s > STALL_S

    def compare_clocks(self, clock: Clock) -> float:
        """Compare the session's clock with the device's.

        Returns by how much the session's is ahead, in s.
        """
        try:
            return min(_read_clocks(clock, self._stream) for _ in range(CLOCK_READS))[1]
        except _load().PortAudioError:
            return float("nan")

    def close(self) -> bool:
        """Silence the device and let it go; one that hangs is left to itself, and finds silence if it comes back."""
        self._is_closed = True
        closing = Thread(target=self._close, daemon=True)
        closing.start()
        return join(closing, patience_s=CLOSING_S)

    def _close(self) -> None:
        # A device that is gone refuses to be stopped; there is nothing left to stop then.
        with suppress(_load().PortAudioError), _hushed():
            self._stream.close(ignore_errors=True)

    def _check_rate(self) -> None:
        if self._stream.samplerate != self._rate_hz:
            self._close()
            raise OSError(
                f"device: got {self.device.name!r}, which runs at {self._stream.samplerate:g} Hz, the stimuli are at "
                f"{self._rate_hz:g} Hz; set the device, or rate_hz under [rig] in study.toml"
            )

    def _open(self, rig: Rig, *, rate_hz: float) -> Foreign:
        sounddevice, latency_s = _load(), rig.device.latency_s
        settings = {
            "device": self.device.index,
            "samplerate": rate_hz,
            "dtype": "float32",
            "latency": latency_s,
        }
        if rig.sensor is None:
            return sounddevice.OutputStream(
                channels=rig.n_channels, callback=self._answer, **settings
            )
        channels = (rig.sensor.channel, rig.n_channels)
        return sounddevice.Stream(channels=channels, callback=self._answer_duplex, **settings)

    def _answer(self, *given: Foreign) -> None:
        self._serve(None, *given)

    def _answer_duplex(self, *given: Foreign) -> None:
        self._serve(given[0][:, self._column], *given[1:])

    def _serve(self, sensed: Samples | None, *given: Foreign) -> None:
        out, *told = given
        if self._is_closed:  # another line may play by now, from the same source
            out.fill(0)
        else:
            self._fill(out, self._note(*told), sensed)

    def _note(self, n: int, times: Foreign, status: Foreign) -> Block:
        self._last_s, before_s = perf_counter(), self._last_s
        is_empty = self._store.refill(
            self._last_s - before_s, block_s=n / self._rate_hz, latency_s=self.latency_s
        )
        return Block(
            now_s=times.currentTime,
            # Interfaces that tell no times say 0.
            dac_s=times.outputBufferDacTime or times.currentTime + self.latency_s,
            adc_s=times.inputBufferAdcTime,
            has_run_dry=bool(status.output_underflow) or is_empty,
            has_lost_input=bool(status.input_overflow or status.input_underflow),
        )


class _Store:
    """How much a device has to play; sound servers do not always tell when it runs out."""

    def __init__(self) -> None:
        self._held_s = OPENED_S

    def refill(self, waited_s: float, *, block_s: float, latency_s: float) -> bool:
        """Take note of a block; say whether the device had waited for it longer than it had samples for."""
        left_s = self._held_s - waited_s
        self._held_s = (
            latency_s + block_s if left_s < 0 else min(latency_s, left_s) + block_s * DRIFT
        )
        return left_s < 0


def _read_clocks(clock: Clock, stream: Foreign) -> tuple[float, float]:
    before_s = clock()
    device_s = float(stream.time)
    after_s = clock()
    return after_s - before_s, (before_s + after_s) / 2 - device_s


def refresh_devices() -> None:
    """Let PortAudio look for devices anew: it lists what was there when it was loaded.

    No stream may be open.
    """
    sounddevice = _load()
    with _hushed():
        # sounddevice offers no other way (its documentation names this one).
        # It is not there if it could not begin the last time.
        with suppress(sounddevice.PortAudioError):
            sounddevice._terminate()
        try:
            sounddevice._initialize()
        except sounddevice.PortAudioError as error:
            raise OSError(
                f"device: PortAudio does not begin ({error}); see to the sound system, then go on"
            ) from None


def _load() -> ModuleType:
    try:
        with _hushed():
            import sounddevice

            module: ModuleType = sounddevice
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"
        raise OSError(f"device: sounddevice not found, which actuators need; {how}") from None
    except OSError:
        raise OSError(
            "device: got no PortAudio, sounddevice needs it; install the package libportaudio2"
        ) from None
    return module


def _describe(error: Exception, device: Device, *, rate_hz: float) -> str:
    reason = " ".join(str(part) for part in error.args[:1]).rstrip(".")
    return (
        f"device: got {device.name!r}, which does not play at {rate_hz:g} Hz ({reason}); "
        "allowed is what it takes without conversion, see: feel321 doctor"
    )


@contextmanager
def _hushed() -> Iterator[None]:
    """Keep off the terminal what PortAudio and ALSA print by themselves while something is tried."""
    try:
        kept = os.dup(2)
    except OSError:  # where stderr is closed, nothing is printed
        yield
        return
    try:
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 2)
        os.close(sink)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
