"""The actuators through one stream that runs for the whole session.

A stream that was just opened loses its first samples on some devices, so nothing is scheduled before it has run for a
while; and a device that runs dry, stands still or disappears is told in the delivery, not raised.
"""

from __future__ import annotations

from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from study.actuator.connection import Connection
from study.actuator.delivered import write_delivered
from study.actuator.mixer import PREROLL_S, Mixer
from study.actuator.output import Delivery
from study.actuator.rig import identify
from study.actuator.take import Take

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.manifest import Stimulus
    from study.actuator.mixer import Cue
    from study.actuator.output import Clock
    from study.actuator.rig import Rig
    from study.actuator.take import Block

    Samples = NDArray[np.float32]

SENSED_BEYOND_S = 5.0
"""Longest recording of a sensor beyond the stimulus; two latencies of 2 s fit in."""


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
        self._folder = folder
        self._clock = clock
        preroll_s = PREROLL_S + 2 * rig.device.latency_s
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=preroll_s)
        self._connection = Connection(rig, rate_hz=rate_hz, fill=self._fill, preroll_s=preroll_s)
        self._sensed = _make_sensed(rig, sounds, rate_hz=rate_hz)
        self._take: Take | None = None
        self._requested_s = 0.0
        self._clock_ahead_s = 0.0
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
        self._take = None
        if self._error or line is None:
            return
        self._latency_s = line.latency_s
        take = Take(self._rate_hz, line.there_and_back_s, sensor=self._sensed)
        self._take = take  # before the mixer knows, so that no block is missed
        take.cue = self._mixer.start(name, gap_s=gap_s)
        self._clock_ahead_s = line.compare_clocks(self._clock)

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
        """Fall silent with the next block."""
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
            If it still plays.
        """
        if self.is_playing:
            raise ValueError("got a playback that still plays; stop it, or wait until is_playing is False")
        take = self._take
        if take is None or take.cue is None:
            return Delivery(self._requested_s, None, completed=False, error=self._error or "nothing was started")
        measured = _measure(take, take.cue, latency_s=self._latency_s) | self._keep_sensed(take)
        return Delivery(
            requested_s=self._requested_s,
            onset_s=None if take.onset_s is None else take.onset_s + self._clock_ahead_s,
            underruns=take.n_underruns,
            clipped=take.cue.clipped,
            completed=take.cue.is_complete and take.is_out,
            error=self._error,
            measured=measured,
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

    def _keep_sensed(self, take: Take) -> dict[str, float]:
        """Write what the sensor measured, in m/s^2."""
        if self._rig.sensor is None or not len(take.sensed):
            return {}
        measured = {
            "sensor_gaps": float(take.n_sensor_gaps),
            "sensor_latency_s": take.sensor_latency_s,
        }
        samples = take.sensed * np.float32(self._rig.sensor.full_scale_m_s2)
        try:
            measured["file_number"] = float(write_delivered(self._folder, samples, rate_hz=self._rate_hz))
        except OSError as problem:
            self._error = self._error or str(problem)
        return measured


def _measure(take: Take, cue: Cue, *, latency_s: float) -> dict[str, float]:
    return {
        "n_samples": float(cue.n_played),
        "blocks": float(take.n_blocks),
        "callback_ms_max": take.longest_s * 1e3,
        "latency_s": latency_s,
        **({} if take.onset_s is None else {"dac_time_s": take.onset_s}),
    }


def _make_sensed(rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float) -> Samples | None:
    """Make room for what the sensor measures of the longest stimulus."""
    if rig.sensor is None:
        return None
    longest = max((len(sound) for sound in sounds.values()), default=0)
    return np.zeros(longest + round(SENSED_BEYOND_S * rate_hz), dtype=np.float32)
