"""What an actuator of several axes can play instead of a reduced signal: the strongest two axes, or the recording.

No reducer is needed then, but one may still be enough: a vibration along one line needs one axis of the actuator,
whatever it can move besides. The measures of one axis carry over: level and spectrum are those of the energies' sum,
and the share of the motion's energy that goes along with the output is the share that is kept.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.advise.draws import Candidate
from analysis.tradeoff.advise.scene import ALL_AXES
from analysis.tradeoff.advise.simplicity import COVARIANCE, MEAN, PROJECTION, Cost

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

TWO, THREE = "two_principal_axes", "three_axes"
"""Their names: the two leading principal axes, and the recording as it is."""


def list_axes(axes: int, n_samples: int) -> Iterator[tuple[Cost, Candidate]]:
    """List what an actuator of several axes can play.

    Parameters
    ----------
    axes : int
        Axes of the actuator.
    n_samples : int
        Length of the scene.

    Yields
    ------
    cost : Cost
        Its record.
    candidate : Candidate
        Gives three axes of the sensor instead of one signal.
    """
    if axes > 1:
        work = MEAN + COVARIANCE + 2 * PROJECTION
        yield Cost(TWO, 2, 3.0 * n_samples, inf, work, 0), Candidate(TWO, _keep_two)
    if axes == ALL_AXES:
        yield Cost(THREE, 3, 0.0, 0.0, 0.0, 0), Candidate(THREE, lambda samples, _: samples)


def _keep_two(samples: NDArray[np.float64], rate_hz: float) -> NDArray[np.float64]:
    """Leave out the motion along the weakest principal axis."""
    del rate_hz
    weakest = np.linalg.eigh(np.einsum("...in,...jn->...ij", samples, samples))[1][..., :, 0]
    along = np.einsum("...i,...in->...n", weakest, samples)
    return np.asarray(samples - weakest[..., :, None] * along[..., None, :])
