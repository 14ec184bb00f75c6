"""The stress test: the battery through every reducer, the recordings diagnosed, everything written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff.results import check_names, write_results
from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
from feel321.analysis.tradeoff.stress.diagnosis import diagnose
from feel321.analysis.tradeoff.stress.measures import measure_battery, measure_gains
from feel321.analysis.tradeoff.stress.page import CAPTION, FIGURE, build_page, draw_stress
from feel321.analysis.tradeoff.stress.result import (
    StressResult,
    build_content,
    compare_metrics_under_rotation,
)
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.stimuli.recording import Recording
    from feel321.types import PathLike, Reducer

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
        return write_results(
            folder,
            FIGURE,
            content=build_content(self),
            tables=self.to_frames(),
            pictures=[Picture(FIGURE, CAPTION, draw_stress(self))],
            values=build_page(self),
        )


def stress_reducers(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Sequence[Recording] = (),
    reducers: Mapping[str, Reducer] | None = None,
    *,
    sensor: Mapping[str, Recording] | None = None,
    seeds: int = TAKES,
    draws: int = DRAWS,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Stress:
    """Put reducers through the battery, and find the recordings that come near its scenes; seeds: takes of a scene."""
    from threadpoolctl import threadpool_limits

    chosen = dict(REDUCERS if reducers is None else reducers)
    check_names(recordings)
    for name, number in (("takes", seeds), ("draws", draws)):
        if number < 2:  # noqa: PLR2004 - a spread needs two
            raise ValueError(f"{name} must be 2 or more, got {number}; a spread needs two")
    scenes = [scene.make(seed) for scene in BATTERY.values()]
    moving = [recording for recording in recordings if recording.acceleration.any()]
    excerpts = [take_excerpt(recording, duration_s=EXCERPT_S) for recording in moving]
    known, before = sensor or {}, len(scenes) * len(chosen)
    total = before + len(moving) * len(chosen)
    tick = progress or (lambda _done, _total: None)
    # Signals here are short: threads of the linear algebra wait for each other most of the time.
    with threadpool_limits(limits=1, user_api="blas"):
        cells = measure_battery(
            chosen, takes=seeds, seed=seed, progress=lambda done, _: tick(done, total)
        )
        gains = measure_gains(
            excerpts, chosen, draws=draws, seed=seed,
            progress=lambda done, _: tick(before + done, total),
        )  # fmt: skip
        metrics = []
        for one in (*scenes, *excerpts):
            part = take_excerpt(one, duration_s=METRICS_S)
            rng = np.random.default_rng([seed, *one.name.encode()])
            metrics.append(compare_metrics_under_rotation(part, chosen, rng=rng))
        diagnoses = [diagnose(one, known.get(one.name)) for one in moving]
    digests = {f"recording {one.name}": one.sha256 for one in recordings}
    inputs = {"seed": seed, "seeds": seeds, "draws": draws, **digests}
    notes = tuple(_collect_notes(recordings, known))
    return Stress(tuple(chosen), cells, gains, tuple(metrics), tuple(diagnoses), notes, inputs)


def write_stress(result: Stress, folder: PathLike) -> Path:
    """Write a stress test; kept for callers of the former name."""
    return result.write(folder)


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
