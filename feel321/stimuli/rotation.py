"""Metrics that no rotation of the sensor changes, and how the match metrics vary over rotations.

Conventions as in `match`: acceleration (3, n_samples) and reduced (n_samples,), both finite; every counterpart is
called alike, `INVARIANTS[name](acceleration, reduced, rate_hz)`, and `name` is the name of its metric in `METRICS`.
Both lie between 0 and 1, or are NaN where the recording leaves nothing to match.

- The paper's temporal match takes the mean of three correlations, whatever the axes' strengths. It thereby rewards a
  signal that lines up with the sensor's own diagonal, lets a whisper on one axis count as much as the motion on the
  others, and changes with the mounting. Its counterpart weighs the axes by their energy.
- The paper's spectral match is rotation-invariant already. But it divides by the recording's energy at every frequency
  and so is unbounded below: a little energy in a band that the recording left empty outweighs everything else. Its
  counterpart divides once, by what either signal has: it is named for that, `spectral_match_energy_weighted`. Where
  the strongest band holds nearly all energy it says little about the others, which `match.spectral_match_bounded`
  weighs alike: read both.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from feel321.arguments import Registry, as_rng
from feel321.stimuli.match import (
    OriginalSpectrum,
    WeberSmoothing,
    energy_spectrum,
    linear_grid,
    mean_over_axes,
    relate_axes,
)
from feel321.stimuli.recording import Signal, admit, as_pair, as_signal, check_reduced
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.types import Metric, Reducer, Rng, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

LEAST_ROTATIONS = 200
# Of rotated copies made at a time: enough to amortise calls and to transform several signals in one.
_SAMPLES_AT_A_TIME = 1_000_000

_LEFT = 1e-12  # Share of an output's energy below which what the axes leave of it is rounding
SAME = 1e-9  # Outputs that differ by less than this share of their amplitude are the same
# A band whose amplitude is below this share of the signals' is the rounding error of the transforms.
_ROUNDING = 32 * np.finfo(np.float64).eps


def spectral_match_energy_weighted(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the share of the energy that either signal has which is common to both, frequency by frequency.

    0 to 1: 1 if the smoothed spectra agree, 0 if one signal is silent wherever the other is not; NaN if both are silent
    from 20 to 1000 Hz, or too short for any frequency there.

    Notes
    -----
    With E the sum of the axes' smoothed energy spectral densities and S that of the reduced signal,

    .. math:: I_{sm} = \frac{\sum_f \min(E, S)}{\sum_f \max(E, S)}
        = \frac{\sum_f (E + S) - \sum_f |E - S|}{\sum_f (E + S) + \sum_f |E - S|}

    (one minus the Jaccard distance of the two spectra). It depends on the recording through E alone, which no rotation
    or reflection of the sensor changes. It is the paper's score with weights max(E, S): where no frequency deviates by
    more than D both are at least 1 - D, and each is 1 exactly where the other is. It is never below the energy-weighted
    form of the paper's, :math:`1 - \sum |E - S| / \sum E`. A gain g of the energy scores min(g, 1/g).
    """
    given, rate = as_pair(acceleration, reduced, rate_hz)
    samples, _ = admit(given, rate)
    signal = check_reduced(reduced, samples.shape)
    n = samples.shape[-1]
    frequencies = linear_grid(n, rate)
    smooth = WeberSmoothing(frequencies, rate / n, n // 2 + 1)
    original = energy_spectrum(samples, smooth.bins).sum(axis=0)
    kept = energy_spectrum(signal, smooth.bins)
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
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the share of the recording's motion that goes along with the reduced signal, in amplitude.

    0 to 1: 1 if the tool moved along one line and the reduced signal is that motion; 0 if the reduced signal is silent;
    NaN if the recording is. The rate is not used.

    Notes
    -----
    With a the recording as a matrix of three rows :math:`a_i`, and s the reduced signal,

    .. math:: I_{tm} = \sqrt{\frac{\sum_i (a_i \cdot s)^2}{\sum_i \|a_i\|^2 \, \|s\|^2}}
        = \frac{\|a s\|}{\|a\|_F \|s\|}

    A rotation or reflection R turns a s into R a s and keeps both norms. No mean is removed, as in the paper.

    - At most :math:`\sqrt{\lambda_1 / \sum_i \lambda_i}`, with the eigenvalues of :math:`a a^T`: reached by the
      projection on the leading axis.
    - With :math:`p_i` the axes' shares of the energy and :math:`|r_i|` the correlations whose mean is the paper's
      :math:`M_{tm}`, :math:`I_{tm}^2 = \sum_i p_i r_i^2`. Hence :math:`I_{tm} \le 3 M_{tm}` and :math:`M_{tm} \le
      I_{tm} / \sqrt{3 p_{min}}`.
    """
    given, rate = as_pair(acceleration, reduced, rate_hz, otherwise=1.0)
    samples, _ = admit(given, rate)
    signal = check_reduced(reduced, samples.shape)
    together = np.linalg.norm(np.einsum("in,n->i", samples, signal))
    scale = np.linalg.norm(samples) * np.linalg.norm(signal)
    if not samples.any():
        return math.nan
    return min(float(together / scale), 1.0) if scale > 0 else 0.0


INVARIANTS: Registry[Metric] = Registry(
    "invariant",
    {"spectral_match": spectral_match_energy_weighted, "temporal_match": temporal_match_invariant},
)
"""Name of one of the paper's metrics -> its bounded, rotation-invariant counterpart."""


def rotation_statistics(
    recording: Signal,
    reducers: str | Iterable[str | Reducer] = "all",
    *,
    rotations: int = LEAST_ROTATIONS,
    rng: Rng = 0,
    rate_hz: float | None = None,
) -> DataFrame:
    """Compute the metrics over random orientations of the sensor.

    Parameters
    ----------
    recording : Recording, or array_like of shape (3, n_samples)
        Acceleration, any unit; plain samples need `rate_hz`.
    reducers : "all", or a list of str or callables
        Names of `REDUCERS`, dotted names ("mylab.haptics:my321"), or functions f(acceleration, rate_hz).
    rotations : int
        Number of orientations, uniform over all rotations; at least 200.
    rng : int or numpy.random.Generator
        Seed or source of the orientations; all reducers meet the same ones.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.

    Returns
    -------
    DataFrame
        A row per reducer: mean and standard deviation (ddof 1) of each metric, and the number of orientations.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scene = stimuli.make_scene("bumps", rate_hz=4000, duration_s=0.5)
    >>> found = stimuli.rotation_statistics(scene, ["sax321", "dft321_principal"])
    >>> found["spectral_sd"].round(2).tolist()
    [0.05, 0.0]
    """
    if not rotations >= LEAST_ROTATIONS or rotations % 1:  # neither NaN nor infinity passes
        got = f"got {rotations}"
        raise ValueError(f"rotations must be a whole number of {LEAST_ROTATIONS} or more, {got}")
    given, rate = as_signal(recording, rate_hz)
    chosen = REDUCERS.choose(reducers)
    turns = random_rotations(rotations, as_rng(rng))
    found = match_rotations(given, rate, reducers=list(chosen.values()), turns=turns)
    import pandas as pd

    statistics: dict[str, Any] = {}
    for name, values in zip(("spectral", "temporal", "bounded"), found.swapaxes(0, 1), strict=True):
        statistics[f"{name}_mean"] = values.mean(axis=1)
        statistics[f"{name}_sd"] = values.std(axis=1, ddof=1)
    return pd.DataFrame(statistics | {"rotations": rotations}, pd.Index(chosen, name="reducer"))


def match_rotations(
    acceleration: ArrayLike, rate_hz: float, *, reducers: Sequence[str | Reducer], turns: Samples
) -> Samples:
    """Rotate a recording, as if the sensor had been mounted differently, reduce it, and match the result.

    turns: (rotations, 3, 3); returns (n_reducers, 3, rotations): spectral, temporal, bounded spectral match.
    """
    samples, _ = admit(acceleration, rate_hz)
    if samples.ndim != 2 or samples.shape[1] == 0:  # noqa: PLR2004 - axes x samples
        must = "acceleration must have the shape (3, n), n >= 1, one recording at a time"
        raise ValueError(f"{must}; got {samples.shape}")
    reduce = [REDUCERS.find(one) for one in reducers]
    original = OriginalSpectrum(samples, rate_hz)
    inverse = np.linalg.pinv(samples @ samples.T, hermitian=True)
    found = np.empty((len(reduce), 3, len(turns)))
    per_batch = max(2, _SAMPLES_AT_A_TIME // samples.size)
    kept: dict[int, Samples] = {}  # outputs that turning the sensor only negates
    for start in range(0, len(turns), per_batch):
        few = turns[start : start + per_batch]
        turned = np.einsum("rij,jn->rin", few, samples)
        energies = np.einsum("rin,rin->ri", turned, turned)
        for place, one in enumerate(reduce):
            reduced = kept[place] if place in kept else _reduce_each(one, turned, rate_hz)
            if start == 0 and len(few) > 1 and _are_alike(reduced):
                kept[place] = reduced[:1]
            along, energy = reduced @ samples.T, np.einsum("rn,rn->r", reduced, reduced)
            together = np.einsum("rij,rj->ri", few, along)
            temporal = mean_over_axes(relate_axes(together, energies, energy))
            weights = along @ inverse
            left = energy - (weights * along).sum(axis=-1)  # of what is no weighted sum of the axes
            if (np.abs(left) <= _LEFT * energy).all():
                spectral, bounded = original.match_sums(weights, energy)
            else:
                spectral, bounded = original.match_both(reduced)
            scores = np.broadcast_arrays(spectral, temporal, bounded)
            found[place, :, start : start + len(few)] = scores
    return found


def _reduce_each(reducer: Reducer, turned: Samples, rate_hz: float) -> Samples:
    """Reduce many recordings; a lab's own function need not take several at once."""
    if reducer in REDUCERS.values():
        return reducer(turned, rate_hz)
    return np.stack([reducer(one, rate_hz) for one in turned])


def _are_alike(outputs: Samples) -> bool:
    """Whether outputs, (rotations, n), are one and the same but for the sign and rounding."""
    first = outputs[0]
    apart = [np.linalg.norm(outputs + sign * first, axis=-1) for sign in (-1, 1)]
    return bool(np.minimum(*apart).max() <= SAME * np.linalg.norm(first))


def random_rotations(count: int, rng: np.random.Generator) -> Samples:
    """Draw rotations uniformly: (count, 3, 3)."""
    from scipy.stats import special_ortho_group

    return np.asarray(special_ortho_group(3, seed=rng).rvs(count)).reshape(count, 3, 3)
