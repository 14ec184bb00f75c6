"""Haptic anchors, and the sensation level of vibrations.

Audio's anchors are low-passed at 3.5 and 7 kHz; below 1 kHz that is no change at all. Here the energy of the recording
is put where the recording has least of it: a hum of two just noticeable bands (22 %), one at the quietest frequency of
those that are easily felt, with nine tenths of the energy, and one at the quietest of all:

- the *low* anchor is steady: wrong frequency, and nothing happens when the tool touches something;
- the *mid* anchor follows the recording's envelope: wrong frequency, but at the right times.

What correlates with an axis by chance is taken out, so the temporal match of both is 0. In a stimulus set they are
played at the sensation level of their recording, so that strength does not mark them, and never set the gain of other
stimuli: the envelope of a mid anchor is flattened until its peaks are no higher than the recording's, and an anchor
that still does not fit the headroom is played as strong as fits. `check_stimuli` refuses a set in which an anchor does
not score below every test stimulus of its recording on both metrics.

Anchors change continuously with the recording. Nothing is decided by a threshold, a smallest value or a phase that
rounding could change, and the random numbers depend on seed and names only: otherwise the same set would differ between
processors.

Detection of brief vibration sums energy over about 200 ms [3]_, so the level of a stimulus is that of its loudest
200 ms: silence before and after changes nothing.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015 (low
   and mid anchors).
.. [2] E. Muschter et al., "Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment", IEEE Transactions on Haptics 14(2), 2021 (hidden reference and anchors for vibrotactile signals).
   doi:10.1109/TOH.2021.3077191
.. [3] R. T. Verrillo, "Temporal summation in vibrotactile sensitivity", JASA 37(5), 1965. doi:10.1121/1.1909458
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from feel321.doors import Registry
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    NUMERICAL_FLOOR,
    WEBER_FRACTION,
    WeberSmoothing,
    energy_spectrum,
    log_grid,
)
from feel321.stimuli.recording import Recording, Signal, as_samples, largest
from feel321.stimuli.thresholds import CONTACTOR, acceleration_threshold
from feel321.types import Samples

WINDOW_S = 0.2
"""Energy is summed over this time."""

EDGE_OCTAVES = 0.5
"""In short windows the felt range ends gradually, or a brief vibration at 20 Hz would lose half its energy."""


def felt_level(
    signal: Signal, rate_hz: float | None = None, *, threshold: str = CONTACTOR
) -> float:
    """Compute the root mean square over the felt range, 20 to 1000 Hz, in units of the threshold; axes add by energy.

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (axes, n_samples)
        Acceleration in m/s²; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    threshold : str
        Name of `THRESHOLDS`.

    Returns
    -------
    float
        Level of the whole signal as a multiple of the threshold's root mean square; 0 for silence. It is no dB:
        20 log10 of it is, and `sensation_level_db` gives that of the loudest 200 ms.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> round(stimuli.felt_level(stimuli.make_scene("circular_motion")), 1)
    61.6
    """
    from scipy import fft

    acceleration, rate_hz = as_samples(signal, rate_hz)
    n = acceleration.shape[-1]
    # Silence at the end adds no energy, and lengths with large prime factors cost ten times as much.
    padded = fft.next_fast_len(n, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    weighted = np.abs(fft.rfft(acceleration, padded)) * _weigh(frequency, threshold=threshold)
    # One-sided bins stand for two, but for one at the Nyquist frequency.
    shares = np.where(2 * frequency < rate_hz * (1 - 1e-12), 2.0, 1.0)
    return float(np.sqrt(np.sum(shares * weighted**2) / n / padded))


def loudest_levels(
    acceleration: Samples,
    rate_hz: float,
    thresholds: Iterable[str] = (CONTACTOR,),
    *,
    shift_db: Callable[[Samples], Samples] | None = None,
) -> dict[str, float]:
    """Largest root mean square in any 200 ms, 20 to 1000 Hz, as a multiple of each threshold; axes add by energy.

    shift_db: how far a person's own threshold lies above each of these, by frequency in Hz.

    Before and after the signal is silence, so that appending some changes nothing, and a signal shorter than 200 ms
    has the level that its energy gives over 200 ms.
    """
    from scipy import fft

    window = max(round(WINDOW_S * rate_hz), 1)
    padded = fft.next_fast_len(acceleration.shape[-1] + window, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    # Far above the edge there is nothing to weigh; most bins of a rig's rate are there.
    felt = slice(np.searchsorted(frequency, 2 * HIGHEST_HZ))
    spectrum = fft.rfft(acceleration, padded)[..., felt]
    levels, summed = {}, np.zeros(padded + 1)
    for name in thresholds:
        weights = _weigh(frequency[felt], threshold=name, edge_octaves=EDGE_OCTAVES)
        if shift_db is not None:
            weights[1:] *= 10 ** (-shift_db(frequency[felt][1:]) / 20)  # nothing is felt at 0 Hz
        # In place: fresh memory of this size takes as long as the arithmetic.
        weighted = np.atleast_2d(fft.irfft(spectrum * weights, padded))
        np.square(weighted, out=weighted)
        energy = weighted[0] if len(weighted) == 1 else weighted.sum(axis=0)
        np.cumsum(energy, out=summed[1:])
        most = max(
            np.subtract(summed[window:], summed[:-window], out=energy[window - 1 :]).max(), 0.0
        )
        levels[name] = float(np.sqrt(most / window))
    return levels


def sensation_level_db(
    signal: Signal, rate_hz: float | None = None, *, threshold: str = CONTACTOR
) -> float:
    """Compute the sensation level: the level over the detection threshold of the loudest 200 ms.

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (axes, n_samples)
        Acceleration at the hand in m/s², as it is played; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    threshold : str
        Name of `THRESHOLDS`: `"contactor"` or `"grasped_stylus"`.

    Returns
    -------
    float
        dB over the threshold: of the 200 ms with the largest root mean square over the threshold, between 20 and 1000
        Hz; axes add by energy. 0 for a lasting sinusoid at its threshold, minus infinity for silence.

    Notes
    -----
    Energy is summed over about 200 ms [1]_, and over frequencies as multiples of each frequency's threshold.

    References
    ----------
    .. [1] R. T. Verrillo, "Temporal summation in vibrotactile sensitivity", JASA 37(5), 1965. doi:10.1121/1.1909458

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> time_s = np.arange(8000) / 8000
    >>> tone = 10 * stimuli.acceleration_threshold(250.0) * np.sin(2 * np.pi * 250 * time_s)
    >>> round(stimuli.sensation_level_db(tone, 8000.0))
    20
    """
    samples, rate = as_samples(signal, rate_hz)
    return to_db(loudest_levels(samples, rate, [threshold])[threshold])


def to_db(level: float) -> float:
    """Ratio of amplitudes in dB; minus infinity for 0."""
    return 20 * float(np.log10(level)) if level > 0 else -np.inf


def _weigh(frequency_hz: Samples, *, threshold: str, edge_octaves: float = 0.0) -> Samples:
    """Weight of each frequency: the threshold's RMS inverted from 20 to 1000 Hz, falling to 0 over the edges beyond."""
    weights = np.zeros_like(frequency_hz)
    beyond = np.full_like(frequency_hz, np.inf)
    above = frequency_hz > 0
    beyond[above] = np.maximum(
        np.log2(LOWEST_HZ / frequency_hz[above]), np.log2(frequency_hz[above] / HIGHEST_HZ)
    )
    felt = beyond <= edge_octaves * (1 - 1e-12)
    weights[felt] = np.sqrt(2) / acceleration_threshold(frequency_hz[felt], threshold=threshold)
    if edge_octaves:
        weights[felt] *= np.cos(np.pi / 2 * np.maximum(beyond[felt], 0.0) / edge_octaves)
    return weights


EASILY_FELT = 2.0
"""Acceleration thresholds up to this multiple of the lowest count as easily felt: up to 250 Hz."""

ENVELOPE_HZ = 50.0
"""Envelopes are followed up to this frequency: equal energy in shorter segments is hard to tell apart."""

FAINT = 0.1
"""Share of the energy in the quietest band of all: it may hardly be felt, so more would cost headroom for nothing."""

PRECEDENCE = 1000
"""A band with 1 % more energy than the quietest gets exp(-10) of its share; bands that differ by rounding share."""

LOWEST_SHARE = 1e-30
"""Bands with less of the energy are left out: 300 dB below the hum."""

DRIFT_HZ = (3.0, 12.0)
DRIFTS = 8
"""A hum's frequency drifts within its band by so many sinusoids, whose rates are drawn from this range."""

RIDGE = 1e-14
PASSES = 3
"""Axes that are parallel but for rounding are not told apart, without a threshold that rounding could cross."""

MARGIN = 0.95
"""A mid anchor's peaks are kept to this share of its recording's, for what resampling adds."""


def low_anchor(
    recording: Recording, rng: np.random.Generator, *, threshold: str = CONTACTOR
) -> Samples:
    """Make a steady hum with the recording's energy, where the recording has least."""
    del threshold  # its peaks cannot be made lower
    return _with_energy_of(recording, _hum(recording, rng))


def mid_anchor(
    recording: Recording, rng: np.random.Generator, *, threshold: str = CONTACTOR
) -> Samples:
    """Make a hum as `low_anchor` does, with the recording's envelope."""
    hum = _hum(recording, rng)
    envelope = _flatten(_envelope(recording), hum, recording, threshold=threshold)
    return _with_energy_of(recording, hum * envelope)


ANCHORS: Registry[Callable[..., Samples]] = Registry(
    "anchor", {"anchor_low": low_anchor, "anchor_mid": mid_anchor}
)
"""Name -> anchor, made from a conditioned recording; the names stand in the manifest's column `reducer`."""


def weigh_bands(recording: Recording) -> tuple[Samples, Samples]:
    """Find the bands in which a recording has least energy: of all that are felt, and of those that are easily felt.

    Returns frequencies in Hz, 24 per octave, and the share of each in the energy of a hum. A tenth of the energy
    is in the first choice, the rest in the second; either is nearly all in one band, and in none below the numerical
    floor. Shares change continuously with the recording: bands that are equally quiet share.
    """
    n, rate_hz, axes = recording.n_samples, recording.rate_hz, recording.acceleration
    frequencies = log_grid(n, rate_hz)
    smooth = WeberSmoothing(frequencies, rate_hz / n, n // 2 + 1)
    energy = smooth(np.sum([energy_spectrum(axis, smooth.bins) for axis in axes], axis=0))
    floor = NUMERICAL_FLOOR * float(np.einsum("in,in->", axes, axes))
    if not (energy > floor).any():
        raise ValueError(
            f"{recording.name!r} is silent between 20 and 1000 Hz and can have no anchors; leave it out"
        )
    # Least at ten times the floor, and higher again below it: no threshold, or a band could cross it by rounding.
    energy = np.maximum(energy, floor)
    energy = energy + 10 * floor * (10 * floor / energy)
    inside = (frequencies >= LOWEST_HZ * (1 + WEBER_FRACTION)) & (
        frequencies * (1 + WEBER_FRACTION) <= min(HIGHEST_HZ, rate_hz / 2)
    )
    easily_felt = acceleration_threshold(frequencies) <= EASILY_FELT * acceleration_threshold(
        LOWEST_HZ
    )
    shares = [_share(energy, inside), _share(energy, inside & easily_felt)]
    return frequencies, FAINT * shares[0] + (1 - FAINT) * shares[1]


def _share(energy: Samples, allowed: NDArray[np.bool_]) -> Samples:
    allowed = allowed if allowed.any() else np.ones_like(allowed)
    ratio = np.minimum(energy[allowed].min() / energy, 1.0)
    shares = np.where(allowed, ratio**PRECEDENCE, 0.0)
    return np.asarray(shares / shares.sum())


def _hum(recording: Recording, rng: np.random.Generator) -> Samples:
    """Sum sinusoids at a constant amplitude whose frequency drifts: noise would have peaks, which cost level."""
    frequencies, shares = weigh_bands(recording)
    time_s = np.arange(recording.n_samples) / recording.rate_hz
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    # As wide as a uniform distribution over the band. What is drifted is time, so that all bands are as wide.
    drift = WEBER_FRACTION / np.sqrt(12) * np.sqrt(2 / DRIFTS)
    warped = time_s.copy()
    for rate, phase in zip(
        2 * np.pi * rng.uniform(*DRIFT_HZ, DRIFTS), rng.uniform(0, 2 * np.pi, DRIFTS), strict=True
    ):
        warped += drift / rate * np.sin(rate * time_s + phase)
    hum = np.zeros(recording.n_samples)
    for one in np.flatnonzero(shares > LOWEST_SHARE):
        hum += np.sqrt(shares[one]) * np.cos(2 * np.pi * frequencies[one] * warped + phases[one])
    return hum


def _envelope(recording: Recording) -> Samples:
    """Root of the three axes' energy, smoothed over half a period of the highest envelope frequency; RMS 1."""
    from scipy.ndimage import gaussian_filter1d

    energy = np.einsum("in,in->n", recording.acceleration, recording.acceleration)
    smooth = gaussian_filter1d(
        energy, recording.rate_hz / (2 * np.pi * ENVELOPE_HZ), mode="nearest"
    )
    smooth = np.maximum(smooth, 0.0)
    return np.asarray(np.sqrt(smooth / smooth.mean()))


def _flatten(envelope: Samples, hum: Samples, recording: Recording, *, threshold: str) -> Samples:
    """Flatten an envelope softly, until an anchor as strong as its recording has no higher peaks.

    At most so far that its root mean square marks the knee: events remain events.
    """
    from scipy.optimize import brentq

    def measure(samples: Samples) -> tuple[float, float]:
        levels = loudest_levels(samples, recording.rate_hz, [threshold])
        return largest(samples), levels[threshold]

    def flatten(much: float) -> Samples:
        return np.asarray(envelope / np.sqrt(1 + much * envelope**2))

    def exceed(much: float) -> float:
        peak, level = measure(hum * flatten(much))
        return peak / level - MARGIN * allowed

    peak, level = measure(recording.acceleration)
    allowed = peak / level
    if exceed(0.0) <= 0:
        return envelope
    return flatten(1.0 if exceed(1.0) >= 0 else brentq(exceed, 0.0, 1.0, xtol=1e-15))


def _with_energy_of(recording: Recording, hum: Samples) -> Samples:
    """Remove what correlates with an axis, and scale the hum to the recording's energy."""
    axes = recording.acceleration
    norms = np.sqrt(np.einsum("in,in->i", axes, axes))[:, None]
    alike = axes / np.where(norms > 0, norms, 1.0)
    # The normal equations of three unknowns; the ridge leaves silent axes alone, and further passes remove its error.
    products = np.einsum("in,jn->ij", alike, alike) + RIDGE * np.eye(len(axes))
    for _ in range(PASSES):
        shares = np.linalg.solve(products, np.einsum("in,n->i", alike, hum))
        hum = hum - np.einsum("i,in->n", shares, alike)
    return np.asarray(hum * np.sqrt(np.sum(norms**2) / np.einsum("n,n->", hum, hum)))
