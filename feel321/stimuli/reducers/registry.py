"""REDUCERS: the one list of reducers, and their streaming form.

Every reducer is called alike, `REDUCERS[name](acceleration, rate_hz)`: acceleration of shape (..., 3, n_samples), any
unit, in; the reduced signal, shape (..., n_samples), float64, same unit, out. Deterministic; the input is never
modified.

A streamed reducer gives, sample by sample, what its offline form gives for the whole signal, `latency_samples` later.
It allocates a little per call and never looks ahead. The work of a window is done in the block that completes half a
window, it is not spread: `feel321 tradeoff` measures what that block costs.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010. doi:10.1007/978-3-642-14075-4_12
"""

from collections.abc import Callable, Sequence
from functools import partial
from inspect import signature

import numpy as np
from numpy.typing import ArrayLike

from feel321.arguments import (
    Registry,
    check_finite,
    check_name,
    check_rate,
    coerce_real,
    describe,
    name_of,
)
from feel321.jobs import Workers, gather_results
from feel321.stimuli.own_methods import find_reducer
from feel321.stimuli.recording import (
    SAFE_PEAK,
    Recording,
    Reduced,
    Signal,
    as_signal,
    coerce_acceleration,
    largest,
)
from feel321.stimuli.reducers import axes, bands, fourier
from feel321.types import REDUCER_NAMES, Reducer, Samples

_OURS = vars(axes) | vars(fourier) | vars(bands)

REDUCERS: Registry[Reducer] = Registry(
    "reducer", {name: _OURS[name] for name in REDUCER_NAMES}, find=find_reducer
)
"""Name -> reducer, in the order of the paper, simplest first; later ones follow."""

DEFAULT_REDUCERS = tuple(REDUCERS)[:9]
"""What a study compares unless it says otherwise: as many as a MUSHRA page holds beside the reference and anchors."""


def reduce(
    recording: Signal,
    reducer: str | Reducer = "dft321",
    *,
    rate_hz: float | None = None,
    window_s: float | None = None,
) -> Reduced:
    """Reduce three axes to one.

    Parameters
    ----------
    recording : Recording, or array_like of shape (3, n_samples)
        Acceleration; plain samples need `rate_hz`.
    reducer : str or callable
        A name of `REDUCERS`, a dotted name ("mylab.haptics:my321"), or a function f(acceleration, rate_hz).
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    window_s : float, optional
        Length of a window in s, for the reducers that work in windows; 0.035 unless given.

    Returns
    -------
    Reduced
        The reduced signal, with its rate and the names of reducer and recording.

    Raises
    ------
    ValueError
        If there is no such reducer, it has no window, or it does not return as many finite real numbers.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.reduce(stimuli.make_scene("bumps"), "dft321")
    Reduced('dft321' of 'bumps', 40000 samples at 10000 Hz, 4 s)
    >>> stimuli.reduce([[1, 2], [3, 4], [5, 6]], lambda samples, rate_hz: samples[2], rate_hz=1000).samples
    array([5., 6.])
    """
    given, rate = as_signal(recording, rate_hz)
    acceleration = coerce_acceleration(given)
    function = with_window(REDUCERS.find(reducer), window_s)
    samples = coerce_real(function(acceleration, rate), f"the output of {name_of(reducer)}")
    check_finite(samples, f"the output of {name_of(reducer)}")
    if samples.shape != acceleration.shape[-1:]:
        must = f"reducer {name_of(reducer)} must return the shape {acceleration.shape[-1:]}"
        raise ValueError(f"{must}, got {samples.shape}")
    name = recording.name if isinstance(recording, Recording) else ""
    return Reduced(samples, rate, name_of(reducer), name)


def with_window(reducer: Reducer, window_s: float | None) -> Reducer:
    """Give a reducer the length of its window, if one is wanted."""
    if window_s is None:
        return reducer
    function: Callable[..., Samples] = reducer
    if "window_s" not in signature(function).parameters:
        raise ValueError(f"window_s must be left out: {name_of(reducer)} has no window")
    return partial(function, window_s=window_s)


AT_A_TIME = 24_576
"""Samples per axis that go through a reducer together, so few that what it works on stays in the processor's cache."""

LONGEST = 8192
"""Longest signal that shares a call, in samples: the length at which einsum and the like cut their sums."""

PIECE = 1 << 20  # Samples per axis of one job


def reduce_many(
    recordings: Sequence[Recording],
    reducer: str | Reducer = "dft321",
    *,
    window_s: float | None = None,
    workers: int | Workers = 1,
) -> list[Reduced]:
    """Reduce many recordings, as `reduce` reduces one: the same results, bit for bit, in less time if they are short.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of any lengths and rates. An array (k, 3, n) at one rate goes through `REDUCERS` as it is.
    reducer : str or callable
        As for `reduce`.
    window_s : float, optional
        Length of a window in s, for the reducers that work in windows; 0.035 unless given.
    workers : int or Workers
        Number of processes, or who else does the work. The result does not depend on it.

    Returns
    -------
    list of Reduced
        One of each recording.

    Raises
    ------
    ValueError
        As `reduce` does; the message names the recording.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scenes = [stimuli.make_scene(name, duration_s=1) for name in ("bumps", "hard_taps")]
    >>> stimuli.reduce_many(scenes, "dft321")[1]
    Reduced('dft321' of 'hard_taps', 10000 samples at 10000 Hz, 1 s)
    """
    if isinstance(recordings, Recording):
        raise TypeError("recordings must be many, got one Recording; write [recording]")
    groups: dict[tuple[int, float], list[int]] = {}
    for place, one in enumerate(recordings):
        if not isinstance(one, Recording):
            raise TypeError(f"recordings must each be a Recording, got {describe(one)}")
        groups.setdefault((one.n_samples, one.rate_hz), []).append(place)
    pieces = [
        places[start : start + max(1, PIECE // n)]
        for (n, _), places in groups.items()
        for start in range(0, len(places), max(1, PIECE // n))
    ]
    is_ours = reducer in REDUCERS or reducer in REDUCERS.values()
    how = {"function": with_window(REDUCERS.find(reducer), window_s), "together": is_ours}
    jobs = [(_reduce_alike, ([recordings[one] for one in piece],), how) for piece in pieces]
    found: dict[int, Reduced] = {}
    for piece, rows in zip(pieces, gather_results(jobs, workers=workers), strict=True):
        for place, row in zip(piece, rows, strict=True):
            one = recordings[place]
            found[place] = Reduced(row, one.rate_hz, name_of(reducer), one.name)
    return [found[place] for place in sorted(found)]


def _reduce_alike(
    recordings: Sequence[Recording], *, function: Reducer, together: bool
) -> list[Samples]:
    """Reduce recordings of one length and rate; several at a time where that is worth it."""
    n, rate_hz = recordings[0].n_samples, recordings[0].rate_hz
    size = max(1, AT_A_TIME // n) if together and n <= LONGEST else 1
    found: list[Samples] = []
    for start in range(0, len(recordings), size):
        few = recordings[start : start + size]
        if len(few) > 1:
            found += [*function(np.array([one.acceleration for one in few]), rate_hz)]
            continue
        try:
            found.append(reduce(few[0], function).samples)
        except ValueError as error:
            raise ValueError(f"recording {few[0].name!r}: {error}") from None
    return found


def _run_axis(axis: int, rate_hz: float) -> Callable[[Samples], Samples]:
    return axes.RunningAxis((), axis, rate_hz).push


_NO_MEMORY = ("sax321", "say321", "saz321", "soc321", "mag321")
_RUNNING: dict[str, Callable[[float], Callable[[Samples], Samples]]] = {
    **{
        f"sa{letter}321_matched_running": partial(_run_axis, axis)
        for axis, letter in enumerate("xyz")
    },
    "dft321_filtered": lambda rate_hz: bands.FilterBank((), rate_hz).push,
}
_IN_FRAMES: dict[str, Callable[[float], Callable[[tuple[int, ...], int], axes.BlockProcessor]]] = {
    "pca321_adaptive": lambda rate_hz: partial(axes.PrincipalFrames, rate_hz=rate_hz),
    "dft321_windowed": lambda _: fourier.FourierFrames,
    "dft321_principal_windowed": lambda _: fourier.TrackingFrames,
    "pca321_matched_windowed": lambda rate_hz: partial(axes.MatchedFrames, rate_hz=rate_hz),
}
_WHOLE = {
    "pca321": ("axis and its mean need", "pca321_adaptive"),
    "dft321": ("spectrum needs", "dft321_windowed"),
    "dft321_principal": ("axis needs", "dft321_principal_windowed"),
    **{f"sa{one}321_matched": ("gain needs", f"sa{one}321_matched_running") for one in "xyz"},
    "pca321_matched": ("axis and its gain need", "pca321_matched_windowed"),
    "dft321_bands": ("bands' axes need", "dft321_filtered"),
}
WHY_NOT_STREAMING = {
    name: f"its {needs} the whole recording; stream {instead} instead"
    for name, (needs, instead) in _WHOLE.items()
}
"""Name -> reason, for the reducers that cannot run causally."""


class _InFrames:
    """A block processor, fed samples as they come."""

    def __init__(self, processor: axes.BlockProcessor) -> None:
        self._processor, self._to_drop = processor, processor.hop
        self._waiting = np.zeros((3, 0))
        self._ready = np.zeros(2 * processor.hop - 1)

    def __call__(self, samples: Samples) -> Samples:
        """Take samples (3, k), return as many of the output, a frame less a sample late."""
        self._waiting = np.concatenate([self._waiting, samples], axis=1)
        if n_blocks := self._waiting.shape[1] // self._processor.hop:
            self._push(n_blocks)
        k = samples.shape[1]
        given, self._ready = self._ready[:k], self._ready[k:]
        return given

    def end(self) -> Samples:
        """Return the samples that the delay still holds back."""
        self._push(-(-self._waiting.shape[1] // self._processor.hop) + 1)
        return self._ready[: 2 * self._processor.hop - 1]

    def _push(self, n_blocks: int) -> None:
        used = n_blocks * self._processor.hop
        blocks = axes.cut_blocks(self._waiting[:, :used], self._processor.hop, n_blocks)
        finished = self._processor.push(*blocks).ravel()
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
    >>> from feel321 import stimuli
    >>> stream = stimuli.StreamingReducer("soc321", rate_hz=1000)
    >>> stream.process([[1, 2], [3, 4], [5, 6]])
    array([ 9., 12.])
    """

    def __init__(self, name: str, rate_hz: float, window_s: float = axes.DEFAULT_WINDOW_S) -> None:
        check_name(name, REDUCERS, "reducer")
        if name in WHY_NOT_STREAMING:
            raise ValueError(f"{name} cannot stream: {WHY_NOT_STREAMING[name]}")
        self._name, self._rate_hz = name, check_rate(rate_hz)
        self._hop = axes.window_samples(window_s, rate_hz) // 2 if name in _IN_FRAMES else 0
        self.latency_samples = max(2 * self._hop - 1, 0)
        self.reset()

    def reset(self) -> None:
        """Forget everything that was fed; it is as new, also after `flush`."""
        self._stream: Callable[[Samples], Samples] | _InFrames
        if self._hop:
            self._stream = _InFrames(_IN_FRAMES[self._name](self._rate_hz)((), self._hop))
        elif self._name in _RUNNING:
            self._stream = _RUNNING[self._name](self._rate_hz)
        else:
            self._stream = lambda samples: REDUCERS[self._name](samples, self._rate_hz)
        self._flushed = False

    def process(self, block: ArrayLike, *, out: Samples | None = None) -> Samples:
        """Reduce the next samples.

        Parameters
        ----------
        block : array_like, shape (3, k)
            The next k >= 0 samples of the three axes; put samples of your own in the place of lost ones, or time stops.
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
            If the block is not three axes of finite numbers up to 1e60, `out` is not fit to hold the output, or the
            stream was flushed. The stream is then as it was before.
        """
        samples = coerce_acceleration(block)
        if samples.ndim != 2:  # noqa: PLR2004 - axes x samples
            got = f"got {samples.shape}"
            raise ValueError(f"block must have the shape (3, k), one stream at a time; {got}")
        if self._flushed:
            do = "reset it or make a new StreamingReducer"
            raise ValueError(f"the stream was flushed and its signal has ended; {do}")
        if out is None:
            out = np.empty(samples.shape[1])
        elif out.shape != samples.shape[1:] or out.dtype != np.float64:
            got = f"got {out.dtype} of shape {out.shape}"
            raise ValueError(f"out must be float64 of shape {samples.shape[1:]}, {got}")
        check_finite(samples, "block")
        # A whole recording can be scaled by its peak; a stream cannot know the peak that is to come.
        if self._name not in _NO_MEMORY and largest(samples) > SAFE_PEAK[1]:
            got = f"got {largest(samples):.3g}"
            raise ValueError(f"block must have a peak of at most {SAFE_PEAK[1]:g}, {got}")
        np.copyto(out, self._stream(samples))
        return out

    def flush(self) -> Samples:
        """End the signal and return the samples that the delay still holds back.

        Returns
        -------
        ndarray of float64, shape (latency_samples,)
            The last samples of the output.
        """
        was_flushed, self._flushed = self._flushed, True
        if was_flushed or not isinstance(self._stream, _InFrames):
            return np.zeros(0)
        return self._stream.end()
