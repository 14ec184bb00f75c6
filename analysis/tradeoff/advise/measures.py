"""What a scene becomes under a reducer: level, spectrum, time, steadiness, and the paper's two metrics beside them."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.invariant import spectral_match_energy_weighted, temporal_match_invariant
from stimuli.match import temporal_match
from stimuli.perception import felt_level
from stimuli.spectrum import OriginalSpectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from stimuli.recording import Recording
    from stimuli.reduce import Reducer

    Samples = NDArray[np.float64]

NOISE = 1e-3
"""Sensor noise against the recording, in amplitude: -60 dB."""

SILENT_DB = -120.0
"""What stands for silence."""

GAIN_DB = {"soc321": 10 * math.log10(3)}
"""Gain of a fixed sum of axes: the norm of its weights, where that is not 1. See `Measures.deviation_db`."""


@dataclass(frozen=True, slots=True)
class Measures:
    """What a reducer makes of a scene.

    Parameters
    ----------
    level_db : float
        Felt level of the output against the recording's, from 20 to 1000 Hz; -120 stands for silence.
    spectrum : float
        `spectral_match_energy_weighted`.
    time : float
        `temporal_match_invariant`.
    change : float
        Relative change of the output, up to its sign, under sensor noise of -60 dB.
    spectral_match, temporal_match : float
        The paper's metrics, for the mounting as it is; NaN where there are none.
    gain_db : float
        Gain that the reducer applies to what it keeps.
    spectral_match_bounded : float
        As the paper's metrics.
    """

    level_db: float
    spectrum: float
    time: float
    change: float
    spectral_match: float
    temporal_match: float
    gain_db: float = 0.0
    spectral_match_bounded: float = math.nan

    @property
    def deviation_db(self) -> float:
        """How far the level is off, in dB.

        A sum of axes is the projection on the sensor's diagonal, 4.8 dB louder. What it lost on the other axes may be
        made up for by that gain, but then mounting and chance decide, and the spectrum and the moment at which they
        cancel go unseen. So the level must be right with the gain and must not be lost without it.
        """
        return max(abs(self.level_db), self.gain_db - self.level_db)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A scene made ready for many reducers: what all of them are compared with is computed once.

    Parameters
    ----------
    recording : Recording
        The scene's samples.
    disturbed : ndarray, shape (3, n_samples)
        The same with sensor noise of -60 dB.
    level : float
        Felt level of the recording, above 0.
    spectrum : OriginalSpectrum
        Its smoothed spectrum.
    """

    recording: Recording
    disturbed: Samples
    level: float
    spectrum: OriginalSpectrum


def make_trial(recording: Recording, name: str, *, seed: int) -> Trial:
    """Make a scene ready.

    Parameters
    ----------
    recording : Recording
        The scene's samples; not silent from 20 to 1000 Hz.
    name : str
        The scene's name: every scene has noise of its own, whatever others there are.
    seed : int
        Of the noise.

    Returns
    -------
    Trial
        The scene with its noise.
    """
    samples, rate_hz = recording.acceleration, recording.rate_hz
    noise = np.random.default_rng([seed, zlib.crc32(name.encode())]).standard_normal(samples.shape)
    noise *= NOISE * _size(samples) / _size(noise)
    return Trial(recording, samples + noise, felt_level(samples, rate_hz), OriginalSpectrum(samples, rate_hz))


def measure(name: str, reduce: Reducer, trial: Trial) -> Measures:
    """Measure a reducer on a scene.

    Parameters
    ----------
    name : str
        Of the reducer.
    reduce : callable
        The reducer.
    trial : Trial
        The scene.

    Returns
    -------
    Measures
        All of them.
    """
    samples, rate_hz = trial.recording.acceleration, trial.recording.rate_hz
    reduced = reduce(samples, rate_hz)
    spectral, bounded = map(float, trial.spectrum.match_both(reduced))
    return Measures(
        level_db=find_level(reduced, trial),
        spectrum=spectral_match_energy_weighted(samples, reduced, rate_hz),
        time=temporal_match_invariant(samples, reduced, rate_hz),
        change=find_change(reduced, reduce(trial.disturbed, rate_hz)),
        spectral_match=spectral,
        temporal_match=temporal_match(samples, reduced, rate_hz),
        gain_db=GAIN_DB.get(name, 0.0),
        spectral_match_bounded=bounded,
    )


def find_level(output: Samples, trial: Trial) -> float:
    """Compare felt levels.

    Parameters
    ----------
    output : ndarray, shape (n_samples,) or (axes, n_samples)
        What is felt instead of the recording.
    trial : Trial
        The scene.

    Returns
    -------
    float
        In dB, -120 or more.
    """
    ratio = felt_level(output, trial.recording.rate_hz) / trial.level
    return max(20 * math.log10(ratio), SILENT_DB) if ratio > 0 else SILENT_DB


def find_change(before: Samples, after: Samples) -> float:
    """Find how much an output has changed; a vibration and its negative feel alike.

    Parameters
    ----------
    before, after : ndarray
        Outputs of one shape.

    Returns
    -------
    float
        Relative to the output before; 1 where that is silent.
    """
    size = _size(before)
    return min(_size(after - before), _size(after + before)) / size if size > 0 else 1.0


def _size(samples: Samples) -> float:
    return math.sqrt(float(np.square(samples).sum()))
