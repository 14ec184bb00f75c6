"""Measurements with the rig: sounds through the stream of sessions, and what the sensor records of them."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

from feel321.files import temporary_folder
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import StreamOutput, open_stream
from feel321.study.actuator.rig import Rig
from feel321.types import Samples

OnStep = Callable[[int, int], None]

N_TRIES = 4  # of a playback in which the device ran dry
CLIPPED = 0.999  # of the sensor's full scale


class SweepStopped(Exception):  # noqa: N818 - nothing went wrong
    """A key was pressed; the coils are silent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What all coils of a calibration share; sounds: of the open output, to which more are added."""

    rig: Rig
    rate_hz: float
    output: StreamOutput
    sounds: dict[str, Frames]
    folder: Path
    advance: Callable[[float], None]
    is_stopping: Callable[[], bool]

    def play(self, samples: Samples, channel: int) -> Samples:
        """Play samples, shape (n,), on a channel, and return what the sensor measured, shape (axes, n) in m/s²."""
        return self.play_all({channel: samples}, n=len(samples))

    def play_all(self, samples: Mapping[int, Samples], *, n: int) -> Samples:
        """Play samples, shape (n,), on several channels at once, and return what the sensor measured."""
        sound = np.zeros((n, self.rig.n_channels), dtype=np.float32)
        for channel, own in samples.items():
            sound[:, channel - 1] = own
        self.sounds[""] = sound
        for _ in range(N_TRIES):
            if (recorded := self._play_once(n)) is not None:
                self.advance(n / self.rate_hz)
                return recorded
        raise OSError(
            f"device {self.rig.device.name!r} ran dry {N_TRIES} times in a row; close other programs, or raise "
            "latency_s in rig.toml"
        )

    def _play_once(self, n: int) -> Samples | None:
        """Return what was recorded, or None if the device ran dry meanwhile."""
        self.output.start("", gap_s=0.05)
        while self.output.is_playing:
            if self.is_stopping():
                self.output.stop()
                raise SweepStopped
            sleep(0.002)
        playback = self.output.collect()
        if playback.error or "file_number" not in playback.measured:
            raise OSError(playback.error or "the sensor's input gave no samples; check its device")
        if playback.underruns or playback.measured["sensor_gaps"] or not playback.completed:
            return None
        path = self.folder / f"{round(playback.measured['file_number']):04}.wav"
        recorded = np.atleast_2d(read_wav(path)[0])[:, :n]
        path.unlink()
        return self._check(recorded, n=n, clipped=playback.clipped)

    def _check(self, recorded: Samples, *, n: int, clipped: int) -> Samples:
        if clipped:
            raise ValueError(
                f"the rig's limits cut {clipped} samples; lower level under [calibration], or sweep_s below duration_s"
            )
        if recorded.shape[1] < n:
            raise OSError(
                f"the sensor's input gave {recorded.shape[1]} samples of {n}; check its device"
            )
        full_scale = self.rig.sensor.full_scale_m_s2 if self.rig.sensor else math.inf
        if np.abs(recorded).max() >= CLIPPED * full_scale:
            raise ValueError(
                f"the sensor's input is clipped (full scale is {full_scale:g} m/s²); lower its gain and raise "
                "full_scale_m_s2 under [sensor] with it, or lower level under [calibration]"
            )
        return recorded


@contextmanager
def open_session(
    rig: Rig,
    *,
    rate_hz: float,
    n_longest: int,
    advance: Callable[[float], None] = lambda _: None,
    is_stopping: Callable[[], bool] = lambda: False,
) -> Iterator[Session]:
    """Open the stream; n_longest: samples of the longest sound, which decides how much can be recorded."""
    sounds: dict[str, Frames] = {"": np.zeros((n_longest, rig.n_channels), dtype=np.float32)}
    with (
        temporary_folder() as folder,
        open_stream(rig, sounds, rate_hz=rate_hz, folder=folder, clock=perf_counter) as output,
    ):
        yield Session(
            rig=rig,
            rate_hz=rate_hz,
            output=output,
            sounds=sounds,
            folder=folder,
            advance=advance,
            is_stopping=is_stopping,
        )
