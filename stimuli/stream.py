"""Reducers that run while the vibration is still being made: blocks in, blocks out, a constant delay.

A streamed reducer gives, sample by sample, what its offline form gives for the whole signal, `latency_samples` later.
It allocates a little per call and never looks ahead.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from stimuli.axes import mag321, sax321, say321, saz321, soc321
from stimuli.door import SAFE_PEAK, largest
from stimuli.fourier import FourierFrames
from stimuli.frames import DEFAULT_WINDOW_S, BlockProcessor, cut_blocks, window_samples
from stimuli.principal import PrincipalFrames
from stimuli.recording import check_acceleration, check_rate
from stimuli.reduce import get_reducer
from stimuli.tracking import TrackingFrames

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

_SAMPLEWISE = MappingProxyType(
    {"sax321": sax321, "say321": say321, "saz321": saz321, "soc321": soc321, "mag321": mag321}
)
_IN_FRAMES: Mapping[str, Callable[[tuple[int, ...], int], BlockProcessor]] = MappingProxyType(
    {
        "pca321_adaptive": PrincipalFrames,
        "dft321_windowed": FourierFrames,
        "dft321_principal_windowed": TrackingFrames,
    }
)
WHY_NOT_STREAMING: Mapping[str, str] = MappingProxyType(
    {
        "pca321": "its axis and its mean need the whole recording; stream pca321_adaptive instead",
        "dft321": "its spectrum needs the whole recording; stream dft321_windowed instead",
        "dft321_principal": "its axis needs the whole recording; stream dft321_principal_windowed instead",
    }
)
"""Name -> reason, for the reducers that cannot run causally."""


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

    Attributes
    ----------
    latency_samples : int
        Delay of the output, constant: 0 for samplewise reducers, one frame less a sample for the others.

    Raises
    ------
    ValueError
        If the reducer is unknown or needs the whole recording.

    Examples
    --------
    >>> stream = StreamingReducer("soc321", rate_hz=1000)
    >>> stream.process([[1, 2], [3, 4], [5, 6]])
    array([ 9., 12.])
    """

    def __init__(self, name: str, rate_hz: float, window_s: float = DEFAULT_WINDOW_S) -> None:
        get_reducer(name)
        if name in WHY_NOT_STREAMING:
            raise ValueError(f"{name} cannot stream: {WHY_NOT_STREAMING[name]}")
        self._name = name
        self._rate_hz = check_rate(rate_hz)
        self._processor: BlockProcessor | None = None
        self.latency_samples = 0
        if name in _IN_FRAMES:
            hop = window_samples(window_s, rate_hz) // 2
            self._processor = _IN_FRAMES[name]((), hop)
            self.latency_samples = 2 * hop - 1
        self._waiting = np.zeros((3, 0))
        self._ready = np.zeros(self.latency_samples)
        self._to_drop = self._processor.hop if self._processor else 0
        self._flushed = False

    def process(self, block: ArrayLike) -> NDArray[np.float64]:
        """Reduce the next samples.

        Parameters
        ----------
        block : array_like, shape (3, k)
            The next k >= 0 samples of the three axes.

        Returns
        -------
        ndarray of float64, shape (k,)
            The output, delayed by `latency_samples`; before the first sample of the signal it is 0.

        Raises
        ------
        ValueError
            If the block is not three axes of finite numbers up to 1e60, or the stream was flushed.
        """
        samples = check_acceleration(block)
        if samples.ndim != 2:  # noqa: PLR2004 - axes x samples
            raise ValueError(f"block: got shape {samples.shape}, allowed is (3, k): one stream at a time")
        if self._flushed:
            raise ValueError("the stream was flushed, its signal has ended; make a new StreamingReducer")
        if self._processor is None:
            return _SAMPLEWISE[self._name](samples, self._rate_hz)
        # A whole recording can be scaled by its peak; a stream cannot know the peak that is to come.
        if largest(samples) > SAFE_PEAK[1]:
            raise ValueError(f"block: got a peak of {largest(samples):.3g}, allowed is up to {SAFE_PEAK[1]:g}")
        self._waiting = np.concatenate([self._waiting, samples], axis=1)
        n_blocks = self._waiting.shape[1] // self._processor.hop
        if n_blocks:
            self._push(self._processor, n_blocks)
        return self._take(samples.shape[1])

    def flush(self) -> NDArray[np.float64]:
        """End the signal and give what the delay still holds back.

        Returns
        -------
        ndarray of float64, shape (latency_samples,)
            The last samples of the output.
        """
        if self._processor is not None and not self._flushed:
            self._push(self._processor, -(-self._waiting.shape[1] // self._processor.hop) + 1)
        rest = self._take(0 if self._flushed else self.latency_samples)
        self._flushed = True
        return rest

    def _push(self, processor: BlockProcessor, n_blocks: int) -> None:
        used = n_blocks * processor.hop
        finished = processor.push(*cut_blocks(self._waiting[:, :used], processor.hop, n_blocks)).ravel()
        self._waiting = self._waiting[:, used:]
        dropped, self._to_drop = self._to_drop, 0
        self._ready = np.concatenate([self._ready, finished[dropped:]])

    def _take(self, count: int) -> NDArray[np.float64]:
        taken, self._ready = self._ready[:count], self._ready[count:]
        return taken
