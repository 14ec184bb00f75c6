"""Metrics that no rotation of the sensor changes, and how the others vary over rotations.

Conventions as in `match`: acceleration (3, n_samples) and reduced (n_samples,), both finite; every counterpart is
called alike, `INVARIANTS[name](acceleration, reduced, rate_hz)`, and `name` is the name of its metric in `METRICS`.
Both lie between 0 and 1, or are NaN where the recording leaves nothing to match.

- The paper's temporal match takes the mean of three correlations, whatever the axes' strengths. It thereby rewards a
  signal that lines up with the sensor's own diagonal, lets a whisper on one axis count as much as the motion on the
  others, and changes with the mounting. Its counterpart weighs the axes by their energy.
- The paper's spectral match is rotation-invariant already. But it divides by the recording's energy at every frequency
  and so is unbounded below: a little energy in a band that the recording left empty outweighs everything else. Its
  counterpart divides once, by what either signal has: it is named for that, `spectral_match_energy_weighted`. (It was
  called `spectral_match_invariant`; that name still works.) Where the strongest band holds nearly all energy it says
  little about the others, which `match.spectral_match_bounded` weighs alike: read both.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
.. [2] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, equations 1 and 2. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.match import (
    OriginalSpectrum,
    WeberSmoothing,
    axis_correlations,
    energy_spectrum,
    linear_grid,
    mean_heard,
)
from feel321.stimuli.recording import (
    admit,
    check_acceleration,
    check_rate,
    check_reduced,
    is_safe,
    largest,
)
from feel321.stimuli.reducers.registry import get_reducer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from feel321.stimuli.match import Metric

# INVARIANTS: for each of the paper's metrics, a bounded counterpart that turning the sensor cannot change.

# A band whose amplitude is below this share of the signals' is the rounding error of the transforms.
_ROUNDING = 32 * np.finfo(np.float64).eps


def spectral_match_energy_weighted(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float
) -> float:
    r"""Compute the share of the energy that either signal has which is common to both, frequency by frequency.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, same unit.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    float
        0 to 1: 1 if the smoothed spectra agree, 0 if one signal is silent wherever the other is not; NaN if both are
        silent from 20 to 1000 Hz, or too short for any frequency there.

    Raises
    ------
    ValueError
        If shapes or values are wrong.

    Notes
    -----
    With E the sum of the axes' smoothed energy spectral densities, S that of the reduced signal, both as in
    `spectral_match`, and sums over the same frequencies,

    .. math:: I_{sm} = \frac{\sum_f \min(E, S)}{\sum_f \max(E, S)}
        = \frac{\sum_f (E + S) - \sum_f |E - S|}{\sum_f (E + S) + \sum_f |E - S|}

    (one minus the Jaccard distance of the two spectra). It depends on the recording through E alone, the trace of its
    spectral matrix, which no rotation or reflection of the sensor changes. Relation to the paper's :math:`M_{sm}`,
    with :math:`d = |E - S| / E` the relative deviation that it averages:

    - It is the paper's score with weights. At each frequency min/max is 1 - d where S <= E and 1 / (1 + d) >= 1 - d
      where S > E, and :math:`I_{sm}` is the mean of that with weights max(E, S). Hence d <= D everywhere gives both
      metrics a value of at least 1 - D, and each is 1 exactly where the other is.
    - It is never below the energy-weighted form of the paper's, :math:`1 - \sum |E - S| / \sum E`, and equal to it
      where S <= E: subtract both from 1, they have the same numerator and max(E, S) >= E.
    - A constant gain g of the energy scores min(g, 1/g): as in the paper for g <= 1, and 1/g instead of 2 - g above.
    - It is at most the smaller of the two energies (each summed over f) over the larger: a sum of minima is at most
      the smaller sum, a sum of maxima at least the larger.

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(spectral_match_energy_weighted([u, u, u], u, 1000), 9)
    0.333333333
    >>> round(spectral_match_energy_weighted([u, u, u], u + u + u, 1000), 9)
    0.333333333
    """
    rate = check_rate(rate_hz)
    samples = check_acceleration(acceleration)
    signal = check_reduced(reduced, samples.shape)
    samples, signal = _bring_into_range(samples, signal)
    n = samples.shape[-1]
    frequencies = linear_grid(n, rate)
    smooth = WeberSmoothing(frequencies, rate / n, n // 2 + 1)
    original, kept = (
        energy_spectrum(samples, smooth.bins).sum(axis=0),
        energy_spectrum(signal, smooth.bins),
    )
    energies = float(np.einsum("in,in->", samples, samples)), float(signal @ signal)
    if not len(frequencies):
        return math.nan
    # Smoothed after they are added or subtracted: what two equal spectra share cancels without rounding.
    total = smooth(original + kept).sum()
    if total <= _ROUNDING**2 * len(frequencies) * sum(energies):
        return math.nan
    apart = np.abs(smooth(original - kept)).sum()
    return max(float((total - apart) / (total + apart)), 0.0)


def temporal_match_invariant(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the share of the recording's motion that goes along with the reduced signal, in amplitude.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, any unit.
    rate_hz : float, optional
        Not used; every counterpart takes it so that all are called alike.

    Returns
    -------
    float
        0 to 1: 1 if the tool moved along one line and the reduced signal is that motion; 0 if the reduced signal is
        silent; NaN if the recording is.

    Raises
    ------
    ValueError
        If shapes or values are wrong.

    Notes
    -----
    With a the recording as a matrix of three rows :math:`a_i`, and s the reduced signal,

    .. math:: I_{tm} = \sqrt{\frac{\sum_i (a_i \cdot s)^2}{\sum_i \|a_i\|^2 \, \|s\|^2}}
        = \frac{\|a s\|}{\|a\|_F \|s\|}

    A rotation or reflection R turns a s into R a s and keeps both norms. No mean is removed, as in the paper.

    - Upper bound: :math:`\|a s\| \le \sigma_1 \|s\|`, so :math:`I_{tm} \le \sqrt{\lambda_1 / \sum_i \lambda_i}` with
      :math:`\lambda = \sigma^2` the eigenvalues of :math:`a a^T`, reached by the projection on the leading axis and by
      no signal of another shape if :math:`\lambda_1 > \lambda_2`.
    - Relation to the paper's :math:`M_{tm}`, the mean of the correlations :math:`|r_i|`: with :math:`p_i` the axes'
      shares of the energy, :math:`I_{tm}^2 = \sum_i p_i r_i^2`. So :math:`I_{tm}` lies between the smallest and the
      largest :math:`|r_i|`, hence :math:`I_{tm} \le 3 M_{tm}`; and from :math:`\sum_i p_i r_i^2 \ge 3 p_{min}
      \overline{r^2} \ge 3 p_{min} M_{tm}^2` follows :math:`M_{tm} \le I_{tm} / \sqrt{3 p_{min}}`.
    - Turned so that all three axes are equally strong (there is always such a way) they obey :math:`I_{tm} / \sqrt 3
      \le M_{tm} \le I_{tm}`: there :math:`M_{tm}` is the 1-norm of :math:`a s` over :math:`\sqrt 3 \|a\|_F \|s\|`.

    Examples
    --------
    >>> round(temporal_match_invariant([[3, 0], [0, 4], [0, 0]], [1, 0]), 12)
    0.6
    """
    check_rate(1.0 if rate_hz is None else rate_hz)
    samples = check_acceleration(acceleration)
    signal = check_reduced(reduced, samples.shape)
    # Each in its own unit.
    (samples,), (signal,) = (_bring_into_range(samples), _bring_into_range(signal))
    together = np.linalg.norm(np.einsum("in,n->i", samples, signal))
    scale = np.linalg.norm(samples) * np.linalg.norm(signal)
    if not samples.any():
        return math.nan
    return min(float(together / scale), 1.0) if scale > 0 else 0.0


spectral_match_invariant = spectral_match_energy_weighted
"""The former name of `spectral_match_energy_weighted`."""

INVARIANTS: Mapping[str, Metric] = MappingProxyType({
    "spectral_match": spectral_match_energy_weighted,
    "temporal_match": temporal_match_invariant,
})
"""Name of one of the paper's metrics -> its bounded, rotation-invariant counterpart."""


def _bring_into_range(*signals: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Divide signals by one power of two where squares would overflow or vanish."""
    peak = max(largest(signal) for signal in signals)
    if is_safe(peak):
        return signals
    exponent = int(np.frexp(peak)[1])
    return tuple(np.ldexp(signal, -exponent) for signal in signals)


# How much the metrics depend on the way the sensor was glued on: their spread over random sensor orientations.

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
        raise ValueError(
            f"rotations: got {rotations}, allowed is a whole number of {LEAST_ROTATIONS} or more"
        )
    turns = random_rotations(rotations, rng)
    found = match_rotations(acceleration, rate_hz, reducers=(reducer,), turns=turns)[0]
    means, sds = found.mean(axis=1).tolist(), found.std(axis=1, ddof=1).tolist()
    spectral, temporal, bounded = zip(means, sds, strict=True)
    return RotationStatistics(*spectral, *temporal, rotations, *bounded)


def match_rotations(
    acceleration: ArrayLike, rate_hz: float, *, reducers: Sequence[str], turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn a recording, as if the sensor had been mounted otherwise, reduce it, and match it with itself.

    acceleration: (3, n_samples); turns: (rotations, 3, 3); returns (n_reducers, 3, rotations).
    """
    samples = admit(acceleration, rate_hz).samples
    if samples.ndim != 2 or samples.shape[1] == 0:  # noqa: PLR2004 - axes x samples
        raise ValueError(
            f"acceleration: got shape {samples.shape}, allowed is (3, n), n >= 1: one recording at a time"
        )
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
            found[place, :, batch] = (
                spectral,
                mean_heard(axis_correlations(turned, reduced)),
                bounded,
            )
    return found


def random_rotations(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw rotations uniformly.

    Returns (count, 3, 3).
    """
    from scipy.stats import special_ortho_group

    return np.asarray(special_ortho_group(3, seed=rng).rvs(count)).reshape(count, 3, 3)
