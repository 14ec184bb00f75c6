"""How much the metrics depend on the way the sensor was glued on: their spread over random sensor orientations.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit
from stimuli.match import axis_correlations, mean_heard
from stimuli.reduce import get_reducer
from stimuli.spectrum import OriginalSpectrum

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

LEAST_ROTATIONS = 200
# Rotated copies made at a time: enough to amortise a call, few enough to stay in the processor's cache.
_SAMPLES_AT_A_TIME = 200_000


@dataclass(frozen=True, slots=True)
class RotationStatistics:
    """The metrics over random sensor orientations.

    Parameters
    ----------
    spectral_mean, spectral_sd, temporal_mean, temporal_sd : float
        Means and standard deviations (ddof 1).
    rotations : int
        Number of orientations.
    bounded_mean, bounded_sd : float
        The same of the bounded spectral match.
    """

    spectral_mean: float
    spectral_sd: float
    temporal_mean: float
    temporal_sd: float
    rotations: int
    bounded_mean: float
    bounded_sd: float


def rotation_statistics(
    acceleration: ArrayLike,
    rate_hz: float,
    *,
    reducer: str,
    rotations: int = LEAST_ROTATIONS,
    rng: np.random.Generator,
) -> RotationStatistics:
    """Reduce a recording as if the sensor had been mounted in many random ways, and describe the metrics.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    rate_hz : float
        Sampling rate in Hz.
    reducer : str
        A name of `REDUCERS`.
    rotations : int
        Number of orientations, uniform over all rotations; at least 200.
    rng : numpy.random.Generator
        Source of the orientations.

    Returns
    -------
    RotationStatistics
        Mean and standard deviation of each metric.

    Raises
    ------
    ValueError
        If the input is not one recording, the reducer is unknown, or there are fewer than 200 rotations.

    References
    ----------
    .. [1] Park & Kuchenbecker 2019. doi:10.1109/WHC.2019.8816148
    """
    if rotations != int(rotations) or rotations < LEAST_ROTATIONS:
        raise ValueError(f"rotations: got {rotations}, allowed is a whole number of {LEAST_ROTATIONS} or more")
    turns = random_rotations(rotations, rng)
    found = match_rotations(acceleration, rate_hz, reducers=(reducer,), turns=turns)[0]
    means, sds = found.mean(axis=1).tolist(), found.std(axis=1, ddof=1).tolist()
    spectral, temporal, bounded = zip(means, sds, strict=True)
    return RotationStatistics(*spectral, *temporal, rotations, *bounded)


def match_rotations(
    acceleration: ArrayLike, rate_hz: float, *, reducers: Sequence[str], turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn a recording, as if the sensor had been mounted otherwise, reduce it, and match it with itself.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    rate_hz : float
        Sampling rate in Hz.
    reducers : sequence of str
        Names of `REDUCERS`; all are given the same turned recordings.
    turns : ndarray, shape (rotations, 3, 3)
        Rotation matrices.

    Returns
    -------
    ndarray of float64, shape (n_reducers, 3, rotations)
        Matches, in the order of `METRICS`, of what each reducer made of the turned recording with that recording.

    Raises
    ------
    ValueError
        If the input is not one recording, or a reducer is unknown.
    """
    samples = admit(acceleration, rate_hz).samples
    if samples.ndim != 2 or samples.shape[1] == 0:  # noqa: PLR2004 - axes x samples
        raise ValueError(f"acceleration: got shape {samples.shape}, allowed is (3, n), n >= 1: one recording at a time")
    reduce = [get_reducer(name) for name in reducers]
    original = OriginalSpectrum(samples, rate_hz)
    found = np.empty((len(reduce), 3, len(turns)))
    per_batch = max(1, _SAMPLES_AT_A_TIME // samples.size)
    for start in range(0, len(turns), per_batch):
        batch = slice(start, start + per_batch)
        turned = np.einsum("rij,jn->rin", turns[batch], samples)
        for place, one in enumerate(reduce):
            reduced = one(turned, rate_hz)
            spectral, bounded = original.match_both(reduced)
            found[place, :, batch] = spectral, mean_heard(axis_correlations(turned, reduced)), bounded
    return found


def random_rotations(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw rotations uniformly.

    Parameters
    ----------
    count : int
        How many.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray of float64, shape (count, 3, 3)
        Rotation matrices.
    """
    from scipy.stats import special_ortho_group

    return np.asarray(special_ortho_group(3, seed=rng).rvs(count)).reshape(count, 3, 3)
