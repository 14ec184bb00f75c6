"""Match metrics: the share of a recording's spectrum and waveform that a reduced signal keeps.

Conventions: acceleration (3, n_samples) and reduced (n_samples,), both finite, in any common unit; every metric is
called alike, `METRICS[name](acceleration, reduced, rate_hz)`, and 1 is a perfect match. Those of the paper have a
`..._details` form that says what the figure rests on.

- `spectral_match` (eq. 1): 1 minus the mean relative deviation of the smoothed energy spectra. At most 1; it may be
  negative, and very much so where the reduced signal has energy in bands in which the recording has almost none.
- `spectral_match_bounded`: the same with each deviation taken relative to the stronger of the two spectra, so that no
  frequency can count for more than 1. 0 to 1, equal to eq. 1 wherever the reduced signal is the weaker one.
- `temporal_match` (eq. 2): mean absolute correlation, at zero lag, of the reduced signal with each axis. 0 to 1. No
  mean is removed: an offset counts as signal, as in the paper.
- `temporal_match_windowed`: the same in windows of 0.1 s, averaged by energy. 0 to 1.

Where there is nothing to match (no frequency from 20 to 1000 Hz with energy, a silent recording) a match is NaN, never
1 or 0, and the details hold the reason. A silent reduced signal of a recording that is not silent scores 0.

Spectra are one-sided energy spectral densities on the DFT's grid, shape (..., n_bins), bin k at
k * rate_hz / n_samples; frequencies in Hz.

The kernel is a rectangle (Daniell smoothing) of full width 0.22 f around f: the Weber fraction of vibration frequency.
The paper used MATLAB's `spafdr` with that width as its *resolution*. MATLAB does not document its kernel's shape; the
match metrics depend on it little, because both spectra are smoothed alike.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 3. doi:10.1007/978-3-642-14075-4_12
.. [2] P. J. Daniell, discussion, Journal of the Royal Statistical Society (Supplement) 8, 1946, 88-90.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from feel321.records import Result
from feel321.stimuli import recording
from feel321.types import Samples

Signal: TypeAlias = recording.Signal

WEBER_FRACTION = 0.22
"""Smallest relative change of vibration frequency that people notice; full width of the smoothing over its centre."""

LOWEST_HZ = 20.0
HIGHEST_HZ = 1000.0  # Range in which Pacinian corpuscles, and so the metrics, are sensitive

NUMERICAL_FLOOR = 1e-12
"""Frequencies whose smoothed energy is below this share of the recording's mean energy per bin are left out: there the
spectrum is the rounding error of the transforms, not a vibration."""


def energy_spectrum(samples: Samples, bins: slice = slice(None)) -> Samples:
    """Compute the energy of signals, (..., n_samples), at every DFT frequency or at some of them: (..., n_bins)."""
    from scipy import fft

    spectrum = fft.rfft(samples)[..., bins]
    energy = np.square(spectrum.real)
    energy += np.square(spectrum.imag)
    return energy


def linear_grid(n_samples: int, rate_hz: float) -> Samples:
    """DFT frequencies from 20 Hz to 1000 Hz, or to the Nyquist frequency if that is lower; possibly none.

    Examples
    --------
    >>> linear_grid(10, 300.0)
    array([ 30.,  60.,  90., 120., 150.])
    """
    spacing = rate_hz / n_samples
    # The tolerance keeps a frequency that is 20 Hz or 1000 Hz but for the rounding of the rate.
    first = int(np.ceil(LOWEST_HZ / spacing * (1 - 1e-12)))
    last = int(np.floor(min(HIGHEST_HZ / spacing * (1 + 1e-12), n_samples / 2)))
    return np.arange(first, last + 1, dtype=np.float64) * spacing


PER_OCTAVE = 24  # Points of a logarithmic grid


def log_grid(n_samples: int, rate_hz: float) -> Samples:
    """Logarithmically spaced frequencies, 24 per octave, over the same range as `linear_grid`; possibly none."""
    lowest, highest = max(LOWEST_HZ, rate_hz / n_samples), min(HIGHEST_HZ, rate_hz / 2)
    if lowest > highest:
        return np.zeros(0)
    n_points = int(np.log2(highest / lowest) * PER_OCTAVE) + 1
    return lowest * 2.0 ** (np.arange(n_points) / PER_OCTAVE)


class WeberSmoothing:
    """Running mean over 0.22 f around f, for one grid: O(n), without loops or matrices over frequencies.

    Each bin's energy is spread evenly over one spacing, so the window's edges may cut bins. A window narrower than one
    spacing gives the bin itself; one that reaches beyond the last bin is cut off there and averaged over what is left.
    Bins far below the lowest frequency, the offset among them, never enter the running sum, and the sum is kept in
    extended precision where the platform has it: a strong tone costs its weak neighbours no accuracy.
    """

    def __init__(self, frequencies_hz: Samples, spacing_hz: float, n_bins: int) -> None:
        centre = frequencies_hz / spacing_hz + 0.5
        half = np.maximum(WEBER_FRACTION / 2 * frequencies_hz / spacing_hz, 0.5)
        low, high = np.maximum(centre - half, 0.0), np.minimum(centre + half, float(n_bins))
        first = int(low[0]) if len(low) else 0
        last = min(int(np.ceil(high[-1])) + 1, n_bins) if len(high) else 0
        self.bins = slice(first, last)
        # Edges of the windows in the running sum: a number of whole bins, and a share of the next.
        edges = np.stack([low, high]) - first
        self._edges = np.clip(edges.astype(np.intp), 0, max(last - first - 1, 0))
        self._shares = edges - self._edges
        self._width = high - low

    def __call__(self, spectrum: Samples) -> Samples:
        """Smooth spectra: (..., number of `bins`) in, (..., n_frequencies) out."""
        running = np.zeros((*spectrum.shape[:-1], spectrum.shape[-1] + 1), dtype=np.longdouble)
        np.cumsum(spectrum, axis=-1, out=running[..., 1:])
        (low, high), (below, above) = self._edges, self._shares
        whole = (running[..., high] - running[..., low]).astype(np.float64)
        cut = above * spectrum[..., high] - below * spectrum[..., low]
        return np.asarray((whole + cut) / self._width)


class OriginalSpectrum:
    """The smoothed spectrum of one recording, ready to be compared with many reduced signals.

    The sum of the axes' energies does not change when the sensor is turned, so one such spectrum serves every
    orientation. Samples are (3, n_samples) with n_samples >= 1; or many recordings, (..., 3, n_samples), each of which
    is compared with a reduced signal of its own.
    """

    def __init__(self, samples: Samples, rate_hz: float) -> None:
        self._samples, n = samples, samples.shape[-1]
        frequencies = linear_grid(n, rate_hz)
        self._smooth = WeberSmoothing(frequencies, rate_hz / n, n // 2 + 1)
        # Axis by axis: three spectra at once cost more in fresh memory than they save in calls.
        first, *others = np.moveaxis(samples, -2, 0)
        self._spectrum = energy_spectrum(first, self._smooth.bins)
        for axis in others:
            self._spectrum += energy_spectrum(axis, self._smooth.bins)
        # By Parseval's theorem the mean energy per bin of the two-sided spectrum is the energy in time.
        self._energy = recording.add_squares(samples, 2)
        self._smoothed = self._smooth(self._spectrum)
        self._used = self._smoothed > NUMERICAL_FLOOR * self._energy[..., None]
        if samples.ndim > 2:  # noqa: PLR2004 - axes x samples
            return
        self.smoothed = self._smoothed[self._used]
        self.frequencies_hz = frequencies[self._used]
        self.n_left_out = int(np.count_nonzero(~self._used))

    @property
    def reason(self) -> str:
        """Why `match` is NaN; empty where it is not."""
        if len(self.smoothed):
            return ""
        if len(self._smoothed):
            return (
                "the recording has no energy from 20 to 1000 Hz: it is silent there, or its offset, a million times "
                "larger, must be removed first"
            )
        short = "the recording is too short, or its rate too low"
        return f"{short}, for any frequency from 20 to 1000 Hz"

    def describe(self, reduced: Samples) -> SpectralMatch:
        """Match one reduced signal, frequency by frequency."""
        difference = self._subtract(reduced)
        apart = difference[self._used]
        used = self.frequencies_hz
        return SpectralMatch(
            value=float(self._relate(difference)),
            lowest_hz=float(used[0]) if len(used) else np.nan,
            highest_hz=float(used[-1]) if len(used) else np.nan,
            n_frequencies=len(used),
            n_left_out=self.n_left_out,
            bounded=float(self._relate_bounded(np.einsum("n,n->", reduced, reduced), difference)),
            reason=self.reason,
            frequencies_hz=used,
            energy=self.smoothed,
            energy_reduced=self.smoothed - apart,
            deviation=np.abs(apart) / self.smoothed,
        )

    def match(self, reduced: Samples) -> Samples:
        """Spectral match of reduced signals, (..., n_samples); NaN where no frequency can be compared."""
        return self._relate(self._subtract(reduced))

    def match_both(self, reduced: Samples) -> tuple[Samples, Samples]:
        """Spectral match and bounded spectral match, from one spectrum of each reduced signal."""
        difference = self._subtract(reduced)
        energy = np.einsum("...n,...n->...", reduced, reduced)
        return self._relate(difference), self._relate_bounded(energy, difference)

    def match_sums(self, weights: Samples, energy: Samples) -> tuple[Samples, Samples]:
        """Match weighted sums of the axes as `match_both`, without their spectra; weights: (..., 3), energy: (...)."""
        first, second = np.triu_indices(recording.AXES)
        own = np.where(first == second, 1.0, 0.0)
        shares = (2 - own) * (own - weights[..., first] * weights[..., second])
        difference = shares @ self._products
        return self._relate(difference), self._relate_bounded(energy, difference)

    @cached_property
    def _products(self) -> Samples:
        """Smoothed products of the spectra of every two axes, (6, n_frequencies)."""
        from scipy import fft

        first, second = np.triu_indices(recording.AXES)
        spectra = fft.rfft(self._samples)[..., self._smooth.bins]
        return self._smooth((spectra[first] * spectra[second].conj()).real)

    def _subtract(self, reduced: Samples) -> Samples:
        """Smoothed energy of the recording minus that of the reduced signals, shape (..., n_frequencies)."""
        # The difference is taken before it is smoothed: what two equal spectra share cancels without rounding.
        difference = energy_spectrum(reduced, self._smooth.bins)
        np.subtract(self._spectrum, difference, out=difference)
        return self._smooth(difference)

    def _relate(self, difference: Samples) -> Samples:
        count = self._used.sum(axis=-1)
        share = np.zeros_like(difference)
        np.divide(np.abs(difference), self._smoothed, out=share, where=self._used)
        return np.where(count > 0, 1.0 - share.sum(axis=-1) / np.maximum(count, 1), np.nan)

    def _relate_bounded(self, energy: Samples, difference: Samples) -> Samples:
        strongest = self._smoothed + np.maximum(-difference, 0.0)  # max(E, S) = E + max(S - E, 0)
        energy = np.maximum(energy, self._energy)
        used = self._used | (strongest > NUMERICAL_FLOOR * energy[..., None])
        deviation = np.zeros_like(strongest)
        np.divide(np.abs(difference), strongest, out=deviation, where=used)
        count = used.sum(axis=-1)
        match = 1.0 - np.minimum(deviation, 1.0).sum(axis=-1) / np.maximum(count, 1)
        return np.where(count > 0, np.maximum(match, 0.0), np.nan)


_SILENT = 1e-12


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class SpectralMatch(Result):
    """A spectral match and the frequencies it rests on.

    Parameters
    ----------
    value : float
        Spectral match; NaN if no frequency could be compared.
    lowest_hz, highest_hz : float
        Range that was compared, in Hz; NaN if there was none.
    n_frequencies, n_left_out : int
        Frequencies compared, and left out below the numerical floor.
    bounded : float
        Bounded spectral match.
    reason : str
        Why the match is NaN; empty where it is not.
    frequencies_hz, energy, energy_reduced, deviation : ndarray, shape (n_frequencies,)
        Frequencies compared, the smoothed energy of both signals there, and the relative deviation that eq. 1 averages.
    """

    value: float
    lowest_hz: float
    highest_hz: float
    n_frequencies: int
    n_left_out: int
    bounded: float
    reason: str
    frequencies_hz: Samples
    energy: Samples
    energy_reduced: Samples
    deviation: Samples


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class TemporalMatch(Result):
    """A temporal match and the axes it rests on.

    Parameters
    ----------
    value : float
        Temporal match; NaN if all three axes are silent.
    correlations : tuple of float
        Absolute correlation with each axis; NaN for a silent one.
    silent_axes : tuple of int
        The silent axes, from 0: those whose norm is below 1e-12 of the strongest axis's.
    silent_reduced : bool
        Whether the reduced signal is silent.
    reason : str
        Why the match is NaN; empty where it is not.
    """

    value: float
    correlations: tuple[float, float, float]
    silent_axes: tuple[int, ...]
    silent_reduced: bool
    reason: str = ""


def spectral_match(acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None) -> float:
    r"""Compute how well a reduced signal keeps the energy of all three axes at every frequency (eq. 1).

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples), or Recording
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, same unit.
    rate_hz : float, optional
        Sampling rate in Hz, unless a Recording is given.

    Returns
    -------
    float
        1 if the smoothed spectra agree, 0 for silence, negative for more than twice the energy on average; NaN for a
        recording without energy, or without any frequency, from 20 to 1000 Hz (`spectral_match_details` says which).

    Notes
    -----
    With :math:`\tilde E` the energy spectral density smoothed over 22 % of the frequency (`WeberSmoothing`),

    .. math:: M_{sm} = 1 - \frac{1}{n_f} \sum_{f = 20\,\mathrm{Hz}}^{1000\,\mathrm{Hz}}
        \frac{|\tilde E_x + \tilde E_y + \tilde E_z - \tilde E_s|}{\tilde E_x + \tilde E_y + \tilde E_z}

    References
    ----------
    .. [1] Landin et al. 2010, equation 1. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> u = np.sin(np.arange(1000))
    >>> round(stimuli.spectral_match([u, u, u], u, 1000), 9)
    0.333333333
    >>> round(stimuli.spectral_match([u, u, u], u + u + u, 1000), 9)
    -1.0
    """
    original, signal = _compare(acceleration, reduced, rate_hz)
    return float(original.match(signal))


def spectral_match_details(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> SpectralMatch:
    """Compute both spectral matches, and show them frequency by frequency.

    Parameters
    ----------
    acceleration, reduced, rate_hz : as for `spectral_match`
        What is compared.

    Returns
    -------
    SpectralMatch
        The matches, the frequencies compared, the energy of both signals there, and why a match is NaN.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scene = stimuli.make_scene("bumps", duration_s=1)
    >>> found = stimuli.spectral_match_details(scene, stimuli.reduce(scene, "say321"))
    >>> found.n_frequencies, bool(abs(1 - found.deviation.mean() - found.value) < 1e-12)
    (981, True)
    """
    original, signal = _compare(acceleration, reduced, rate_hz)
    return original.describe(signal)


def spectral_match_bounded(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the spectral match with deviations relative to the stronger spectrum: eq. 1, bounded by 0 and 1.

    Parameters
    ----------
    acceleration, reduced, rate_hz : as for `spectral_match`
        What is compared.

    Returns
    -------
    float
        0 to 1: 1 if the smoothed spectra agree, 0 if one signal is silent wherever the other is not; NaN if there is no
        frequency from 20 to 1000 Hz at which either has energy.

    Notes
    -----
    With E the sum of the axes' smoothed energy spectral densities and S that of the reduced signal, both as in
    `spectral_match`, and the mean over the same frequencies,

    .. math:: M_{sb} = 1 - \frac{1}{n_f} \sum_{f = 20\,\mathrm{Hz}}^{1000\,\mathrm{Hz}} \frac{|E - S|}{\max(E, S)}
        = \frac{1}{n_f} \sum_f \frac{\min(E, S)}{\max(E, S)}

    - Where S <= E everywhere it is the paper's eq. 1. Ten times the energy scores 1/10, where eq. 1 gives -8: eq. 1 has
      no lower bound, so that a few frequencies of a few stimuli decide a mean or a slope.
    - It is symmetric in E and S; one factor on both signals, and turning the sensor, do not change it.
    - Eq. 1 leaves out frequencies at which the recording has no energy (below 1e-12 of its mean energy per bin). Here
      energy that the reduced signal adds to empty bands counts as a deviation of 1.

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> u = np.sin(np.arange(1000))
    >>> round(stimuli.spectral_match_bounded([u, u, u], u + u + u, 1000), 9)
    0.333333333
    """
    original, signal = _compare(acceleration, reduced, rate_hz)
    return float(original.match_both(signal)[1])


def temporal_match(acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None) -> float:
    r"""Compute how well peaks and sudden changes of the reduced signal coincide with those of the axes (eq. 2).

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples), or Recording
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, any unit.
    rate_hz : float, optional
        Not used by this metric; every metric takes it so that all are called alike.

    Returns
    -------
    float
        0 to 1: mean of the absolute correlations with the axes that are not silent; 0 for a silent reduced signal; NaN
        for a silent recording, in which there is nothing to match.

    Notes
    -----
    .. math:: M_{tm} = \frac{1}{3} \sum_{i \in x,y,z} \frac{|a_i \cdot a_s|}{\|a_i\| \, \|a_s\|}

    References
    ----------
    .. [1] Landin et al. 2010, equation 2. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.temporal_match([[1, 0], [0, 1], [0, 0]], [1, 0])
    0.5
    """
    return temporal_match_details(acceleration, reduced, rate_hz).value


def temporal_match_details(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> TemporalMatch:
    """Compute `temporal_match`, and show it axis by axis.

    Parameters
    ----------
    acceleration, reduced, rate_hz : as for `temporal_match`
        What is compared.

    Returns
    -------
    TemporalMatch
        The match, the absolute correlation with each axis, the silent axes, and why the match is NaN.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.temporal_match_details([[3, 4], [4, 3], [0, 0]], [3, 4]).silent_axes
    (2,)
    """
    given, rate = recording.as_pair(acceleration, reduced, rate_hz, otherwise=1.0)
    samples, _ = recording.admit(given, rate)
    signal = recording.check_reduced(reduced, samples.shape)
    correlations = axis_correlations(samples, signal)
    x, y, z = (float(r) for r in correlations)
    silent = tuple(int(axis) for axis in np.flatnonzero(np.isnan(correlations)))
    reason = "all three axes of the recording are silent" if len(silent) == len("xyz") else ""
    value = float(mean_over_axes(correlations))
    return TemporalMatch(value, (x, y, z), silent, not signal.any(), reason)


def mean_over_axes(correlations: Samples) -> Samples:
    """Mean over the axes that are not silent: (..., 3) in, (...) out, NaN where all axes are silent."""
    moving = ~np.isnan(correlations)
    count = moving.sum(axis=-1)
    mean = np.where(moving, correlations, 0.0).sum(axis=-1) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def axis_correlations(samples: Samples, reduced: Samples) -> Samples:
    """Absolute correlation at zero lag of reduced signals, (..., n), with each axis: (..., 3), NaN for silent axes."""
    together = np.einsum("...in,...n->...i", samples, reduced)
    energies = np.einsum("...in,...in->...i", samples, samples)
    return relate_axes(together, energies, np.einsum("...n,...n->...", reduced, reduced))


def relate_axes(together: Samples, energies: Samples, energy: Samples) -> Samples:
    """Absolute correlations (..., 3), from products with each axis (..., 3), the axes' energies and the signal's."""
    together, norms, norm = np.abs(together), np.sqrt(energies), np.sqrt(energy)[..., None]
    silent = norms <= _SILENT * norms.max(axis=-1, keepdims=True)
    scale = norms * np.where(norm > 0, norm, 1.0)
    return np.where(silent, np.nan, np.minimum(together / np.where(silent, 1.0, scale), 1.0))


WINDOW_S = 0.1
"""Window of `temporal_match_windowed`, about: two periods of 20 Hz, the slowest vibration that is felt."""


def temporal_match_windowed(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the temporal match (eq. 2) in windows of about 0.1 s, averaged by the recording's energy.

    Parameters
    ----------
    acceleration, reduced, rate_hz : as for `spectral_match`
        What is compared.

    Returns
    -------
    float
        0 to 1, as for `temporal_match`: 0 for a silent reduced signal, NaN for a silent recording.

    Notes
    -----
    Where the axis of the motion turns, a signal that follows it correlates with each component in one part of the
    recording and not, or negatively, in another: over the whole recording the products cancel, however well every
    moment is kept. So the recording is cut into as many equal windows w as come nearest to 0.1 s each, and with
    :math:`M_{tm}(w)` equation 2 in a window and :math:`E_w` the energy of all axes there,

    .. math:: M_{tw} = \frac{\sum_w E_w \, M_{tm}(w)}{\sum_w E_w}

    - In less than two periods of 20 Hz any two waveforms correlate; in much longer windows the axis turns. Two
      unrelated signals that fill the felt band score about 0.06, and more if their band is narrower.
    - A reduced signal may change its sign from window to window at no cost, as the skin does not feel the direction;
      eq. 2 is what notices that. A change within a window is noticed by both.
    - A recording of up to 0.15 s is one window: there it is eq. 2. It changes with the mounting, as eq. 2 does.

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> u = np.sin(np.arange(2000))
    >>> first = np.arange(2000) < 1000
    >>> turning = np.array([u * first, u * ~first, 0 * u])
    >>> round(stimuli.temporal_match(turning, u), 2), round(stimuli.temporal_match_windowed(turning, u, 1000), 2)
    (0.71, 1.0)
    """
    given, rate = recording.as_pair(acceleration, reduced, rate_hz)
    samples, _ = recording.admit(given, rate)
    signal = recording.check_reduced(reduced, samples.shape)
    return float(match_in_windows(samples, signal, float(rate)))


def match_in_windows(samples: Samples, reduced: Samples, rate_hz: float) -> Samples:
    """Compute `temporal_match_windowed` of recordings (..., 3, n) and as many reduced signals (..., n): (...)."""
    n = samples.shape[-1]
    if not n:
        return np.full(samples.shape[:-2], np.nan)
    count = min(max(1, round(n / rate_hz / WINDOW_S)), n)
    starts = np.arange(count) * n // count
    products = (samples * reduced[..., None, :], np.square(samples), np.square(reduced))
    together, energies, own = (np.add.reduceat(one, starts, axis=-1) for one in products)
    of_axes = relate_axes(np.swapaxes(together, -1, -2), np.swapaxes(energies, -1, -2), own)
    weights = energies.sum(axis=-2)
    total = weights.sum(axis=-1)
    share = np.nan_to_num(mean_over_axes(of_axes)) * weights
    unknown = np.full_like(total, np.nan)
    return np.asarray(np.divide(share.sum(axis=-1), total, out=unknown, where=total > 0))


PLANNED = ("spectral_match_bounded", "temporal_match")
"""The metrics of the primary analysis, unless a study declares others."""


def _compare(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None
) -> tuple[OriginalSpectrum, Samples]:
    """Check a pair, and return the recording's spectrum and the reduced signal."""
    given, rate = recording.as_pair(acceleration, reduced, rate_hz)
    samples, _ = recording.admit(given, rate)
    signal = recording.check_reduced(reduced, samples.shape)
    return OriginalSpectrum(samples, float(rate)), signal
