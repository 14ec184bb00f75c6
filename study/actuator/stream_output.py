"""The actuators through one stream that runs for the whole session.

A stream that was just opened loses its first samples on some devices, so nothing is scheduled before it has run for a
while; and a device that runs dry, stands still or disappears is told in the delivery, not raised.
"""

from __future__ import annotations

from contextlib import contextmanager
from math import isnan
from time import perf_counter
from typing import TYPE_CHECKING, Any

from study.actuator.connection import Connection
from study.actuator.mixer import PREROLL_S, Mixer
from study.actuator.output import Delivery
from study.actuator.recorder import Recorder
from study.actuator.rig import identify
from study.actuator.take import Take

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from stimuli.manifest import Stimulus
    from study.actuator.mixer import Cue
    from study.actuator.output import Clock
    from study.actuator.rig import Rig
    from study.actuator.take import Block

    Samples = NDArray[np.float32]


@contextmanager
def open_stream(
    rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path, clock: Clock
) -> Iterator[StreamOutput]:
    """Open the device of a rig, and silence and close it whatever happens.

    Parameters
    ----------
    rig : Rig
        The rig.
    sounds : mapping of str to ndarray of float32, shape (n_samples, channels)
        Rendered stimuli, by their ids.
    rate_hz : float
        Sampling rate in Hz; the device plays at it, or not at all.
    folder : Path
        Where recordings of the sensor go; made if there is one.
    clock : callable
        The session's clock.

    Yields
    ------
    StreamOutput
        The output; its stream runs.

    Raises
    ------
    OSError
        If the device is not there, refuses channels or rate, or does not run.
    """
    output = StreamOutput(rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock)
    try:
        output.open()
        yield output
    finally:
        output.close()


class StreamOutput:
    """Plays stimuli through one running stream; `open_stream` makes, opens and closes it.

    Parameters
    ----------
    rig : Rig
        The rig.
    sounds : mapping of str to ndarray of float32, shape (n_samples, channels)
        Rendered stimuli, by their ids.
    rate_hz : float
        Sampling rate in Hz.
    folder : Path
        Where recordings of the sensor go.
    clock : callable
        The session's clock.
    """

    def __init__(self, rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path, clock: Clock) -> None:
        self._rig = rig
        self._rate_hz = rate_hz
        self._clock = clock
        preroll_s = PREROLL_S + 2 * rig.device.latency_s
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=preroll_s)
        self._connection = Connection(
            rig, rate_hz=rate_hz, fill=self._fill, reset=self._mixer.reset, preroll_s=preroll_s
        )
        self._recorder = Recorder(rig, sounds, rate_hz=rate_hz, folder=folder)
        self._take: Take | None = None
        self._requested_s = 0.0
        self._clock_ahead_s = 0.0
        self._stopped_s: float | None = None
        self._latency_s = rig.device.latency_s
        self._error = ""

    @property
    def identity(self) -> Mapping[str, Any]:
        """What plays: rig, device, host API, rate, channels."""
        line = self._connection.line
        return {
            "rig": identify(self._rig),
            "device": line.device.name if line else self._rig.device.name,
            "host_api": line.device.host_api if line else self._rig.device.host_api,
            "is_program": line.device.is_program if line else None,
            "rate_hz": self._rate_hz,
            "channels": self._rig.n_channels,
        }

    def open(self) -> None:
        """Open the device, and wait until it runs steadily.

        Raises
        ------
        OSError
            If the device is not there, refuses channels or rate, or does not run.
        """
        self._connection.open()

    def start(self, stimulus: Stimulus | str, *, gap_s: float) -> None:
        """Schedule silence, then a stimulus; a dead device is opened again first, if it can be.

        Parameters
        ----------
        stimulus : Stimulus or str
            What to play, or its id.
        gap_s : float
            Silence before it, in s; longer where masking has to begin first.
        """
        name = stimulus if isinstance(stimulus, str) else stimulus.stimulus_id
        self._error = self._connection.revive()
        line = self._connection.line
        self._requested_s = self._clock() + gap_s
        self._take = self._stopped_s = None
        if self._error or line is None:
            return
        self._latency_s = line.latency_s
        take = Take(self._rate_hz, line.there_and_back_s, sensor=self._recorder.room)
        self._take = take  # before the mixer knows, so that no block is missed
        take.cue = self._mixer.start(name, gap_s=gap_s)
        ahead_s = line.compare_clocks(self._clock)
        self._clock_ahead_s = self._clock_ahead_s if isnan(ahead_s) else ahead_s

    @property
    def is_playing(self) -> bool:
        """Whether something of the stimulus, or of its gap, has not yet left the converter of a device that lives."""
        line = self._connection.line
        if self._take is None or self._take.is_out or line is None:
            return False
        if reason := line.find_fault():
            self._error = f"device {line.device.name!r} {reason}"
            self._mixer.stop()
        return not self._error

    def stop(self) -> None:
        """Fall silent with the next block that the device asks for.

        What it holds, it still plays: `latency_s` of rig.toml and a block. To throw that away would be a knock on the
        skin, a click in the ears, and a device that begins anew. `stop_s` in the delivery tells how long it took.
        """
        self._stopped_s = self._stopped_s or self._clock()
        self._mixer.stop()

    def collect(self) -> Delivery:
        """Tell what became of the playback.

        Returns
        -------
        Delivery
            What became of it.

        Raises
        ------
        ValueError
            If it still plays, and was not stopped.
        """
        if self.is_playing and self._stopped_s is None:
            raise ValueError("got a playback that still plays; stop it, or wait until is_playing is False")
        take = self._take
        if take is None or take.cue is None:
            return Delivery(self._requested_s, None, completed=False, error=self._error or "nothing was started")
        measured = _measure(take, take.cue)
        if self._stopped_s is not None and take.end_s is not None and 0 < take.cue.n_played < len(take.cue.sound):
            measured["stop_s"] = take.end_s + self._clock_ahead_s - self._stopped_s
        try:
            measured |= self._recorder.keep(take)
        except OSError as problem:
            self._error = self._error or str(problem)
        return Delivery(
            requested_s=self._requested_s,
            onset_s=None if take.onset_s is None else take.onset_s + self._clock_ahead_s,
            underruns=take.n_underruns,
            clipped=take.cue.clipped,
            completed=take.cue.is_complete and take.is_out,
            error=self._error,
            measured=measured | {"latency_s": self._latency_s},
        )

    def close(self) -> None:
        """Silence the device and let it go."""
        self._connection.close()

    def _fill(self, out: Samples, block: Block, sensed: Samples | None) -> None:
        """Do what the device asks for; this runs in its own thread."""
        begin_s, take, frame = perf_counter(), self._take, self._mixer.frame
        self._mixer.fill(out)
        if take is None or take.is_out:
            return
        take.note(block, frame=frame)
        if sensed is not None:
            take.sense(sensed, frame=frame)
        take.longest_s = max(take.longest_s, perf_counter() - begin_s)


def _measure(take: Take, cue: Cue) -> dict[str, float]:
    return {
        "n_samples": float(cue.n_played),
        "blocks": float(take.n_blocks),
        "callback_ms_max": take.longest_s * 1e3,
        **({} if take.onset_s is None else {"dac_time_s": take.onset_s}),
    }
