"""Draws: what every reducer makes of a scene in each segment, with the sensor mounted in many ways.

A scene is cut into segments of about 2 s, and each is turned as if the sensor had been glued on otherwise. The
orientations are spread evenly over all rotations (Halton points [1]_ through Shoemake's formula [2]_), so that few of
them stand for all. The *worst* orientation decides in a segment, and the worst segment in a scene (the 90th percentile
of the segments where there are ten or more).

Three things spare most of the work. What turns with the sensor (`TURNS_ALONG`) is measured once per segment. Cyclic
permutations of the axes are mountings too: of them what treats the axes alike (`TREATS_ALIKE`) knows nothing, and over
them the three single axes are equal. And a reducer that has missed the tolerance by half is not tried any further.
Tests hold the first two to be true.

References
----------
.. [1] J. H. Halton, "On the efficiency of certain quasi-random sequences of points in evaluating multi-dimensional
   integrals", Numerische Mathematik 2, 1960. doi:10.1007/BF01386213
.. [2] K. Shoemake, "Uniform random rotations", in Graphics Gems III, Academic Press 1992.
"""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from feel321.stimuli.recording import Recording

    Samples = NDArray[np.float64]
    Reduce = Callable[[Samples, float], Samples]
    Judge = Callable[[Samples], Samples]

SEGMENT_S = 2.0
"""About the length of a segment: long enough for 20 Hz and for a stroke, short enough that a scene has several."""

TURNS = 24
"""Orientations of a scene; each counts three times, with x, y and z in each other's place."""

FIRST_TURNS = 4
"""So many of them are tried before reducers are left out that have failed."""

HOPELESS = 1.5
"""Shortfall, in tolerances, from which on a reducer is not tried any further."""

SEGMENTS = 0.9
"""Share of the segments in which a reducer must suffice: all of them, where they are fewer than ten."""

QUIET = 0.01
"""Segments with less than this share of the strongest one's energy (20 dB) do not count."""

NOISE = 1e-3
"""Sensor noise against the recording, in amplitude: -60 dB."""

SILENT_DB = -120.0
"""What stands for silence."""

TURNS_ALONG = frozenset({
    "mag321", "pca321", "pca321_adaptive", "dft321_principal", "dft321_principal_windowed", "pca321_matched",
    "pca321_matched_windowed", "two_principal_axes", "three_axes",
})  # fmt: skip
"""Reducers, and what several axes of an actuator play, whose output no rotation changes but for its sign."""

TREATS_ALIKE = TURNS_ALONG | {"soc321", "dft321", "dft321_windowed"}
"""Reducers whose output no permutation of the axes changes."""


class Candidate(NamedTuple):
    """A reducer, or one of its windows."""

    name: str
    reduce: Reduce


class Draw(NamedTuple):
    """One segment with the sensor mounted in one way.

    turn: (3, 3).
    """

    segment: Segment
    turn: Samples


class Segment:
    """A segment made ready for many reducers: what all of them are compared with is computed once.

    samples: (3, n_samples).
    """

    def __init__(self, samples: Samples, rate_hz: float, rng: np.random.Generator) -> None:
        from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ, WeberSmoothing, linear_grid
        from feel321.stimuli.sets.anchors import acceleration_threshold

        self.samples, self.rate_hz = samples, rate_hz
        noise = rng.standard_normal(samples.shape)
        noise *= NOISE * np.linalg.norm(samples) / (np.linalg.norm(noise) or 1.0)
        self.both = np.array([samples, samples + noise])
        n = samples.shape[-1]
        self._smooth = WeberSmoothing(linear_grid(n, rate_hz), rate_hz / n, n // 2 + 1)
        frequency = np.arange(n // 2 + 1) * rate_hz / n
        felt = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
        self._weights = np.where(
            felt, 1 / acceleration_threshold(np.where(felt, frequency, LOWEST_HZ)) ** 2, 0.0
        )
        self._power = _measure_power(samples).sum(axis=0)
        self.level = float(self._power @ self._weights)
        self._size = float(np.linalg.norm(samples))

    def score(self, reduce: Reduce, both: Samples) -> Samples:
        """Measure one reducer.

        both: (2, 3, n_samples); returns (4,), level in dB, spectrum, time and change.
        """
        output, disturbed = reduce(both, self.rate_hz)
        power = _measure_power(output)
        size = float(np.linalg.norm(output))
        if output.ndim > 1:  # axes that are kept
            time, power = size / self._size, power.sum(axis=0)
        else:
            along = float(np.linalg.norm(both[0] @ output))
            time = min(along / (size * self._size), 1.0) if size > 0 else 0.0
        return np.array([
            self._find_level(power),
            self._compare(power),
            time,
            find_change(output, disturbed),
        ])

    def _find_level(self, power: Samples) -> float:
        ratio = float(power @ self._weights) / self.level
        return max(10 * math.log10(ratio), SILENT_DB) if ratio > 0 else SILENT_DB

    def _compare(self, power: Samples) -> float:
        """`spectral_match_energy_weighted`, of spectra that are there already."""
        own, kept = self._power[self._smooth.bins], power[self._smooth.bins]
        total, apart = self._smooth(own + kept).sum(), np.abs(self._smooth(own - kept)).sum()
        return float(max((total - apart) / (total + apart), 0.0))


def score_scene(
    recording: Recording,
    reducers: Mapping[str, Candidate],
    judge: Judge,
    *,
    any_mounting: bool,
    seed: int,
) -> tuple[list[Draw], Samples]:
    """Measure reducers in every draw of a scene.

    recording: the scene, not silent from 20 to 1000 Hz; returns scores: (n_reducers, n_draws, 4),
    level in dB, spectrum, time and change, as in `measures.Measures`.
    """
    rng = np.random.default_rng([seed, zlib.crc32(recording.name.encode())])
    segments = [Segment(part, recording.rate_hz, rng) for part in cut_segments(recording)]
    draws = _make_draws(segments, rng, any_mounting=any_mounting)
    scores = np.full((len(reducers), len(draws), 4), np.nan)
    steady = [name in TURNS_ALONG or not any_mounting for name, _ in reducers.values()]
    for row, (_, reduce) in enumerate(reducers.values()):
        for segment in segments if steady[row] else ():
            scores[row, [draw.segment is segment for draw in draws]] = segment.score(
                reduce, segment.both
            )
    first = 3 * max(FIRST_TURNS, len(segments))
    tried = np.array([not one for one in steady])
    for columns in (range(first), range(first, len(draws))) if any_mounting else ():
        for column in columns[::3]:
            _score_turn(
                scores[:, column : column + 3], draws[column], reducers=reducers, tried=tried
            )
        tried &= ~(np.nan_to_num(judge(scores)).max(axis=(1, 2)) > HOPELESS)
    return draws, scores


def cut_segments(recording: Recording) -> list[Samples]:
    """Cut a recording into equal segments of about 2 s that are fast to transform; quiet ones are left out.

    Returns (3, n_samples).
    """
    from scipy.fft import prev_fast_len

    count = max(1, math.floor(recording.duration_s / SEGMENT_S + 0.5))
    length = recording.n_samples // count
    parts = [
        recording.acceleration[:, start * length :][:, : prev_fast_len(length)]
        for start in range(count)
    ]
    energies = [float(np.square(part).sum()) for part in parts]
    return [
        part
        for part, energy in zip(parts, energies, strict=True)
        if energy >= QUIET * max(energies)
    ]


def spread_turns(count: int, rng: np.random.Generator) -> Samples:
    """Spread orientations evenly over all rotations.

    Returns (count, 3, 3).
    """
    from scipy.spatial.transform import Rotation
    from scipy.stats import qmc

    first, second, third = qmc.Halton(3, seed=rng).random(count).T
    second, third = 2 * np.pi * second, 2 * np.pi * third
    low, high = np.sqrt(1 - first), np.sqrt(first)
    quaternions = (
        low * np.sin(second),
        low * np.cos(second),
        high * np.sin(third),
        high * np.cos(third),
    )
    return np.asarray(Rotation.from_quat(np.transpose(quaternions)).as_matrix())


def find_change(before: Samples, after: Samples) -> float:
    """Find how much an output has changed; a vibration and its negative feel alike."""
    size = float(np.linalg.norm(before))
    if size == 0:
        return 1.0
    return float(min(np.linalg.norm(after - before), np.linalg.norm(after + before))) / size


def _make_draws(
    segments: list[Segment], rng: np.random.Generator, *, any_mounting: bool
) -> list[Draw]:
    """Give every segment its orientations in turn, each with the two other permutations of the axes."""
    if not any_mounting:
        return [Draw(segment, np.eye(3)) for segment in segments]
    turns = spread_turns(math.ceil(TURNS / len(segments)) * len(segments), rng)
    return [
        Draw(segments[place % len(segments)], np.roll(turn, step, axis=0))
        for place, turn in enumerate(turns)
        for step in range(3)
    ]


def _score_turn(
    scores: Samples, draw: Draw, *, reducers: Mapping[str, Candidate], tried: NDArray[np.bool_]
) -> None:
    """Fill in three columns: an orientation and its permutations, which only some reducers know of."""
    both = np.einsum("ij,bjn->bin", draw.turn, draw.segment.both)
    for row, (name, reduce) in enumerate(reducers.values()):
        if tried[row] and name in TREATS_ALIKE:
            scores[row] = draw.segment.score(reduce, both)
        elif tried[row]:
            scores[row] = [
                draw.segment.score(reduce, np.roll(both, step, axis=1)) for step in range(3)
            ]


def _measure_power(samples: Samples) -> Samples:
    from scipy import fft

    spectrum = fft.rfft(samples)
    power = np.square(spectrum.real)
    power += np.square(spectrum.imag)
    return np.asarray(power)
