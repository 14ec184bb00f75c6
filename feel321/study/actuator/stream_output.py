"""The output through one stream that runs for the whole session, and is opened again after a failure.

A stream that was just opened loses its first samples on some devices, so nothing is scheduled before it has run for a
while; and a device that runs dry, stands still or disappears is told in the delivery, not raised.
"""

from __future__ import annotations

from contextlib import contextmanager
from math import isnan
from threading import Thread
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.study.actuator.mixer import PREROLL_S, Mixer
from feel321.study.actuator.output import Delivery, write_delivered
from feel321.study.actuator.rig import identify
from feel321.study.actuator.stream import (
    Line,
    Patience,
    Take,
    check_channels,
    find_device,
    join,
    list_devices,
    refresh_devices,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.actuator.mixer import Cue
    from feel321.study.actuator.output import Clock
    from feel321.study.actuator.rig import Rig
    from feel321.study.actuator.stream import Block, Device, Fill

    Samples = NDArray[np.float32]

# The connection to a rig's device: opened until it runs steadily, and opened again if the device dies.

OPENING_S = 5.0
"""So long a device may take, beyond its pre-roll, until its stream runs; sound servers take two seconds by habit."""

N_OPENINGS = 3
"""A sound server that is busy may let a first stream stand; a later one runs."""

WAKING_S = 1.0
"""So long a stream that nobody looked at, and that was silent for long, may take to ask for a block."""

REVIVING_S = 8.0
"""So long a start waits for a dead device; it may well come back later."""


class Connection:
    """The one line to a device, if there is one."""

    def __init__(
        self, rig: Rig, *, rate_hz: float, fill: Fill, reset: Callable[[], None], preroll_s: float
    ) -> None:
        self.line: Line | None = None
        self._rig = rig
        self._rate_hz = rate_hz
        self._fill = fill
        self._reset = reset
        self._preroll_s = preroll_s
        self._n_frames = 0
        self._opening: Thread | None = None
        self._error = ""

    def open(self) -> None:
        """Find the device, open it, and wait until it runs steadily."""
        device = find_device(
            list_devices(), self._rig.device.name, host_api=self._rig.device.host_api
        )
        check_channels(device, self._rig)
        if not any(self._begin(device) for _ in range(N_OPENINGS)):
            raise OSError(
                f"device: got {device.name!r}, which does not run; is it in use elsewhere?"
            )

    def _begin(self, device: Device) -> bool:
        self._n_frames = 0
        self._reset()
        self.line = Line(device, self._rig, rate_hz=self._rate_hz, fill=self._count)
        patience = Patience()
        while self._n_frames < self._preroll_s * self._rate_hz:
            if not self.line.is_active or patience.look() > OPENING_S + self._preroll_s:
                self.close()
                return False
            sleep(0.005)
        return True

    def revive(self) -> str:
        """Open the device again if it does not run."""
        if self._opening is None and self.line is not None and self._runs(self.line):
            return ""
        if self._opening is None:
            # Looking for devices can hang as long as a sound server does; the session must not.
            self._opening = Thread(target=self._reopen, daemon=True)
            self._opening.start()
        if not join(self._opening, patience_s=REVIVING_S):
            return f"device: got {self._rig.device.name!r}, which does not answer; see to it, then go on"
        self._opening = None
        return self._error

    @staticmethod
    def _runs(line: Line) -> bool:
        patience = Patience()
        while not line.find_fault():
            if not line.is_silent:
                return True
            if patience.look() > WAKING_S:
                return False
            sleep(0.005)
        return False

    def close(self) -> None:
        """Silence the device and let it go."""
        if self.line is not None:
            self.line.close()
        self.line = None

    def _reopen(self) -> None:
        self._error = ""
        self.close()
        try:
            refresh_devices()
            self.open()
        except OSError as problem:
            self._error = str(problem)

    def _count(
        self, out: NDArray[np.float32], block: Block, sensed: NDArray[np.float32] | None
    ) -> None:
        self._fill(out, block, sensed)
        self._n_frames += len(out)


# What a sensor measured of each playback, written to numbered WAV files.

BEYOND_S = 5.0
"""Longest recording beyond the stimulus; two latencies of 2 s fit in."""


class Recorder:
    """Room for what a sensor measures, and where it goes; without a sensor there is neither.

    sounds: (n_samples, channels); room: (n,).
    """

    def __init__(
        self, rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path
    ) -> None:
        self._sensor = rig.sensor
        self._rate_hz = rate_hz
        self._folder = folder
        longest = max((len(sound) for sound in sounds.values()), default=0)
        n = longest + round(BEYOND_S * rate_hz)
        self.room: Samples | None = None if rig.sensor is None else np.zeros(n, dtype=np.float32)

    def keep(self, take: Take) -> dict[str, float]:
        """Write what was measured, in m/s^2, from the frame on in which the onset was sent.

        So recordings of one session are aligned to the sample: the onset stands at the same sample in all of them,
        which is the way there and back and is measured by doctor. They are not cut there by the times that the device
        tells of its input, which can be wrong by much more (10 ms and, at a stream's begin, 0.4 s were seen).
        """
        if self._sensor is None or not len(take.sensed):
            return {}
        samples = take.sensed * np.float32(self._sensor.full_scale_m_s2)
        return {
            "file_number": float(write_delivered(self._folder, samples, rate_hz=self._rate_hz)),
            "sensor_onset_sample": float(round(take.sensor_latency_s * self._rate_hz)),
            "sensor_gaps": float(take.n_sensor_gaps),
        }


# The actuators through one stream that runs for the whole session.


@contextmanager
def open_stream(
    rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path, clock: Clock
) -> Iterator[StreamOutput]:
    """Open the device of a rig, and silence and close it whatever happens.

    sounds: (n_samples, channels).
    """
    output = StreamOutput(rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock)
    try:
        output.open()
        yield output
    finally:
        output.close()


class StreamOutput:
    """Plays stimuli through one running stream; `open_stream` makes, opens and closes it.

    sounds: (n_samples, channels).
    """

    def __init__(
        self, rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path, clock: Clock
    ) -> None:
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
        """Open the device, and wait until it runs steadily."""
        self._connection.open()

    def start(self, stimulus: Stimulus | str, *, gap_s: float) -> None:
        """Schedule silence, then a stimulus; a dead device is opened again first, if it can be."""
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
        """Tell what became of the playback."""
        if self.is_playing and self._stopped_s is None:
            raise ValueError(
                "got a playback that still plays; stop it, or wait until is_playing is False"
            )
        take = self._take
        if take is None or take.cue is None:
            return Delivery(
                self._requested_s, None, completed=False, error=self._error or "nothing was started"
            )
        measured = _measure(take, take.cue)
        if (
            self._stopped_s is not None
            and take.end_s is not None
            and 0 < take.cue.n_played < len(take.cue.sound)
        ):
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
