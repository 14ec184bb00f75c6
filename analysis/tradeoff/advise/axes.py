"""What an actuator of several axes can play instead of a reduced signal: the strongest two axes, or the recording.

No reducer is needed then, but one may still be enough: a vibration along one line needs one axis of the actuator,
whatever it can move besides. The measures of one axis carry over. Level and spectrum are those of the energies' sum,
for which `dft321` of the axes stands; the square of the temporal match is the share of the motion's energy that goes
along with the output, which for an output on principal axes is the sum of their shares.
"""

from __future__ import annotations

from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.advise.measures import NOISE, Measures, Trial, find_change, find_level
from analysis.tradeoff.advise.scene import ALL_AXES
from analysis.tradeoff.advise.simplicity import COVARIANCE, MEAN, PROJECTION, Cost
from stimuli.fourier import dft321
from stimuli.invariant import spectral_match_energy_weighted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


TWO, THREE = "two_principal_axes", "three_axes"
"""Their names: the two leading principal axes, and the recording as it is."""


def measure_axes(trial: Trial, *, axes: int) -> Iterator[tuple[Cost, Measures]]:
    """Measure what an actuator of several axes can play.

    Parameters
    ----------
    trial : Trial
        The scene.
    axes : int
        Axes of the actuator.

    Yields
    ------
    cost : Cost
        Its record.
    measures : Measures
        What is felt; the paper's temporal match is not defined for several axes.
    """
    if axes > 1:
        work = MEAN + COVARIANCE + 2 * PROJECTION
        yield Cost(TWO, 2, 3.0 * trial.recording.n_samples, inf, work, 0), _measure_two(trial)
    if axes == ALL_AXES:
        yield Cost(THREE, 3, 0.0, 0.0, 0.0, 0), Measures(0.0, 1.0, 1.0, NOISE, 1.0, nan)


def _measure_two(trial: Trial) -> Measures:
    samples, rate_hz = trial.recording.acceleration, trial.recording.rate_hz
    kept = _keep_two(samples)
    return Measures(
        level_db=find_level(kept, trial),
        spectrum=spectral_match_energy_weighted(samples, dft321(kept, rate_hz), rate_hz),
        time=float(np.sqrt(np.square(kept).sum() / np.square(samples).sum())),
        change=find_change(kept, _keep_two(trial.disturbed)),
        spectral_match=nan,
        temporal_match=nan,
    )


def _keep_two(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out the motion along the weakest principal axis."""
    weakest = np.linalg.eigh(np.einsum("in,jn->ij", samples, samples))[1][:, 0]
    return np.asarray(samples - np.outer(weakest, np.einsum("i,in->n", weakest, samples)))
