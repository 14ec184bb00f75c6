"""Many recordings at once: reduced, and matched.

Conventions: a batch is an array (k, 3, n) at one rate, or a sequence of Recordings, of any lengths and rates. Results
come in the order of the batch and are those of one recording at a time, bit for bit.

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
from feel321.jobs import Workers, as_workers, gather_results
from feel321.names import MATCHES
from feel321.stimuli import recording
from feel321.stimuli.guard import OwnReducer
from feel321.stimuli.metrics import METRICS
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


class _One(NamedTuple):
    """A signal of a batch, (3, n), with the name that a refusal gives it."""

    name: str
    samples: Samples
    rate_hz: float
    reduced: ArrayLike | None = None


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
    batch = _list_batch(recordings, rate_hz)
    function, name = with_window(REDUCERS.find(reducer), window_s), name_of(reducer)
    ours = reducer in REDUCERS or reducer in REDUCERS.values() or isinstance(function, OwnReducer)
    rows = _run(batch, _reduce_piece, workers, function=function, name=name, together=ours)
    if isinstance(recordings, Sequence) and all(isinstance(one, Recording) for one in recordings):
        return [
            Reduced(row, one.rate_hz, name, one.name)
            for row, one in zip(rows, recordings, strict=True)
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

    batch = _list_batch(recordings, rate_hz, reduced)
    chosen = METRICS.choose(metrics)
    rows = _run(batch, _match_piece, workers, chosen=chosen)
    own = isinstance(recordings, Sequence) and all(isinstance(one, Recording) for one in recordings)
    names = (
        [one.name for one in cast("Sequence[Recording]", recordings)] if own else range(len(rows))
    )
    return pd.DataFrame(rows, pd.Index(names, name="recording"), columns=[*chosen])


def _list_batch(
    given: Sequence[Recording] | ArrayLike,
    rate_hz: float | None,
    reduced: Sequence[ArrayLike] | ArrayLike | None = None,
) -> list[_One]:
    """Check a batch, and list its signals, each with its reduced one if there are any."""
    if isinstance(given, Recording):
        raise TypeError("recordings must be many, got one Recording; write [recording]")
    is_list = isinstance(given, Sequence) and not isinstance(given, str)
    several = cast("Sequence[object]", given if is_list else [given])
    others = [one for one in several if not isinstance(one, Recording)]
    if 0 < len(others) < len(several):
        raise TypeError(f"recordings must each be a Recording, got {describe(others[0])}")
    signals: Sequence[Recording] | Samples = cast("Sequence[Recording]", given)
    if others:
        signals = np.asarray(given)
        if signals.ndim != 3 or signals.shape[1] != recording.AXES:  # noqa: PLR2004 - signals x axes x samples
            raise ValueError(
                f"recordings must be Recordings, or an array of shape (k, 3, n); got the shape {signals.shape}"
            )
        recording.as_signal(signals, rate_hz)
    beside = [None] * len(signals) if reduced is None else [*cast("Iterable[ArrayLike]", reduced)]
    if len(beside) != len(signals):
        raise ValueError(
            f"reduced must hold one signal for each of {len(signals)} recordings, got {len(beside)}"
        )
    found = []
    for place, (one, own) in enumerate(zip(signals, beside, strict=True)):
        samples, rate = recording.as_pair(one, own, rate_hz)
        name = repr(one.name) if isinstance(one, Recording) else str(place)
        found.append(_One(name, cast("Samples", samples), rate, own))
    return found


def _run(
    batch: Sequence[_One], work: Callable[..., list[Samples]], workers: int | Workers, **how: object
) -> list[Samples]:
    """Do the work on signals of one length and rate at a time, and return a row per signal, in their order."""
    groups: dict[tuple[int, float], list[int]] = {}
    for place, one in enumerate(batch):
        groups.setdefault((np.shape(one.samples)[-1], one.rate_hz), []).append(place)
    pieces = [
        piece for (n, _), places in groups.items() for piece in _cut(places, max(1, PIECE // max(1, n)))
    ]  # fmt: skip
    jobs = [(work, ([batch[place] for place in piece],), how) for piece in pieces]
    rows: dict[int, Samples] = {}
    for piece, found in zip(pieces, gather_results(jobs, workers=as_workers(workers)), strict=True):
        rows |= zip(piece, found, strict=True)
    return [rows[place] for place in sorted(rows)]


def _cut(items: Sequence[int], size: int) -> list[Sequence[int]]:
    return [items[start : start + size] for start in range(0, len(items), size)]


def _reduce_piece(
    piece: Sequence[_One], *, function: Reducer, name: str, together: bool
) -> list[Samples]:
    """Reduce signals, together where that is worth it; a refusal is repeated for the one that it is about."""
    found: list[Samples] = []
    n = np.shape(piece[0].samples)[-1]
    for places in _cut(range(len(piece)), max(1, AT_A_TIME // max(1, n))):
        few = [piece[place] for place in places]
        if together and len(few) > 1 and n <= LONGEST:
            try:
                samples = recording.coerce_acceleration(np.array([one.samples for one in few]))
                reduced = recording.coerce_real(function(samples, few[0].rate_hz), name)
                recording.check_finite(reduced, name)
            except ValueError:
                pass
            else:
                found += [*reduced]
                continue
        for one in few:
            with _named(one):
                found.append(reduce(one.samples, function, rate_hz=one.rate_hz).samples)
    return found


@contextmanager
def _named(one: _One) -> Iterator[None]:
    """Name the recording in a refusal."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"recording {one.name}: {error}") from None


def _match_piece(piece: Sequence[_One], *, chosen: Mapping[str, Metric]) -> list[Samples]:
    rows = []
    for one in piece:
        with _named(one):
            signal = recording.coerce_real(cast("ArrayLike", one.reduced), "reduced")
            values = [metric(one.samples, signal, one.rate_hz) for metric in chosen.values()]
            rows.append(np.array(values, float))
    return rows
