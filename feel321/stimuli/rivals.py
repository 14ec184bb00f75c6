r"""RIVALS: other ways to compare vibrations, most from the literature, to test the match metrics against.

Conventions: acceleration (..., 3, n) and reduced (..., n), finite, in one unit; what a rival measures has the shape
(...). A recording enters through sums over its axes that no rotation of the sensor changes, unless a metric says
otherwise: where a method was published for one axis, it comes out as published if two axes are silent. A recording
without energy in the felt range leaves nothing to compare: NaN, as for the match metrics. Levels further apart than
`MOST_DB` count as that far apart, so that a silent reduced signal has a value: people feel vibrations over some 55 dB.

E is the energy of the recording (the sum of its axes), S that of the reduced signal, from 20 to 1000 Hz. Bands are as
wide as the smallest change of frequency that people notice: 18 of them where the rate allows, at equal steps of the
logarithm; a spectral match averages over Hz instead, where half of all frequencies lie above 500 Hz. Bands in which
neither signal has energy are left out. T is the detection threshold of
acceleration (`acceleration_threshold`, that of a contactor).

The envelope of a recording is the root of the energy of all its axes at each time, from 20 to 1000 Hz; that of a
reduced signal the magnitude of its analytic signal. An envelope at up to some 50 Hz is felt as such, and equal energy
in shorter segments is hard to tell apart [3]_.

ST-SIM and SPQI were made for codecs. Both cut signals into blocks of 64 ms (512 samples at 8 kHz) and weigh spectra by
the same threshold, in dB over 1 m/s²: :math:`T(f) = 62 \, (\log_{10}(f / 550 + 6 / 11) / \log_{10}(6 / 11))^2 - 77`,
at most 0: lowest at 250 Hz. The publications were not available; the formulas are second-hand, read from the code of
VibroMAF 0.0.8 [6]_ (by authors of both), and its numbers are met where neither of the following matters:

- It takes discrete cosine transforms, whose coefficients depend on the phase: :math:`c^2 = 2 \cos^2(\phi) |X|^2 / N`
  with X the spectrum of the block, zero-padded to twice its length. Three axes have no one phase, and a reduction is
  free to choose one. Here :math:`|X|^2 / N` itself stands, the mean over phases, which that code has as its option
  `compute_block_dft`. The energies of the recording's axes add.
- Rates: it assumes 8 kHz. Here blocks last 64 ms at any rate, levels are those that 8 kHz would give, and frequencies
  count up to 4 kHz.
- Silence: a block that is silent in both signals scored 0 in ST-SIM, so that a perfect copy of a recording with pauses
  fell below 1. Here such blocks are left out.
- Sign: its temporal part is a mean correlation, negative for a signal in anti-phase, and a root of it complex. A
  reduced signal has no sign of its own. Here it is the share of the recording's motion that goes along with the reduced
  signal, block by block (as in `INVARIANTS`), which is the absolute correlation if the recording has one axis.
- Bounds: its spectral part exceeds 1 where the reduced signal is stronger. Here it is taken relative to the stronger.

A remainder shorter than a block is left out, as in the original; a recording shorter than a block gives NaN.

References
----------
.. [1] A. H. Gray, J. D. Markel, "Distance measures for speech processing", IEEE Transactions on Acoustics, Speech, and
   Signal Processing 24(5), 1976, 380-391. doi:10.1109/TASSP.1976.1162849
.. [2] S. J. Bensmaïa, M. Hollins, "The vibrations of texture", Somatosensory & Motor Research 20(1), 2003, 33-43.
   doi:10.1080/0899022031000083825
.. [3] N. Cao, H. Nagano, M. Konyo, S. Okamoto, S. Tadokoro, "A pilot study: introduction of time-domain segment to
   intensity-based perception model of high-frequency vibration", EuroHaptics 2018. doi:10.1007/978-3-319-93445-7_28
.. [4] R. Hassen, E. Steinbach, "Subjective evaluation of the spectral temporal SIMilarity (ST-SIM) measure for
   vibrotactile quality assessment", IEEE Transactions on Haptics 13(1), 2020.
.. [5] A. Noll, M. Hofbauer, E. Muschter, S.-C. Li, E. Steinbach, "Automated quality assessment for compressed
   vibrotactile signals using multi-method assessment fusion", IEEE Haptics Symposium 2022.
   doi:10.1109/HAPTICS52432.2022.9765599
.. [6] VibroMAF 0.0.8, https://pypi.org/project/vibromaf/
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feel321.arguments import Registry
from feel321.stimuli import recording
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    NUMERICAL_FLOOR,
    WEBER_FRACTION,
    WeberSmoothing,
    linear_grid,
)
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import MOST_DB, Samples


@dataclass(frozen=True)
class Pair:
    """Checked samples (..., 3, n) and a reduced signal (..., n)."""

    samples: Samples
    reduced: Samples
    rate_hz: float

    @cached_property
    def frequencies_hz(self) -> Samples:
        """Frequencies of the felt range, on the DFT's grid; possibly none."""
        return linear_grid(self.samples.shape[-1], self.rate_hz)

    @cached_property
    def felt(self) -> slice:
        """The bins of `frequencies_hz`."""
        if not len(self.frequencies_hz):
            return slice(0, 0)
        first = round(float(self.frequencies_hz[0]) * self.samples.shape[-1] / self.rate_hz)
        return slice(first, first + len(self.frequencies_hz))

    @cached_property
    def spectra(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Spectra of the axes, (..., 3, n // 2 + 1), and of the reduced signal, (..., n // 2 + 1)."""
        from scipy import fft

        return fft.rfft(self.samples), fft.rfft(self.reduced)

    @cached_property
    def energies(self) -> tuple[Samples, Samples]:
        """Energy of the recording (the sum of its axes) and of the reduced signal, (..., n // 2 + 1), bin by bin."""
        energies = (np.square(one.real) + np.square(one.imag) for one in self.spectra)
        axes, reduced = energies
        return axes.sum(axis=-2), reduced

    @cached_property
    def nothing(self) -> NDArray[np.bool_]:
        """Whether the recording has no energy in the felt range, (...)."""
        energy = self.energies[0]
        floor = NUMERICAL_FLOOR * np.einsum("...in,...in->...", self.samples, self.samples)
        return np.asarray(energy[..., self.felt].max(axis=-1, initial=0.0) <= floor)

    def settle(self, values: Samples) -> Samples:
        """Put NaN where there is nothing to compare."""
        return np.where(self.nothing, np.nan, values)


def make_pair(
    acceleration: recording.Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> Pair:
    """Check one recording and one reduced signal."""
    given, rate = recording.as_pair(acceleration, reduced, rate_hz)
    samples, _ = recording.admit(given, rate)
    return Pair(samples, recording.check_reduced(reduced, samples.shape), float(rate))


def follow_energy(pair: Pair, weights: Samples | float = 1.0) -> tuple[Samples, Samples, float]:
    """Follow the energy of recording (the sum of its axes) and reduced signal in the felt range; and the rate of both.

    weights: of the felt frequencies. The energy is the squared magnitude of the analytic signal, (..., m), at a rate
    that is just enough for it, a little below 2 kHz; as for all Fourier transforms, the end leads into the beginning.
    """
    axes, reduced = (follow_band(one, pair.felt, weights) for one in pair.spectra)
    return axes.sum(axis=-2), reduced, axes.shape[-1] * pair.rate_hz / pair.samples.shape[-1]


def follow_band(
    spectrum: NDArray[np.complex128], felt: slice, weights: Samples | float = 1.0
) -> Samples:
    """Follow the energy of signals in a band of their spectra (..., n // 2 + 1), as `follow_energy`: (..., m)."""
    from scipy import fft

    length = fft.next_fast_len(max(2 * (felt.stop - felt.start), 1))
    return np.asarray(np.abs(fft.ifft(spectrum[..., felt] * weights, length)) ** 2)


def level_db(original: Samples, reduced: Samples) -> Samples:
    """Level of energies over others in dB, at most `MOST_DB` either way; 0 where both are silent."""
    most = 10 ** (MOST_DB / 10)
    both = np.maximum(original, reduced)
    floored = (np.maximum(energy, both / most) for energy in (reduced, original))
    above, below = (np.where(both > 0, energy, 1.0) for energy in floored)
    return np.asarray(10 * np.log10(above / below))


def smooth_bands(pair: Pair) -> tuple[Samples, Samples, Samples]:
    """Middles of the bands in Hz; mean energy per bin of the recording and of the reduced signal, (..., n_bands)."""
    n = pair.samples.shape[-1]
    # Bands 22 % wide that fill the felt range; possibly none.
    lowest, highest = max(LOWEST_HZ, pair.rate_hz / n), min(HIGHEST_HZ, pair.rate_hz / 2)
    centres = np.zeros(0)
    if lowest < highest:
        ratio = (2 + WEBER_FRACTION) / (2 - WEBER_FRACTION)
        n_bands = max(round(math.log(highest / lowest) / math.log(ratio)), 1)
        edges = np.geomspace(lowest, highest, n_bands + 1)
        centres = (edges[1:] + edges[:-1]) / 2
    smooth = WeberSmoothing(centres, pair.rate_hz / n, n // 2 + 1)
    # What is left of a sum of energies may be negative by rounding.
    smoothed = (smooth(energy[..., smooth.bins]) for energy in pair.energies)
    original, reduced = (np.maximum(energy, 0.0) for energy in smoothed)
    return centres, original, reduced


def level_difference(pair: Pair) -> Samples:
    r"""Measure how far the level of a reduced signal is from its recording's, whatever the spectra.

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f)}{\sum_f E(f)} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. Half the amplitude is 6.02 dB, and so is twice.
    """
    original, reduced = (energy[..., pair.felt].sum(axis=-1) for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))


def log_spectral_distance(pair: Pair) -> Samples:
    r"""Measure the root mean square over bands of the difference in level [1]_.

    .. math:: D = \sqrt{\frac{1}{K} \sum_k \left( 10 \log_{10} \frac{S_k}{E_k} \right)^2} \mathrm{dB}

    0 to 60. A gain g of the amplitude alone is :math:`|20 \log_{10} g|` dB, as for `level_difference`, and D is never
    less than the mean difference.
    """
    _, original, reduced = smooth_bands(pair)
    total = sum(energy[..., pair.felt].max(axis=-1, initial=0.0) for energy in pair.energies)
    empty = np.maximum(original, reduced) <= NUMERICAL_FLOOR * np.asarray(total)[..., None]
    levels = np.where(empty, np.nan, level_db(original, reduced))
    return np.sqrt(_average(pair, np.square(levels)))


def _average(pair: Pair, values: Samples) -> Samples:
    """Mean over the bands that have energy; NaN where there is nothing to compare."""
    there = ~np.isnan(values)
    count = there.sum(axis=-1)
    mean = np.where(there, values, 0.0).sum(axis=-1) / np.maximum(count, 1)
    return pair.settle(np.where(count > 0, mean, np.nan))


def pacinian_power_difference(pair: Pair) -> Samples:
    r"""Measure how far the Pacinian power of a reduced signal is from its recording's.

    Perceived roughness of fine surfaces follows the power of the skin's vibration, weighted by the sensitivity of the
    Pacinian system [2]_.

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f) / T(f)^2}{\sum_f E(f) / T(f)^2} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. The paper's abstract states the weighted power;
    that three axes add by energy, and the difference in dB, are ours.
    """
    weights = acceleration_threshold(pair.frequencies_hz) ** -2
    original, reduced = (energy[..., pair.felt] @ weights for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))


FASTEST_HZ = 50.0
SLOWEST_HZ = 2.0
N_BANDS = 9  # Half an octave each from 2 to 50 Hz

# An envelope that varies by less than this share of its mean is constant but for rounding.
_CONSTANT = 1e-6


def envelope_correlation(pair: Pair) -> Samples:
    """Measure the correlation of the envelopes, as far as they vary at up to 50 Hz.

    Pearson's correlation, -1 to 1, after everything faster than 50 Hz was removed; our own construction. No gain and no
    phase changes it. 0 if the reduced signal is silent or its envelope constant; NaN if the recording's is, or if it is
    shorter than a period of 50 Hz.
    """
    *energies, rate_hz = follow_energy(pair)
    (mean, own, _), (mean_reduced, kept, _) = (_modulate(one, rate_hz) for one in energies)
    together = np.einsum("...k,...k->...", own, kept.conj()).real
    norms = [np.sqrt(np.einsum("...k,...k->...", one, one.conj()).real) for one in (own, kept)]
    steady = norms[0] <= _CONSTANT * mean
    flat = norms[1] <= _CONSTANT * mean_reduced
    scale = np.where(steady | flat, 1.0, norms[0] * norms[1])
    correlation = np.where(flat, 0.0, np.clip(together / scale, -1.0, 1.0))
    return pair.settle(np.where(steady, np.nan, correlation))


def modulation_distance(pair: Pair) -> Samples:
    r"""Measure how far the depths of modulation at 2 to 50 Hz are from the recording's.

    In nine bands of half an octave, with :math:`\hat e(f)` the spectrum of an envelope,

    .. math:: m_k = \frac{2}{\hat e(0)} \sqrt{\sum_{f \in k} |\hat e(f)|^2}, \qquad
        D = \sqrt{\frac{1}{K} \sum_k (m^s_k - m_k)^2},

    so that 1 is the depth of a fully modulated vibration. Our own construction. No gain, shift in time or phase changes
    it. Bands that hold no frequency of a short recording are left out; NaN if all are, below 20 ms. A silent reduced
    signal has no envelope: it counts as unmodulated or fully modulated in all bands, whichever is further off.
    """
    *energies, rate_hz = follow_energy(pair)
    return pair.settle(compare_depths(*(find_depths(one, rate_hz) for one in energies)))


def find_depths(energy: Samples, rate_hz: float) -> Samples:
    """Find how deeply the envelope of an energy (..., m) is modulated in each band: (..., k), NaN for silence."""
    mean, spectrum, rates_hz = _modulate(energy, rate_hz)
    edges = np.geomspace(SLOWEST_HZ, FASTEST_HZ, N_BANDS + 1) * (1 - 1e-12)
    band = np.minimum(np.searchsorted(edges, rates_hz, side="right") - 1, N_BANDS - 1)
    shares = (band[:, None] == np.unique(band[band >= 0])).astype(float)
    depths = 2 * np.sqrt(np.abs(spectrum) ** 2 @ shares)
    mean = mean[..., None]
    return np.asarray(np.divide(depths, mean, out=np.full_like(depths, np.nan), where=mean > 0))


def compare_depths(recorded: Samples, reduced: Samples) -> Samples:
    """Compare depths (..., k) in root mean square over bands: `modulation_distance`, NaN without bands."""
    if not recorded.shape[-1]:
        return np.full(recorded.shape[:-1], np.nan)
    silent = np.isnan(reduced).any(axis=-1)
    squares = (np.square(recorded - other) for other in (reduced, 0.0, 1.0))
    apart = [np.sqrt(np.mean(one, axis=-1)) for one in squares]
    return np.where(silent, np.maximum(apart[1], apart[2]), apart[0])


def _modulate(energy: Samples, rate_hz: float) -> tuple[Samples, NDArray[np.complex128], Samples]:
    """Mean and spectrum of an envelope above 0 to 50 Hz, (...) and (..., k), and the rates of modulation in Hz."""
    from scipy import fft

    length = energy.shape[-1]
    rates_hz = np.arange(1, length // 2 + 1) * (rate_hz / length)
    slow = slice(1, 1 + int(np.searchsorted(rates_hz, FASTEST_HZ * (1 + 1e-12), side="right")))
    spectrum = fft.rfft(np.sqrt(energy))
    return spectrum[..., 0].real, spectrum[..., slow], rates_hz[: slow.stop - 1]


BLOCK_S = 0.064
PUBLISHED_HZ = 8000.0
SUPPORT_DB = 12.0
"""Spread of the normal distribution by which a level over the threshold counts as felt."""

TEMPORAL_SHARE = 2 / 3  # Exponent of ST-SIM's temporal part; the spectral part has the rest
SLOPE, OFFSET = 0.3, -2.0  # Of SPQI's step from an error in dB to a score

# A block that is nowhere felt with more than this chance is silent.
_NOT_FELT = 1e-6
_SILENT = 1e-12


def st_sim(pair: Pair) -> Samples:
    r"""Measure the spectral temporal similarity [4]_, 0 to 1.

    With :math:`p(f) = \Phi(L(f) / 12)` the chance that a level L over the threshold is felt, p of the recording and q
    of the reduced signal, r the share of the block's motion (its mean removed) that goes along with the reduced
    signal, and means over blocks of 64 ms (see the module for what differs from the original, and why),

    .. math:: M = \left( \overline{r} \right)^{2/3} \left(
        \overline{\sum_f p q / \max\left(\sum_f p^2, \sum_f q^2\right)} \right)^{1/3}, \qquad
        r = \frac{\|a s\|}{\|a\|_F \|s\|}

    The unit matters: samples must be in m/s². 0 for a silent reduced signal. NaN if no block of the recording can be
    felt.
    """
    from scipy.special import ndtr

    blocks = _cut(pair)
    if blocks is None:
        return np.full(pair.nothing.shape, np.nan)
    felt = [ndtr((_decibels(power) - blocks.threshold) / SUPPORT_DB) for power in blocks.powers]
    there = np.maximum(felt[0].max(axis=-1), felt[1].max(axis=-1)) > _NOT_FELT
    own, kept = (np.einsum("...k,...k->...", one, one) for one in felt)
    both = np.einsum("...k,...k->...", *felt)
    most = np.maximum(own, kept)
    spectral = both / np.where(most > 0, most, 1.0)
    similarity = [_mean(one, there) for one in (_go_along(blocks), spectral)]
    heard = felt[0].max(axis=(-1, -2), initial=0.0) > _NOT_FELT
    value = similarity[0] ** TEMPORAL_SHARE * similarity[1] ** (1 - TEMPORAL_SHARE)
    return pair.settle(np.where(heard, np.minimum(np.asarray(value), 1.0), np.nan))


def spqi(pair: Pair) -> Samples:
    r"""Measure the spectral perceptual quality index [5]_, 0 to 1.

    With W the energies over the threshold of a block's frequencies, of the recording and of the reduced signal, and a
    mean over blocks of 64 ms (see the module for what differs from the original, and why),

    .. math:: D = 10 \log_{10} \frac{\sum_f |W_s - W|}{\sum_f W} \mathrm{dB}, \qquad
        M = \overline{\tfrac{1}{2} \left( 1 - \tanh(0.3 D + 2) \right)}

    A silent reduced signal scores (1 - tanh 2) / 2 = 0.018, as does one of twice the energy: both are errors of 0 dB.
    An error of -6.7 dB, a fifth of the energy lacking or in excess, scores 1/2. One factor on both changes nothing.
    """
    blocks = _cut(pair)
    if blocks is None:
        return np.full(pair.nothing.shape, np.nan)
    weights = 10 ** (-blocks.threshold / 10)
    own, kept = (power @ weights for power in blocks.powers)
    apart = np.abs(blocks.powers[1] - blocks.powers[0]) @ weights
    floor = _SILENT * np.maximum(own, kept).max(axis=-1, keepdims=True)
    silent = own <= floor
    error = _decibels(apart / np.where(silent, 1.0, own))
    scores = np.where(silent, 0.0, (1 - np.tanh(SLOPE * error - OFFSET)) / 2)
    return pair.settle(_mean(scores, np.maximum(own, kept) > floor))


class _Blocks(NamedTuple):
    """Samples (..., 3, m, length) and (..., m, length), powers (..., m, n_frequencies) of both, a threshold in dB."""

    samples: Samples
    reduced: Samples
    powers: tuple[Samples, Samples]
    threshold: Samples


def _cut(pair: Pair) -> _Blocks | None:
    """Cut both signals into blocks; None if there is no whole one."""
    from scipy import fft

    n = pair.samples.shape[-1]
    length = max(round(BLOCK_S * pair.rate_hz), 2)
    if n < length:
        return None
    frequencies = np.arange(length) * (pair.rate_hz / (2 * length))
    kept = slice(int(np.searchsorted(frequencies, PUBLISHED_HZ / 2)))
    curve = np.log10(frequencies[kept] / 550 + 6 / 11) / math.log10(6 / 11)
    whole = n // length * length
    cut, powers = [], []
    for signal in (pair.samples, pair.reduced):
        blocks = signal[..., :whole].reshape(*signal.shape[:-1], -1, length)
        spectrum = fft.rfft(blocks, 2 * length)[..., kept]
        power = np.square(spectrum.real) + np.square(spectrum.imag)
        cut.append(blocks)
        powers.append(power * (BLOCK_S * PUBLISHED_HZ / length**2))
    both = powers[0].sum(axis=-3), powers[1]
    return _Blocks(cut[0], cut[1], both, np.minimum(62 * curve**2 - 77, 0.0))


def _go_along(blocks: _Blocks) -> Samples:
    """Share of the recording's motion that goes along with the reduced signal, (..., m); 0 where one is silent."""
    samples, reduced = (one - one.mean(axis=-1, keepdims=True) for one in blocks[:2])
    together = np.einsum("...imt,...mt->...im", samples, reduced)
    strength = np.einsum("...imt,...imt->...m", samples, samples)
    strength *= np.einsum("...mt,...mt->...m", reduced, reduced)
    share = np.einsum("...im,...im->...m", together, together)
    share /= np.where(strength > 0, strength, 1.0)
    return np.asarray(np.sqrt(np.minimum(share, 1.0)))


def _decibels(energy: Samples) -> Samples:
    return 10 * np.log10(energy, out=np.full(energy.shape, -np.inf), where=energy > 0)


def _mean(values: Samples, there: Samples) -> Samples:
    """Mean over the blocks that are there; 0 if none is."""
    return np.asarray(np.where(there, values, 0.0).sum(axis=-1) / np.maximum(there.sum(axis=-1), 1))


SILENT = "the recording has no energy from 20 to 1000 Hz, or is too short for any frequency there"
SHORT = f"{SILENT}, or is shorter than a block of 64 ms"


class Rival(NamedTuple):
    """A rival metric of pairs, and the reason where it is NaN."""

    measure: Callable[[Pair], Samples]
    reason: str = SILENT


_ALL = (
    Rival(level_difference),
    Rival(log_spectral_distance),
    Rival(pacinian_power_difference),
    Rival(envelope_correlation, f"{SILENT}, or its envelope does not vary at up to 50 Hz"),
    Rival(modulation_distance, f"{SILENT}, or is shorter than 20 ms"),
    Rival(st_sim, f"{SHORT}, or cannot be felt (samples in m/s^2?)"),
    Rival(spqi, SHORT),
)

RIVALS: Registry[Rival] = Registry("rival metric", {one.measure.__name__: one for one in _ALL})
"""Name -> rival metric, the baseline first."""
