"""PortAudio: its devices, and one open stream to one of them; and ports for triggers.

Only this module knows sounddevice and PsychoPy's ports.

All times are the device's own, in s.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import nan
from threading import Thread
from time import perf_counter, sleep
from types import ModuleType
from typing import Any

from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.rig import Rig, TriggerTable

Foreign = Any  # sounddevice has no types
# In s since the session began, without the time between its openings.
SessionClock = Callable[[], float]
Fill = Callable[[Frames, "BlockTimes", Frames | None], None]

FALLBACKS = ("default", "sysdefault")  # not always the same device, so no study can use them

ALSA = "ALSA"
HARDWARE = "(hw:"  # part of ALSA's names of devices that are a card, not a program

PROGRAMS = ("JACK Audio Connection Kit", "PulseAudio", "MME", "Windows DirectSound")
"""Interfaces that are programs themselves."""


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
        """Whether a program stands before the hardware, such as a sound server.

        It may convert the rate, and play the rig's channels on others too where its sink has more of them; PortAudio
        learns of neither.
        """
        return self.host_api in PROGRAMS or (self.host_api == ALSA and HARDWARE not in self.name)


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
        )
        for row in sounddevice.query_devices()
    ]


def find_devices(rig: Rig) -> tuple[Device, Device]:
    """Find the devices that play on a rig and measure there, and check that they have the channels it names."""
    devices = list_devices()
    device = find_device(devices, rig.device.name, host_api=rig.device.host_api)
    source = device
    if rig.sensor is not None and rig.sensor.device is not None:
        inputs = [one for one in devices if one.n_inputs and one.host_api == device.host_api]
        source = _pick(inputs, rig.sensor.device, listed=inputs, which=" of [sensor]")
    check_channels(rig, device, source)
    return device, source


def find_device(devices: Sequence[Device], name: str, *, host_api: str | None = None) -> Device:
    """Find an output device by its name or a part of it that no other has; never take another one instead."""
    outputs = [one for one in devices if one.n_outputs and one.name.lower() not in FALLBACKS]
    if not outputs:
        raise OSError(f"device {name!r} not found: there is no output device at all; plug it in")
    if name.lower() in FALLBACKS:
        raise OSError(
            f"device {name!r} may be another one tomorrow; name one of {_list_names(outputs)}"
        )
    allowed = [one for one in outputs if not host_api or one.host_api.lower() == host_api.lower()]
    return _pick(allowed, name, listed=outputs, which=f" through {host_api}" if host_api else "")


def _pick(devices: Sequence[Device], name: str, *, listed: Sequence[Device], which: str) -> Device:
    """Pick the device of a name, or the only one that has it as a part of its own."""
    part = name.strip().lower()
    found = [one for one in devices if one.name == name]
    found = found or [one for one in devices if part and part in one.name.lower()]
    if not found:
        raise OSError(f"device {name!r}{which} not found; name one of {_list_names(listed)}")
    if len(found) > 1:
        raise OSError(
            f"device {name!r}{which} is ambiguous: {len(found)} devices have it in their names: {_list_names(found)}; "
            "name one in full, and its host_api in rig.toml"
        )
    return found[0]


def _list_names(devices: Sequence[Device]) -> str:
    return ", ".join(f"{device.name!r} ({device.host_api})" for device in devices)


def check_channels(rig: Rig, device: Device, source: Device) -> None:
    """Refuse devices that lack a channel that the rig names."""
    n_inputs = max(rig.sensor.inputs) if rig.sensor else 0
    for one, kind, needed, there in (
        (device, "output", rig.n_channels, device.n_outputs),
        (source, "input", n_inputs, source.n_inputs),
    ):
        if needed > there:
            raise OSError(
                f"device {one.name!r} has {there} {kind} channel(s), the rig needs {needed}; "
                "take another device, or other channels in rig.toml"
            )


def list_rates(device: Device, rates_hz: Sequence[float]) -> list[float]:
    """List the rates at which a device would play on one channel, of those that are tried."""
    sounddevice, settings = _load(), {"device": device.index, "channels": 1, "dtype": "float32"}
    taken = []
    with _silence_stderr():
        for rate_hz in rates_hz:
            with suppress(sounddevice.PortAudioError):
                sounddevice.check_output_settings(**settings, samplerate=rate_hz)
                taken.append(rate_hz)
    return taken


def refresh_devices() -> None:
    """Let PortAudio look for devices anew: it lists those that it found when it was loaded. No stream may be open."""
    sounddevice = _load()
    with _silence_stderr():
        # sounddevice offers no other way (its documentation names this one).
        with suppress(sounddevice.PortAudioError):  # where it could not begin the last time
            sounddevice._terminate()
        try:
            sounddevice._initialize()
        except sounddevice.PortAudioError as error:
            raise OSError(
                f"device: PortAudio does not start ({error}); check the sound system, then resume"
            ) from None


def _load() -> ModuleType:
    try:
        with _silence_stderr():
            import sounddevice

            module: ModuleType = sounddevice
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"
        raise OSError(f"device: actuators need sounddevice, which is not found; {how}") from None
    except OSError:
        raise OSError(
            "device: sounddevice needs PortAudio, which is not found; install the package libportaudio2"
        ) from None
    return module


@contextmanager
def _silence_stderr() -> Iterator[None]:
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


GLANCE_S = 0.25  # longest time between two looks that counts: beyond, this process was suspended


class Patience:
    """Adds up the time between looks at something that is waited for.

    On a busy machine this process itself may stand still for seconds, and what it waits for could not do anything
    either: a device is not dead because nobody looked.
    """

    def __init__(self) -> None:
        self._looked_s, self._waited_s = perf_counter(), 0.0

    def look(self) -> float:
        """Look, and return how long was waited, in s."""
        now_s = perf_counter()
        self._waited_s += min(now_s - self._looked_s, GLANCE_S)
        self._looked_s = now_s
        return self._waited_s


def join(thread: Thread, *, patience_s: float) -> bool:
    """Wait for the end of a thread, not counting time during which this process was suspended."""
    patience = Patience()
    while thread.is_alive() and patience.look() < patience_s:
        thread.join(min(GLANCE_S, patience_s))
    return not thread.is_alive()


# What the blocks of the mixer go to.

FROM_DEVICE, FROM_LATENCY = "device", "latency"  # ways to get the time of an onset


@dataclass(frozen=True, slots=True)
class BlockTimes:
    """Times and flags that come with a block; dac_source: how `dac_s` was got, empty where nothing plays."""

    now_s: float
    dac_s: float
    adc_s: float = 0.0
    has_run_dry: bool = False
    has_lost_input: bool = False
    dac_source: str = FROM_DEVICE


class Sink:
    """What the blocks of the mixer go to: a device, simulated coils, or a file; it runs from the time it is made.

    latency_s: from a block to its sound; there_and_back_s: from a block to what the sensor makes of it.
    """

    latency_s = 0.0
    there_and_back_s = 0.0
    name = ""

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        self._rig, self._rate_hz, self._fill, self._clock = rig, rate_hz, fill, clock

    @property
    def identity(self) -> dict[str, object]:
        """What a journal says of it."""
        return {"device": self.name}

    @property
    def is_active(self) -> bool:
        """Whether it was not stopped; it may stand still nevertheless."""
        return True

    @property
    def is_silent(self) -> bool:
        """Whether it has asked for nothing for long; if nobody looked meanwhile, it may just go on."""
        return not self.is_active

    def find_fault(self) -> str:
        """Describe why it does not run; empty if it does."""
        return "" if self.is_active else "stopped"

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of its own, in s; NaN if it is dead."""
        return 0.0

    def begin(self) -> None:
        """Be told that a playback begins."""

    def serve_due(self) -> bool:
        """Serve a block that is due, if it does not ask for blocks by itself; returns whether there was one."""
        return False

    def close(self) -> None:
        """Fall silent and let go of everything."""

    @staticmethod
    def refresh() -> None:
        """Look anew for what there is, before it is opened again."""


STALL_S = 2.5  # a device that asks for nothing for so long, while it is looked at, counts as dead
OPENED_S = 60.0  # time until the second block that is no underrun; nothing is played by then
DRIFT = 1.001  # factor by which a device's clock may be slow without running dry in the end
CLOSING_S = 2.0  # longest wait for a dead device to close; then it is abandoned
CLOCK_READS = 5  # of the device's clock beside the session's; the fastest reading is the truest


class DeviceStream(Sink):
    """One open stream to the device of a rig."""

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        super().__init__(rig, rate_hz=rate_hz, fill=fill, clock=clock)
        device, source = find_devices(rig)
        self.name, self._device = device.name, device
        self._columns = [channel - 1 for channel in rig.sensor.inputs] if rig.sensor else None
        # What the device has to play: sound servers do not always say that it ran out.
        self._held_s = OPENED_S
        self._is_closed = False
        self._seen_s, self._patience = 0.0, Patience()
        self._untimed_s = nan  # time of the last call that did not say when its samples leave
        try:
            with _silence_stderr():
                self._stream = self._open(device, source)
                latency = self._stream.latency
                self.latency_s = float(latency if self._columns is None else latency[1])
                self.there_and_back_s = float(latency if self._columns is None else sum(latency))
                if self._stream.samplerate != rate_hz:
                    self._close()
                    raise OSError(
                        f"device {device.name!r} runs at {self._stream.samplerate:g} Hz, the stimuli are at "
                        f"{rate_hz:g} Hz; set the device, or rate_hz under [rig] in study.toml"
                    )
                # Opening may have taken long; only from here on it can stand still.
                self._last_s = perf_counter()
                self._stream.start()
        except _load().PortAudioError as error:
            reason = " ".join(str(part) for part in error.args[:1]).rstrip(".")
            raise OSError(
                f"device {device.name!r} does not play at {rate_hz:g} Hz ({reason}); "
                "use a rate that it takes without conversion, see: feel321 doctor"
            ) from None

    @property
    def identity(self) -> dict[str, object]:
        """What a journal says of it."""
        own = self._device
        return {"device": own.name, "host_api": own.host_api, "is_program": own.is_program}

    def _open(self, device: Device, source: Device) -> Foreign:
        rig = self._rig
        settings: dict[str, Any] = {"samplerate": self._rate_hz, "dtype": "float32"}
        settings["latency"] = rig.device.latency_s
        if rig.sensor is None:
            settings |= {"device": device.index, "channels": rig.n_channels}
            return _load().OutputStream(callback=partial(self._serve, None), **settings)
        settings |= {
            "device": (source.index, device.index),
            "channels": (max(rig.sensor.inputs), rig.n_channels),
        }
        return _load().Stream(callback=self._serve, **settings)

    @property
    def is_active(self) -> bool:
        """Whether the stream was not stopped; it may stand still nevertheless."""
        return bool(self._stream.active)

    @property
    def is_silent(self) -> bool:
        """Whether it has asked for nothing for long; if nobody looked meanwhile, it may just go on."""
        return perf_counter() - self._last_s > STALL_S

    def find_fault(self) -> str:
        """Describe why the stream does not run; empty if it does."""
        if not self.is_active:
            return "stopped: unplugged, or its server ended"
        if self._last_s != self._seen_s:
            self._seen_s, self._patience = self._last_s, Patience()
        silent_s = self._patience.look()
        if silent_s > STALL_S:
            return f"stands still: it asked for nothing for {silent_s:.1f} s"
        return ""

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of the device's, in s; NaN if the device is dead."""
        readings = []
        try:
            for _ in range(CLOCK_READS):
                before_s, device_s, after_s = (
                    self._clock(),
                    float(self._stream.time),
                    self._clock(),
                )
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

    @staticmethod
    def refresh() -> None:
        """Let PortAudio look for devices anew."""
        refresh_devices()

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
        dac_s, dac_source = self._find_dac_time(times)
        is_empty = self._refill(self._last_s - before_s, block_s=n / self._rate_hz)
        block = BlockTimes(
            now_s=times.currentTime,
            dac_s=dac_s,
            # DirectSound never says when its input was measured (PortAudio#121).
            adc_s=times.inputBufferAdcTime
            or times.currentTime - (self.there_and_back_s - self.latency_s),
            has_run_dry=bool(status.output_underflow) or is_empty,
            has_lost_input=bool(status.input_overflow or status.input_underflow),
            dac_source=dac_source,
        )
        self._fill(out, block, None if sensed is None else sensed[:, self._columns])

    def _find_dac_time(self, times: Foreign) -> tuple[float, str]:
        """Find when the first sample of a block leaves the converter, and how that was got.

        Nothing leaves in the moment in which it is asked for: a DAC time that is not after now only says that the
        interface does not know. DirectSound gives now itself (PortAudio#530), WDM-KS gives 0 (PortAudio#531).
        """
        now_s, dac_s = times.currentTime, times.outputBufferDacTime
        # PortAudio splits a buffer that wraps around: its second part has the same now, and a DAC time that is later
        # by the length of the first.
        if dac_s > now_s and now_s != self._untimed_s:
            return dac_s, FROM_DEVICE
        self._untimed_s = now_s
        return max(dac_s, now_s) + self.latency_s, FROM_LATENCY

    def _refill(self, waited_s: float, *, block_s: float) -> bool:
        """Count a block, and return whether the device had waited for it longer than it had samples for."""
        left_s = self._held_s - waited_s
        held_s = min(self.latency_s, left_s) + block_s * DRIFT
        self._held_s = self.latency_s + block_s if left_s < 0 else held_s
        return left_s < 0


# A trigger for other recorders, by PsychoPy's own classes.

LOOK_S = 0.0005  # between two looks at whether the onset is known, and whether it is there
SPIN_S = 0.002  # before an onset, within which there is no sleep


class Trigger:
    """Sends a code to a port at each onset, in a thread of its own, and 0 a little later; clock: the session's."""

    def __init__(self, table: TriggerTable, clock: SessionClock) -> None:
        self._table, self._clock = table, clock
        self._send = open_port(table)
        self._watching: Thread | None = None
        self._is_over = False
        self.sent_s: float | None = None
        self.error = ""

    def watch(self, find_onset: Callable[[], float | None]) -> None:
        """Wait for the onset of a playback that begins, as soon as it is known."""
        self.leave()
        self.sent_s, self.error, self._is_over = None, "", False
        self._watching = Thread(target=self._run, args=(find_onset,), daemon=True)
        self._watching.start()

    def leave(self) -> None:
        """Wait no longer."""
        self._is_over = True
        # A port that takes nothing may not hold up the session.
        if self._watching is not None and not join(
            self._watching, patience_s=CLOSING_S + self._table.duration_s
        ):
            self.error = f"trigger on {self._table.address}: the port takes nothing"

    def _run(self, find_onset: Callable[[], float | None]) -> None:
        while not self._is_over:
            onset_s = find_onset()
            left_s = LOOK_S if onset_s is None else onset_s - self._clock()
            if onset_s is not None and left_s <= 0:
                self._pulse()
                return
            if left_s > SPIN_S or onset_s is None:
                sleep(LOOK_S)

    def _pulse(self) -> None:
        try:
            self._send(self._table.code)
            self.sent_s = self._clock()
            sleep(self._table.duration_s)
            self._send(0)
        except Exception as error:  # noqa: BLE001 - whatever a driver raises, the session goes on
            self.error = f"trigger on {self._table.address}: {error}"


def open_port(table: TriggerTable) -> Callable[[int], object]:
    """Open a port by PsychoPy's class for it, and return what sends a code there."""
    try:
        if table.port == "parallel":
            from psychopy import parallel

            address: Any = table.address
            if address.lower().startswith("0x"):
                address = int(address, 16)
            send: Callable[[int], object] = parallel.ParallelPort(address).setData
            return send
        from psychopy.hardware.serialdevice import SerialDevice

        class Port(SerialDevice):  # type: ignore[misc]  # PsychoPy has no types
            """A port at whose other end nobody answers."""

            def isAwake(self) -> bool:  # noqa: N802 - PsychoPy's name
                return True

        port = Port(table.address, table.baud)
    except Exception as error:  # noqa: BLE001 - PsychoPy and its drivers raise what they like
        raise OSError(
            f"trigger: {table.port} port {table.address} does not open ({error}); check [trigger] in rig.toml, and "
            "whether this account may use the port"
        ) from None
    return lambda code: port.com.write(bytes([code]))
