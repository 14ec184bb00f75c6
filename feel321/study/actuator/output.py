"""Outputs: play a stimulus, stop it, report what was delivered; into numbered WAV files, or through a device.

All times are in s on the session's clock.

A device is played on through one stream that runs for the whole session, and is opened again after a failure. A stream
that was just opened loses its first samples on some devices, so nothing is scheduled before it has run for a while; and
a device that runs dry, stands still or disappears is reported in the playback, not raised.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from math import isnan
from pathlib import Path
from threading import Thread
from time import perf_counter, sleep
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from feel321.files import make_folder, write_bytes
from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.wav import encode_wav
from feel321.study.actuator import device as portaudio
from feel321.study.actuator.device import BlockTimes, SessionClock, Take
from feel321.study.actuator.mixer import PREROLL_S, Cue, Frames, Mixer, Sounds
from feel321.study.actuator.rig import FILE_DEVICE, SIMULATED_DEVICE, Rig, identify
from feel321.study.actuator.simulated import SIMULATED, SimulatedStream
from feel321.study.folder import name_delivered
from feel321.study.session.ports import Playback, Scaled, Tone
from feel321.types import Samples


class Check(Protocol):
    """Compares playbacks with what was asked: `delivered.DeliveryCheck`."""

    def describe(
        self, stimulus_id: str, sent: Frames, measured: ArrayLike | None
    ) -> Mapping[str, float]:
        """Describe a completed playback; sent: (n, channels); measured: m/s², (axes, m), None without a sensor."""


class Output(Protocol):
    """Plays stimuli, one at a time.

    lead_s: by how much the filters of a certificate let samples go out before the vibration that they make. So much of
    the gap is taken up by it, and an onset is that of the vibration.
    """

    lead_s: float

    @property
    def identity(self) -> Mapping[str, Any]:
        """Rig, device, rate and channels, for the journal's header; compared when a session is resumed."""

    def start(
        self, stimulus: Stimulus | Tone | Scaled, *, gap_s: float, goes_on: bool = False
    ) -> None:
        """Schedule silence, then a stimulus, and return at once; goes_on: where the last one was stopped."""

    @property
    def is_playing(self) -> bool:
        """Whether the stimulus that was started last is not over yet, its silence included."""

    def stop(self) -> None:
        """Fall silent within one block; the stimulus is then not completed."""

    def collect(self) -> Playback:
        """Report what became of the stimulus that was started last, once it no longer plays."""


def write_delivered(folder: Path, samples: ArrayLike, *, rate_hz: float) -> tuple[int, str]:
    """Write samples to a WAV file with the next free number, and return that and the file's digest.

    A name would tell the experimenter what was played.
    """
    make_folder(folder, private=True)
    numbers = [int(path.stem) for path in folder.glob("*.wav") if path.stem.isdecimal()]
    number = max(numbers, default=0) + 1
    path = folder / name_delivered(number)
    content = encode_wav(samples, rate_hz)
    write_bytes(path, content, private=True)
    return number, hashlib.sha256(content).hexdigest()


BLOCK_FRAMES = 512  # longest delay of a stop, as with a device


class FileOutput:
    """For machines without actuators: each playback becomes a WAV file, in the time that it would take.

    The journal's `file_number` says which file; sounds: (n_samples, channels).
    """

    def __init__(
        self,
        rig: Rig,
        sounds: Sounds,
        *,
        rate_hz: float,
        folder: Path,
        clock: SessionClock,
        check: Check | None = None,
    ) -> None:
        self._rig, self._rate_hz, self._folder, self._clock = rig, rate_hz, folder, clock
        self._check, self._name = check, ""
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=0.0)
        self._block = np.zeros((BLOCK_FRAMES, rig.n_channels), dtype=np.float32)
        self._blocks: list[Frames] = []
        self._cue: Cue | None = None
        self._begin_s = self._requested_s = self.lead_s = 0.0
        self._first_frame = 0

    @property
    def identity(self) -> Mapping[str, Any]:
        """The rig, with files in place of its device."""
        return {
            "rig": identify(self._rig),
            "device": FILE_DEVICE,
            "rate_hz": self._rate_hz,
            "channels": self._rig.n_channels,
        }

    def start(
        self, stimulus: Stimulus | Tone | Scaled, *, gap_s: float, goes_on: bool = False
    ) -> None:
        """Begin a playback."""
        scale = stimulus.scale if isinstance(stimulus, Tone | Scaled) else 1.0
        self._name = stimulus.stimulus_id
        self._cue = self._mixer.start(
            self._name, gap_s=gap_s, scale=scale, goes_on=goes_on, lead_s=self.lead_s
        )
        self._blocks = []
        self._begin_s, self._first_frame = self._clock(), self._mixer.frame
        self._requested_s = self._begin_s + gap_s

    @property
    def is_playing(self) -> bool:
        """Whether the playback is not over yet; fills the blocks that a device would have played by now."""
        while self._mixer.is_playing:
            filled = self._mixer.frame - self._first_frame
            if (self._clock() - self._begin_s) * self._rate_hz - filled < BLOCK_FRAMES:
                return True
            self._fill()
        return False

    def stop(self) -> None:
        """End the playback with the next block."""
        if self.is_playing:
            self._mixer.stop()
            self._fill()

    def collect(self) -> Playback:
        """Write the file of the playback, and report what became of it."""
        cue = self._cue
        if cue is None or not cue.is_over:
            raise ValueError("no playback is over; start one and wait until is_playing is False")
        sent_s = self._begin_s + (cue.onset_frame - self._first_frame) / self._rate_hz
        error, sha256, measured = "", "", _measure_place(cue)
        try:
            samples = np.concatenate(self._blocks).T
            number, sha256 = write_delivered(self._folder, samples, rate_hz=self._rate_hz)
            measured["file_number"] = float(number)
        except OSError as problem:
            error = str(problem)
        return Playback(
            requested_s=self._requested_s,
            onset_s=sent_s + cue.lead_frames / self._rate_hz if cue.n_played else None,
            clipped=cue.clipped,
            completed=cue.is_complete,
            error=error,
            measured=measured,
            delivered=_describe(self._check, self._name, cue, measured=None),
            delivered_sha256=sha256,
        )

    def _fill(self) -> None:
        self._mixer.fill(self._block)
        self._blocks.append(self._block.copy())


# Through a device.

OPENING_S = 5.0  # beyond its pre-roll; sound servers usually take two seconds to run a stream
N_OPENINGS = 3  # attempts: a busy sound server may let a first stream stand; a later one runs
WAKING_S = 1.0  # until a stream asks for a block that nobody looked at and that was silent for long
REVIVING_S = 8.0  # longest wait of a start for a dead device; it may well come back later
BEYOND_S = 5.0  # longest recording of the sensor beyond the stimulus; two latencies of 2 s fit in


class Connection:
    """The connection to a rig's device: opened until it runs steadily, and opened again if the device dies."""

    def __init__(
        self,
        rig: Rig,
        *,
        rate_hz: float,
        fill: portaudio.Fill,
        reset: Callable[[], None],
        preroll_s: float,
    ) -> None:
        self.stream: portaudio.DeviceStream | SimulatedStream | None = None
        self._rig, self._rate_hz, self._fill, self._reset = rig, rate_hz, fill, reset
        self._preroll_s = preroll_s
        self._n_frames = 0
        self._opening: Thread | None = None
        self._error = ""

    def open(self) -> None:
        """Find the device, open it, and wait until it runs steadily."""
        is_simulated = self._rig.device.name == SIMULATED_DEVICE
        device, source = (
            (SIMULATED, SIMULATED) if is_simulated else portaudio.find_devices(self._rig)
        )
        if not any(self._begin(device, source) for _ in range(N_OPENINGS)):
            raise OSError(f"device {device.name!r} does not run; is it in use elsewhere?")

    def revive(self) -> str:
        """Open the device again if it does not run; returns what went wrong."""
        if self._opening is None and self.stream is not None and self._runs(self.stream):
            return ""
        if self._opening is None:
            # Looking for devices can hang as long as a sound server does; the session must not.
            self._opening = Thread(target=self._reopen, daemon=True)
            self._opening.start()
        if not portaudio.join(self._opening, patience_s=REVIVING_S):
            return f"device {self._rig.device.name!r} does not answer; check it, then resume"
        self._opening = None
        return self._error

    def close(self) -> None:
        """Silence the device and let it go."""
        if self.stream is not None:
            self.stream.close()
        self.stream = None

    def _begin(self, device: portaudio.Device, source: portaudio.Device) -> bool:
        self._n_frames = 0
        self._reset()
        if device is SIMULATED:
            self.stream = SimulatedStream(self._rig, rate_hz=self._rate_hz, fill=self._count)
        else:
            self.stream = portaudio.DeviceStream(
                device, self._rig, rate_hz=self._rate_hz, fill=self._count, source=source
            )
        patience = portaudio.Patience()
        while self._n_frames < self._preroll_s * self._rate_hz:
            if not self.stream.is_active or patience.look() > OPENING_S + self._preroll_s:
                self.close()
                return False
            sleep(0.005)
        return True

    @staticmethod
    def _runs(stream: portaudio.DeviceStream | SimulatedStream) -> bool:
        patience = portaudio.Patience()
        while not stream.find_fault():
            if not stream.is_silent:
                return True
            if patience.look() > WAKING_S:
                return False
            sleep(0.005)
        return False

    def _reopen(self) -> None:
        self._error = ""
        self.close()
        try:
            portaudio.refresh_devices()
            self.open()
        except OSError as problem:
            self._error = str(problem)

    def _count(self, out: Frames, block: BlockTimes, sensed: Frames | None) -> None:
        self._fill(out, block, sensed)
        self._n_frames += len(out)


class StreamOutput:
    """Plays stimuli, shape (n_samples, channels), through one running stream; `open_stream` opens and closes it."""

    def __init__(
        self,
        rig: Rig,
        sounds: Sounds,
        *,
        rate_hz: float,
        folder: Path,
        clock: SessionClock,
        check: Check | None = None,
    ) -> None:
        self._rig, self._rate_hz, self._folder, self._clock = rig, rate_hz, folder, clock
        self._check, self._name = check, ""
        preroll_s = PREROLL_S + 2 * rig.device.latency_s
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=preroll_s)
        self._connection = Connection(
            rig, rate_hz=rate_hz, fill=self._fill, reset=self._mixer.reset, preroll_s=preroll_s
        )
        longest = max((len(sound) for sound in sounds.values()), default=0)
        self._room: Frames | None = None
        if rig.sensor is not None:
            n_room, n_axes = longest + round(BEYOND_S * rate_hz), len(rig.sensor.inputs)
            self._room = np.zeros((n_room, n_axes), dtype=np.float32)
        self._take: Take | None = None
        self._requested_s = self.lead_s = 0.0
        self._clock_ahead_s = 0.0
        self._stopped_s: float | None = None
        self._latency_s = rig.device.latency_s
        self._error = ""

    @property
    def identity(self) -> Mapping[str, Any]:
        """Rig, device, host API, rate and channels."""
        stream = self._connection.stream
        return {
            "rig": identify(self._rig),
            "device": stream.device.name if stream else self._rig.device.name,
            "host_api": stream.device.host_api if stream else self._rig.device.host_api,
            "is_program": stream.device.is_program if stream else None,
            "rate_hz": self._rate_hz,
            "channels": self._rig.n_channels,
        }

    def open(self) -> None:
        """Open the device, and wait until it runs steadily."""
        self._connection.open()

    def close(self) -> None:
        """Silence the device and let it go."""
        self._connection.close()

    def start(
        self, stimulus: Stimulus | Tone | Scaled | str, *, gap_s: float, goes_on: bool = False
    ) -> None:
        """Schedule silence, then a stimulus; a dead device is opened again first, if it can be."""
        self._name = name = stimulus if isinstance(stimulus, str) else stimulus.stimulus_id
        self._error = self._connection.revive()
        stream = self._connection.stream
        self._requested_s = self._clock() + gap_s
        self._take = self._stopped_s = None
        if self._error or stream is None:
            return
        self._latency_s = stream.latency_s
        take = Take(self._rate_hz, stream.there_and_back_s, sensor=self._room)
        self._take = take  # before the mixer knows, so that no block is missed
        scale = stimulus.scale if isinstance(stimulus, Tone | Scaled) else 1.0
        take.cue = self._mixer.start(
            name, gap_s=gap_s, scale=scale, goes_on=goes_on, lead_s=self.lead_s
        )
        ahead_s = stream.compare_clocks(self._clock)
        self._clock_ahead_s = self._clock_ahead_s if isnan(ahead_s) else ahead_s

    @property
    def is_playing(self) -> bool:
        """Whether part of the stimulus, or of its gap, has not yet left the converter of a device that is alive."""
        stream = self._connection.stream
        if self._take is None or self._take.is_out or stream is None:
            return False
        if reason := stream.find_fault():
            self._error = f"device {stream.device.name!r} {reason}"
            self._mixer.stop()
        return not self._error

    def stop(self) -> None:
        """Fall silent with the next block that the device asks for.

        What it holds, it still plays: `latency_s` of rig.toml and a block. To throw that away would be a knock on the
        skin, a click in the ears, and a device that begins anew. `stop_s` in the playback is how long it took.
        """
        self._stopped_s = self._stopped_s or self._clock()
        self._mixer.stop()

    def collect(self) -> Playback:
        """Report what became of the playback."""
        if self.is_playing and self._stopped_s is None:
            raise ValueError("the playback still plays; stop it, or wait until is_playing is False")
        take, ahead_s = self._take, self._clock_ahead_s
        if take is None or take.cue is None:
            return Playback(
                self._requested_s, None, completed=False, error=self._error or "nothing was started"
            )
        cue, onset_s = take.cue, None
        measured = {**_measure_place(cue), **self._measure_times(take, cue)}
        if take.onset_s is not None:
            onset_s = take.onset_s + ahead_s + cue.lead_frames / self._rate_hz
        sensed, sha256 = self._scale_sensed(take), ""
        try:
            if sensed is not None:
                number, sha256 = write_delivered(self._folder, sensed, rate_hz=self._rate_hz)
                measured |= self._describe_sensed(take, number)
        except OSError as problem:
            self._error = self._error or str(problem)
        is_whole = take.is_out and not take.n_underruns and not take.n_sensor_gaps
        return Playback(
            requested_s=self._requested_s,
            onset_s=onset_s,
            underruns=take.n_underruns,
            clipped=cue.clipped,
            completed=cue.is_complete and take.is_out,
            error=self._error,
            measured=measured | {"latency_s": self._latency_s},
            dac_source=take.dac_source,
            delivered=_describe(self._check, self._name, cue, measured=sensed) if is_whole else {},
            delivered_sha256=sha256,
        )

    def _measure_times(self, take: Take, cue: Cue) -> dict[str, float]:
        """Measure blocks, and times of the device: onset, and how long a stop took."""
        ahead_s = self._clock_ahead_s
        measured = {"blocks": float(take.n_blocks), "callback_ms_max": take.longest_s * 1e3}
        if take.onset_s is not None:
            measured["dac_time_s"] = take.onset_s
        was_cut = 0 < cue.n_played < len(cue.sound)
        if self._stopped_s is not None and take.end_s is not None and was_cut:
            measured["stop_s"] = take.end_s + ahead_s - self._stopped_s
        return measured

    def _scale_sensed(self, take: Take) -> Samples | None:
        """Scale what the sensor measured to m/s², (axes, n), from the frame on in which the onset was sent.

        So recordings of one session are aligned to the sample: the onset stands at the same sample in all of them,
        which is the way there and back and is measured by doctor. They are not cut there by the times that the device
        gives of its input, which can be wrong by much more (10 ms and, at a stream's begin, 0.4 s were seen).
        """
        if self._rig.sensor is None or not len(take.sensed):
            return None
        return np.asarray(take.sensed.T * np.float32(self._rig.sensor.full_scale_m_s2))

    def _describe_sensed(self, take: Take, number: int) -> dict[str, float]:
        return {
            "file_number": float(number),
            "sensor_onset_sample": float(round(take.sensor_latency_s * self._rate_hz)),
            "sensor_gaps": float(take.n_sensor_gaps),
        }

    def _fill(self, out: Frames, block: BlockTimes, sensed: Frames | None) -> None:
        """Fill a block that the device asks for, in the device's own thread."""
        begin_s, take, frame = perf_counter(), self._take, self._mixer.frame
        self._mixer.fill(out)
        if take is None or take.is_out:
            return
        take.add_block(block, frame=frame)
        if sensed is not None:
            take.record(sensed, frame=frame)
        take.longest_s = max(take.longest_s, perf_counter() - begin_s)


def _measure_place(cue: Cue) -> dict[str, float]:
    """Count the samples that were played, and, where they are not from its first on, those left out before."""
    before = {"first_sample": float(cue.first_frame)} if cue.first_frame else {}
    return {"n_samples": float(cue.n_played), **before}


def _describe(
    check: Check | None, stimulus_id: str, cue: Cue, *, measured: ArrayLike | None
) -> Mapping[str, float]:
    """Compare a playback that came to its end with what was asked, unless its level is not the set's."""
    if check is None or not cue.is_complete or cue.scale != 1:
        return {}
    return check.describe(stimulus_id, cue.sound, measured)


@contextmanager
def open_stream(
    rig: Rig,
    sounds: Sounds,
    *,
    rate_hz: float,
    folder: Path,
    clock: SessionClock,
    check: Check | None = None,
) -> Iterator[StreamOutput]:
    """Open the device of a rig, and silence and close it whatever happens."""
    output = StreamOutput(rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock, check=check)
    try:
        output.open()
        yield output
    finally:
        output.close()
