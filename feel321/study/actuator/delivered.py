"""Delivered vibration: what the hand got, as the rig's sensor measured it, compared with what was asked.

A comparison takes out the latency first: the lag with the largest cross-correlation. Level is that of the part of the
measured motion that follows what was asked, from 20 to 1000 Hz (coherent output power, Bendat & Piersol), so noise does
not count as vibration; coherence is that part's share of the energy.

The match metrics of a stimulus are those of its reduction, at the recording's own rate, before level, rate and fades.
So that the delivered metrics differ from them by what the rig did and by nothing else, the rig's error (measured minus
asked, in the band) is brought to the recording's rate and strength and added to the reduced signal.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from feel321.stimuli.condition import resample
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    WEBER_FRACTION,
    OriginalSpectrum,
    axis_correlations,
    mean_over_axes,
)
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.render import Rendering
from feel321.study.actuator.certificate import MEASURED, Certificate
from feel321.study.actuator.faults import Diagnosis
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.render import find_directions, find_mix, sum_motion
from feel321.study.actuator.response import Band, find_inside
from feel321.study.actuator.rig import AXES, REDUCED, Rig
from feel321.types import Samples

SEGMENT_S = 0.1  # of the averaged spectra: a coil rings for less
LEAST_SEGMENTS = 8  # of half a segment's step, so that chance is no coherence
REACH = WEBER_FRACTION / 2  # of a frequency: so far the metrics' smoothing looks beyond it
LOWEST_DB = -120.0  # stands for silence
TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Delivery:
    """Measured and asked motion, compared: lag in samples; rms_m_s2: of what was measured.

    error: measured minus asked, at the asked strength's scale and polarity, shape (axes, n).
    """

    lag: int
    polarity: int
    level_error_db: float
    coherence: float
    rms_m_s2: float
    error: Samples


def compare(asked: Samples, measured: Samples, *, rate_hz: float) -> Delivery:
    """Compare measured with asked motion in m/s², shapes (axes, m) and (axes, n)."""
    asked, measured = _center(asked), _center(measured)
    n, total = asked.shape[-1], _correlate(asked, measured).sum(axis=0)
    lag = int(np.argmax(np.abs(total)))
    polarity = -1 if total[lag] < 0 else 1
    # A path that is slower than the device says is cut off at its end; what is there is compared.
    n_there = max(min(n, measured.shape[-1] - lag), n // 2)
    asked = _center(asked[:, :n_there])
    felt = polarity * _center(_cut(measured[:, lag:], n_there))
    power, coherent, whole = _find_power(asked, felt, rate_hz=rate_hz)
    level_db = 10 * np.log10(max(coherent, TINY) / max(power, TINY))
    return Delivery(
        lag=lag,
        polarity=polarity,
        level_error_db=max(float(level_db), LOWEST_DB),
        coherence=coherent / whole if whole > 0 else 0.0,
        rms_m_s2=float(np.sqrt(np.mean(np.square(measured).sum(axis=0)))),
        error=_cut(felt - asked, n),
    )


def _center(samples: Samples) -> Samples:
    """Remove offsets: a stimulus has none, and the sensor's is gravity or its own."""
    return np.asarray(samples - samples.mean(axis=-1, keepdims=True))


def _correlate(asked: Samples, measured: Samples) -> Samples:
    """Correlate each asked axis with its measured one at lags from 0, shape (axes, m)."""
    m = measured.shape[-1]
    n = fft.next_fast_len(asked.shape[-1] + m, real=True)
    together = fft.rfft(measured, n) * fft.rfft(asked, n).conj()
    return np.asarray(fft.irfft(together, n)[:, :m])


def _cut(samples: Samples, n: int) -> Samples:
    piece = samples[:, :n]
    return np.pad(piece, ((0, 0), (0, n - piece.shape[-1])))


def _find_power(asked: Samples, felt: Samples, *, rate_hz: float) -> tuple[float, float, float]:
    """Sum over axes and the band: power asked, power that follows what was asked, and all power measured."""
    n = min(round(SEGMENT_S * rate_hz), 2 * asked.shape[-1] // (LEAST_SEGMENTS + 1))
    band_hz = (LOWEST_HZ, HIGHEST_HZ)
    inside = find_inside(fft.rfftfreq(n, 1 / rate_hz), band_hz=band_hz)

    def transform(samples: Samples) -> Samples:
        """Transform overlapping segments under a Hann window, shape (axes, segments, k)."""
        limited = _limit(samples, rate_hz, band_hz=band_hz)  # what is strong below would leak in
        pieces = np.lib.stride_tricks.sliding_window_view(limited, n, axis=-1)
        windowed = pieces[:, :: max(n // 2, 1)] * signal.windows.hann(n, sym=False)
        return np.asarray(fft.rfft(windowed)[..., inside])

    x, y = transform(asked), transform(felt)
    sxx, syy = (np.square(np.abs(one)).sum(axis=1) for one in (x, y))
    sxy = (x.conj() * y).sum(axis=1)
    followed = np.square(np.abs(sxy)) / np.maximum(sxx, TINY)
    return float(sxx.sum()), float(followed.sum()), float(syy.sum())


def _limit(samples: Samples, rate_hz: float, *, band_hz: Band) -> Samples:
    n = samples.shape[-1]
    inside = find_inside(fft.rfftfreq(n, 1 / rate_hz), band_hz=band_hz)
    return np.asarray(fft.irfft(fft.rfft(samples) * inside, n))


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """A stimulus to compare with: what it was made of, its conditioned recording, and that one's spectrum.

    samples: the reduction, (n,), or the recording itself, (3, n), in m/s²; gain: m/s² asked per m/s² of them.
    """

    recording: Recording
    spectrum: OriginalSpectrum
    samples: Samples
    gain: float

    def match(self, error: Samples, *, rate_hz: float) -> dict[str, float]:
        """Match the reduced signal with the rig's error, shape (axes, n), on it."""
        original, rate = self.recording.acceleration, self.recording.rate_hz
        shape = self.samples.shape
        at_rate = _cut(resample(error, rate_hz, to_hz=rate) / self.gain, shape[-1])
        band_hz = (LOWEST_HZ * (1 - REACH), HIGHEST_HZ * (1 + REACH))
        own = _limit(at_rate, rate, band_hz=band_hz).reshape(shape)
        one = delivered = self.samples + own
        if delivered.ndim == 1:
            correlations = axis_correlations(original, delivered)
        else:
            pairs = zip(original, delivered, strict=True)
            correlations = np.concatenate([axis_correlations(a[None], b) for a, b in pairs])
            one = REDUCERS["dft321"](delivered, rate)  # its energies are those of all axes
        spectral, bounded = self.spectrum.match_both(one)
        return {
            "spectral_match": float(spectral),
            "temporal_match": float(mean_over_axes(correlations)),
            "spectral_match_bounded": float(bounded),
        }


def reduce_stimuli(
    stimuli: StimulusSet, recordings: Iterable[Recording], recipe: Recipe
) -> dict[str, Baseline]:
    """Make again what the stimuli of a set were made from, by stimulus; those of other recordings are left out."""
    found: dict[str, Baseline] = {}
    for recording in recordings:
        source = (recording.name, recording.sha256)
        own = [one for one in stimuli if (one.recording, one.recording_sha256) == source]
        made = Rendering(recording, recipe)
        played = {name: made.play(name) for name in {one.reducer for one in own}}
        for one in own:
            samples, _, factor = played[one.reducer]
            gain = one.gain * factor
            found[one.stimulus_id] = Baseline(made.recording, made.spectrum, samples, gain)
    return found


class DeliveryCheck:
    """Compares each playback of a set with what was asked; reduced: by stimulus, where its metrics can be known."""

    def __init__(
        self,
        stimuli: StimulusSet,
        rig: Rig,
        *,
        full_scale_m_s2: float,
        reduced: Mapping[str, Baseline],
        certificate: Certificate | None = None,
        tolerance_db: float | None = None,
    ) -> None:
        self._stimuli, self._rig, self._full_scale = stimuli, rig, full_scale_m_s2
        self._reduced, self._is_calibrated = reduced, certificate is not None
        self._own = {stimulus.stimulus_id for stimulus in stimuli}
        self._seen: dict[str, Samples] = {}  # directions in which the sensor saw the coils move
        self._diagnosis: Diagnosis | None = None
        if certificate is not None and certificate.method == MEASURED:  # typed gains show none
            self._seen = {name: coil.direction for name, coil in certificate.coils.items()}
            if rig.sensor is not None:
                self._diagnosis = Diagnosis(certificate, rig, tolerance_db=tolerance_db)

    def diagnose(
        self, sent: Frames, sensed: Frames | None, *, keeps_latency: bool
    ) -> tuple[str, str]:
        """Name what is wrong with the rig by a whole playback: what spoils it, or else what is only to be told."""
        diagnosis = self._diagnosis
        if diagnosis is None or sensed is None:
            return "", ""
        if not keeps_latency:  # the device had a break since the last one
            diagnosis.lag = None
        found = diagnosis.judge(sent, np.asarray(sensed, dtype=np.float64))
        return (found, "") if diagnosis.is_grave else ("", found)

    def describe(self, stimulus_id: str, sensed: Frames | Samples | None) -> dict[str, float]:
        """Compare what the sensor measured, in m/s², (3, m), since the onset was sent; tones have no comparison."""
        if sensed is None or stimulus_id not in self._own:
            return {}
        samples, rate = self._stimuli.read(stimulus_id)
        tracks, measured = np.atleast_2d(samples) * self._full_scale, np.asarray(sensed, np.float64)
        moves = find_moves(self._rig, len(tracks), self._seen)
        asked = moves @ tracks
        if len(measured) > len(moves):  # the direction in which they follow the one asked axis
            correlation = _correlate(asked, _center(measured))
            ways = correlation[:, np.argmax(np.einsum("in,in->n", correlation, correlation))]
            measured = ways[None] / max(float(np.linalg.norm(ways)), TINY) @ measured
        back = np.linalg.pinv(moves)  # to the stimulus's own axes and strength
        found = compare(back @ asked, back @ measured, rate_hz=rate)
        reduced = self._reduced.get(stimulus_id)
        matches = reduced.match(found.error, rate_hz=rate) if reduced else {}
        return {
            "level_error_db": found.level_error_db,
            **{name: value for name, value in matches.items() if np.isfinite(value)},
            "lag": float(found.lag),
            "polarity": float(found.polarity),
            "coherence": found.coherence,
            "rms_m_s2": found.rms_m_s2,
            "is_calibrated": float(self._is_calibrated),
            "is_measured": float(bool(self._seen)),
        }


def find_moves(rig: Rig, n_tracks: int, seen: Mapping[str, Samples]) -> Samples:
    """Find how tracks of a stimulus move the hand, (axes, n_tracks), by directions seen, by rig.toml, or as is."""
    sources, mix = (REDUCED,) if n_tracks == 1 else AXES, find_mix(rig)
    directions, unknown = (seen, []) if seen else find_directions(rig)
    if any(source in mix[name] for name in unknown for source in sources):
        return np.eye(n_tracks)
    return sum_motion(mix, directions, sources)
