"""What a rig plays on: PortAudio's devices, simulated voice coils, WAV files.

Only this module knows sounddevice. All times are the sink's own, in s.
"""

import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import ceil, inf, nan
from threading import Event, Thread
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np
from scipy import signal

from feel321.study.actuator import rig as rigs
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.rig import CoilTable, Rig, SimulationTable
from feel321.types import Samples

Foreign = Any  # sounddevice has no types
SessionClock = Callable[[], float]  # in s since the session began, its interruptions left out
Fill = Callable[[Frames, "BlockTimes", Frames | None], None]

FALLBACKS = ("default", "sysdefault")  # not always the same device, so no study can use them
PROGRAMS = ("JACK Audio Connection Kit", "PulseAudio", "MME", "Windows DirectSound")


@dataclass(frozen=True, slots=True)
class Device:
    """A device as PortAudio lists it, with the largest numbers of its channels."""

    index: int
    name: str
    host_api: str
    n_outputs: int
    n_inputs: int

    @property
    def is_program(self) -> bool:
        """Whether a sound server stands before the hardware, which may convert rate and channels without notice."""
        return self.host_api in PROGRAMS or (self.host_api == "ALSA" and "(hw:" not in self.name)


def list_devices() -> list[Device]:
    """List the audio devices of this machine."""
    sounddevice = _load()
    apis = [api["name"] for api in sounddevice.query_hostapis()]
    names = ("index", "name", "max_output_channels", "max_input_channels")
    rows = ((row["hostapi"], *(row[name] for name in names)) for row in sounddevice.query_devices())
    return [Device(index, name, apis[api], *channels) for api, index, name, *channels in rows]


def find_devices(rig: Rig, devices: Sequence[Device] | None = None) -> tuple[Device, Device]:
    """Find the devices that play on a rig and measure there, among those of this machine; never take others instead.

    A device is the one of that name, or the only one that has it as a part of its own; it has the channels needed.
    """
    devices, own, sensor = list_devices() if devices is None else devices, rig.device, rig.sensor
    outputs = [one for one in devices if one.n_outputs and one.name.lower() not in FALLBACKS]
    if not outputs:
        raise OSError(
            f"device {own.name!r} not found: there is no output device at all; plug it in"
        )
    api = (own.host_api or "").lower()
    which = " (which may be another one tomorrow)" if own.name.lower() in FALLBACKS else ""
    which += f" through {own.host_api}" if api else ""
    allowed = [one for one in outputs if not api or one.host_api.lower() == api]
    device = source = _pick(allowed, own.name, listed=outputs, which=which)
    if sensor is not None and sensor.device is not None:
        inputs = [one for one in devices if one.n_inputs and one.host_api == device.host_api]
        source = _pick(inputs, sensor.device, listed=inputs, which=" of [sensor]")
    n_inputs = max(sensor.channels) if sensor else 0
    for name, kind, needed, there in (
        (device.name, "output", rig.n_channels, device.n_outputs),
        (source.name, "input", n_inputs, source.n_inputs),
    ):
        if needed > there:
            raise OSError(
                f"device {name!r} has {there} {kind} channel(s), the rig needs {needed}; take another device, or other "
                "channels in rig.toml"
            )
    return device, source


def _pick(devices: Sequence[Device], name: str, *, listed: Sequence[Device], which: str) -> Device:
    part = name.strip().lower()
    found = [one for one in devices if one.name == name]
    found = found or [one for one in devices if part and part in one.name.lower()]
    if len(found) == 1:
        return found[0]
    known = ", ".join(f"{device.name!r} ({device.host_api})" for device in found or listed)
    if found:
        raise OSError(
            f"device {name!r}{which} is ambiguous: {len(found)} devices have it in their names: {known}; name one in "
            "full, and its host_api in rig.toml"
        )
    raise OSError(f"device {name!r}{which} not found; name one of {known}")


def list_rates(device: Device, rates_hz: Sequence[float]) -> list[float]:
    """List the rates at which a device would play on one channel, of those that are tried."""
    sounddevice, taken = _load(), []
    with _silence_stderr():
        for rate_hz in rates_hz:
            with suppress(sounddevice.PortAudioError):
                sounddevice.check_output_settings(device.index, 1, "float32", samplerate=rate_hz)
                taken.append(rate_hz)
    return taken


def refresh_devices() -> None:
    """Let PortAudio look for devices anew: it lists those that it found when it was loaded. No stream may be open."""
    sounddevice = _load()
    try:
        with _silence_stderr():
            # sounddevice offers no other way (its documentation names this one).
            with suppress(sounddevice.PortAudioError):  # where it could not begin the last time
                sounddevice._terminate()
            sounddevice._initialize()
    except sounddevice.PortAudioError as error:
        why = f"PortAudio does not start ({error})"
        raise OSError(f"device: {why}; check the sound system, then resume") from None


def _load() -> ModuleType:
    try:
        with _silence_stderr():
            import sounddevice
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"
        raise OSError(f"device: actuators need sounddevice, which is not found; {how}") from None
    except OSError:
        how = "install the package libportaudio2"
        raise OSError(f"device: sounddevice needs PortAudio, which is not found; {how}") from None
    return sounddevice  # type: ignore[no-any-return]  # it has no types


@contextmanager
def _silence_stderr() -> Iterator[None]:
    """Keep off the terminal what PortAudio and ALSA print by themselves while something is tried."""
    try:
        kept = os.dup(2)
    except OSError:  # where stderr is closed, nothing is printed
        yield
        return
    try:
        with pathlib.Path(os.devnull).open("wb") as sink:
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


GLANCE_S = 0.25  # longest time between two looks that counts: beyond, this process was suspended


def join(thread: Thread, *, patience_s: float) -> bool:
    """Wait for the end of a thread, not counting time during which this process was suspended."""
    for _ in range(ceil(patience_s / GLANCE_S)):
        thread.join(min(GLANCE_S, patience_s))
    return not thread.is_alive()


FROM_DEVICE, FROM_LATENCY = "device", "latency"  # ways to get the time of an onset


@dataclass(frozen=True, slots=True)
class BlockTimes:
    """Times and flags that come with a block; dac_source: how `dac_s` was got, empty where nothing plays."""

    now_s: float
    dac_s: float
    has_run_dry: bool = False
    has_lost_input: bool = False
    dac_source: str = FROM_DEVICE


class Sink:
    """What the mixer's blocks go to; latency_s: from a block to its sound, there_and_back_s: to the sensor."""

    latency_s = there_and_back_s = 0.0
    name = ""

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        self._rig, self._rate_hz, self._fill, self._clock = rig, rate_hz, fill, clock
        self.identity: dict[str, object] = {"device": self.name}

    def find_fault(self) -> str:
        """Describe why it does not run; empty if it does."""
        return ""

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of its own, in s; NaN if it is dead."""
        return 0.0

    def close(self) -> None:
        """Fall silent and let go of everything."""


STALL_S = 2.5  # a device that asks for nothing for so long, while it is looked at, counts as dead
OPENED_S = 60.0  # time until the second block that is no underrun; nothing is played by then
DRIFT = 1.001  # factor by which a device's clock may be slow without running dry in the end
CLOSING_S = 2.0  # longest wait for a dead device to close; then it is abandoned
CLOCK_READS = 5  # of the device's clock beside the session's; the fastest reading is the truest


class DeviceStream(Sink):
    """One open stream to the device of a rig."""

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        super().__init__(rig, rate_hz=rate_hz, fill=fill, clock=clock)
        (device, source), sensor, sounddevice = find_devices(rig), rig.sensor, _load()
        self.name = device.name
        self._columns = [channel - 1 for channel in sensor.channels] if sensor else []
        known = {"host_api": device.host_api, "is_program": device.is_program}
        self.identity = {"device": device.name, **known}
        # What the device has to play: sound servers do not always say that it ran out.
        self._held_s, self._is_closed = OPENED_S, False
        self._untimed_s = nan  # time of the last call that did not say when its samples leave
        own: dict[str, Any] = {"samplerate": rate_hz, "dtype": "float32"}
        own |= {"latency": rig.device.latency_s, "channels": rig.n_channels}
        if sensor is None:
            own |= {"device": device.index, "callback": partial(self._serve, None)}
        else:
            own |= {"device": (source.index, device.index), "callback": self._serve}
            own["channels"] = (max(sensor.channels), rig.n_channels)
        try:
            with _silence_stderr():
                make = sounddevice.Stream if sensor else sounddevice.OutputStream
                self._stream = make(**own)
                latencies_s = np.atleast_1d(self._stream.latency)
                self.latency_s = float(latencies_s[-1])
                self.there_and_back_s = float(latencies_s.sum())
                if self._stream.samplerate != rate_hz:
                    self._close()
                    raise OSError(
                        f"device {device.name!r} runs at {self._stream.samplerate:g} Hz, the stimuli are at "
                        f"{rate_hz:g} Hz; set the device, or rate_hz under [rig] in study.toml"
                    )
                # Opening may have taken long; only from here on it can stand still.
                self._last_s = self._seen_s = self._looked_s = perf_counter()
                self._silent_s = 0.0  # while it was looked at: not every silence is the device's
                self._stream.start()
        except sounddevice.PortAudioError as error:
            reason = " ".join(str(part) for part in error.args[:1]).rstrip(".")
            raise OSError(
                f"device {device.name!r} does not play at {rate_hz:g} Hz ({reason}); "
                "use a rate that it takes without conversion, see: feel321 doctor"
            ) from None

    def find_fault(self) -> str:
        """Describe why the stream does not run; empty if it does."""
        if not self._stream.active:
            return "stopped: unplugged, or its server ended"
        looked_s, self._looked_s = self._looked_s, perf_counter()
        self._silent_s += min(self._looked_s - looked_s, GLANCE_S)
        if self._last_s != self._seen_s:
            self._seen_s, self._silent_s = self._last_s, 0.0
        is_still = self._silent_s > STALL_S
        return f"stands still: it asked for nothing for {self._silent_s:.1f} s" if is_still else ""

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of the device's, in s; NaN if the device is dead."""
        readings = []
        try:
            for _ in range(CLOCK_READS):
                before_s, device_s = self._clock(), float(self._stream.time)
                after_s = self._clock()
                readings.append((after_s - before_s, (before_s + after_s) / 2 - device_s))
        except _load().PortAudioError:
            return nan
        return min(readings)[1]

    def close(self) -> None:
        """Silence the device and let it go; one that hangs is abandoned, and plays silence if it comes back."""
        self._is_closed = True
        closing = Thread(target=self._close, daemon=True)
        closing.start()
        join(closing, patience_s=CLOSING_S)

    def _close(self) -> None:
        # A device that is gone refuses to be stopped; there is nothing left to stop then.
        with suppress(_load().PortAudioError), _silence_stderr():
            self._stream.close(ignore_errors=True)

    def _serve(self, sensed: Foreign, out: Foreign, *given: Foreign) -> None:
        """Fill a block, in the device's own thread."""
        if self._is_closed:  # another stream may play by now, from the same source
            out.fill(0)
            return
        n, times, status = given
        self._last_s, before_s = perf_counter(), self._last_s
        # A DAC time that is not after now only says that the interface does not know: DirectSound gives now itself
        # (PortAudio#530), WDM-KS gives 0 (PortAudio#531). PortAudio splits a buffer that wraps around: its second part
        # has the same now, and a DAC time that is later by the length of the first.
        now_s, dac_s = times.currentTime, times.outputBufferDacTime
        is_timed = dac_s > now_s and now_s != self._untimed_s
        if not is_timed:
            self._untimed_s, dac_s = now_s, max(dac_s, now_s) + self.latency_s
        # The device waited for this block longer than it had samples for, though it need not say so.
        block_s = n / self._rate_hz
        left_s = self._held_s - (self._last_s - before_s)
        held_s = min(self.latency_s, left_s) + block_s * DRIFT
        self._held_s = self.latency_s + block_s if left_s < 0 else held_s
        is_dry, has_lost = left_s < 0 or status.output_underflow, status.input_overflow
        has_lost |= status.input_underflow
        source = FROM_DEVICE if is_timed else FROM_LATENCY
        block = BlockTimes(now_s, dac_s, bool(is_dry), bool(has_lost), source)
        self._fill(out, block, None if sensed is None else sensed[:, self._columns])


BLOCK_FRAMES = 512  # longest delay of a stop, as with a device
MOST_BEHIND_S = 0.2  # of its own time: a machine that lags by more slows the device down


class FileSink(Sink):
    """Keeps the blocks of a playback, which are filled in the time that they would take."""

    name = rigs.FILE_DEVICE

    def begin(self) -> None:
        """Begin a playback."""
        self._begin_s = self._clock()
        self.blocks: list[Frames] = []

    def serve_due(self) -> bool:
        """Fill a block that would have been played by now; returns whether there was one."""
        n_filled = BLOCK_FRAMES * len(self.blocks)
        if (self._clock() - self._begin_s) * self._rate_hz - n_filled < BLOCK_FRAMES:
            return False
        out = np.zeros((BLOCK_FRAMES, self._rig.n_channels), dtype=np.float32)
        sent_s = self._begin_s + n_filled / self._rate_hz
        # What is in a file is out.
        self._fill(out, BlockTimes(now_s=inf, dac_s=sent_s, dac_source=""), None)
        self.blocks.append(out)
        return True


class SimulatedCoil:
    """A voice coil at work: a causal filter that takes drive block by block and keeps its state between blocks.

    Acceleration over force of a mass on a damped spring is `s² / (s² + s ω₀ / Q + ω₀²)`, made discrete by the bilinear
    transform with the resonance kept in its place. How drive is cut into blocks changes nothing, noise included.
    """

    def __init__(self, coil: CoilTable, *, rate_hz: float, rng: np.random.Generator) -> None:
        if not rate_hz > 2 * coil.resonance_hz:
            raise ValueError(
                f"rate_hz must be above twice the resonance of {coil.resonance_hz:g} Hz, got {rate_hz:g}"
            )
        self._coil, self._rng, direction = coil, rng, np.array(coil.direction or (1.0, 0.0, 0.0))
        self._direction = direction / np.linalg.norm(direction)
        self._b, self._a = discretise(coil, rate_hz=rate_hz)
        self._state, self._line = np.zeros(2), np.zeros(coil.latency)

    def process(self, drive: Samples) -> Samples:
        """Return acceleration in m/s², shape (3, n), for drive in full scales, shape (n,)."""
        coil, n = self._coil, len(drive)
        self._line = np.concatenate([self._line, drive])
        late, self._line = self._line[:n], self._line[n:]
        if coil.saturation is not None:
            late = coil.saturation * np.tanh(late / coil.saturation)
        moved, self._state = signal.lfilter(self._b, self._a, late, zi=self._state)
        noise = self._rng.standard_normal((n, 3)).T  # in time order, so that blocks do not matter
        motion: Samples = np.outer(self._direction, coil.full_scale_m_s2 * moved)
        return motion + coil.noise_m_s2 * noise


def discretise(coil: CoilTable, *, rate_hz: float) -> tuple[Samples, Samples]:
    """Make numerator and denominator, shape (3,) each, of a coil's digital filter of unit gain at high frequencies."""
    omega = 2 * rate_hz * np.tan(np.pi * coil.resonance_hz / rate_hz)
    b, a = signal.bilinear([1.0, 0.0, 0.0], [1.0, omega / coil.q, omega**2], fs=rate_hz)
    return np.asarray(b, dtype=np.float64), np.asarray(a, dtype=np.float64)


class Hardware:
    """The coils and the sensor of a rig, without a device; they keep their state between blocks."""

    def __init__(self, rig: Rig, *, rate_hz: float) -> None:
        simulation = rig.simulation or SimulationTable()
        tables = {coil.name: coil for coil in simulation.coils}
        self._rng, self._coils = np.random.default_rng(simulation.seed), []
        for one in rig.actuators:
            own = tables.get(one.name, CoilTable(name=one.name))
            late = {"latency": own.latency + simulation.latency}
            own = own.model_copy(update={"direction": own.direction or one.direction} | late)
            coil = SimulatedCoil(own, rate_hz=rate_hz, rng=self._rng)
            self._coils.append((one.channel - 1, coil))
        self._noise_m_s2, self._sensor = simulation.noise_m_s2, rig.sensor

    def sense(self, out: Frames) -> Frames | None:
        """Return what the sensor's inputs get for frames sent, shape (n, channels), as parts of its full scale."""
        motion = self._noise_m_s2 * self._rng.standard_normal((3, len(out)))
        for column, coil in self._coils:
            motion += coil.process(out[:, column].astype(np.float64))
        if self._sensor is None:
            return None
        return np.clip(motion.T / self._sensor.full_scale_m_s2, -1, 1).astype(np.float32)


class SimulatedStream(Sink):
    """Coils of `[simulation]` that a thread moves, block by block, as a device would."""

    name = rigs.SIMULATED_DEVICE

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        super().__init__(rig, rate_hz=rate_hz, fill=fill, clock=clock)
        self.identity |= {"host_api": "feel321", "is_program": False}
        simulation = rig.simulation or SimulationTable()
        self.latency_s = rig.device.latency_s
        self.there_and_back_s = rig.device.latency_s + simulation.latency / rate_hz
        self._hardware, self._speed = Hardware(rig, rate_hz=rate_hz), simulation.speed
        self._sensed = self._hardware.sense(np.zeros((BLOCK_FRAMES, rig.n_channels), np.float32))
        self._begin_s, self._frame = perf_counter(), 0
        self._closing = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def find_fault(self) -> str:
        """Say whether it has stopped asking for blocks."""
        return "" if self._thread.is_alive() else "stopped"

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of the device's, in s."""
        return self._clock() - (perf_counter() - self._begin_s) * self._speed

    def close(self) -> None:
        """Silence the device and let it go."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        block_s = BLOCK_FRAMES / self._rate_hz
        while not self._closing.is_set():
            now_s = self._frame / self._rate_hz
            behind_s = (perf_counter() - self._begin_s) * self._speed - now_s
            if behind_s < block_s:
                self._closing.wait((block_s - behind_s) / self._speed)
                continue
            if behind_s > MOST_BEHIND_S * max(self._speed, 1.0):
                self._begin_s += behind_s / self._speed
            out = np.zeros((BLOCK_FRAMES, self._rig.n_channels), dtype=np.float32)
            self._frame += BLOCK_FRAMES
            # As with a device, what is sensed is of the block before.
            self._fill(out, BlockTimes(now_s, now_s + self.latency_s), self._sensed)
            self._sensed = self._hardware.sense(out)
