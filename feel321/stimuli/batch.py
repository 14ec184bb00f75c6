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
from typing import TYPE_CHECKING, NamedTuple, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from feel321.doors import describe, name_of
from feel321.jobs import Workers, as_workers, run_jobs
from feel321.names import MATCHES
from feel321.stimuli import recording
from feel321.stimuli.guard import OwnReducer
from feel321.stimuli.match import OriginalSpectrum, axis_correlations, mean_over_axes
from feel321.stimuli.metrics import METRICS, RivalMetric
from feel321.stimuli.recording import Recording, Reduced
from feel321.stimuli.reducers.registry import REDUCERS, reduce, with_window
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
        places, names, signals, rate_hz, reduced = self
        size = max(1, samples // max(1, np.shape(signals[0])[-1])) if places else 1
        for start in range(0, len(places), size):
            at = slice(start, start + size)
            yield _Piece(places[at], names[at], signals[at], rate_hz, reduced[at])


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
    pieces, own = _cut_batch(recordings, rate_hz)
    function, name = with_window(REDUCERS.find(reducer), window_s), name_of(reducer)
    ours = reducer in REDUCERS or reducer in REDUCERS.values() or isinstance(function, OwnReducer)
    rows = _run(pieces, _reduce_piece, workers, function=function, name=name, together=ours)
    if own is not None:
        return [
            Reduced(row, one.rate_hz, name, one.name) for row, one in zip(rows, own, strict=True)
        ]
    return np.array(rows, dtype=np.float64).reshape(len(rows), np.shape(recordings)[-1])


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

    pieces, own = _cut_batch(recordings, rate_hz, reduced)
    chosen = METRICS.choose(metrics)
    rows = _run(pieces, _match_piece, workers, chosen=chosen)
    names = range(len(rows)) if own is None else [one.name for one in own]
    return pd.DataFrame(rows, pd.Index(names, name="recording"), columns=[*chosen])


def _run(
    pieces: Sequence[_Piece], work: Callable[..., Samples], workers: int | Workers, **how: object
) -> list[Samples]:
    """Do the work on each piece, and return a row per recording, in the order of the batch."""
    jobs = [(work, (piece,), how) for piece in pieces]
    rows: dict[int, Samples] = {}
    for number, found in run_jobs(jobs, workers=as_workers(workers)):
        rows |= zip(pieces[number].places, found, strict=True)
    return [rows[place] for place in sorted(rows)]


def _cut_batch(
    given: Sequence[Recording] | ArrayLike,
    rate_hz: float | None,
    reduced: Sequence[ArrayLike] | ArrayLike | None = None,
) -> tuple[list[_Piece], Sequence[Recording] | None]:
    """Check a batch, and cut it into pieces of one length and rate; of Recordings these come too."""
    if isinstance(given, Recording):
        raise TypeError("recordings must be many, got one Recording; write [recording]")
    is_list = isinstance(given, Sequence) and not isinstance(given, str)
    several = cast("Sequence[object]", given if is_list else [given])
    others = [one for one in several if not isinstance(one, Recording)]
    if 0 < len(others) < len(several):
        raise TypeError(f"recordings must each be a Recording, got {describe(others[0])}")
    if not others:
        recordings = cast("Sequence[Recording]", given)
        own = _list_reduced(reduced, len(recordings))
        groups: dict[tuple[int, float], list[int]] = {}
        for place, one in enumerate(recordings):
            _, rate = recording.as_pair(one, own[place] if own else None, rate_hz)
            groups.setdefault((one.n_samples, rate), []).append(place)
        pieces = [
            _Piece(
                places,
                [repr(recordings[place].name) for place in places],
                [recordings[place].acceleration for place in places],
                rate,
                [own[place] for place in places] if own else (),
            )
            for (_, rate), places in groups.items()
        ]
        return [one for piece in pieces for one in piece.cut(PIECE)], recordings
    samples = np.asarray(given)
    if samples.ndim != 3 or samples.shape[1] != recording.AXES:  # noqa: PLR2004 - signals x axes x samples
        raise ValueError(
            f"recordings must be Recordings, or an array of shape (k, 3, n); got the shape {samples.shape}"
        )
    _, rate = recording.as_signal(samples, rate_hz)
    places = range(len(samples))
    signals = _list_reduced(reduced, len(samples))
    return [*_Piece(places, [*map(str, places)], samples, rate, signals).cut(PIECE)], None


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
    """Reduce signals, together where that is worth it; a refusal is repeated for the one that it is about."""
    found: list[Samples] = []
    for chunk in piece.cut(AT_A_TIME):
        if together and len(chunk.places) > 1 and np.shape(chunk.signals[0])[-1] <= LONGEST:
            try:
                samples = recording.coerce_acceleration(np.ascontiguousarray(chunk.signals))
                reduced = recording.coerce_real(function(samples, chunk.rate_hz), name)
                recording.check_finite(reduced, name)
            except ValueError:
                pass
            else:
                found += [*reduced]
                continue
        for one, signal in zip(chunk.names, chunk.signals, strict=True):
            with _named(one):
                found.append(reduce(signal, function, rate_hz=chunk.rate_hz).samples)
    return np.array(found)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the recording in a refusal."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"recording {name}: {error}") from None


def _match_piece(piece: _Piece, *, chosen: Mapping[str, Metric]) -> Samples:
    """Match signals: (k, metrics). Those of unusual strength, and by a lab's own metrics, one by one."""
    rows = []
    for chunk in piece.cut(AT_A_TIME):
        found = _match_together(chunk, [name for name, one in chosen.items() if METRICS.get(name) is one])  # fmt: skip
        for place, name in enumerate(chunk.names):
            with _named(name):
                signal = recording.coerce_real(chunk.reduced[place], "reduced")
                pair = chunk.signals[place], signal, chunk.rate_hz
                rows.append([
                    found[key][place] if key in found else metric(*pair)
                    for key, metric in chosen.items()
                ])
    return np.array(rows, float)


def _match_together(chunk: _Piece, names: Sequence[str]) -> dict[str, Samples]:
    """Match signals by our own metrics, (k,) each; nothing where they need a scale or are to be refused."""
    from feel321.stimuli.rivals.pairs import make_pairs

    try:
        pair = make_pairs(np.array(chunk.signals), np.array(chunk.reduced), chunk.rate_hz)
    except ValueError:
        return {}
    samples, reduced = pair.samples, pair.reduced
    if not (np.isscalar(pair.scale) and recording.is_safe(np.abs(reduced).max(axis=-1)).all()):
        return {}
    rivals = [(name, METRICS[name]) for name in names]
    found = {name: one.measure(pair) for name, one in rivals if isinstance(one, RivalMetric)}
    if "temporal_match" in names:
        found["temporal_match"] = mean_over_axes(axis_correlations(samples, reduced))
    if not {"spectral_match", "spectral_match_bounded"}.isdisjoint(names):
        both = OriginalSpectrum(samples, chunk.rate_hz).match_both(reduced)
        found["spectral_match"], found["spectral_match_bounded"] = both
    return found
