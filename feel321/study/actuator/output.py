"""The output of a session: plays a stimulus, stops it, and reports what was delivered. Times are on its clock, in s.

A rig plays through one sink that runs for the whole session, and is opened again after a failure. A device that runs
dry, stands still or disappears is reported in the playback, not raised.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from threading import Thread
from time import perf_counter, sleep
from typing import Any, Protocol

import numpy as np

from feel321.files import make_folder, write_bytes
from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.wav import encode_wav
from feel321.study.actuator import device as devices
from feel321.study.actuator.device import BlockTimes, FileSink, SessionClock, Sink
from feel321.study.actuator.mixer import PREROLL_S, Cue, Frames, Mixer, Sounds
from feel321.study.actuator.response import Sweep, find_slip
from feel321.study.actuator.rig import Rig, advise_latency, identify, require_sensor
from feel321.study.folder import name_delivered
from feel321.study.session.ports import Playback, Scaled, Tone
from feel321.types import Samples

SENSOR_TAIL_S = 0.05  # the sensor is recorded longer than the vibration: an actuator rings on


@dataclass(slots=True, kw_only=True)
class Take(Cue):
    """One playback as the sink sees it, block by block; the callback writes it, the session reads it once it is out.

    latency_s: of the sink, there and back; sensor: room for what a sensor measures, shape (n, axes), if there is one.
    held_s: what the sink still has to play; dry_frames: first frames of the blocks before which it had run dry.
    """

    rate_hz: float
    latency_s: float
    held_s: float = 0.0
    sensor: Frames | None = None
    onset_s: float | None = None
    dac_source: str = ""
    end_s: float | None = None
    is_out: bool = False
    dry_frames: list[int] = field(default_factory=list)
    n_sensor_gaps: int = 0
    longest_s: float = 0.0
    n_sensed: int = 0
    end_frame: int = 0

    def add_block(self, block: BlockTimes, *, frame: int) -> None:
        """Take account of a block that the mixer has filled."""
        if block.has_run_dry:
            self.dry_frames.append(frame)
        self.n_sensor_gaps += block.has_lost_input
        if self.onset_s is None and self.n_played:
            self.onset_s = block.dac_s + (self.onset_frame - frame) / self.rate_hz
            self.dac_source = block.dac_source
        if self.end_s is None and self.is_over:
            self.end_frame = self.onset_frame + self.n_played if self.n_played else frame
            self.end_s = block.dac_s + (self.end_frame - frame) / self.rate_hz
        if self.end_s is None:
            return
        n_since = frame - self.end_frame
        # Some host interfaces give no times: then the sink's own latency counts, twice to be safe.
        is_heard = block.now_s >= self.end_s or n_since >= round(2 * self.latency_s * self.rate_hz)
        # Times of inputs are less true than those of outputs, so the sensor is recorded by frames.
        n_sensed = round((self.latency_s + SENSOR_TAIL_S) * self.rate_hz)
        self.is_out = is_heard and (self.sensor is None or n_since >= n_sensed)

    def find_underruns(self) -> list[int]:
        """List the samples of the stimulus at which the sink ran dry, and may have dropped what it held."""
        last = self.n_played and self.n_played + round(self.held_s * self.rate_hz)
        places = (frame - self.onset_frame for frame in self.dry_frames)
        return [min(at, self.n_played) for at in places if 0 < at < last]

    def record(self, samples: Frames, *, frame: int) -> None:
        """Keep what the sensor measured, shape (n, axes), since the onset's frame went out; it comes back later."""
        if self.sensor is None or self.onset_s is None:
            return
        first = max(self.onset_frame - frame, 0)
        piece = samples[first : first + len(self.sensor) - self.n_sensed]
        self.sensor[self.n_sensed : self.n_sensed + len(piece)] = piece
        self.n_sensed += len(piece)


OPENING_S = 5.0  # beyond its pre-roll; sound servers usually take two seconds to run a stream
N_OPENINGS = 3  # attempts: a busy sound server may let a first stream stand; a later one runs
REVIVING_S = 8.0  # longest wait of a start for a dead device; it may well come back later
BEYOND_S = 5.0  # longest recording of the sensor beyond the stimulus; two latencies of 2 s fit in
LOOK_S = 0.005  # between two looks at a sink that is waited for
# Sinks by the name of the device; every other name is an audio device's.
SINKS: Mapping[str, type[Sink]] = {one.name: one for one in (FileSink, devices.SimulatedStream)}


class _Check(Protocol):  # `DeliveryCheck`, which knows the stimuli
    def diagnose(
        self, sent: Frames, sensed: Frames | None, *, keeps_latency: bool
    ) -> tuple[str, str]: ...

    def describe(self, stimulus_id: str, sensed: Frames | None) -> dict[str, float]: ...


class Output:
    """Plays sounds, shape (n_samples, channels), one at a time; `open_output` opens and closes it.

    lead_s: by how much the filters of a certificate let samples go out before the vibration that they make: an onset is
    that of the vibration. captured: what was recorded of the last playback, (axes, n) in m/s² by a sensor, (channels,
    n) for a file; it is written to the folder under the next free number, as a name would tell what was played.
    identity: for the journal's header.
    """

    def __init__(
        self,
        rig: Rig,
        sounds: Sounds,
        *,
        rate_hz: float,
        clock: SessionClock,
        folder: Path | None = None,
        check: _Check | None = None,
    ) -> None:
        self._rig, self._rate_hz, self._folder, self._clock = rig, rate_hz, folder, clock
        self._check, self._name, self.identity = check, "", dict[str, Any]()
        self._make_sink = SINKS.get(rig.device.name, devices.DeviceStream)
        self._preroll_s, room = PREROLL_S + 2 * rig.device.latency_s, None
        if self._make_sink is FileSink:
            self._preroll_s = 0.0
        elif rig.sensor is not None:
            longest = max(map(len, sounds.values()), default=0) + round(BEYOND_S * rate_hz)
            room = np.zeros((longest, len(rig.sensor.channels)), dtype=np.float32)
        self._room = room
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=self._preroll_s)
        self._sink: Sink | None = None
        self._n_frames = self._n_dry = 0
        self._n_dry_before = -1  # a stream that was opened anew has not the certificate's latency
        self._opening: Thread | None = None
        self._opening_error = self._error = ""
        self._take: Take | None = None
        self._requested_s = self._clock_ahead_s = self.lead_s = 0.0
        self._stopped_s: float | None = None
        self.captured: Frames | None = None

    def open(self) -> None:
        """Open the sink, and wait until it runs steadily."""
        rig, rate_hz = self._rig, self._rate_hz
        n_wanted = self._preroll_s * rate_hz
        for _ in range(N_OPENINGS):
            self._n_frames = 0
            self._mixer.reset()
            sink = self._make_sink(rig, rate_hz=rate_hz, fill=self._fill, clock=self._clock)
            self._sink = sink
            for _ in range(round((OPENING_S + self._preroll_s) / LOOK_S)):
                if self._n_frames >= n_wanted:
                    own = {"rate_hz": rate_hz, "channels": rig.n_channels}
                    self.identity = {"rig": identify(rig), **sink.identity, **own}
                    return
                sleep(LOOK_S)
            self.close()
        raise OSError(f"device {sink.name!r} does not run; is it in use elsewhere?")

    def close(self) -> None:
        """Silence the sink and let it go."""
        if self._sink is not None:
            self._sink.close()
        self._sink = None

    def start(
        self, stimulus: Stimulus | Tone | Scaled | str, *, gap_s: float, goes_on: bool = False
    ) -> None:
        """Schedule silence, then a stimulus, and return at once; goes_on: where the last one was stopped."""
        self._name = stimulus if isinstance(stimulus, str) else stimulus.stimulus_id
        self._error = self._revive()
        sink = self._sink
        self._requested_s = self._clock() + gap_s
        self._take = self._stopped_s = self.captured = None
        if self._error or sink is None:
            return
        if isinstance(sink, FileSink):
            sink.begin()
        scale = stimulus.scale if isinstance(stimulus, Tone | Scaled) else 1.0
        self._take = take = Take(  # before the mixer knows, so that no block is missed
            rate_hz=self._rate_hz,
            latency_s=sink.there_and_back_s,
            held_s=sink.latency_s,
            sensor=self._room,
        )
        self._mixer.start(
            self._name, gap_s=gap_s, scale=scale, goes_on=goes_on, lead_s=self.lead_s, cue=take
        )
        ahead_s = sink.compare_clocks()
        self._clock_ahead_s = self._clock_ahead_s if isnan(ahead_s) else ahead_s

    @property
    def is_playing(self) -> bool:
        """Whether part of the stimulus, or of its silence, has not yet left a sink that is alive."""
        take, sink = self._take, self._sink
        if take is None or sink is None:
            return False
        while isinstance(sink, FileSink) and not take.is_out and sink.serve_due():
            continue
        if take.is_out:
            return False
        if reason := sink.find_fault():
            self._error = f"device {sink.name!r} {reason}"
            self._mixer.stop()
        return not self._error

    def stop(self) -> None:
        """Fall silent with the next block; to cut off what a device still holds would be a knock on the skin."""
        self._stopped_s = self._stopped_s or self._clock()
        self._mixer.stop()

    def collect(self) -> Playback:
        """Report what became of the stimulus that was started last, once it no longer plays."""
        if self.is_playing and self._stopped_s is None:
            raise ValueError("the playback still plays; stop it, or wait until is_playing is False")
        take = self._take
        if take is None:
            error = self._error or "nothing was started"
            return Playback(self._requested_s, None, completed=False, error=error)
        self.captured = self._capture(take)
        underruns, is_completed = take.find_underruns(), take.is_complete and take.is_out
        measured, sha256, fault, notice = self._measure(take, underruns), "", "", ""
        if self.captured is not None and self._folder is not None:
            try:
                number, sha256 = self._write_numbered(self._folder, self.captured)
                measured["file_number"] = float(number)
            except OSError as problem:
                self._error = self._error or str(problem)
        delivered = dict[str, float]()
        if self._check and is_completed and not underruns and not take.n_sensor_gaps:
            sensed = None if self._room is None else self.captured
            is_steady, self._n_dry_before = self._n_dry == self._n_dry_before, self._n_dry
            fault, notice = self._check.diagnose(take.sound, sensed, keeps_latency=is_steady)
            # At another level than the set's nothing is promised.
            delivered = self._check.describe(self._name, sensed) if take.scale == 1 else {}
        onset_s, lead_s = take.onset_s, take.lead_frames / self._rate_hz
        if onset_s is not None:
            onset_s = onset_s + self._clock_ahead_s + lead_s
        return Playback(
            requested_s=self._requested_s,
            onset_s=onset_s,
            underruns=len(underruns),
            clipped=take.clipped,
            completed=is_completed,
            error=self._error,
            measured=measured,
            dac_source=take.dac_source,
            delivered=delivered,
            delivered_sha256=sha256,
            fault=fault,
            notice=notice,
        )

    def _capture(self, take: Take) -> Frames | None:
        """Take what was recorded: by a file from the start on, by a sensor from the onset's frame."""
        # Times that devices give of their input were seen to be wrong by 10 ms, at a stream's begin by 0.4 s.
        if isinstance(self._sink, FileSink):
            return np.concatenate(self._sink.blocks).T
        if self._rig.sensor is None or take.sensor is None or not take.n_sensed:
            return None
        scale = np.float32(self._rig.sensor.full_scale_m_s2)
        return np.asarray(take.sensor[: take.n_sensed].T * scale)

    def _write_numbered(self, folder: Path, samples: Frames) -> tuple[int, str]:
        """Write samples to a WAV file with the next free number; returns that and the file's digest."""
        make_folder(folder, private=True)
        numbers = [int(path.stem) for path in folder.glob("*.wav") if path.stem.isdecimal()]
        number, content = max(numbers, default=0) + 1, encode_wav(samples, self._rate_hz)
        write_bytes(folder / name_delivered(number), content, private=True)
        return number, hashlib.sha256(content).hexdigest()

    def _measure(self, take: Take, underruns: list[int]) -> dict[str, float]:
        own: dict[str, float | None] = {"n_samples": take.n_played}
        own["first_sample"] = take.first_frame or None
        if self._make_sink is not FileSink:
            own |= {
                "callback_ms_max": take.longest_s * 1e3,
                "latency_s": take.held_s,
                "gap_underruns": len(take.dry_frames) - len(underruns) or None,
                "underrun_sample": underruns[0] if underruns else None,
                "dac_time_s": take.onset_s,
                "sensor_gaps": None if self.captured is None else take.n_sensor_gaps,
            }
            was_cut = 0 < take.n_played < len(take.sound)
            if self._stopped_s is not None and take.end_s is not None and was_cut:
                own["stop_s"] = take.end_s + self._clock_ahead_s - self._stopped_s
        return {name: float(value) for name, value in own.items() if value is not None}

    def _fill(self, out: Frames, block: BlockTimes, sensed: Frames | None) -> None:
        """Fill a block that the sink asks for, in its own thread."""
        begin_s, take, frame = perf_counter(), self._take, self._mixer.frame
        self._mixer.fill(out)
        self._n_frames += len(out)
        self._n_dry += block.has_run_dry
        if take is None or take.is_out:
            return
        take.add_block(block, frame=frame)
        if sensed is not None:
            take.record(sensed, frame=frame)
        take.longest_s = max(take.longest_s, perf_counter() - begin_s)

    def _revive(self) -> str:
        """Open the sink again if it does not run; returns what went wrong."""
        if self._opening is None:
            if self._sink is not None and not self._sink.find_fault():
                return ""
            # Looking for devices can hang as long as a sound server does; the session must not.
            self._opening = Thread(target=self._reopen, daemon=True)
            self._opening.start()
        if not devices.join(self._opening, patience_s=REVIVING_S):
            return f"device {self._rig.device.name!r} does not answer; check it, then resume"
        self._opening = None
        return self._opening_error

    def _reopen(self) -> None:
        self._opening_error = ""
        self._n_dry += 1
        self.close()
        try:
            if self._make_sink is devices.DeviceStream:
                devices.refresh_devices()
            self.open()
        except OSError as problem:
            self._opening_error = str(problem)


@contextmanager
def open_output(rig: Rig, sounds: Sounds, **choices: Any) -> Iterator[Output]:  # noqa: ANN401 - as of `Output`
    """Open what a rig plays on, and silence and close it whatever happens."""
    output = Output(rig, sounds, **choices)
    try:
        output.open()
        yield output
    finally:
        output.close()


# A bench for measurements: sounds through the output that sessions use, and what the sensor records of them.

OnStep = Callable[[int, int], None]
N_TRIES = 4  # of a playback in which the device ran dry, or samples were lost
CLIPPED = 0.999  # of the sensor's full scale


@dataclass(slots=True, kw_only=True)
class Bench:
    """An open output, and what the measurements on it share; sounds: those that it plays, to which more are added."""

    rig: Rig
    rate_hz: float
    output: Output
    sounds: dict[str, Frames]
    total_s: float = 0.0
    on_step: OnStep = lambda _done, _total: None
    done_s: float = 0.0

    def play(self, samples: Mapping[int, Samples], *, n: int) -> Samples:
        """Play samples by channel, shape (n,), and return what the sensor measured, shape (3, n) in m/s²."""
        sound = np.zeros((n, self.rig.n_channels), dtype=np.float32)
        for channel, own in samples.items():
            sound[:, channel - 1] = own
        self.sounds[""] = sound
        for _ in range(N_TRIES):
            self.output.start("", gap_s=0.05)
            while self.output.is_playing:
                sleep(0.002)
            played, recorded = self.output.collect(), self.output.captured
            if played.error or recorded is None or recorded.shape[1] < n:
                raise OSError(played.error or "the sensor's input gave too few samples; check it")
            if played.completed and not played.underruns + played.measured["sensor_gaps"]:
                break
        else:
            raise OSError(
                f"device {self.rig.device.name!r} ran dry {N_TRIES} times in a row; close other programs, or "
                f"{advise_latency(self.rig)}"
            )
        if played.clipped:
            raise ValueError(
                f"the rig's limits cut {played.clipped} samples; lower level under [calibration], or sweep_s below "
                "duration_s"
            )
        full_scale = require_sensor(self.rig).full_scale_m_s2
        if np.abs(recorded[:, :n]).max() >= CLIPPED * full_scale:
            raise ValueError(
                f"the sensor's input is clipped (full scale is {full_scale:g} m/s²); lower its gain and raise "
                "full_scale_m_s2 under [sensor] with it, or lower level under [calibration]"
            )
        self.done_s += n / self.rate_hz
        self.on_step(round(self.done_s), round(self.total_s))
        return recorded[:, :n].astype(np.float64)

    def play_sweep(self, sent: Samples, sweep: Sweep, channel: int) -> Samples:
        """Play sweeps, shape (n,), until their recordings are in step."""
        return self.insist({channel: sent}, lambda got: find_slip(got, sweep))

    def insist(self, samples: Mapping[int, Samples], slip_of: Callable[[Samples], int]) -> Samples:
        """Play until nothing has slipped, a few times: a sound server may drop samples without saying so."""
        n = max(map(len, samples.values()))
        for _ in range(N_TRIES):
            recorded = self.play(samples, n=n)
            if not (slip := slip_of(recorded)):
                return recorded
        raise OSError(
            f"the recordings of equal sweeps are {slip} samples out of step, {N_TRIES} times in a row: samples are "
            "lost between output and sensor, or the sensor's device has a clock of its own; put both on one sound "
            f"card, named itself, {advise_latency(self.rig)}, or lower sweep_s and repeats under [calibration]"
        )


@contextmanager
def open_bench(rig: Rig, *, rate_hz: float, n_longest: int, **choices: Any) -> Iterator[Bench]:  # noqa: ANN401 - fields of a bench
    """Open the output; n_longest: samples of the longest sound, by which room is made to record it."""
    sounds: dict[str, Frames] = {"": np.zeros((n_longest, rig.n_channels), dtype=np.float32)}
    with open_output(rig, sounds, rate_hz=rate_hz, clock=perf_counter) as output:
        yield Bench(rig=rig, rate_hz=rate_hz, output=output, sounds=sounds, **choices)
