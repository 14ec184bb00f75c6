"""PortAudio: its devices, and one open stream to one of them. Only this module knows sounddevice."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from threading import Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any

from study.actuator.devices import Device
from study.actuator.patience import Patience, join
from study.actuator.take import Block

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import ModuleType

    import numpy as np
    from numpy.typing import NDArray

    from study.actuator.output import Clock
    from study.actuator.rig import Rig

    Samples = NDArray[np.float32]
    Foreign = Any  # sounddevice has no types
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
    """List the audio devices of this machine.

    Returns
    -------
    list of Device
        All of them, in PortAudio's order.

    Raises
    ------
    OSError
        If sounddevice or PortAudio is missing.
    """
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
    """Try at which rates a device would play.

    Parameters
    ----------
    device : Device
        The device.
    n_channels : int
        On how many channels.
    rates_hz : sequence of float
        What to try, in Hz.

    Returns
    -------
    list of float
        Those that it takes.
    """
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
    """One open stream, from its opening to its closing; it runs at once.

    Parameters
    ----------
    device : Device
        The device.
    rig : Rig
        Which channels are needed, and which latency is asked for.
    rate_hz : float
        Sampling rate in Hz.
    fill : callable
        Takes a block to be filled, what the stream says of itself, and what came in on the sensor's channel (None
        without a sensor); called in the stream's own thread.

    Attributes
    ----------
    latency_s : float
        From a block to its sound, as the device says, in s.
    there_and_back_s : float
        The same, and from the sensor back if there is one, in s.

    Raises
    ------
    OSError
        If the device refuses.
    """

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
                self._last_s = perf_counter()  # opening may have taken long; only from here on it can stand still
                self._stream.start()
        except _load().PortAudioError as error:
            raise OSError(_describe(error, self.device, rate_hz=rate_hz)) from None

    def find_fault(self) -> str:
        """Find out whether the stream still runs.

        Returns
        -------
        str
            What is wrong with it; empty if nothing is.
        """
        if not self.is_active:
            return "stopped: unplugged, or its server ended"
        if self._last_s != self._seen_s:
            self._seen_s, self._patience = self._last_s, Patience()
        silent_s = self._patience.look()
        return f"stands still: it asked for nothing for {silent_s:.1f} s" if silent_s > STALL_S else ""

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

        Parameters
        ----------
        clock : callable
            The session's clock.

        Returns
        -------
        float
            By how much the session's is ahead, in s; NaN if the device has just died.
        """
        try:
            return min(_read_clocks(clock, self._stream) for _ in range(CLOCK_READS))[1]
        except _load().PortAudioError:
            return float("nan")

    def close(self) -> bool:
        """Silence the device and let it go; one that hangs is left to itself, and finds silence if it comes back.

        Returns
        -------
        bool
            Whether it is closed.
        """
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
        settings = {"device": self.device.index, "samplerate": rate_hz, "dtype": "float32", "latency": latency_s}
        if rig.sensor is None:
            return sounddevice.OutputStream(channels=rig.n_channels, callback=self._answer, **settings)
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
        is_empty = self._store.refill(self._last_s - before_s, block_s=n / self._rate_hz, latency_s=self.latency_s)
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
        self._held_s = latency_s + block_s if left_s < 0 else min(latency_s, left_s) + block_s * DRIFT
        return left_s < 0


def _read_clocks(clock: Clock, stream: Foreign) -> tuple[float, float]:
    before_s = clock()
    device_s = float(stream.time)
    after_s = clock()
    return after_s - before_s, (before_s + after_s) / 2 - device_s


def refresh_devices() -> None:
    """Let PortAudio look for devices anew: it lists what was there when it was loaded.

    No stream may be open.

    Raises
    ------
    OSError
        If it does not begin again.
    """
    sounddevice = _load()
    with _hushed():
        # sounddevice offers no other way (its documentation names this one).
        with suppress(sounddevice.PortAudioError):  # it is not there if it could not begin the last time
            sounddevice._terminate()
        try:
            sounddevice._initialize()
        except sounddevice.PortAudioError as error:
            raise OSError(f"device: PortAudio does not begin ({error}); see to the sound system, then go on") from None


def _load() -> ModuleType:
    try:
        with _hushed():
            import sounddevice

            module: ModuleType = sounddevice
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"
        raise OSError(f"device: sounddevice not found, which actuators need; {how}") from None
    except OSError:
        raise OSError("device: got no PortAudio, sounddevice needs it; install the package libportaudio2") from None
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
