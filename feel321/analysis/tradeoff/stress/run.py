"""The stress test: the battery through every reducer, and the recordings diagnosed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, count
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.results import as_recordings
from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
from feel321.analysis.tradeoff.stress.diagnosis import diagnose
from feel321.analysis.tradeoff.stress.measures import (
    MetricRow,
    compare_metrics_under_rotation,
    measure_gains,
    measure_scene,
)
from feel321.analysis.tradeoff.stress.page import Stress
from feel321.doors import describe
from feel321.jobs import ALONE, Job, Workers, as_workers, gather_results
from feel321.stimuli.reducers.registry import REDUCERS, reduce
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

EXCERPT_S, METRICS_S = 2.0, 1.0
"""Longest part of a recording whose gains are measured, and whose metrics are, in s."""

TAKES, DRAWS = 40, 16
"""Takes of every scene of the battery, and noises per recording."""


def stress_reducers(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Recording | Iterable[Recording] = (),
    reducers: Mapping[str, Reducer] | None = None,
    *,
    sensor: Mapping[str, Recording] | None = None,
    seeds: int = TAKES,
    draws: int = DRAWS,
    seed: int,
    workers: int | Workers = ALONE,
    progress: Callable[[int, int], None] | None = None,
) -> Stress:
    """Put reducers through the battery, and find the recordings that come near its scenes; seeds: takes of a scene."""
    given = REDUCERS if reducers is None else reducers
    chosen = {name: take_batches(one) for name, one in given.items()}
    recordings = as_recordings(recordings)
    known = sensor or {}
    _check_inputs(recordings, known, {"takes": seeds, "draws": draws})
    scenes = [scene.make(seed) for scene in BATTERY.values()]
    moving = [recording for recording in recordings if recording.acceleration.any()]
    excerpts = [take_excerpt(recording, duration_s=EXCERPT_S) for recording in moving]
    each: list[Job] = [
        *((measure_scene, (name, chosen), {"takes": seeds, "seed": seed}) for name in BATTERY),
        *((measure_gains, (one, chosen), {"draws": draws, "seed": seed}) for one in excerpts),
        *((_measure_metrics, (one, chosen), {"seed": seed}) for one in (*scenes, *excerpts)),
    ]
    jobs: list[Job] = [(_in_one_thread, job, {}) for job in each]
    tick, steps = progress or (lambda _done, _total: None), count(1)
    found = gather_results(
        jobs, workers=as_workers(workers), done=lambda: tick(next(steps), len(jobs))
    )
    parts = len(BATTERY), len(BATTERY) + len(excerpts)
    cells, gains = (tuple(chain(*part)) for part in (found[: parts[0]], found[slice(*parts)]))
    diagnoses = [diagnose(one, known.get(one.name)) for one in moving]
    digests = {f"recording {one.name}": one.sha256 for one in recordings}
    inputs = {"seed": seed, "seeds": seeds, "draws": draws, **digests}
    notes = tuple(_collect_notes(recordings, known))
    return Stress(
        tuple(chosen), cells, gains, tuple(found[parts[1] :]), tuple(diagnoses), notes, inputs
    )


def _in_one_thread(
    function: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]
) -> object:
    """Do a job; signals here are short, and threads of the linear algebra wait for each other most of the time."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        return function(*arguments, **named)


def _measure_metrics(one: Recording, reducers: Mapping[str, Reducer], *, seed: int) -> MetricRow:
    part = take_excerpt(one, duration_s=METRICS_S)
    rng = np.random.default_rng([seed, *one.name.encode()])
    return compare_metrics_under_rotation(part, reducers, rng=rng)


def take_batches(reducer: Reducer) -> Reducer:
    """Let a lab's own reducer, which need not take many signals at once, take (..., 3, n) like ours."""
    if reducer in REDUCERS.values():
        return reducer

    def apply(acceleration: Samples, rate_hz: float) -> Samples:
        *many, axes, n = acceleration.shape
        signals = acceleration.reshape(-1, axes, n)
        outputs = [reduce(one, reducer, rate_hz=rate_hz).samples for one in signals]
        return np.reshape(outputs, (*many, n))

    return apply


def _check_inputs(
    recordings: Sequence[Recording], sensor: Mapping[str, Recording], numbers: Mapping[str, int]
) -> None:
    """Refuse numbers of draws without a spread, and originals that belong to no recording."""
    for name, number in numbers.items():
        if number != int(number) or number < 2:  # noqa: PLR2004 - a spread needs two
            raise ValueError(
                f"{name} must be a whole number of 2 or more, got {number}; a spread needs two"
            )
    if not isinstance(sensor, Mapping):
        raise TypeError(f"sensor must be a mapping of names to Recordings, got {describe(sensor)}")
    names = [one.name for one in recordings]
    if unknown := [name for name in sensor if name not in names]:
        known = ", ".join(names) or "none"
        raise ValueError(f"sensor must name recordings ({known}), got {unknown[0]!r}")


def _collect_notes(
    recordings: Sequence[Recording], sensor: Mapping[str, Recording]
) -> Iterator[str]:
    if recordings:
        yield (
            f"Gains are those of the strongest {EXCERPT_S:g} s of a recording, metrics those of its strongest "
            f"{METRICS_S:g} s."
        )
    moving = {one.name: bool(one.acceleration.any()) for one in recordings}
    yield from (f"{name}: silent, left out." for name, moves in moving.items() if not moves)
    unseen = [name for name, moves in moving.items() if moves and name not in sensor]
    if unseen:
        yield (
            f"{', '.join(unseen)}: only the conditioned signal was available, which hides offsets, clipping and the "
            "sensor's steps."
        )
    yield from (f"{one.name}: {warning}" for one in recordings for warning in one.warnings)
