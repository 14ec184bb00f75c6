"""Simplicity of reducers, and what each makes of a scene in every segment and mounting of the sensor.

Simplicity rests on state (numbers that must be held at once), latency, operations per sample, and parameters (what has
to be chosen). Latency is that of `StreamingReducer`, and parameters are those of the reducer's signature. State and
operations follow from its definition: a real transform of n samples takes 2.5 n log2(n) operations; an addition, a
multiplication, a division and a root count one each. Which of the four is scarce depends on where the reducer runs:

- *offline* the recording is there, so neither waiting nor memory is scarce: parameters, then operations, then state.
- *online*: latency, then state, then operations, then parameters.

In both, fewer axes of the actuator come before everything else. Reducers alike in all of it, as the three single axes
are, are equally simple.

A scene is cut into segments of about 2 s, and each is rotated as if the sensor had been mounted differently. The
orientations are spread evenly over all rotations (Halton points [1]_ through Shoemake's formula [2]_), so that few of
them stand for all. The *worst* orientation decides in a segment, and the worst segment in a scene (the 90th percentile
of the segments where there are ten or more).

Three shortcuts save most of the work. A reducer whose output follows the sensor (`TURNS_ALONG`) is measured once per
segment. Cyclic permutations of the axes are mountings too: what treats the axes alike (`TREATS_ALIKE`) is not changed
by them, and over them the three single axes are equal. And a reducer that has missed the tolerance by half is not
tried any further. Tests hold the first two to be true.

References
----------
.. [1] J. H. Halton, "On the efficiency of certain quasi-random sequences of points in evaluating multi-dimensional
   integrals", Numerische Mathematik 2, 1960. doi:10.1007/BF01386213
.. [2] K. Shoemake, "Uniform random rotations", in Graphics Gems III, Academic Press 1992.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from inspect import signature
from math import inf, isfinite, log2
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from feel321.stimuli.guard import OwnReducer
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    OriginalSpectrum,
    WeberSmoothing,
    linear_grid,
    temporal_match,
)
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING, StreamingReducer
from feel321.stimuli.rivals.envelope import compare_depths, find_depths
from feel321.stimuli.rivals.pairs import Pair, follow_band, follow_energy
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

MS_PER_S = 1000.0
WINDOWS_MS = (10.0, 15.0, 20.0, 25.0, 35.0, 50.0)
"""Windows in ms that are tried where the delay matters."""

PROJECTION, COVARIANCE, MEAN = 5.0, 12.0, 6.0
SPECTRA_TO_ONE = 11.0
"""Per sample, of three spectra: squared magnitudes and their root, the phase of the sum, and their product."""

LEADING_AXIS = 23.0
"""Per sample, to find the axis of the motion and take the phase along it: the onset (6), the covariance (12), and the
projection (5)."""

AXIS_MEMORY = 19
"""Numbers that frames remember of the axis: two covariances (6 each, they are symmetric), two axes, one loudness."""

SEGMENT_S = 2.0
"""About the length of a segment: long enough for 20 Hz and for a stroke, short enough that a scene has several."""

TURNS = 24
"""Orientations of a scene; each counts three times, with x, y and z in each other's place."""

FIRST_TURNS = 4
"""So many of them are tried before reducers that have failed are left out."""

HOPELESS = 1.5
"""Shortfall, in tolerances, from which on a reducer is not tried any further."""

QUIET = 0.01
"""Segments with less than this share of the strongest one's energy (20 dB) do not count."""

NOISE = 1e-3
"""Sensor noise against the recording, in amplitude: -60 dB."""

SILENT_DB = -120.0
"""The level that stands for silence."""

TURNS_ALONG = frozenset({
    "mag321", "pca321", "pca321_adaptive", "dft321_principal", "dft321_principal_windowed", "pca321_matched",
    "pca321_matched_windowed", "dft321_bands", "two_principal_axes", "three_axes",
})  # fmt: skip
"""Reducers, and what several axes of an actuator play, whose output no rotation changes but for its sign."""

TREATS_ALIKE = TURNS_ALONG | {"soc321", "dft321", "dft321_windowed", "dft321_filtered"}
"""Reducers whose output no permutation of the axes changes."""

GAIN_DB = {"soc321": 10 * math.log10(3)}
"""Gain of a fixed sum of axes: the norm of its weights, where that is not 1. See `Scores.deviation_db`."""


class Contender(NamedTuple):
    """A reducer, or one of its windows."""

    name: str
    reduce: Callable[[Samples, float], Samples]

    @property
    def gain_db(self) -> float:
        """Its fixed gain."""
        return GAIN_DB.get(self.name, 0.0)


def _transforms(n: int) -> float:
    return 4 * 2.5 * log2(max(n, 2))  # three axes there, one back


_SPECTRA = SPECTRA_TO_ONE + 4
_WORK: Mapping[str, Callable[[int, int], tuple[float, float]]] = MappingProxyType({
    **{f"sa{axis}321": lambda *_: (0.0, 0.0) for axis in "xyz"},
    "soc321": lambda *_: (0.0, 2.0),
    "mag321": lambda *_: (0.0, 6.0),
    **{f"sa{axis}321_matched": lambda n, _: (n + 2.0, 7.0) for axis in "xyz"},
    # Three squares and their sums, two sums that forget, the limit, division, root and product.
    **{f"sa{axis}321_matched_running": lambda *_: (2.0, 14.0) for axis in "xyz"},
    "pca321": lambda n, _: (3.0 * n, MEAN + COVARIANCE + PROJECTION),
    "pca321_matched": lambda n, _: (3.0 * n, MEAN + COVARIANCE + PROJECTION + 1),
    # One covariance, axis and gain are remembered; axis and gain fade from one estimate to the next.
    "pca321_matched_windowed": lambda _, window: (3.0 * window + 10, COVARIANCE + 16 + PROJECTION),
    # Each sample lies in two frames; its axis is mixed from theirs and brought to unit length. One axis and the memory.
    "pca321_adaptive": lambda _, window: (3.0 * window + 6, 2 * (MEAN + COVARIANCE) + 18 + PROJECTION),
    "dft321": lambda n, _: (4.0 * n, _transforms(n) + SPECTRA_TO_ONE),
    "dft321_principal": lambda n, _: (4.0 * n, _transforms(n) + SPECTRA_TO_ONE + LEADING_AXIS),
    "dft321_windowed": lambda _, window: (3.5 * window, 2 * (_transforms(window) + _SPECTRA) + 1),
    "dft321_principal_windowed": lambda _, window: (
        3.5 * window + AXIS_MEMORY, 2 * (_transforms(window) + _SPECTRA + LEADING_AXIS) + 1),
    # The axis of the motion, then covariance, projection and gain of every band.
    "dft321_bands": lambda n, _: (4.0 * n, _transforms(n) + LEADING_AXIS + COVARIANCE + PROJECTION + 1),
    # Five low-passes of three axes; six bands: 3 differences, 2 sums over axes, 4 squares, 2 sums, 8 for the gain, 2.
    "dft321_filtered": lambda *_: (27.0, 5 * 3 * 3 + 6 * 21.0),
})  # fmt: skip
"""Reducer -> numbers held at once and operations per sample, by lengths of the signal and the window."""


@dataclass(frozen=True, slots=True)
class Complexity:
    """What a reducer needs on a scene; latency_ms is infinite where the whole recording is needed."""

    name: str
    axes: int
    state: float
    latency_ms: float
    operations: float
    parameters: int

    def rank(self, *, online: bool) -> tuple[float, ...]:
        """Its place in the order of simplicity; the simplest is the smallest."""
        if online:
            return self.axes, self.latency_ms, self.state, self.operations, self.parameters
        return self.axes, self.parameters, self.operations, self.state


def list_windows(name: str, reducer: Reducer, *, longest_ms: float) -> Iterator[tuple[str, float]]:
    """List a reducer as it is and, if it has a window, with other windows whose delay is short enough.

    longest_ms: infinite where it does not matter, and the usual window is enough.

    Examples
    --------
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> [label for label, _ in list_windows("dft321_windowed", REDUCERS["dft321_windowed"], longest_ms=15.0)]
    ['dft321_windowed', 'dft321_windowed@10ms', 'dft321_windowed@15ms']
    """
    yield name, DEFAULT_WINDOW_S
    if "window_s" in signature(reducer).parameters and isfinite(longest_ms):
        for window_ms in WINDOWS_MS:
            if window_ms <= longest_ms and window_ms != MS_PER_S * DEFAULT_WINDOW_S:
                yield f"{name}@{window_ms:g}ms", window_ms / MS_PER_S


def find_complexity(
    name: str,
    reducer: Reducer,
    *,
    n_samples: int,
    rate_hz: float,
    window_s: float = DEFAULT_WINDOW_S,
) -> Complexity:
    """Find what a reducer needs on a scene."""
    if isinstance(reducer, OwnReducer):
        return _find_declared(name, reducer, rate_hz)
    if name not in _WORK:
        raise ValueError(
            f"reducer {name!r} must have its state and operations recorded in {__name__}; add them"
        )
    latency_ms = inf
    if name not in WHY_NOT_STREAMING:
        stream = StreamingReducer(name, rate_hz, window_s)
        latency_ms = MS_PER_S * stream.latency_samples / rate_hz
    state, operations = _WORK[name](n_samples, window_samples(window_s, rate_hz))
    options = [
        each for each in signature(reducer).parameters.values() if each.kind is each.KEYWORD_ONLY
    ]
    return Complexity(name, 1, state, latency_ms, operations, len(options))


def _find_declared(name: str, reducer: OwnReducer, rate_hz: float) -> Complexity:
    """Take what a lab declares of its reducer; what is unknown is infinite, so that known ones count as simpler."""
    facts = {fact: reducer.method.find_fact(fact) for fact in ("operations", "state")}
    known = {k: float(v) if isinstance(v, int | float) else inf for k, v in facts.items()}
    latency_s = reducer.find_latency(rate_hz)
    latency_ms = inf if latency_s is None else MS_PER_S * latency_s
    return Complexity(name, 1, known["state"], latency_ms, known["operations"], 0)


@dataclass(frozen=True, slots=True)
class Scores:
    """What a reducer makes of a segment of a scene, with the sensor mounted in one way.

    change: relative change of the output, up to its sign, under sensor noise of -60 dB; envelope: the
    `modulation_distance`; the paper's metrics are NaN where there are none.
    """

    level_db: float
    spectrum: float
    time: float
    change: float
    spectral_match: float
    temporal_match: float
    gain_db: float = 0.0
    spectral_match_bounded: float = math.nan
    envelope: float = 0.0

    @property
    def deviation_db(self) -> float:
        """How far the level is off, in dB.

        A sum of axes is the projection on the sensor's diagonal, 4.8 dB louder. What it lost on the other axes may be
        made up for by that gain, but then mounting and chance decide, and the spectrum and the moment at which they
        cancel go unseen. So the level must be right with the gain and must not be lost without it. A gain that is
        measured, as that of the reducers with matched energy is, is right for every mounting and does not count.
        """
        return max(abs(self.level_db), self.gain_db - self.level_db)


class MountedSegment(NamedTuple):
    """One segment with the sensor mounted in one way: turn is (3, 3)."""

    segment: Segment
    turn: Samples


class Segment:
    """A segment, (3, n_samples), made ready for many reducers: what all are compared with is computed once."""

    def __init__(self, samples: Samples, rate_hz: float, rng: np.random.Generator) -> None:
        self.samples, self.rate_hz = samples, rate_hz
        self._size = float(np.linalg.norm(samples))
        noise = rng.standard_normal(samples.shape)
        noise *= NOISE * self._size / (np.linalg.norm(noise) or 1.0)
        self.both = np.array([samples, samples + noise])
        n = samples.shape[-1]
        self._smooth = WeberSmoothing(linear_grid(n, rate_hz), rate_hz / n, n // 2 + 1)
        frequency = np.arange(n // 2 + 1) * rate_hz / n
        felt = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
        thresholds = acceleration_threshold(np.where(felt, frequency, LOWEST_HZ))
        self._weights = np.where(felt, 1 / thresholds**2, 0.0)
        pair = Pair(samples, samples[0], rate_hz)
        self._felt = pair.felt
        energy, _, self._envelope_hz = follow_energy(pair)
        self._depths = find_depths(energy, self._envelope_hz)
        self._power = _measure_power(samples).sum(axis=0)
        self.level = float(self._power @ self._weights)

    def score(self, reduce: Callable[[Samples, float], Samples], both: Samples) -> Samples:
        """Score one reducer on the segment and the same with noise, (2, 3, n_samples).

        Returns level in dB, spectrum, time, change and envelope.
        """
        from scipy import fft

        output, disturbed = reduce(both, self.rate_hz)
        spectrum, size = fft.rfft(output), float(np.linalg.norm(output))
        power, energy = _square(spectrum), follow_band(spectrum, self._felt)
        if output.ndim > 1:  # axes that are kept
            time, power, energy = size / self._size, power.sum(axis=0), energy.sum(axis=0)
        else:
            along = float(np.linalg.norm(both[0] @ output))
            time = min(along / (size * self._size), 1.0) if size > 0 else 0.0
        ratio = float(power @ self._weights) / self.level
        level_db = max(10 * math.log10(ratio), SILENT_DB) if ratio > 0 else SILENT_DB
        envelope = float(compare_depths(self._depths, find_depths(energy, self._envelope_hz)))
        change = find_change(output, disturbed)
        return np.array([level_db, self._compare(power), time, change, envelope])

    def _compare(self, power: Samples) -> float:
        """`spectral_match_energy_weighted`, of spectra that are there already."""
        own, kept = self._power[self._smooth.bins], power[self._smooth.bins]
        total, apart = self._smooth(own + kept).sum(), np.abs(self._smooth(own - kept)).sum()
        return float(max((total - apart) / (total + apart), 0.0))


def complete_scores(contender: Contender, mounted: MountedSegment, scores: Samples) -> Scores:
    """Add the paper's metrics to what `Segment.score` found, (5,)."""
    samples, rate_hz = mounted.turn @ mounted.segment.samples, mounted.segment.rate_hz
    output = contender.reduce(samples, rate_hz)
    spectral = bounded = temporal = math.nan
    if output.ndim == 1:
        spectral, bounded = map(float, OriginalSpectrum(samples, rate_hz).match_both(output))
        temporal = temporal_match(samples, output, rate_hz)
    level_db, spectrum, time, change, envelope = scores.tolist()
    paper = spectral, temporal, contender.gain_db, bounded
    return Scores(level_db, spectrum, time, change, *paper, envelope)


def score_scene(
    recording: Recording,
    contenders: Mapping[str, Contender],
    judge: Callable[[Samples], Samples],
    *,
    any_mounting: bool,
    seed: int,
) -> tuple[list[MountedSegment], Samples]:
    """Score reducers in every segment and mounting of a scene that is not silent from 20 to 1000 Hz.

    judge: turns scores into shortfalls; returns the mounted segments and scores, (n_reducers, n_mounted, 5), level in
    dB, spectrum, time, change and envelope; NaN where a reducer was not tried any further.
    """
    rng = np.random.default_rng([seed, zlib.crc32(recording.name.encode())])
    segments = [Segment(part, recording.rate_hz, rng) for part in cut_segments(recording)]
    mounted = _mount(segments, rng, any_mounting=any_mounting)
    scores = np.full((len(contenders), len(mounted), 5), np.nan)
    steady = [one.name in TURNS_ALONG or not any_mounting for one in contenders.values()]
    for row, contender in enumerate(contenders.values()):
        for segment in segments if steady[row] else ():
            own = [each.segment is segment for each in mounted]
            scores[row, own] = segment.score(contender.reduce, segment.both)
    first = 3 * max(FIRST_TURNS, len(segments))
    tried = np.array([not one for one in steady])
    for columns in (range(first), range(first, len(mounted))) if any_mounting else ():
        for column in columns[::3]:
            part = scores[:, column : column + 3]
            _score_turn(part, mounted[column], contenders=contenders, tried=tried)
        tried &= ~(np.nan_to_num(judge(scores)).max(axis=(1, 2)) > HOPELESS)
    return mounted, scores


def cut_segments(recording: Recording) -> list[Samples]:
    """Cut a recording into equal segments of about 2 s that are fast to transform; quiet ones are left out."""
    from scipy.fft import prev_fast_len

    count = max(1, math.floor(recording.duration_s / SEGMENT_S + 0.5))
    length = recording.n_samples // count
    starts = (start * length for start in range(count))
    parts = [recording.acceleration[:, start:][:, : prev_fast_len(length)] for start in starts]
    energies = [float(np.square(part).sum()) for part in parts]
    loud = [energy >= QUIET * max(energies) for energy in energies]
    return [part for part, kept in zip(parts, loud, strict=True) if kept]


def spread_turns(count: int, rng: np.random.Generator) -> Samples:
    """Spread orientations, (count, 3, 3), evenly over all rotations."""
    from scipy.spatial.transform import Rotation
    from scipy.stats import qmc

    first, *angles = qmc.Halton(3, seed=rng).random(count).T
    second, third = 2 * np.pi * np.array(angles)
    low, high = np.sqrt(1 - first), np.sqrt(first)
    parts = low * np.sin(second), low * np.cos(second), high * np.sin(third), high * np.cos(third)
    return np.asarray(Rotation.from_quat(np.transpose(parts)).as_matrix())


def find_change(before: Samples, after: Samples) -> float:
    """Find how much an output has changed; a vibration and its negative feel alike."""
    size = float(np.linalg.norm(before))
    if size == 0:
        return 1.0
    return float(min(np.linalg.norm(after - before), np.linalg.norm(after + before))) / size


def _mount(
    segments: list[Segment], rng: np.random.Generator, *, any_mounting: bool
) -> list[MountedSegment]:
    """Give every segment its orientations in turn, each with the two other permutations of the axes."""
    if not any_mounting:
        return [MountedSegment(segment, np.eye(3)) for segment in segments]
    turns = spread_turns(math.ceil(TURNS / len(segments)) * len(segments), rng)
    return [
        MountedSegment(segments[place % len(segments)], np.roll(turn, step, axis=0))
        for place, turn in enumerate(turns)
        for step in range(3)
    ]


def _score_turn(
    scores: Samples,
    mounted: MountedSegment,
    *,
    contenders: Mapping[str, Contender],
    tried: NDArray[np.bool_],
) -> None:
    """Fill in three columns: an orientation and its permutations, which change the output of some reducers only."""
    segment = mounted.segment
    both = np.einsum("ij,bjn->bin", mounted.turn, segment.both)
    for row, (name, reduce) in enumerate(contenders.values()):
        if tried[row] and name in TREATS_ALIKE:
            scores[row] = segment.score(reduce, both)
        elif tried[row]:
            scores[row] = [segment.score(reduce, np.roll(both, step, axis=1)) for step in range(3)]


def _measure_power(samples: Samples) -> Samples:
    from scipy import fft

    return _square(fft.rfft(samples))


def _square(spectrum: NDArray[np.complex128]) -> Samples:
    return np.asarray(np.square(spectrum.real) + np.square(spectrum.imag))
