"""The stress test: the battery through every reducer, the recordings diagnosed, everything written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
from feel321.analysis.tradeoff.stress.diagnosis import diagnose
from feel321.analysis.tradeoff.stress.measures import measure_battery, measure_gains
from feel321.analysis.tradeoff.stress.result import (
    StressResult,
    build_content,
    compare_metrics_under_rotation,
)
from feel321.doors import as_names, as_seed, follow
from feel321.stimuli.reducers.registry import REDUCERS, get_reducer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from feel321.stimuli.recording import Recording
    from feel321.types import PathLike, Progress, Reducer, Rng

EXCERPT_S, METRICS_S = 2.0, 1.0
"""Longest part of a recording whose gains are measured, and whose metrics are, in s."""

TAKES = 40
"""Takes of every scene of the battery."""

DRAWS = 16
"""Noises per recording."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Stress(StressResult):
    """Where reducers fail, how badly, and which recordings come near.

    Parameters
    ----------
    reducers : tuple of str
        Names of the reducers.
    cells : tuple of StressCell
        Every measure of every reducer on every scene of the battery.
    gains : tuple of StressCell
        Perturbation gain of every reducer on every recording.
    metrics : tuple of MetricRow
        The metrics on every scene and recording.
    diagnoses : tuple of Diagnosis
        What in each recording makes reducers fail.
    notes : tuple of str
        What was left out or assumed.
    inputs : Mapping of str to object
        Seed, numbers of takes and draws, digests of the recordings.
    """

    def write(self, folder: PathLike) -> Path:
        """Write page, numbers, tables and figure.

        Parameters
        ----------
        folder : str or PathLike
            The folder. The files of a former stress test are replaced; all others stay.

        Returns
        -------
        Path
            The page.

        Raises
        ------
        OSError
            If a file cannot be written, or would replace one that is not of a former stress test.
        """
        from feel321.analysis.report.section import Picture
        from feel321.analysis.tradeoff.results import write_results
        from feel321.analysis.tradeoff.stress.page import CAPTION, FIGURE, build_page, draw_stress

        return write_results(
            folder,
            FIGURE,
            content=build_content(self),
            tables=self.to_frames(),
            pictures=[Picture(FIGURE, CAPTION, draw_stress(self))],
            values=build_page(self),
        )


def stress(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Sequence[Recording] = (),
    *,
    reducers: Mapping[str, Reducer] | Sequence[str] | None = None,
    sensor: Mapping[str, Recording] | None = None,
    takes: int = TAKES,
    draws: int = DRAWS,
    rng: Rng = 0,
    progress: Progress = False,
) -> Stress:
    """Put reducers through the battery, and find the recordings that come near its scenes.

    Parameters
    ----------
    recordings : sequence of Recording
        Conditioned, as they are felt; each with a name of its own. Silent ones are left out, and noted.
    reducers : sequence of str, or Mapping of str to callable, optional
        Names of reducers, or name -> reducer; all of `REDUCERS` if left out.
    sensor : Mapping of str to Recording, optional
        The same recordings as they came from the sensor, by name; needed to see offsets, clipping and steps.
    takes : int
        Takes of every scene, at least 2, each with a noise, orientations and a shift of its own.
    draws : int
        Noises per recording, at least 2.
    rng : int or Generator
        A seed, or a generator from which one is drawn.
    progress : bool or callable
        Whether to show a bar; or called with the numbers of steps done and to do.

    Returns
    -------
    Stress
        Every number, to be written or read as tables.

    Raises
    ------
    ValueError
        If two recordings have the same name, there is no reducer, or there are fewer than 2 takes or draws.

    Examples
    --------
    >>> from feel321 import analysis
    >>> found = analysis.stress(reducers=["soc321"], takes=2)
    >>> found.failures[0].recording
    'ordinary_drag'
    """
    from threadpoolctl import threadpool_limits

    chosen, seed = _choose_reducers(reducers), as_seed(rng)
    _check(recordings, takes=takes, draws=draws)
    scenes = [scene.make(seed) for scene in BATTERY.values()]
    moving = [recording for recording in recordings if recording.acceleration.any()]
    excerpts = [take_excerpt(recording, duration_s=EXCERPT_S) for recording in moving]
    known, before = sensor or {}, len(scenes) * len(chosen)
    total = before + len(moving) * len(chosen)
    # Signals here are short: threads of the linear algebra wait for each other most of the time.
    with follow(progress, "stress") as tick, threadpool_limits(limits=1, user_api="blas"):
        cells = measure_battery(
            chosen, takes=takes, seed=seed, progress=lambda done, _: tick(done, total)
        )
        gains = measure_gains(
            excerpts, chosen, draws=draws, seed=seed,
            progress=lambda done, _: tick(before + done, total),
        )  # fmt: skip
        metrics = [
            compare_metrics_under_rotation(
                take_excerpt(one, duration_s=METRICS_S),
                chosen,
                rng=np.random.default_rng([seed, *one.name.encode()]),
            )
            for one in (*scenes, *excerpts)
        ]
        diagnoses = [diagnose(one, known.get(one.name)) for one in moving]
    digests = {f"recording {one.name}": one.sha256 for one in recordings}
    inputs = {"seed": seed, "seeds": takes, "draws": draws, **digests}
    notes = tuple(_collect_notes(recordings, known))
    return Stress(tuple(chosen), cells, gains, tuple(metrics), tuple(diagnoses), notes, inputs)


def _choose_reducers(reducers: Mapping[str, Reducer] | Sequence[str] | None) -> dict[str, Reducer]:
    if reducers is None:
        return dict(REDUCERS)
    if not reducers:
        raise ValueError("reducers must be one or more, got none; leave them out to take all")
    if isinstance(reducers, Mapping):
        return dict(reducers)
    return {name: get_reducer(name) for name in as_names(reducers, "reducers")}


def _check(recordings: Sequence[Recording], *, takes: int, draws: int) -> None:
    names = [recording.name for recording in recordings]
    if len(set(names)) < len(names):
        doubled = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"recordings must have different names, got {doubled!r} twice; rename one")
    for name, count in (("takes", takes), ("draws", draws)):
        if count < 2:  # noqa: PLR2004 - a spread needs two
            raise ValueError(f"{name} must be 2 or more, got {count}; a spread needs two")


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


def stress_reducers(  # noqa: PLR0913 - the former form of `stress`
    recordings: Sequence[Recording] = (),
    reducers: Mapping[str, Reducer] | None = None,
    *,
    sensor: Mapping[str, Recording] | None = None,
    seeds: int = TAKES,
    draws: int = DRAWS,
    seed: int,
    progress: Progress | None = None,
) -> Stress:
    """Call `stress` by its former name and arguments."""
    return stress(
        recordings, reducers=reducers, sensor=sensor, takes=seeds, draws=draws, rng=seed,
        progress=progress or False,
    )  # fmt: skip


def write_stress(result: Stress, folder: PathLike) -> Path:
    """Write a stress test, by the former name of its `write`."""
    return result.write(folder)
