"""Simplicity and measures of reducers: what a choice rests on.

The record holds state (numbers that must be held at once), latency, operations per sample, and parameters (what has to
be chosen). Latency is what `StreamingReducer` says, and parameters are what the reducer's signature names. State and
operations follow from its definition: a real transform of n samples takes 2.5 n log2(n) operations; an addition, a
multiplication, a division and a root count one each.

Which of the four is scarce depends on where the reducer runs:

- *offline* the recording is there, so neither waiting nor memory is scarce. First come what has to be chosen, then
  operations, then state.
- *online* come latency and state, then operations, then parameters.

In both, fewer axes of the actuator come before everything else. Reducers alike in all of it, as the three single axes
are, are equally simple.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from inspect import signature
from math import inf, isfinite, log2
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.stimuli.match import OriginalSpectrum, temporal_match
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from feel321.analysis.tradeoff.advise.draws import Candidate, Draw
    from feel321.stimuli.reducers.registry import Reducer

# What a reducer costs, and which of two is the simpler: an order computed from a record, never from a list.

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


class _Size(NamedTuple):
    """What operations and state depend on."""

    n: int
    window: int


class _Work(NamedTuple):
    """Numbers held at once, and operations per sample."""

    state: float
    operations: float


def _no_memory(operations: float) -> Callable[[_Size], _Work]:
    return lambda _: _Work(0.0, operations)


def _transforms(n: int) -> float:
    return 4 * 2.5 * log2(max(n, 2))  # three axes there, one back


_WORK: Mapping[str, Callable[[_Size], _Work]] = MappingProxyType({
    "sax321": _no_memory(0.0),
    "say321": _no_memory(0.0),
    "saz321": _no_memory(0.0),
    "soc321": _no_memory(2.0),
    "mag321": _no_memory(6.0),
    **dict.fromkeys(("sax321_matched", "say321_matched", "saz321_matched"), lambda size: _Work(size.n + 2.0, 7.0)),
    # Three squares and their sums, two sums that forget, the limit, division, root and product.
    **dict.fromkeys(
        ("sax321_matched_running", "say321_matched_running", "saz321_matched_running"), lambda _: _Work(2.0, 14.0)
    ),
    "pca321": lambda size: _Work(3.0 * size.n, MEAN + COVARIANCE + PROJECTION),
    "pca321_matched": lambda size: _Work(3.0 * size.n, MEAN + COVARIANCE + PROJECTION + 1),
    # One covariance, axis and gain are remembered; axis and gain fade from one estimate to the next.
    "pca321_matched_windowed": lambda size: _Work(3.0 * size.window + 10, COVARIANCE + 16 + PROJECTION),
    # Each sample lies in two frames; its axis is mixed from theirs and brought to unit length.
    "pca321_adaptive": lambda size: _Work(3.0 * size.window + 3, 2 * (MEAN + COVARIANCE) + 18 + PROJECTION),
    "dft321": lambda size: _Work(4.0 * size.n, _transforms(size.n) + SPECTRA_TO_ONE),
    "dft321_principal": lambda size: _Work(
        4.0 * size.n, _transforms(size.n) + SPECTRA_TO_ONE + LEADING_AXIS
    ),
    "dft321_windowed": lambda size: _Work(3.5 * size.window, 2 * (_transforms(size.window) + SPECTRA_TO_ONE + 4) + 1),
    "dft321_principal_windowed": lambda size: _Work(
        3.5 * size.window + AXIS_MEMORY,
        2 * (_transforms(size.window) + SPECTRA_TO_ONE + 4 + LEADING_AXIS) + 1,
    ),
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class Cost:
    """The record of a reducer on a scene.

    latency_ms: infinite where the whole recording is needed.
    """

    name: str
    axes: int
    state: float
    latency_ms: float
    operations: float
    parameters: int

    def rank(self, *, online: bool) -> tuple[float, ...]:
        """Tell how simple it is."""
        if online:
            return self.axes, self.latency_ms, self.state, self.operations, self.parameters
        return self.axes, self.parameters, self.operations, self.state


def list_windows(name: str, reducer: Reducer, *, longest_ms: float) -> Iterator[tuple[str, float]]:
    """List a reducer as it is and, if it has a window, with other windows whose delay is short enough.

    longest_ms: where it does not matter (infinite) the usual window is enough.

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


def find_cost(
    name: str,
    reducer: Reducer,
    *,
    n_samples: int,
    rate_hz: float,
    window_s: float = DEFAULT_WINDOW_S,
) -> Cost:
    """Find what a reducer costs on a scene.

    Examples
    --------
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> find_cost("soc321", REDUCERS["soc321"], n_samples=1000, rate_hz=1000.0).operations
    2.0
    """
    if name not in _WORK:
        raise ValueError(
            f"reducer: got {name!r}, whose state and operations are not recorded in {__name__}; add them"
        )
    work = _WORK[name](_Size(n_samples, window_samples(window_s, rate_hz)))
    chosen = [
        each for each in signature(reducer).parameters.values() if each.kind is each.KEYWORD_ONLY
    ]
    return Cost(
        name, 1, work.state, _find_latency(name, rate_hz, window_s), work.operations, len(chosen)
    )


def _find_latency(name: str, rate_hz: float, window_s: float) -> float:
    if name in WHY_NOT_STREAMING:
        return inf
    return MS_PER_S * StreamingReducer(name, rate_hz, window_s).latency_samples / rate_hz


# What a scene becomes under a reducer: level, spectrum, time, steadiness, and the paper's two metrics beside them.

GAIN_DB = {"soc321": 10 * math.log10(3)}
"""Gain of a fixed sum of axes: the norm of its weights, where that is not 1. See `Measures.deviation_db`."""


@dataclass(frozen=True, slots=True)
class Measures:
    """What a reducer makes of a segment of a scene, with the sensor mounted in one way.

    change: relative change of the output, up to its sign, under sensor noise of -60 dB;
    spectral_match, temporal_match: naN where there are none.
    """

    level_db: float
    spectrum: float
    time: float
    change: float
    spectral_match: float
    temporal_match: float
    gain_db: float = 0.0
    spectral_match_bounded: float = math.nan

    @property
    def deviation_db(self) -> float:
        """How far the level is off, in dB.

        A sum of axes is the projection on the sensor's diagonal, 4.8 dB louder. What it lost on the other axes may be
        made up for by that gain, but then mounting and chance decide, and the spectrum and the moment at which they
        cancel go unseen. So the level must be right with the gain and must not be lost without it. A gain that is
        measured, as that of the reducers with matched energy is, is right for every mounting and does not count.
        """
        return max(abs(self.level_db), self.gain_db - self.level_db)


def find_gains(candidates: list[Candidate]) -> NDArray[np.float64]:
    """Look up the fixed gains of candidates, one row each, to be set against draws.

    Returns (n_candidates, 1), in dB.
    """
    return np.array([[GAIN_DB.get(candidate.name, 0.0)] for candidate in candidates])


def measure(candidate: Candidate, draw: Draw, scores: NDArray[np.float64]) -> Measures:
    """Put together what is known of a reducer in a draw, and add the paper's metrics.

    scores: (4,).
    """
    samples, rate_hz = draw.turn @ draw.segment.samples, draw.segment.rate_hz
    output = candidate.reduce(samples, rate_hz)
    spectral = bounded = temporal = math.nan
    if output.ndim == 1:
        spectral, bounded = map(float, OriginalSpectrum(samples, rate_hz).match_both(output))
        temporal = temporal_match(samples, output, rate_hz)
    level_db, spectrum, time, change = scores.tolist()
    gain_db = GAIN_DB.get(candidate.name, 0.0)
    return Measures(level_db, spectrum, time, change, spectral, temporal, gain_db, bounded)
