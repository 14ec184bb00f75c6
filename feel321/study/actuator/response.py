"""From samples sent to acceleration felt: sweeps, the response of a coil, its inverse filter.

Sent samples are in units of full scale, recorded ones in m/s², responses in m/s² per full scale, frequencies in Hz.
After Novak et al. 2015 (synchronized sweeps, doi:10.17743/jaes.2015.0071), Bendat & Piersol 2010 (H1 and coherence,
doi:10.1002/9781118032428), Knapp & Carter 1976 (delays, doi:10.1109/TASSP.1976.1162830), and Kirkeby & Nelson 1999
(inversion, J Audio Eng Soc 47, 583-595).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, signal

from feel321.types import Samples

Spectrum = NDArray[np.complex128]
Band = tuple[float, float]

BAND_HZ = (20.0, 1000.0)
BELOW, ABOVE = 2.0, 1.25  # how far a sweep goes beyond its band; its ramps lie there
ORDERS = (2, 3, 4, 5)  # harmonics that count as distortion
LEAD_PERIODS = 4.0  # of the band's lowest frequency, by which a filter reaches ahead
SMOOTH_HZ = 1.0  # spectra of sweeps, which are finer, are averaged over so many Hz
TINY = float(np.finfo(float).tiny)
DB = 20 / math.log(10)
ALIVE = 0.8  # least median coherence of a coil that moves at all; of two sweeps of noise it is 0.5
IN_STEP = 2  # samples by which noise may shift what is in step
MOST_TURNED = 0.3  # rad by which a third octave of equal sweeps may differ
PEAK = 10.0  # least height of a correlation's peak over its standard deviation


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """Equal exponential sine sweeps with pauses; duration_s is rounded to put harmonics in phase (Novak et al.)."""

    rate_hz: float
    band_hz: Band = BAND_HZ
    duration_s: float = 4.0
    pause_s: float = 1.0
    n_repeats: int = 4
    peak: float = 0.5

    def __post_init__(self) -> None:
        """Refuse sweeps that cannot be made."""
        check_band(self.band_hz, rate_hz=self.rate_hz, above=ABOVE)
        if self.time_constant_s <= 0 or self.pause_s <= 0:
            got = f"{self.duration_s} and {self.pause_s}"
            raise ValueError(f"duration_s and pause_s must be longer, got {got}")

    @property
    def ends_hz(self) -> Band:
        """First and last frequency."""
        return self.band_hz[0] / BELOW, self.band_hz[1] * ABOVE

    @property
    def time_constant_s(self) -> float:
        """Time in which frequency grows by the factor e: whole periods of the first frequency."""
        first, last = self.ends_hz
        return round(first * self.duration_s / math.log(last / first)) / first

    @property
    def period(self) -> int:
        """Samples from the start of one sweep to the start of the next."""
        first, last = self.ends_hz
        sweep_s = self.time_constant_s * math.log(last / first)
        return math.ceil((sweep_s + self.pause_s) * self.rate_hz)


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """What a coil makes of the samples sent to it, along a unit vector `direction`, shape (axes,).

    response (latency removed), coherence and distortion (harmonics 2 to 5 over the fundamental, NaN where it was not
    measured) have the shape (k,) of frequency_hz. cross_talk_db: motion across the direction over motion along it.
    """

    rate_hz: float
    band_hz: Band
    frequency_hz: Samples
    response: Spectrum
    coherence: Samples
    distortion: Samples
    latency: int
    direction: Samples
    cross_talk_db: float

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which of its frequencies lie in the band of its sweep."""
        return find_inside(self.frequency_hz, band_hz=self.band_hz)

    def find_deviation_db(self, *, target: float, band_hz: Band) -> Samples:
        """Find how far it is from a target in a band, shape (k,)."""
        inside = find_inside(self.frequency_hz, band_hz=band_hz)
        size = np.maximum(np.abs(self.response[inside]), TINY)
        return np.asarray(20 * np.log10(size / target))


@dataclass(frozen=True, slots=True, kw_only=True)
class InverseFilter:
    """An FIR filter, shape (n,), that gives a coil the response `target` in a band, `delay` samples late."""

    fir: Samples
    target: float
    delay: int
    gain_db: float


def check_band(band_hz: Band, *, rate_hz: float, above: float = 1.0) -> None:
    """Refuse a band that is empty, or that comes, `above` times as high, to half the rate."""
    low, high = band_hz
    if not 0 < low < high * above < rate_hz / 2:
        raise ValueError(
            f"band_hz must rise within 0 to {rate_hz / 2 / above:g} Hz at {rate_hz:g} Hz, got {low:g} to {high:g}"
        )


def find_inside(frequency_hz: Samples, *, band_hz: Band) -> NDArray[np.bool_]:
    """Say which frequencies lie in a band, its ends included."""
    return (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])


def make_sweep(sweep: Sweep) -> Samples:
    """Make the samples of a sweep, `sin(2π f₁ L exp(t / L))`, shape (period * n_repeats,)."""
    first, last = sweep.ends_hz
    constant_s = sweep.time_constant_s
    time_s = np.arange(sweep.period) / sweep.rate_hz
    length_s = constant_s * math.log(last / first)
    phase = 2 * math.pi * first * constant_s * np.exp(np.minimum(time_s, length_s) / constant_s)
    rise = time_s / (constant_s * math.log(BELOW))
    fall = (length_s - time_s) / (constant_s * math.log(ABOVE))
    return np.tile(sweep.peak * make_ramps(rise, fall) * np.sin(phase), sweep.n_repeats)


def make_ramps(rise: Samples, fall: Samples) -> Samples:
    """Make the gain of a sweep where it is so far into its first ramp, and before the end of its last."""
    rising, falling = (np.sin(math.pi / 2 * np.clip(one, 0, 1)) ** 2 for one in (rise, fall))
    return np.asarray(rising * falling)


def measure_sweep(sweep: Sweep, recorded: Samples, *, sent: Samples | None = None) -> Response:
    """Measure a response, H1 = Sxy / Sxx over equal sweeps, and its distortion; recorded: shape (n,) or (axes, n).

    sent: what was asked for, if it is not the sweep at its own peak. Spectra are averaged over periods and over 1 Hz;
    coherence is |Sxy|² / (Sxx Syy). The direction is the first principal axis of the real part of the cross-spectra.
    """
    asked, axes = make_sweep(sweep) if sent is None else sent, np.atleast_2d(recorded)
    if not (np.isfinite(axes).all() and axes.any()):
        raise ValueError("recorded samples must be finite and not all 0; check the sensor")

    def average(x: Samples, y: Samples) -> tuple[Samples, Spectrum]:
        return signal.csd(x, y, sweep.rate_hz, "boxcar", sweep.period, 0, detrend=False)

    frequency_hz, sxx = average(asked, asked)
    sxy = average(asked, axes)[1]
    inside = find_inside(frequency_hz, band_hz=sweep.band_hz)
    raw = sxy / np.maximum(sxx.real, TINY)
    values, vectors = np.linalg.eigh((raw[:, inside] @ raw[:, inside].conj().T).real)
    latency, sign = find_latency(vectors[:, -1] @ raw, inside=inside)
    direction = sign * vectors[:, -1]  # for positive drive
    turned = direction @ sxy * np.exp(2j * math.pi * frequency_hz * latency / sweep.rate_hz)
    along = average(direction @ axes, direction @ axes)[1].real
    n_bins = max(round(SMOOTH_HZ / frequency_hz[1]), 1)
    share = np.abs(turned) ** 2 / np.maximum(sxx.real, TINY)  # what of Syy comes from the coil
    spectra = (sxx.real, turned, share, along)
    sxx, turned, share, syy = (ndimage.uniform_filter1d(one, n_bins) for one in spectra)
    mean = (direction @ axes).reshape(sweep.n_repeats, sweep.period).mean(axis=0)
    return Response(
        rate_hz=sweep.rate_hz,
        band_hz=sweep.band_hz,
        frequency_hz=frequency_hz,
        response=turned / np.maximum(sxx, TINY),
        coherence=np.clip(share / np.maximum(syy, TINY), 0, 1),
        distortion=measure_distortion(sweep, np.roll(mean, -latency), frequency_hz=frequency_hz),
        latency=latency,
        direction=direction,
        cross_talk_db=10 * math.log10(max(float(values[:-1].sum()), TINY) / max(values[-1], TINY)),
    )


def find_latency(response: Spectrum, *, inside: NDArray[np.bool_]) -> tuple[int, int]:
    """Find the latency in whole samples, and the polarity (1 or -1), of a response from 0 to half the rate.

    A coil is a minimum-phase filter, whose phase follows from its magnitude; what phase is left is delay, whose pulse
    Knapp & Carter's phase transform makes.
    """
    bins = np.log(np.maximum(np.arange(len(response)), 1))
    log_magnitude = np.log(np.maximum(np.abs(response), TINY))
    # Outside the band is noise: there the magnitude stays as at the upper end, and falls on as at the lower.
    lowest = bins[inside][0]
    half_octave = inside & (bins <= lowest + math.log(2) / 2)
    slope = np.polyfit(bins[half_octave], log_magnitude[half_octave], 1)[0]
    smooth = np.interp(bins, bins[inside], log_magnitude[inside])
    smooth += slope * np.minimum(bins - lowest, 0)
    # Of a minimum-phase spectrum the phase is minus the Hilbert transform of the log magnitude.
    analytic: Spectrum = signal.hilbert(np.concatenate([smooth, smooth[-2:0:-1]]))
    excess = inside * response / np.exp(np.conj(analytic)[: len(smooth)])
    pulse = fft.irfft(excess / np.maximum(np.abs(excess), TINY))
    peak = int(np.argmax(np.abs(pulse)))
    return (peak if peak < len(pulse) // 2 else peak - len(pulse)), int(np.sign(pulse[peak]))


def measure_distortion(sweep: Sweep, recorded: Samples, *, frequency_hz: Samples) -> Samples:
    """Measure harmonics 2 to 5 over the fundamental, at given fundamentals, from one recorded period without latency.

    Deconvolved by `2 √(f / L) exp(-2πi f L (1 - ln(f / f₁)) + iπ/4)` (Novak et al.), the response to the
    n-th harmonic comes `L ln n` before that of the fundamental, and is cut out there.
    """
    n, constant_s = 2 * sweep.period, sweep.time_constant_s
    grid_hz = fft.rfftfreq(n, 1 / sweep.rate_hz)
    positive = np.maximum(grid_hz, grid_hz[1])
    turns = positive * constant_s * (1 - np.log(positive / sweep.ends_hz[0]))
    inverse = 2 * np.sqrt(positive / constant_s) * np.exp(-2j * math.pi * turns + 0.25j * math.pi)
    impulses = fft.irfft(fft.rfft(recorded, n) * inverse * (grid_hz > 0), n)
    # From a little before the response of a harmonic to a little before that of the one it precedes.
    samples = constant_s * sweep.rate_hz
    gap = samples * math.log((ORDERS[-1] + 1) / ORDERS[-1])
    before, after = round(0.2 * gap), round(0.7 * gap)
    sizes = []
    for order in (1, *ORDERS):
        start = round(-samples * math.log(order)) - before
        line = np.roll(impulses, -start)[: before + after]
        line = line * signal.windows.tukey(len(line), 0.2)
        sizes.append(np.interp(order * frequency_hz, grid_hz, np.abs(fft.rfft(line, n))))
    reached = [order * frequency_hz < sweep.rate_hz / 2 for order in ORDERS]
    above = np.linalg.norm(np.array(sizes[1:]) * reached, axis=0)
    inside = find_inside(frequency_hz, band_hz=sweep.band_hz)
    return np.where(inside, above / np.maximum(sizes[0], TINY), np.nan)


def make_inverse(
    response: Response,
    *,
    band_hz: Band = BAND_HZ,
    max_gain_db: float = 20.0,
    n_taps: int,
    min_coherence: float = 0.95,
) -> InverseFilter:
    """Make the filter that brings a response to its median magnitude in the band.

    It is `T |H| / (|H|² + β)` with Kirkeby's regularisation β, at each frequency the least that keeps the gain at
    or below the bound, so 0 wherever it can. The coil's phase is taken away too, so that what arrives has the shape of
    what was asked for, later by `delay`. Where coherence is below its minimum, and outside the band, the gain is 1; at
    the band's edges it goes there within half an octave.
    """
    check_band(band_hz, rate_hz=response.rate_hz)
    inside = find_inside(response.frequency_hz, band_hz=band_hz)
    good = inside & (response.coherence >= min_coherence)
    if not good.any():
        raise ValueError(
            f"no frequency from {band_hz[0]:g} to {band_hz[1]:g} Hz has coherence {min_coherence} or more; "
            "check that the coil moves and the sensor measures"
        )
    target = float(np.median(np.abs(response.response[good])))
    bound = 10 ** (max_gain_db / 20)
    wanted = target / np.maximum(np.abs(response.response), target / bound)
    n_grid = fft.next_fast_len(8 * n_taps, real=True) // 2 * 2
    grid_hz = fft.rfftfreq(n_grid, 1 / response.rate_hz)
    poor = inside & ~good
    weight = np.interp(grid_hz, response.frequency_hz, np.where(poor, 0.0, 1.0))
    # 1 in the band, 0 beyond half an octave outside it, a raised cosine in between.
    octaves = np.log2(np.maximum(grid_hz, grid_hz[1] / 2))
    outside = np.maximum(math.log2(band_hz[0]) - octaves, octaves - math.log2(band_hz[1]))
    weight *= np.cos(math.pi / 2 * np.clip(2 * outside, 0, 1)) ** 2
    log_gain = weight * np.interp(grid_hz, response.frequency_hz, np.log(wanted))
    turned = np.unwrap(np.angle(response.response[inside]))
    # Whole turns are taken away, so that the phase is near 0 at the band's upper end.
    turned -= 2 * math.pi * round(turned[-1] / (2 * math.pi))
    turned = np.interp(grid_hz, response.frequency_hz[inside], turned)
    # The last `delay` samples of the periodic impulse response, and the first of what is left.
    delay = min(round(LEAD_PERIODS / band_hz[0] * response.rate_hz), n_taps // 2)
    fir: Samples = np.roll(fft.irfft(np.exp(log_gain - 1j * weight * turned)), delay)[:n_taps]
    n_rise, n_fall = delay // 2, (n_taps - delay) // 2
    fir[:n_rise] *= np.sin(math.pi / 2 * np.arange(n_rise) / max(n_rise, 1)) ** 2
    fir[n_taps - n_fall :] *= np.cos(math.pi / 2 * np.arange(n_fall) / max(n_fall, 1)) ** 2
    largest = float(np.abs(fft.rfft(fir, n_grid)).max())
    within = min(1.0, bound / largest)  # cutting a filter to its length ripples; the bound holds
    return InverseFilter(
        fir=within * fir,
        target=within * target,
        delay=delay,
        gain_db=20 * math.log10(within * largest),
    )


def find_slip(recorded: Samples, sweep: Sweep) -> int:
    """Find by how many samples later sweeps are out of step with the first one, at most; 0 where noise hides it."""
    periods = recorded.reshape(len(recorded), sweep.n_repeats, sweep.period)
    spectra = fft.rfft(periods, axis=-1)
    frequency_hz = fft.rfftfreq(sweep.period, 1 / sweep.rate_hz)
    inside = find_inside(frequency_hz, band_hz=sweep.band_hz)
    cross = (spectra[:, 1:] * spectra[:, :1].conj()).sum(axis=0)
    pulses = fft.irfft(inside * cross / np.maximum(np.abs(cross), TINY), sweep.period)
    places = np.argmax(pulses, axis=-1)
    clear = pulses.max(axis=-1) > PEAK * pulses.std(axis=-1)
    lags = np.where(clear, np.minimum(places, sweep.period - places), 0)
    energy = np.square(np.abs(spectra)).sum(axis=0)
    together, size, middle_hz = (
        average_thirds(one, frequency_hz, band_hz=sweep.band_hz)
        for one in (cross, np.sqrt(energy[1:] * energy[:1]), frequency_hz)
    )
    # Samples may be lost while the sweep passes through a third octave, whose phase then differs.
    turned = np.abs(np.angle(together)) * (np.abs(together) > ALIVE * size)
    lost = turned * (turned > MOST_TURNED) / (2 * math.pi * middle_hz) * sweep.rate_hz
    slip = max(int(lags.max()), round(float(lost.max())))
    return slip if slip > IN_STEP else 0


def average_thirds(values: Samples, frequency_hz: Samples, *, band_hz: Band) -> Samples:
    """Average values, shape (..., k), in the third octaves of a band that are not empty."""
    low, high = band_hz
    n_bands = max(round(3 * math.log2(high / low)), 1)
    number = np.floor(n_bands * np.log(np.maximum(frequency_hz, 1e-9) / low) / math.log(high / low))
    found = [values[..., number == band] for band in range(n_bands)]
    return np.stack([one.mean(axis=-1) for one in found if one.shape[-1]], axis=-1)
