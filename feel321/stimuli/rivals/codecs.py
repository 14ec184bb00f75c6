r"""Metrics of compressed vibrations, made for codecs: ST-SIM and SPQI, for three axes and one.

Both cut signals into blocks of 64 ms (512 samples at 8 kHz) and weigh spectra by the same threshold, in dB over 1 m/s²:
:math:`T(f) = 62 \, (\log_{10}(f / 550 + 6 / 11) / \log_{10}(6 / 11))^2 - 77`, at most 0: lowest at 250 Hz. The
publications were not available; the formulas are second-hand, read from the code of VibroMAF 0.0.8 [3]_ (by authors of
both), and its numbers are met where neither of the following matters:

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
.. [1] R. Hassen, E. Steinbach, "Subjective evaluation of the spectral temporal SIMilarity (ST-SIM) measure for
   vibrotactile quality assessment", IEEE Transactions on Haptics 13(1), 2020.
.. [2] A. Noll, M. Hofbauer, E. Muschter, S.-C. Li, E. Steinbach, "Automated quality assessment for compressed
   vibrotactile signals using multi-method assessment fusion", IEEE Haptics Symposium 2022.
   doi:10.1109/HAPTICS52432.2022.9765599
.. [3] VibroMAF 0.0.8, https://pypi.org/project/vibromaf/
"""

import math
from typing import NamedTuple

import numpy as np

from feel321.stimuli.rivals.pairs import Pair
from feel321.types import Samples

BLOCK_S = 0.064
PUBLISHED_HZ = 8000.0
SUPPORT_DB = 12.0
"""Spread of the normal distribution by which a level over the threshold counts as felt."""

TEMPORAL_SHARE = 2 / 3
"""Exponent of ST-SIM's temporal part; the spectral part has the rest."""

SLOPE, OFFSET = 0.3, -2.0
"""Of SPQI's step from an error in dB to a score."""

# A block that is nowhere felt with more than this chance is silent.
_NOT_FELT = 1e-6
_SILENT = 1e-12


def st_sim(pair: Pair) -> Samples:
    r"""Measure the spectral temporal similarity [1]_, 0 to 1.

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
    scale = np.log10(np.broadcast_to(pair.scale, (*pair.nothing.shape, 1)))[..., None] * 20
    felt = [
        ndtr((_decibels(power) - scale - blocks.threshold) / SUPPORT_DB) for power in blocks.powers
    ]
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
    r"""Measure the spectral perceptual quality index [2]_, 0 to 1.

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
