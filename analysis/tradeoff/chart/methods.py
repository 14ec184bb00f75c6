"""Which methods are charted: every reducer, and the windowed ones with other windows and hops.

All go through `REDUCERS`; what takes a window says so in its signature. Frames overlap by half, because the squares of
their windows then add up to one. A smaller hop is had without touching a reducer: the frames of hop h/m are m families
of frames of hop h, each shifted by h/m, so the mean of m runs over shifted signals is that method exactly. This holds
for `dft321_windowed`, whose frames do not depend on each other; axes that are handed over from frame to frame do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from stimuli.frames import DEFAULT_WINDOW_S, window_samples
from stimuli.reduce import REDUCERS, get_reducer
from stimuli.stream import WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

WINDOWS_S = (0.01, 0.02, 0.035, 0.05, 0.1, 0.2)
FAMILIES = (1, 2, 4)
"""How many times more frames than half overlap has."""

HOPPING = "dft321_windowed"
"""The reducer whose frames are independent of each other."""


@dataclass(frozen=True, slots=True)
class Method:
    """A reducer with its window and hop.

    Parameters
    ----------
    reducer : str
        A name of `REDUCERS`.
    window_s : float, optional
        Length of a frame; the reducer's own if left out.
    families : int
        Hop is half the window divided by this.

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

        Parameters
        ----------
        acceleration : array_like, shape (..., 3, n_samples)
            Any unit.
        rate_hz : float
            Sampling rate in Hz.

        Returns
        -------
        ndarray of float64, shape (..., n_samples)
            Same unit.
        """
        own: dict[str, Any] = {} if self.window_s is None else {"window_s": self.window_s}
        reducer = get_reducer(self.reducer)
        if self.families == 1:
            return reducer(acceleration, rate_hz, **own)
        samples = np.asarray(acceleration, dtype=np.float64)
        hop = window_samples(self.window_s or DEFAULT_WINDOW_S, rate_hz) // 2
        shifts = [round(number * hop / self.families) for number in range(self.families)]
        before = [(0, 0)] * (samples.ndim - 1)
        runs = [reducer(np.pad(samples, [*before, (shift, 0)]), rate_hz, **own)[..., shift:] for shift in shifts]
        return np.asarray(np.mean(runs, axis=0))

    def find_latency(self, rate_hz: float) -> float | None:
        """Tell how much later than its sample a result can be there at the earliest.

        Parameters
        ----------
        rate_hz : float
            Sampling rate in Hz.

        Returns
        -------
        float or None
            In s: 0 for a reducer without memory, a window less a sample for a windowed one; None where the
            whole signal is needed.

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
    """List the reducers that take a window.

    Returns
    -------
    tuple of str
        In the order of `REDUCERS`.
    """
    return tuple(name for name, reducer in REDUCERS.items() if "window_s" in signature(reducer).parameters)


def list_methods() -> tuple[Method, ...]:
    """List every reducer as it is unless told otherwise.

    Returns
    -------
    tuple of Method
        In the order of `REDUCERS`.
    """
    return tuple(Method(name) for name in REDUCERS)


def list_windows() -> tuple[Method, ...]:
    """List the windowed reducers with every window.

    Returns
    -------
    tuple of Method
        10 to 200 ms each.
    """
    return tuple(Method(name, window_s) for name in list_windowed() for window_s in WINDOWS_S)


def list_hops() -> tuple[Method, ...]:
    """List what can be had with every hop.

    Returns
    -------
    tuple of Method
        Hops of a half, a quarter and an eighth of the window.
    """
    return tuple(replace(Method(HOPPING, DEFAULT_WINDOW_S), families=families) for families in FAMILIES)
