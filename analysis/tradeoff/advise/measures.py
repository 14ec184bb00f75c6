"""What a scene becomes under a reducer: level, spectrum, time, steadiness, and the paper's two metrics beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.match import temporal_match
from stimuli.spectrum import OriginalSpectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.tradeoff.advise.draws import Candidate, Draw

GAIN_DB = {"soc321": 10 * math.log10(3)}
"""Gain of a fixed sum of axes: the norm of its weights, where that is not 1. See `Measures.deviation_db`."""


@dataclass(frozen=True, slots=True)
class Measures:
    """What a reducer makes of a segment of a scene, with the sensor mounted in one way.

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
        The paper's metrics; NaN where there are none.
    gain_db : float
        Gain that the reducer applies to what it keeps, whatever that is.
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
        cancel go unseen. So the level must be right with the gain and must not be lost without it. A gain that is
        measured, as that of the reducers with matched energy is, is right for every mounting and does not count.
        """
        return max(abs(self.level_db), self.gain_db - self.level_db)


def find_gains(candidates: list[Candidate]) -> NDArray[np.float64]:
    """Look up the fixed gains of candidates, one row each, to be set against draws.

    Parameters
    ----------
    candidates : list of Candidate
        The candidates.

    Returns
    -------
    ndarray of float64, shape (n_candidates, 1)
        In dB.
    """
    return np.array([[GAIN_DB.get(candidate.name, 0.0)] for candidate in candidates])


def measure(candidate: Candidate, draw: Draw, scores: NDArray[np.float64]) -> Measures:
    """Put together what is known of a reducer in a draw, and add the paper's metrics.

    Parameters
    ----------
    candidate : Candidate
        The reducer.
    draw : Draw
        The draw.
    scores : ndarray, shape (4,)
        What `draws.score_scene` gave.

    Returns
    -------
    Measures
        All of them.
    """
    samples, rate_hz = draw.turn @ draw.segment.samples, draw.segment.rate_hz
    output = candidate.reduce(samples, rate_hz)
    spectral = bounded = temporal = math.nan
    if output.ndim == 1:
        spectral, bounded = map(float, OriginalSpectrum(samples, rate_hz).match_both(output))
        temporal = temporal_match(samples, output, rate_hz)
    level_db, spectrum, time, change = scores.tolist()
    gain_db = GAIN_DB.get(candidate.name, 0.0)
    return Measures(level_db, spectrum, time, change, spectral, temporal, gain_db, bounded)
