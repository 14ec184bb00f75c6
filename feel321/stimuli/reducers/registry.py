"""REDUCERS: the one list of reducers, and their streaming form.

Every reducer is called alike, `REDUCERS[name](acceleration, rate_hz)`: acceleration of shape (..., 3, n_samples), any
unit, in; the reduced signal, shape (..., n_samples), float64, same unit, out. Deterministic; the input is never
modified.

A streamed reducer gives, sample by sample, what its offline form gives for the whole signal, `latency_samples` later.
It allocates a little per call and never looks ahead. The work of a window is done in the block that completes half a
window, it is not spread: `feel321 chart` measures what that block costs.

A *gap* is a run of samples that did not arrive: samples of which an axis is not a finite number, or that `skip`
declares. Time goes on during a gap, so as many samples are given as are missing.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from feel321.stimuli.recording import (
    SAFE_PEAK,
    check_finite,
    check_rate,
    coerce_acceleration,
    largest,
)
from feel321.stimuli.reducers.axes import (
    DEFAULT_WINDOW_S,
    BlockProcessor,
    PrincipalFrames,
    cut_blocks,
    mag321,
    pca321,
    pca321_adaptive,
    sax321,
    say321,
    saz321,
    soc321,
    window_samples,
)
from feel321.stimuli.reducers.fourier import (
    FourierFrames,
    TrackingFrames,
    dft321,
    dft321_principal,
    dft321_principal_windowed,
    dft321_windowed,
)
from feel321.stimuli.reducers.matched import (
    RunningAxis,
    frames_at,
    pca321_matched,
    pca321_matched_windowed,
    sax321_matched,
    sax321_matched_running,
    say321_matched,
    say321_matched_running,
    saz321_matched,
    saz321_matched_running,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    OnGap = Literal["raise", "hold", "zero"]

# REDUCERS: the one list of the 321 transforms, in the order of the paper, simplest first; later ones follow.


class Reducer(Protocol):
    """A 321 transform: (..., 3, n_samples) -> (..., n_samples)."""

    def __call__(self, acceleration: ArrayLike, rate_hz: float, /) -> NDArray[np.float64]:
        """Reduce three axes of acceleration to one."""


REDUCERS: Mapping[str, Reducer] = MappingProxyType({
    "sax321": sax321,
    "say321": say321,
    "saz321": saz321,
    "soc321": soc321,
    "mag321": mag321,
    "pca321": pca321,
    "pca321_adaptive": pca321_adaptive,
    "dft321": dft321,
    "dft321_windowed": dft321_windowed,
    "dft321_principal": dft321_principal,
    "dft321_principal_windowed": dft321_principal_windowed,
    "sax321_matched": sax321_matched,
    "say321_matched": say321_matched,
    "saz321_matched": saz321_matched,
    "pca321_matched": pca321_matched,
    "sax321_matched_running": sax321_matched_running,
    "say321_matched_running": say321_matched_running,
    "saz321_matched_running": saz321_matched_running,
    "pca321_matched_windowed": pca321_matched_windowed,
})
"""Name -> reducer."""

DEFAULT_REDUCERS = tuple(REDUCERS)[:9]
"""What a study compares unless it says otherwise: as many as a MUSHRA page holds beside the reference and anchors."""


def get_reducer(name: str) -> Reducer:
    """Look a reducer up, or say which there are."""
    try:
        return REDUCERS[name]
    except KeyError:
        raise ValueError(
            f"reducer: got {name!r}, allowed is one of {', '.join(REDUCERS)}"
        ) from None


# Reducers that run while the vibration is still being made: blocks in, blocks out, a constant delay.

ON_GAP = ("raise", "hold", "zero")
"""What can stand for a missing sample: an error, the last sample that arrived (0 before the first), or 0."""

_NO_MEMORY = MappingProxyType({
    "sax321": sax321,
    "say321": say321,
    "saz321": saz321,
    "soc321": soc321,
    "mag321": mag321,
})
_RUNNING = MappingProxyType({
    "sax321_matched_running": 0,
    "say321_matched_running": 1,
    "saz321_matched_running": 2,
})
_IN_FRAMES: Mapping[str, Callable[[float], Callable[[tuple[int, ...], int], BlockProcessor]]] = (
    MappingProxyType({
        "pca321_adaptive": lambda _: PrincipalFrames,
        "dft321_windowed": lambda _: FourierFrames,
        "dft321_principal_windowed": lambda _: TrackingFrames,
        "pca321_matched_windowed": frames_at,
    })
)
WHY_NOT_STREAMING: Mapping[str, str] = MappingProxyType({
    "pca321": "its axis and its mean need the whole recording; stream pca321_adaptive instead",
    "dft321": "its spectrum needs the whole recording; stream dft321_windowed instead",
    "dft321_principal": "its axis needs the whole recording; stream dft321_principal_windowed instead",
    "sax321_matched": "its gain needs the whole recording; stream sax321_matched_running instead",
    "say321_matched": "its gain needs the whole recording; stream say321_matched_running instead",
    "saz321_matched": "its gain needs the whole recording; stream saz321_matched_running instead",
    "pca321_matched": "its axis and its gain need the whole recording; stream pca321_matched_windowed instead",
})
"""Name -> reason, for the reducers that cannot run causally."""


class _Gaps:
    """What stands for missing samples, and how many there were."""

    def __init__(self, on_gap: OnGap) -> None:
        self._on_gap = on_gap
        self._last = np.zeros((3, 1))
        self._inside = False
        self.gaps = self.samples = 0

    def fill(self, samples: NDArray[np.float64], there: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Put something in the place of missing samples, or raise ValueError; nothing is remembered yet."""
        if self._on_gap == "raise":
            check_finite(samples, "block")
        if there.all():
            return samples
        which = np.where(there, np.arange(1, there.size + 1), 0)
        if self._on_gap == "hold":
            which = np.maximum.accumulate(which)
        # Place 0 is the last sample before this block.
        before = self._last if self._on_gap == "hold" else np.zeros((3, 1))
        return np.asarray(np.concatenate([before, samples], axis=1)[:, which])

    def count(self, samples: NDArray[np.float64], there: NDArray[np.bool_]) -> None:
        """Count missing samples, and gaps where they begin; remember the last of the filled samples."""
        missing = ~np.concatenate([[not self._inside], there])
        self.gaps += int(np.count_nonzero(missing[1:] & ~missing[:-1]))
        self.samples += int(np.count_nonzero(missing[1:]))
        self._inside = bool(missing[-1])
        if there.size:
            self._last = samples[:, -1:].copy()


class _Samplewise:
    """A reducer without frames: as many samples out as in."""

    def __init__(self, push: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        self._push = push

    def step(self, samples: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Write the output of samples (3, k) to `out`."""
        np.copyto(out, self._push(samples))

    def end(self) -> NDArray[np.float64]:
        """Give nothing: nothing is held back."""
        return np.zeros(0)


class _InFrames:
    """A block processor, fed samples as they come."""

    def __init__(self, processor: BlockProcessor) -> None:
        self._processor, self._to_drop = processor, processor.hop
        self._waiting = np.zeros((3, 0))
        self._ready = np.zeros(2 * processor.hop - 1)

    def step(self, samples: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Write the output of samples (3, k) to `out`."""
        self._waiting = np.concatenate([self._waiting, samples], axis=1)
        if n_blocks := self._waiting.shape[1] // self._processor.hop:
            self._push(n_blocks)
        out[:], self._ready = self._ready[: out.size], self._ready[out.size :]

    def end(self) -> NDArray[np.float64]:
        """Give what the delay still holds back."""
        self._push(-(-self._waiting.shape[1] // self._processor.hop) + 1)
        return self._ready[: 2 * self._processor.hop - 1]

    def _push(self, n_blocks: int) -> None:
        used = n_blocks * self._processor.hop
        finished = self._processor.push(
            *cut_blocks(self._waiting[:, :used], self._processor.hop, n_blocks)
        ).ravel()
        self._waiting = self._waiting[:, used:]
        dropped, self._to_drop = self._to_drop, 0
        self._ready = np.concatenate([self._ready, finished[dropped:]])


class StreamingReducer:
    """One reducer, fed block by block.

    Parameters
    ----------
    name : str
        A name of `REDUCERS` that can run causally.
    rate_hz : float
        Sampling rate in Hz.
    window_s : float
        Length of a frame in s, for the reducers that work in frames.
    on_gap : {"raise", "hold", "zero"}
        What stands for missing samples: nothing, they are an error; the last sample that arrived; or 0.

    Attributes
    ----------
    latency_samples : int
        Delay of the output, constant: 0 for samplewise reducers, one frame less a sample for the others.

    Raises
    ------
    ValueError
        If the reducer is unknown or needs the whole recording, or `on_gap` is none of the three.

    Examples
    --------
    >>> stream = StreamingReducer("soc321", rate_hz=1000, on_gap="hold")
    >>> stream.process([[1, 2], [3, 4], [5, 6]])
    array([ 9., 12.])
    >>> stream.skip(2), stream.gaps, stream.missing_samples
    (array([12., 12.]), 1, 2)
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        window_s: float = DEFAULT_WINDOW_S,
        *,
        on_gap: OnGap = "raise",
    ) -> None:
        get_reducer(name)
        if name in WHY_NOT_STREAMING:
            raise ValueError(f"{name} cannot stream: {WHY_NOT_STREAMING[name]}")
        if on_gap not in ON_GAP:
            raise ValueError(f"on_gap: got {on_gap!r}, allowed is one of {', '.join(ON_GAP)}")
        self._name = name
        self._rate_hz = check_rate(rate_hz)
        self._hop = window_samples(window_s, rate_hz) // 2 if name in _IN_FRAMES else 0
        self._on_gap = on_gap
        self.latency_samples = max(2 * self._hop - 1, 0)
        self.reset()

    def reset(self) -> None:
        """Forget everything that was fed, the counts of gaps included: as new, also after `flush`."""
        self._stream = self._make_stream()
        self._flushed = False
        self._gaps = _Gaps(self._on_gap)

    @property
    def missing_samples(self) -> int:
        """Samples so far that did not arrive."""
        return self._gaps.samples

    @property
    def gaps(self) -> int:
        """Runs of such samples, however they were cut into blocks."""
        return self._gaps.gaps

    def process(
        self, block: ArrayLike, *, out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Reduce the next samples.

        Parameters
        ----------
        block : array_like, shape (3, k)
            The next k >= 0 samples of the three axes; those that are missing are not finite in one of the axes.
        out : ndarray of float64, shape (k,), optional
            Where the output is written to; a new array if left out.

        Returns
        -------
        ndarray of float64, shape (k,)
            The output, delayed by `latency_samples`; before the first sample of the signal it is 0. It is `out`, if
            that was given.

        Raises
        ------
        ValueError
            If the block is not three axes of numbers up to 1e60, samples are missing and `on_gap` is "raise", `out` is
            not fit to hold the output, or the stream was flushed. The stream is then as it was before.
        """
        samples = coerce_acceleration(block)
        if samples.ndim != 2:  # noqa: PLR2004 - axes x samples
            raise ValueError(
                f"block: got shape {samples.shape}, allowed is (3, k): one stream at a time"
            )
        if self._flushed:
            raise ValueError(
                "the stream was flushed, its signal has ended; reset it or make a new StreamingReducer"
            )
        if out is None:
            out = np.empty(samples.shape[1])
        elif out.shape != samples.shape[1:] or out.dtype != np.float64:
            raise ValueError(
                f"out: got {out.dtype} of shape {out.shape}, allowed is float64 of shape {samples.shape[1:]}"
            )
        there = np.asarray(np.isfinite(samples).all(axis=0))
        samples = self._gaps.fill(samples, there)
        # A whole recording can be scaled by its peak; a stream cannot know the peak that is to come.
        if self._name not in _NO_MEMORY and largest(samples) > SAFE_PEAK[1]:
            raise ValueError(
                f"block: got a peak of {largest(samples):.3g}, allowed is up to {SAFE_PEAK[1]:g}"
            )
        self._gaps.count(samples, there)
        self._stream.step(samples, out)
        return out

    def skip(
        self, n_samples: int, *, out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Declare that the next samples were lost on their way, as a driver reports it after an overrun.

        Parameters
        ----------
        n_samples : int
            How many, 0 or more.
        out : ndarray of float64, shape (n_samples,), optional
            As in `process`.

        Returns
        -------
        ndarray of float64, shape (n_samples,)
            As many samples of the output.

        Raises
        ------
        ValueError
            As `process`.
        """
        if n_samples < 0:
            raise ValueError(f"n_samples: got {n_samples}, allowed is 0 or more")
        return self.process(np.full((3, n_samples), np.nan), out=out)

    def flush(self) -> NDArray[np.float64]:
        """End the signal and give what the delay still holds back.

        Returns
        -------
        ndarray of float64, shape (latency_samples,)
            The last samples of the output.
        """
        rest = np.zeros(0) if self._flushed else self._stream.end()
        self._flushed = True
        return rest

    def _make_stream(self) -> _Samplewise | _InFrames:
        if self._hop:
            return _InFrames(_IN_FRAMES[self._name](self._rate_hz)((), self._hop))
        if self._name in _RUNNING:
            return _Samplewise(RunningAxis((), _RUNNING[self._name], self._rate_hz).push)
        return _Samplewise(partial(_NO_MEMORY[self._name], rate_hz=self._rate_hz))
