"""How well reducers keep a scene, whatever way the sensor was mounted; with other windows, hops and rates too.

Reducers that take a window have it in their signature. Frames overlap by half, because the squares of their windows
then add up to one. A smaller hop is had without touching a reducer: the frames of hop h/m are m families of frames of
hop h, each shifted by h/m, so the mean of m runs over shifted signals is that method exactly. This holds for
`dft321_windowed`, whose frames do not depend on each other; axes that are handed over from frame to frame do.

The same random orientations serve every scene and method, so that differences between methods are not differences
between draws. For a reducer as it is, the paper's two metrics come out as `feel321.stimuli.rotation_statistics` gives
them [1]_.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from feel321.analysis.tradeoff.chart.points import MEASURES, TABLES
from feel321.stimuli.condition import resample
from feel321.stimuli.match import (
    OriginalSpectrum,
    WeberSmoothing,
    axis_correlations,
    energy_spectrum,
    linear_grid,
    mean_over_axes,
)
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer
from feel321.stimuli.rotation import random_rotations, temporal_match_invariant
from feel321.types import Samples

if TYPE_CHECKING:
    from feel321.stimuli.guard import OwnReducer, OwnStream
    from feel321.stimuli.recording import Recording

WINDOWS_S = (0.01, 0.02, 0.035, 0.05, 0.1, 0.2)
FAMILIES = (1, 2, 4)
"""How many times more frames than half overlap has."""

HOPPING = "dft321_windowed"
"""The reducer whose frames are independent of each other."""


@dataclass(frozen=True, slots=True)
class ReducerVariant:
    """A reducer with its window and hop.

    Examples
    --------
    >>> ReducerVariant("dft321").label, ReducerVariant("dft321_windowed", 0.1, families=2).label
    ('dft321', 'dft321_windowed, 100 ms, hop 25 ms')
    """

    reducer: str
    window_s: float | None = None
    families: int = 1
    own: OwnReducer | None = None

    @property
    def label(self) -> str:
        """The "method" of every table."""
        window = self.window_s or DEFAULT_WINDOW_S
        parts = [self.reducer]
        if self.window_s is not None or self.families > 1:
            parts.append(f"{1000 * window:g} ms")
        if self.families > 1:
            parts.append(f"hop {1000 * window / 2 / self.families:.3g} ms")
        return ", ".join(parts)

    def reduce(self, acceleration: ArrayLike, rate_hz: float) -> Samples:
        """Reduce a signal, (..., 3, n_samples)."""
        own: dict[str, Any] = {} if self.window_s is None else {"window_s": self.window_s}
        reducer: Callable[..., Samples] = self.own or REDUCERS[self.reducer]
        samples = np.asarray(acceleration, dtype=np.float64)
        if self.families == 1:
            return reducer(samples, rate_hz, **own)
        hop = window_samples(self.window_s or DEFAULT_WINDOW_S, rate_hz) // 2
        before = [(0, 0)] * (samples.ndim - 1)
        runs = []
        for shift in (round(number * hop / self.families) for number in range(self.families)):
            shifted = np.pad(samples, [*before, (shift, 0)])
            runs.append(reducer(shifted, rate_hz, **own)[..., shift:])
        return np.asarray(np.mean(runs, axis=0))

    def find_latency(self, rate_hz: float) -> float | None:
        """Find how many s after its sample a result can be there; None where the whole signal is needed."""
        if self.own:
            return self.own.find_latency(rate_hz)
        if self.reducer in WHY_NOT_STREAMING:
            return None
        stream = StreamingReducer(self.reducer, rate_hz, self.window_s or DEFAULT_WINDOW_S)
        return stream.latency_samples / rate_hz

    def open_stream(self, rate_hz: float) -> StreamingReducer | OwnStream | None:
        """Open its streaming form; None where it has none."""
        if self.own:
            return self.own.open_stream(rate_hz)
        is_causal = self.reducer not in WHY_NOT_STREAMING
        return StreamingReducer(self.reducer, rate_hz) if is_causal else None


def list_variants(
    sweep: str = "reducer", own: Mapping[str, OwnReducer] | None = None
) -> tuple[ReducerVariant, ...]:
    """List every reducer as it is; those with a window with every "window"; or what can be had with every "hop".

    own: reducers of a lab, which are taken as they are.
    """
    if sweep == "window":
        windowed = (
            name for name, one in REDUCERS.items() if "window_s" in signature(one).parameters
        )
        return tuple(ReducerVariant(name, window_s) for name in windowed for window_s in WINDOWS_S)
    if sweep == "hop":
        return tuple(ReducerVariant(HOPPING, DEFAULT_WINDOW_S, count) for count in FAMILIES)
    ours = [ReducerVariant(name) for name in REDUCERS]
    return (*ours, *(ReducerVariant(name, own=one) for name, one in (own or {}).items()))


def measure_accuracy(
    recording: Recording,
    variants: Iterable[ReducerVariant],
    *,
    turns: Samples,
    sweep: str = "reducer",
) -> list[dict[str, Any]]:
    """Measure methods on one scene: rows of the table "accuracies".

    turns: sensor orientations, (rotations, 3, 3), at least two.
    """
    if len(turns) < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"rotations must be 2 or more, got {len(turns)}: one has no spread")
    rate, rows = recording.rate_hz, []
    try:
        scorer = Scorer(recording)
        turned = [recording.acceleration, *(turn @ recording.acceleration for turn in turns)]
        for variant in variants:
            scores = np.array([scorer.score(one, variant.reduce(one, rate)) for one in turned])
            values = scores[0], scores[1:].mean(axis=0), scores[1:].std(axis=0, ddof=1)
            for measure, found in zip(MEASURES, np.transpose(values).tolist(), strict=True):
                row = (sweep, variant.label, variant.reducer, recording.name, rate, measure)
                rows.append((*row, *found, len(turns)))
    except ValueError as error:
        raise ValueError(f"recording {recording.name!r}: {error}") from error
    return [dict(zip(TABLES["accuracies"], row, strict=True)) for row in rows]


def draw_turns(rotations: int, seed: int) -> Samples:
    """Draw sensor orientations, (rotations, 3, 3)."""
    return random_rotations(rotations, np.random.default_rng(seed))


def cut_piece(recording: Recording, longest_s: float) -> Recording:
    """Take the middle of a recording that is longer."""
    if recording.duration_s <= longest_s:
        return recording
    n = round(longest_s * recording.rate_hz)
    first = (recording.n_samples - n) // 2
    return replace(recording, acceleration=recording.acceleration[:, first : first + n], sha256="")


def change_rate(recording: Recording, rate_hz: float) -> Recording:
    """Resample a recording."""
    samples = resample(recording.acceleration, recording.rate_hz, to_hz=rate_hz)
    return replace(recording, acceleration=samples, rate_hz=rate_hz, sha256="")


class Scorer:
    """What `METRICS` and `INVARIANTS` would compute anew in every call, computed once for a recording.

    No orientation changes the sum of its axes' energies.
    """

    def __init__(self, recording: Recording) -> None:
        samples, rate, n = recording.acceleration, recording.rate_hz, recording.n_samples
        self._original = OriginalSpectrum(samples, rate)
        if self._original.reason:
            raise ValueError(self._original.reason)
        self._smooth = WeberSmoothing(linear_grid(n, rate), rate / n, n // 2 + 1)
        self._energy = energy_spectrum(samples, self._smooth.bins).sum(axis=0)

    def score(self, turned: Samples, reduced: Samples) -> list[float]:
        """Score one reduced signal, in the order of `MEASURES`."""
        energy = energy_spectrum(reduced, self._smooth.bins)
        total = self._smooth(self._energy + energy).sum()
        apart = np.abs(self._smooth(self._energy - energy)).sum()
        spectral, bounded = map(float, self._original.match_both(reduced))
        temporal = float(mean_over_axes(axis_correlations(turned, reduced)))
        shared = float((total - apart) / (total + apart))
        return [spectral, temporal, bounded, shared, temporal_match_invariant(turned, reduced)]
