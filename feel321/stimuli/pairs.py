"""A recording and a reduced signal, or batches of both, with the spectra that several rival metrics share.

Conventions: acceleration (..., 3, n) and reduced (..., n), finite, in one unit; what a rival measures has the shape
(...). A recording enters through sums over its axes that no rotation of the sensor changes, unless a metric says
otherwise: where a method was published for one axis, it comes out as published if two axes are silent. The felt range
is that of the match metrics, 20 to 1000 Hz or the Nyquist frequency.

- A recording without energy in the felt range leaves nothing to compare: NaN, as for the match metrics.
- Levels further apart than `MOST_DB` count as that far apart. People feel vibrations over some 55 dB, from threshold
  to discomfort: beyond, one of the two is as good as silent. So a silent reduced signal has a value, and it is finite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feel321.names import MOST_DB
from feel321.stimuli import recording
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    NUMERICAL_FLOOR,
    WEBER_FRACTION,
    WeberSmoothing,
    linear_grid,
)
from feel321.types import Samples

_BEYOND_COMPARISON = 1e80


@dataclass(frozen=True)
class Pair:
    """Checked samples (..., 3, n) and a reduced signal (..., n), both scaled alike into a safe range.

    scale: what both were multiplied by, (..., 1): a power of two, nearly always 1.
    """

    samples: Samples
    reduced: Samples
    rate_hz: float
    scale: Samples | float = 1.0

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
        axes, reduced = (
            np.square(spectrum.real) + np.square(spectrum.imag) for spectrum in self.spectra
        )
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
    samples = np.asarray(given)
    return make_pairs(
        given, recording.check_reduced(reduced, samples.shape) if samples.ndim else reduced, rate
    )


def make_pairs(acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float) -> Pair:
    """Check recordings (..., 3, n) and as many reduced signals (..., n)."""
    admitted = recording.admit(acceleration, rate_hz)
    samples = admitted.samples
    signal = recording.coerce_real(reduced, "reduced")
    if signal.shape != (*samples.shape[:-2], samples.shape[-1]) or not samples.shape[-1]:
        raise ValueError(
            f"reduced must have the shape (..., n) of acceleration (..., 3, n), n >= 1; got {signal.shape} for "
            f"{samples.shape}"
        )
    recording.check_finite(signal, "reduced")
    scale: Samples | float = 1.0
    if admitted.exponents is not None:
        signal = np.ldexp(signal, -admitted.exponents)
        scale = np.ldexp(1.0, -admitted.exponents)
    if recording.largest(signal) > _BEYOND_COMPARISON:
        raise ValueError(
            "reduced is more than 1e80 times as strong as the recording; are they in the same unit?"
        )
    return Pair(samples, signal, float(rate_hz), scale)


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
    centres = _band_centres(n, pair.rate_hz)
    smooth = WeberSmoothing(centres, pair.rate_hz / n, n // 2 + 1)
    # What is left of a sum of energies may be negative by rounding.
    original, reduced = (
        np.maximum(smooth(energy[..., smooth.bins]), 0.0) for energy in pair.energies
    )
    return centres, original, reduced


def _band_centres(n_samples: int, rate_hz: float) -> Samples:
    """Middles of bands 22 % wide that fill the felt range; possibly none."""
    lowest, highest = max(LOWEST_HZ, rate_hz / n_samples), min(HIGHEST_HZ, rate_hz / 2)
    if lowest >= highest:
        return np.zeros(0)
    ratio = (2 + WEBER_FRACTION) / (2 - WEBER_FRACTION)
    n_bands = max(round(math.log(highest / lowest) / math.log(ratio)), 1)
    edges = np.geomspace(lowest, highest, n_bands + 1)
    return np.asarray((edges[1:] + edges[:-1]) / 2)
