"""Many recordings at once: reduced, and matched.

Conventions: a batch is an array (k, 3, n) at one rate, or a sequence of Recordings, of any lengths and rates. Results
come in the order of the batch and are those of one recording at a time: of reducers bit for bit, of metrics but for the
last digits.

Short signals share the cost of a call: so many go through a reducer together that what it works on stays in the
processor's cache (a large batch at once would be slower than one by one). A signal of more than `LONGEST` samples is
worth a call of its own; and NumPy cuts longer sums where the shape of a batch tells it to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple, TypeGuard, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from feel321.doors import describe, name_of
from feel321.jobs import Workers, as_workers, run_jobs
from feel321.names import MATCHES
from feel321.stimuli import recording
from feel321.stimuli.guard import OwnReducer
from feel321.stimuli.match import OriginalSpectrum, axis_correlations, mean_over_axes
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.recording import Recording, Reduced
from feel321.stimuli.reducers.registry import REDUCERS, reduce, with_window
from feel321.stimuli.rivals import catalog, pairs
from feel321.types import Metric, Reducer, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

AT_A_TIME = 24_576
"""Samples per axis that go through a reducer together."""

LONGEST = 8192
"""Longest signal that shares a call, in samples: the length at which einsum and the like cut their sums."""

PIECE = 1 << 20
"""Samples per axis of one job."""


class _Piece(NamedTuple):
    """Signals of one length and rate, (3, n) each: their places in the batch, and what was reduced of them."""

    places: Sequence[int]
    names: Sequence[str]
    signals: Sequence[Samples] | Samples
    rate_hz: float
    reduced: Sequence[ArrayLike] = ()

    def cut(self, samples: int) -> Iterator[_Piece]:
        """Cut into pieces of so many samples per axis, or of one signal."""
        size = max(1, samples // max(1, np.shape(self.signals[0])[-1])) if self.places else 1
        for start in range(0, len(self.places), size):
            part = slice(start, start + size)
            yield _Piece(
                self.places[part],
                self.names[part],
                self.signals[part],
                self.rate_hz,
                self.reduced[part],
            )


class _Batch(NamedTuple):
    """The pieces of a batch, each a job; the Recordings, or the shape of the array."""

    pieces: list[_Piece]
    recordings: Sequence[Recording] = ()
    shape: tuple[int, ...] = ()

    def run(
        self, work: Callable[..., Samples], workers: int | Workers, **how: object
    ) -> Iterator[tuple[_Piece, Samples]]:
        """Do the work on each piece; yields the piece and what was made of it."""
        todo = [(work, (piece,), how) for piece in self.pieces]
        for number, found in run_jobs(todo, workers=as_workers(workers)):
            yield self.pieces[number], found


@overload
def reduce_many(
    recordings: Sequence[Recording],
    reducer: str | Reducer = ...,
    *,
    rate_hz: None = ...,
    window_s: float | None = ...,
    workers: int | Workers = ...,
) -> list[Reduced]: ...


@overload
def reduce_many(
    recordings: ArrayLike,
    reducer: str | Reducer = ...,
    *,
    rate_hz: float | None = ...,
    window_s: float | None = ...,
    workers: int | Workers = ...,
) -> Samples: ...


def reduce_many(
    recordings: Sequence[Recording] | ArrayLike,
    reducer: str | Reducer = "dft321",
    *,
    rate_hz: float | None = None,
    window_s: float | None = None,
    workers: int | Workers = 1,
) -> list[Reduced] | Samples:
    """Reduce many recordings, as `reduce` reduces one: the same results, bit for bit, in less time if they are short.

    Parameters
    ----------
    recordings : sequence of Recording, or array_like of shape (k, 3, n_samples)
        Recordings of any lengths and rates; or acceleration of equal lengths at one rate.
    reducer : str or callable
        As for `reduce`.
    rate_hz : float, optional
        Sampling rate of an array in Hz.
    window_s : float, optional
        Length of a window in s, for the reducers that work in windows; 0.035 unless given.
    workers : int or Workers
        Number of processes, or who else does the work. The result does not depend on it.

    Returns
    -------
    list of Reduced, or ndarray of shape (k, n_samples)
        A Reduced of each Recording; or an array of an array.

    Raises
    ------
    ValueError
        As `reduce` does; the message names the recording, or its place in the array, from 0.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scenes = [stimuli.make_scene(name, duration_s=1) for name in ("bumps", "hard_taps")]
    >>> stimuli.reduce_many(scenes, "dft321")[1]
    Reduced('dft321' of 'hard_taps', 10000 samples at 10000 Hz, 1 s)
    >>> stimuli.reduce_many([[[1, 2], [3, 4], [5, 6]]] * 3, "soc321", rate_hz=1000)
    array([[ 9., 12.],
           [ 9., 12.],
           [ 9., 12.]])
    """
    batch = _cut_batch(recordings, rate_hz)
    function, name = with_window(REDUCERS.find(reducer), window_s), name_of(reducer)
    ours = reducer in REDUCERS or reducer in REDUCERS.values() or isinstance(function, OwnReducer)
    found = batch.run(_reduce_piece, workers, function=function, name=name, together=ours)
    if batch.shape:
        reduced = np.empty((batch.shape[0], batch.shape[-1]))
        for piece, samples in found:
            reduced[piece.places] = samples
        return reduced
    rows = {
        place: row for piece, own in found for place, row in zip(piece.places, own, strict=True)
    }
    return [
        Reduced(rows[place], one.rate_hz, name, one.name)
        for place, one in enumerate(batch.recordings)
    ]


def match_many(
    recordings: Sequence[Recording] | ArrayLike,
    reduced: Sequence[ArrayLike] | ArrayLike,
    *,
    rate_hz: float | None = None,
    metrics: str | Metric | Iterable[str | Metric] = MATCHES,
    workers: int | Workers = 1,
) -> DataFrame:
    """Match many recordings with one reduced signal each, as the metrics do one by one.

    Parameters
    ----------
    recordings : sequence of Recording, or array_like of shape (k, 3, n_samples)
        Recordings of any lengths and rates; or acceleration of equal lengths at one rate.
    reduced : sequence of Reduced or of array_like, or array_like of shape (k, n_samples)
        The reduced signal of each, in the same order.
    rate_hz : float, optional
        Sampling rate of an array in Hz.
    metrics : "all", or a list of str or callables
        As for `match`; the match metrics if left out, and "all" for their rivals too.
    workers : int or Workers
        Number of processes, or who else does the work.

    Returns
    -------
    DataFrame
        A row per recording, a column per metric.

    Raises
    ------
    ValueError
        If numbers, lengths or rates differ; the message names the recording, or its place in the array, from 0.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> scenes = [stimuli.make_scene(name, duration_s=1) for name in ("bumps", "hard_taps")]
    >>> stimuli.match_many(scenes, stimuli.reduce_many(scenes, "say321")).round(1)
               spectral_match  temporal_match  spectral_match_bounded
    recording
    bumps                 0.5             0.5                     0.5
    hard_taps             0.4             0.5                     0.4
    """
    import pandas as pd

    batch = _cut_batch(recordings, rate_hz, reduced)
    chosen = METRICS.choose(metrics)
    rows = {
        place: row
        for piece, own in batch.run(_match_piece, workers, chosen=chosen)
        for place, row in zip(piece.places, own, strict=True)
    }
    names = range(batch.shape[0]) if batch.shape else [one.name for one in batch.recordings]
    index = pd.Index(names, name="recording")
    return pd.DataFrame([rows[place] for place in range(len(rows))], index, columns=[*chosen])


def _cut_batch(
    given: Sequence[Recording] | ArrayLike,
    rate_hz: float | None,
    reduced: Sequence[ArrayLike] | ArrayLike | None = None,
) -> _Batch:
    """Check a batch and cut it into pieces."""
    if isinstance(given, Recording):
        raise TypeError("recordings must be many, got one Recording; write [recording]")
    if isinstance(given, Sequence) and not isinstance(given, str) and _are_recordings(given):
        return _Batch([*_group(given, rate_hz, reduced)], given)
    samples = np.asarray(given)
    if samples.ndim != 3 or samples.shape[1] != recording.AXES:  # noqa: PLR2004 - signals x axes x samples
        raise ValueError(
            f"recordings must be Recordings, or an array of shape (k, 3, n); got the shape {samples.shape}"
        )
    _, rate = recording.as_signal(samples, rate_hz)
    places, own = range(len(samples)), _list_reduced(reduced, len(samples))
    whole = _Piece(places, [str(place) for place in places], samples, rate, own)
    return _Batch([*whole.cut(PIECE)], shape=samples.shape)


def _are_recordings(given: Sequence[object]) -> TypeGuard[Sequence[Recording]]:
    """Whether all are Recordings; some of them are refused."""
    others = [one for one in given if not isinstance(one, Recording)]
    if others and len(others) < len(given):
        raise TypeError(f"recordings must each be a Recording, got {describe(others[0])}")
    return not others


def _group(
    recordings: Sequence[Recording],
    rate_hz: float | None,
    reduced: Sequence[ArrayLike] | ArrayLike | None,
) -> Iterator[_Piece]:
    """Group recordings by length and rate."""
    own = _list_reduced(reduced, len(recordings))
    groups: dict[tuple[int, float], list[int]] = {}
    for place, one in enumerate(recordings):
        _, rate = recording.as_pair(one, own[place] if own else None, rate_hz)
        groups.setdefault((one.n_samples, rate), []).append(place)
    for (_, rate), places in groups.items():
        names = [repr(recordings[place].name) for place in places]
        signals = [recordings[place].acceleration for place in places]
        some = [own[place] for place in places] if own else ()
        yield from _Piece(places, names, signals, rate, some).cut(PIECE)


def _list_reduced(reduced: Sequence[ArrayLike] | ArrayLike | None, k: int) -> Sequence[ArrayLike]:
    """List as many reduced signals as there are recordings; none if none are given."""
    if reduced is None:
        return ()
    signals = [*cast("Iterable[ArrayLike]", reduced)]
    if len(signals) != k:
        raise ValueError(
            f"reduced must hold one signal for each of {k} recordings, got {len(signals)}"
        )
    return signals


def _reduce_piece(piece: _Piece, *, function: Reducer, name: str, together: bool) -> Samples:
    reduced = np.empty((len(piece.places), np.shape(piece.signals[0])[-1]))
    done = 0
    for chunk in piece.cut(AT_A_TIME):
        rows = slice(done, done := done + len(chunk.places))
        if together:
            reduced[rows] = _reduce_chunk(chunk, function, name=name)
        else:
            reduced[rows] = _one_by_one(chunk, function)
    return reduced


def _reduce_chunk(chunk: _Piece, function: Reducer, *, name: str) -> Samples:
    """Reduce signals together: (k, n). A refusal is repeated for the signal that it is about."""
    n = np.shape(chunk.signals[0])[-1]
    if len(chunk.places) == 1 or n > LONGEST:
        return _one_by_one(chunk, function)
    try:
        samples = recording.coerce_acceleration(np.ascontiguousarray(chunk.signals))
        reduced = recording.coerce_real(function(samples, chunk.rate_hz), name)
        recording.check_finite(reduced, name)
    except ValueError:
        return _one_by_one(chunk, function)
    return reduced


def _one_by_one(chunk: _Piece, function: Reducer) -> Samples:
    found = []
    for name, one in zip(chunk.names, chunk.signals, strict=True):
        with _named(name):
            found.append(reduce(one, function, rate_hz=chunk.rate_hz).samples)
    return np.array(found)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the recording in a refusal."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"recording {name}: {error}") from None


def _match_piece(piece: _Piece, *, chosen: Mapping[str, Metric]) -> Samples:
    return np.concatenate([_match_chunk(chunk, chosen) for chunk in piece.cut(AT_A_TIME)])


def _match_chunk(chunk: _Piece, chosen: Mapping[str, Metric]) -> Samples:
    """Match signals: (k, metrics). Those of unusual strength, and by a lab's own metrics, one by one."""
    found = _match_together(chunk, [name for name, one in chosen.items() if _is_ours(name, one)])
    rows = []
    for place, name in enumerate(chunk.names):
        with _named(name):
            signal = recording.coerce_real(chunk.reduced[place], "reduced")
            pair = chunk.signals[place], signal, chunk.rate_hz
            rows.append([
                found[key][place] if key in found else metric(*pair)
                for key, metric in chosen.items()
            ])
    return np.array(rows, float)


def _is_ours(name: str, metric: Metric) -> bool:
    return METRICS.get(name) is metric


def _match_together(chunk: _Piece, names: Sequence[str]) -> dict[str, Samples]:
    """Match signals by our own metrics, (k,) each; nothing where they need a scale or are to be refused."""
    try:
        pair = pairs.make_pairs(np.array(chunk.signals), np.array(chunk.reduced), chunk.rate_hz)
    except ValueError:
        return {}
    samples, reduced = pair.samples, pair.reduced
    if not (np.isscalar(pair.scale) and recording.is_safe(np.abs(reduced).max(axis=-1)).all()):
        return {}
    found = {name: catalog.RIVALS[name].measure(pair) for name in names if name in catalog.RIVALS}
    if "temporal_match" in names:
        found["temporal_match"] = mean_over_axes(axis_correlations(samples, reduced))
    if not {"spectral_match", "spectral_match_bounded"}.isdisjoint(names):
        both = OriginalSpectrum(samples, chunk.rate_hz).match_both(reduced)
        found["spectral_match"], found["spectral_match_bounded"] = both
    return found
