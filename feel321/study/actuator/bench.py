"""A bench for measurements: sounds through the output that sessions use, and what the sensor records of them."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter, sleep

import numpy as np
from scipy import fft

from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import Output, open_output
from feel321.study.actuator.response import TINY, Band, Sweep, find_inside
from feel321.study.actuator.rig import Rig, require_sensor
from feel321.types import Samples

OnStep = Callable[[int, int], None]

N_TRIES = 4  # of a playback in which the device ran dry, or samples were lost
CLIPPED = 0.999  # of the sensor's full scale
ALIVE = 0.8  # least median coherence of a coil that moves at all; of two sweeps of noise it is 0.5
IN_STEP = 2  # samples by which noise may shift what is in step
MOST_TURNED = 0.3  # rad by which a third octave of equal sweeps may differ
CLEAR = 10.0  # least height of a correlation's peak over its standard deviation


class SweepStopped(Exception):  # noqa: N818 - nothing went wrong
    """A key was pressed; the coils are silent."""


@dataclass(slots=True, kw_only=True)
class Bench:
    """An open output, and what the measurements on it share; sounds: those that it plays, to which more are added."""

    rig: Rig
    rate_hz: float
    output: Output
    sounds: dict[str, Frames]
    total_s: float
    on_step: OnStep | None
    is_stopping: Callable[[], bool]
    done_s: float = 0.0

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
            self.output.start("", gap_s=0.05)
            while self.output.is_playing:
                if self.is_stopping():
                    self.output.stop()
                    raise SweepStopped
                sleep(0.002)
            playback, recorded = self.output.collect(), self.output.captured
            if playback.error or recorded is None:
                raise OSError(
                    playback.error or "the sensor's input gave no samples; check its device"
                )
            n_lost = playback.underruns + playback.measured["sensor_gaps"]
            if playback.completed and not n_lost:
                break
        else:
            raise OSError(
                f"device {self.rig.device.name!r} ran dry {N_TRIES} times in a row; close other programs, or raise "
                "latency_s in rig.toml"
            )
        self._check(recorded, n=n, clipped=playback.clipped)
        self.done_s += n / self.rate_hz
        if self.on_step is not None:
            self.on_step(round(self.done_s), round(self.total_s))
        return recorded[:, :n].astype(np.float64)

    def _check(self, recorded: Frames, *, n: int, clipped: int) -> None:
        if clipped:
            raise ValueError(
                f"the rig's limits cut {clipped} samples; lower level under [calibration], or sweep_s below duration_s"
            )
        if recorded.shape[1] < n:
            raise OSError(
                f"the sensor's input gave {recorded.shape[1]} samples of {n}; check its device"
            )
        full_scale = require_sensor(self.rig).full_scale_m_s2
        if np.abs(recorded[:, :n]).max() >= CLIPPED * full_scale:
            raise ValueError(
                f"the sensor's input is clipped (full scale is {full_scale:g} m/s²); lower its gain and raise "
                "full_scale_m_s2 under [sensor] with it, or lower level under [calibration]"
            )

    def play_sweep(self, sent: Samples, sweep: Sweep, channel: int) -> Samples:
        """Play sweeps, shape (n,), until their recordings are in step."""
        return self.insist(lambda: self.play(sent, channel), lambda found: find_slip(found, sweep))

    def insist(self, play: Callable[[], Samples], slip_of: Callable[[Samples], int]) -> Samples:
        """Play until nothing has slipped, a few times: a sound server may drop samples without saying so."""
        for _ in range(N_TRIES):
            recorded = play()
            if not (slip := slip_of(recorded)):
                return recorded
        raise OSError(
            f"the recordings of equal sweeps are {slip} samples out of step, {N_TRIES} times in a row: samples are "
            "lost between output and sensor, or the sensor's device has a clock of its own; put both on one sound "
            "card, named itself, raise latency_s in rig.toml, or lower sweep_s and repeats under [calibration]"
        )


@contextmanager
def open_bench(
    rig: Rig,
    *,
    rate_hz: float,
    n_longest: int,
    n_all: int = 0,
    on_step: OnStep | None = None,
    is_stopping: Callable[[], bool] = lambda: False,
) -> Iterator[Bench]:
    """Open the output; n_longest: samples of the longest sound, by which room is made to record it; n_all: of all."""
    sounds: dict[str, Frames] = {"": np.zeros((n_longest, rig.n_channels), dtype=np.float32)}
    with open_output(rig, sounds, rate_hz=rate_hz, clock=perf_counter) as output:
        yield Bench(
            rig=rig,
            rate_hz=rate_hz,
            output=output,
            sounds=sounds,
            total_s=n_all / rate_hz,
            on_step=on_step,
            is_stopping=is_stopping,
        )


# Whether samples were lost between equal sweeps.


def find_slip(recorded: Samples, sweep: Sweep) -> int:
    """Find by how many samples later sweeps are out of step with the first one, at most; 0 where noise hides it.

    Over the whole band by correlation with equal weights (Knapp & Carter's phase transform); and by the phase of each
    third octave, because samples may be lost while the sweep passes through it.
    """
    periods = recorded.reshape(len(recorded), sweep.n_repeats, sweep.period)
    spectra = fft.rfft(periods, axis=-1)
    frequency_hz = fft.rfftfreq(sweep.period, 1 / sweep.rate_hz)
    inside = find_inside(frequency_hz, band_hz=sweep.band_hz)
    cross = (spectra[:, 1:] * spectra[:, :1].conj()).sum(axis=0)
    pulses = fft.irfft(inside * cross / np.maximum(np.abs(cross), TINY), sweep.period)
    places = np.argmax(pulses, axis=-1)
    clear = pulses.max(axis=-1) > CLEAR * pulses.std(axis=-1)
    lags = np.where(clear, np.minimum(places, sweep.period - places), 0)
    energy = np.square(np.abs(spectra)).sum(axis=0)
    together, size, middle_hz = (
        average_thirds(one, frequency_hz, band_hz=sweep.band_hz)
        for one in (cross, np.sqrt(energy[1:] * energy[:1]), frequency_hz)
    )
    turned = np.abs(np.angle(together)) * (np.abs(together) > ALIVE * size)
    lost = turned * (turned > MOST_TURNED) / (2 * math.pi * middle_hz) * sweep.rate_hz
    slip = max(int(lags.max()), round(float(lost.max())))
    return slip if slip > IN_STEP else 0


def average_thirds(values: Samples, frequency_hz: Samples, *, band_hz: Band) -> Samples:
    """Average values, shape (..., k), in third octaves of a band; empty ones are left out."""
    low, high = band_hz
    n_bands = max(round(3 * math.log2(high / low)), 1)
    number = np.floor(n_bands * np.log(np.maximum(frequency_hz, 1e-9) / low) / math.log(high / low))
    found = [values[..., number == band] for band in range(n_bands)]
    return np.stack([one.mean(axis=-1) for one in found if one.shape[-1]], axis=-1)
