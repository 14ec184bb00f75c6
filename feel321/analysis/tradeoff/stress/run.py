"""The stress test: the battery through every reducer, the recordings diagnosed, everything written."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from feel321.analysis.tradeoff.stress.cells import MetricRow
    from feel321.analysis.tradeoff.stress.result import StressResult
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.reducers.registry import Reducer

    Progress = Callable[[int, int], None]

EXCERPT_S, METRICS_S = 2.0, 1.0
"""Longest part of a recording whose gains are measured, and whose metrics are, in s."""

SEEDS = 40
"""Takes of every scene of the battery."""

DRAWS = 16
"""Noises per recording."""


def stress_reducers(  # noqa: PLR0913 - every choice that changes the figures has a name of its own
    recordings: Sequence[Recording] = (),
    reducers: Mapping[str, Reducer] | None = None,
    *,
    sensor: Mapping[str, Recording] | None = None,
    seeds: int = SEEDS,
    draws: int = DRAWS,
    seed: int,
    progress: Progress | None = None,
) -> StressResult:
    """Put reducers through the battery, and find the recordings that come near its scenes.

    Parameters
    ----------
    recordings : sequence of Recording
        Conditioned, as they are felt; each with a name of its own. Silent ones are left out, and noted.
    reducers : Mapping of str to Reducer, optional
        Name -> reducer; `REDUCERS` if left out.
    sensor : Mapping of str to Recording, optional
        The same recordings as they came from the sensor, by name; needed to see offsets, clipping and steps.
    seeds : int
        Takes of every scene, at least 2, each with a noise, orientations and a shift of its own.
    draws : int
        Noises per recording, at least 2.
    seed : int
        Of all randomness.
    progress : callable, optional
        Called with the numbers of steps done and to do.

    Returns
    -------
    StressResult
        Every figure.

    Raises
    ------
    ValueError
        If two recordings bear one name, there is no reducer, or there are fewer than 2 draws.

    Examples
    --------
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> stress_reducers(reducers={"soc321": REDUCERS["soc321"]}, seeds=2, seed=0).failures[0].recording
    'ordinary_drag'
    """
    from threadpoolctl import threadpool_limits

    from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
    from feel321.analysis.tradeoff.stress.cells import measure_cells
    from feel321.analysis.tradeoff.stress.diagnosis import diagnose
    from feel321.analysis.tradeoff.stress.result import StressResult
    from feel321.analysis.tradeoff.stress.takes import measure_battery
    from feel321.stimuli.reducers.registry import REDUCERS

    reducers = REDUCERS if reducers is None else reducers
    _require_names(recordings, reducers)
    scenes = [scene.make(seed) for scene in BATTERY.values()]
    moving = [recording for recording in recordings if recording.acceleration.any()]
    tell, total = progress or _stay_silent, (len(scenes) + len(moving)) * len(reducers)
    known, excerpts = (
        sensor or {},
        [take_excerpt(recording, duration_s=EXCERPT_S) for recording in moving],
    )
    # Signals here are short: threads of the linear algebra wait for each other most of the time.
    with threadpool_limits(limits=1, user_api="blas"):
        cells = measure_battery(
            reducers, seeds=seeds, seed=seed, progress=lambda done, _: tell(done, total)
        )
        gains = measure_cells(
            excerpts, reducers, measures=("gain",), draws=draws, seed=seed,
            progress=lambda done, _: tell(len(scenes) * len(reducers) + done, total),
        )  # fmt: skip
        metrics = tuple(_compare(recording, reducers, seed) for recording in (*scenes, *excerpts))
        diagnoses = tuple(diagnose(recording, known.get(recording.name)) for recording in moving)
    notes = _note(recordings, moving, known)
    digests = {f"recording {one.name}": one.sha256 for one in recordings}
    inputs = {"seed": seed, "seeds": seeds, "draws": draws, **digests}
    return StressResult(tuple(reducers), cells, gains, metrics, diagnoses, notes, inputs)


def write_stress(result: StressResult, folder: Path | str) -> Path:
    """Write the page, its numbers, its tables and its figure.

    Parameters
    ----------
    result : StressResult
        What `stress_reducers` returns.
    folder : Path or str
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
    from feel321.analysis.figures.style import save_figure
    from feel321.analysis.report.folder import list_files, replace_report
    from feel321.analysis.tradeoff.stress.page import draw_stress, render_page
    from feel321.analysis.tradeoff.stress.result import FIGURES, TABLES

    target = Path(folder)
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as name:
        place = Path(name)
        (place / "figures").mkdir()
        (place / "tables").mkdir()
        for table, frame in result.to_tables().items():
            text = frame.to_csv(index=False, float_format="%.10g", lineterminator="\n")
            (place / "tables" / f"{table}.csv").write_text(text, encoding="utf-8", newline="")
        save_figure(draw_stress(result), place / "figures" / FIGURES[0])
        (place / "results.json").write_text(result.to_json(), encoding="utf-8", newline="")
        page = render_page(result, figures=place / "figures")
        (place / "index.html").write_text(page, encoding="utf-8", newline="")
        replace_report(place, target, files=list_files(FIGURES, TABLES))
    return target / "index.html"


def _require_names(recordings: Sequence[Recording], reducers: Mapping[str, Reducer]) -> None:
    names = [recording.name for recording in recordings]
    if len(set(names)) < len(names):
        raise ValueError(
            f"recordings: got {len(names)} with {len(set(names))} names, allowed is a name for each"
        )
    if not reducers:
        raise ValueError("reducers: got none, allowed is one or more")


def _stay_silent(done: int, total: int) -> None:
    del done, total


def _compare(recording: Recording, reducers: Mapping[str, Reducer], seed: int) -> MetricRow:
    from feel321.analysis.tradeoff.stress.battery import take_excerpt
    from feel321.analysis.tradeoff.stress.cells import compare_metrics_under_rotation

    rng = np.random.default_rng([seed, *recording.name.encode()])
    return compare_metrics_under_rotation(
        take_excerpt(recording, duration_s=METRICS_S), reducers, rng=rng
    )


def _note(
    recordings: Sequence[Recording], moving: Sequence[Recording], sensor: Mapping[str, Recording]
) -> tuple[str, ...]:
    silent = [f"{one.name}: silent, left out." for one in recordings if one not in moving]
    unseen = [one.name for one in moving if one.name not in sensor]
    if unseen:
        silent.append(
            f"{', '.join(unseen)}: seen after conditioning only, which hides offsets, clipping and the sensor's steps."
        )
    told = [f"{one.name}: {warning}" for one in recordings for warning in one.warnings]
    excerpt = f"Gains are those of a recording's strongest {EXCERPT_S:g} s, metrics of its strongest {METRICS_S:g} s."
    return (excerpt, *silent, *told) if recordings else ()
