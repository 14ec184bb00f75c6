"""Accuracy of every reducer, and its ratings where people rated it, compared within recordings.

All go through `REDUCERS`; what takes a window says so in its signature. Frames overlap by half, because the squares of
their windows then add up to one. A smaller hop is had without touching a reducer: the frames of hop h/m are m families
of frames of hop h, each shifted by h/m, so the mean of m runs over shifted signals is that method exactly. This holds
for `dft321_windowed`, whose frames do not depend on each other; axes that are handed over from frame to frame do.

The same random orientations serve every scene and method, so that differences between methods are
not differences between draws. For a reducer as it is, the paper's two metrics come out as
`feel321.stimuli.rotation_statistics` gives them.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.chart.records import MEASURES, Accuracy
from feel321.stimuli.condition import resample
from feel321.stimuli.match import (
    OriginalSpectrum,
    WeberSmoothing,
    axis_correlations,
    energy_spectrum,
    linear_grid,
    mean_heard,
)
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import (
    REDUCERS,
    WHY_NOT_STREAMING,
    StreamingReducer,
    get_reducer,
)
from feel321.stimuli.rotation import random_rotations, temporal_match_invariant

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    from feel321.stimuli.recording import Recording

    Samples = NDArray[np.float64]

# Which methods are charted: every reducer, and the windowed ones with other windows and hops.

WINDOWS_S = (0.01, 0.02, 0.035, 0.05, 0.1, 0.2)
FAMILIES = (1, 2, 4)
"""How many times more frames than half overlap has."""

HOPPING = "dft321_windowed"
"""The reducer whose frames are independent of each other."""


@dataclass(frozen=True, slots=True)
class Method:
    """A reducer with its window and hop.

    Examples
    --------
    >>> Method("dft321").label, Method("dft321_windowed", 0.1, families=2).label
    ('dft321', 'dft321_windowed, 100 ms, hop 25 ms')
    """

    reducer: str
    window_s: float | None = None
    families: int = 1

    @property
    def label(self) -> str:
        """What the method is called in tables."""
        window = self.window_s or DEFAULT_WINDOW_S
        parts = [self.reducer]
        if self.window_s is not None or self.families > 1:
            parts.append(f"{1000 * window:g} ms")
        if self.families > 1:
            parts.append(f"hop {1000 * window / 2 / self.families:.3g} ms")
        return ", ".join(parts)

    def reduce(self, acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
        """Reduce a signal.

        acceleration: (..., 3, n_samples); returns (..., n_samples).
        """
        own: dict[str, Any] = {} if self.window_s is None else {"window_s": self.window_s}
        reducer = get_reducer(self.reducer)
        if self.families == 1:
            return reducer(acceleration, rate_hz, **own)
        samples = np.asarray(acceleration, dtype=np.float64)
        hop = window_samples(self.window_s or DEFAULT_WINDOW_S, rate_hz) // 2
        shifts = [round(number * hop / self.families) for number in range(self.families)]
        before = [(0, 0)] * (samples.ndim - 1)
        runs = [
            reducer(np.pad(samples, [*before, (shift, 0)]), rate_hz, **own)[..., shift:]
            for shift in shifts
        ]
        return np.asarray(np.mean(runs, axis=0))

    def find_latency(self, rate_hz: float) -> float | None:
        """Tell how much later than its sample a result can be there at the earliest.

        Examples
        --------
        >>> [Method(name).find_latency(10_000) for name in ("soc321", "dft321_windowed", "pca321")]
        [0.0, 0.0349, None]
        """
        if self.reducer in WHY_NOT_STREAMING:
            return None
        stream = StreamingReducer(self.reducer, rate_hz, self.window_s or DEFAULT_WINDOW_S)
        return stream.latency_samples / rate_hz


def list_windowed() -> tuple[str, ...]:
    """List the reducers that take a window."""
    return tuple(
        name for name, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters
    )


def list_methods() -> tuple[Method, ...]:
    """List every reducer as it is unless told otherwise."""
    return tuple(Method(name) for name in REDUCERS)


def list_windows() -> tuple[Method, ...]:
    """List the windowed reducers with every window.

    Returns 10 to 200 ms each.
    """
    return tuple(Method(name, window_s) for name in list_windowed() for window_s in WINDOWS_S)


def list_hops() -> tuple[Method, ...]:
    """List what can be had with every hop."""
    return tuple(
        replace(Method(HOPPING, DEFAULT_WINDOW_S), families=families) for families in FAMILIES
    )


# How well methods keep scenes, whatever way the sensor was glued on.


def measure_accuracy(
    recording: Recording, methods: Iterable[Method], *, turns: Samples, sweep: str = "reducer"
) -> tuple[Accuracy, ...]:
    """Measure methods on one scene.

    turns: (rotations, 3, 3), sensor orientations, at least two.
    """
    if len(turns) < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(
            f"rotations: got {len(turns)}, allowed is 2 or more: one orientation has no spread"
        )
    try:
        scene = _Scene(recording)
        turned = [recording.acceleration, *(turn @ recording.acceleration for turn in turns)]
        return tuple(
            found
            for method in methods
            for found in _measure(scene, method, turned=turned, sweep=sweep)
        )
    except ValueError as error:
        raise ValueError(f"recording {recording.name!r}: {error}") from error


def draw_turns(rotations: int, seed: int) -> Samples:
    """Draw sensor orientations.

    Returns (rotations, 3, 3).
    """
    return random_rotations(rotations, np.random.default_rng(seed))


def cut_piece(recording: Recording, longest_s: float) -> Recording:
    """Take the middle of a recording that is long.

    longest_s: what is kept at most, in s.
    """
    if recording.duration_s <= longest_s:
        return recording
    n = round(longest_s * recording.rate_hz)
    first = (recording.n_samples - n) // 2
    return replace(recording, acceleration=recording.acceleration[:, first : first + n], sha256="")


def change_rate(recording: Recording, rate_hz: float) -> Recording:
    """Resample a recording."""
    samples = resample(recording.acceleration, recording.rate_hz, to_hz=rate_hz)
    return replace(recording, acceleration=samples, rate_hz=rate_hz, sha256="")


class _Scene:
    """A recording whose spectrum is ready to be compared: no orientation changes the sum of its axes' energies.

    What `INVARIANTS` would work out anew in every call is here worked out once.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        samples, rate, n = recording.acceleration, recording.rate_hz, recording.n_samples
        self._original = OriginalSpectrum(samples, rate)
        if self._original.reason:
            raise ValueError(self._original.reason)
        self._smooth = WeberSmoothing(linear_grid(n, rate), rate / n, n // 2 + 1)
        self._energy = energy_spectrum(samples, self._smooth.bins).sum(axis=0)

    def score(self, turned: Samples, reduced: Samples) -> list[float]:
        """Give the measures of one reduced signal, in the order of `MEASURES`."""
        energy = energy_spectrum(reduced, self._smooth.bins)
        total, apart = (
            self._smooth(self._energy + energy).sum(),
            np.abs(self._smooth(self._energy - energy)).sum(),
        )
        spectral, bounded = map(float, self._original.match_both(reduced))
        temporal = float(mean_heard(axis_correlations(turned, reduced)))
        shared = float((total - apart) / (total + apart))
        return [spectral, temporal, bounded, shared, temporal_match_invariant(turned, reduced)]


def _measure(scene: _Scene, method: Method, *, turned: list[Samples], sweep: str) -> list[Accuracy]:
    name, rate = scene.recording.name, scene.recording.rate_hz
    scores = np.array([scene.score(one, method.reduce(one, rate)) for one in turned])
    mounted, mean, sd = scores[0], scores[1:].mean(axis=0), scores[1:].std(axis=0, ddof=1)
    return [
        Accuracy(
            sweep,
            method.label,
            method.reducer,
            name,
            rate,
            measure,
            float(mounted[i]),
            float(mean[i]),
            float(sd[i]),
            len(turned) - 1,
        )
        for i, measure in enumerate(MEASURES)
    ]
