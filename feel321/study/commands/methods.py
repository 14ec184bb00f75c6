"""Verbs about reducers: chart, stress, advise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feel321.jobs import ALONE, Workers
from feel321.study.commands import shared
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.analysis.tradeoff.advise.scene import Rated
    from feel321.stimuli.guard import OwnReducer
    from feel321.stimuli.recording import Recording

    Verb = Callable[..., None]
    Ratings = dict[str, dict[str, Rated]]


@dataclass(frozen=True, slots=True)
class MethodTask:
    """What reducers are to be compared on, and where the results go."""

    study: StudyFolder
    scenes: bool
    extra: tuple[Path, ...]
    output: Path
    seed: int
    workers: Workers = ALONE

    def list_own(self) -> dict[str, OwnReducer]:
        """List the reducers of the lab that the study names, but what was made elsewhere: it reduces nothing else."""
        from feel321.study.methods import list_own_reducers
        from feel321.study.settings.read import read_settings

        if not self.study.settings.is_file():
            return {}
        found = list_own_reducers(read_settings(self.study.settings), self.study.path)
        return {name: one for name, one in found.items() if one.method.origin != "made"}

    def gather(self, *, conditioned: bool = True) -> tuple[Recording, ...]:
        """Gather the recordings, conditioned or as they came from the sensor."""
        from feel321.study.analyze import gather_recordings

        if not (self.scenes or self.extra or self.study.settings.is_file()):
            try:
                require_study(self.study.path)
            except OSError as error:
                need = "or give --scenes or --recordings FILE, which need none"
                raise type(error)(f"{error}; {need}") from None
        recordings = gather_recordings(
            self.study.path, scenes=self.scenes, extra=self.extra, conditioned=conditioned
        )
        if conditioned:
            shared.report_warnings(recordings)
        return recordings


def _check_folder(folder: Path) -> None:
    if not folder.is_dir():
        what = "a study must be a folder" if folder.exists() else "no such folder"
        raise NotADirectoryError(f"{folder}: {what}; check the name")


def _find_seed(study: StudyFolder) -> int:
    from feel321.study.settings.read import read_settings

    return read_settings(study.settings).study.seed if study.settings.is_file() else 0


def comparison_options(output: str) -> Callable[[Verb], Verb]:
    """Give a verb STUDY and the options that say which recordings; it receives `task` and `as_json`."""

    def give(verb: Verb) -> Verb:
        @shared.folder_argument
        @shared.flag("--scenes", "Also use the bundled scenes; no study required.")
        @click.option(
            "--recordings", "extra", type=shared.FILE, multiple=True,
            help="Also use this recording, or a folder of them; repeatable; no study required.",
        )  # fmt: skip
        @click.option(
            "-o",
            "--output",
            "--out",
            "target",
            type=shared.FILE,
            help=f"Folder of the results.  [default: STUDY/{output}]",
        )
        @shared.seed_option("", default="the study's, or 0")
        @shared.workers_option
        @shared.json_option
        @wraps(verb)
        def ask_then_do(
            *,
            folder: Path,
            scenes: bool,
            extra: tuple[Path, ...],
            target: Path | None,
            seed: int | None,
            workers: Workers,
            **own: object,
        ) -> None:
            from feel321.analysis.report.folder import check_target

            _check_folder(folder)
            study, output_folder = StudyFolder(folder), target or folder / output
            check_target(output_folder)
            chosen = _find_seed(study) if seed is None else seed
            task = MethodTask(study, scenes, extra, output_folder, chosen, workers)
            verb(task=task, **own)

        return ask_then_do

    return give


@click.command(epilog="Example: feel321 chart my-study --scenes")
@comparison_options("chart")
@click.option(
    "--full/--quick",
    help="Whole recordings, 200 orientations, signals up to 10^7 samples; takes many times as long.  [default: quick]",
)
def chart(*, task: MethodTask, full: bool, as_json: bool) -> None:
    """Plot the speed of every reducer against its accuracy.

    Writes a page to explore, figures for print, CSV and JSON. Times are measured on this machine: leave it idle.
    """
    from feel321.analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart
    from feel321.study.analyze import find_ratings

    recordings, ratings = task.gather(), find_ratings(task.study)
    with shared.show_progress("chart") as progress:
        measured = compute_chart(
            recordings,
            ratings=ratings,
            own=task.list_own(),
            effort=FULL if full else QUICK,
            seed=task.seed,
            workers=task.workers,
            progress=progress,
        )
    with shared.recording(task.study, "chart", task.output):
        measured.write(task.output)
    shared.print_results(task.output, as_json=as_json)


@click.command(epilog="Example: feel321 stress my-study --scenes")
@comparison_options("stress")
def stress(*, task: MethodTask, as_json: bool) -> None:
    """Find where reducers fail, and which recordings come near.

    Every reducer meets a battery of scenes: anti-phase axes, circular motion, clipping, gaps and so on. Each figure
    comes with its limit, each failure with its explanation: index.html, results.json, tables/*.csv, figures/stress.
    """
    from feel321.analysis.tradeoff.stress.run import stress_reducers
    from feel321.stimuli.reducers.registry import REDUCERS

    recordings = task.gather()
    sensor = {recording.name: recording for recording in task.gather(conditioned=False)}
    with shared.show_progress("stress") as progress:
        reducers = {**REDUCERS, **task.list_own()}
        result = stress_reducers(
            recordings, reducers, sensor=sensor, seed=task.seed, workers=task.workers,
            progress=progress,
        )  # fmt: skip
    result.write(task.output)
    for name, lines in result.warnings.items():
        for line in lines:
            shared.warn(f"{name}: {line}")
    shared.print_results(task.output, as_json=as_json)


@click.command(epilog="Example: feel321 advise my-study --scenes --online --latency-ms 45")
@comparison_options("advice")
@shared.flag("--online", "The reducer runs while the vibration is made.")
@shared.number_option(
    "--latency-ms", "Longest delay online, of reducer, block and device, in ms.", "45"
)
@shared.number_option(
    "--block-ms", "Length of a block online, in ms.", "64 samples at 48 kHz, 1.33"
)
@shared.number_option("--device-ms", "Delay of sensor, driver and actuator online, in ms.", "5")
@click.option(
    "--mounting",
    type=click.Choice(["any", "recorded"]),
    default="any",
    show_default=True,
    help="Whether advice must hold however the sensor is mounted, or only as it was mounted.",
)
@click.option(
    "--axes",
    type=click.IntRange(1, 3),
    default=1,
    show_default=True,
    help="Axes that the actuator can move, 1 to 3.",
)
@shared.number_option(
    "--tolerance", "Largest energy change taken as imperceptible, as a Weber fraction.", "0.22"
)
@shared.number_option("--segment", "Advise for segments of this duration, in s.")
def advise(  # noqa: PLR0913 - every option has a name of its own
    *,
    task: MethodTask,
    as_json: bool,
    online: bool,
    latency_ms: float | None,
    block_ms: float | None,
    device_ms: float | None,
    mounting: str,
    axes: int,
    tolerance: float | None,
    segment: float | None,
) -> None:
    """Name the simplest sufficient reducer for every scene.

    The first, by simplicity, that is equivalent to the best within tolerance, by metrics, in every segment of 2 s and
    however the sensor is mounted; and by ratings where the study has them.
    """
    from feel321.analysis.tradeoff.advise.page import advise_recordings, write_advice
    from feel321.analysis.tradeoff.advise.scene import Context, Tolerance, check_segment

    given = {"block_ms": block_ms, "device_ms": device_ms, "latency_ms": latency_ms}
    with _as_options():
        limits = Tolerance() if tolerance is None else Tolerance(tolerance)
        times = {name: value for name, value in given.items() if value is not None}
        context = Context(online=online, axes=axes, tolerance=limits, mounting=mounting, **times)
        segment_s = None if segment is None else check_segment(segment)
    recordings, ratings = task.gather(), _read_ratings(task.study)
    with shared.show_progress("advise") as progress:
        study = advise_recordings(
            recordings,
            context,
            seed=task.seed,
            segment_s=segment_s,
            ratings=ratings,
            own=task.list_own(),
            workers=task.workers,
            progress=progress,
        )
        with shared.recording(task.study, "advise", task.output):
            content = write_advice(study, task.output)
    if as_json:
        shared.print_json(content)
        return
    shared.echo(study.summary())
    shared.echo(task.output / "index.html")


_OPTIONS = {
    "--weber": "--tolerance", "--segment_s": "--segment", "_ms must": "-ms must", "set online=True": "add --online",
}  # fmt: skip
"""What messages call an argument -> the option."""


@contextmanager
def _as_options() -> Iterator[None]:
    """Turn what is wrong with an argument into what is wrong with the option of that name."""
    try:
        yield
    except ValueError as error:
        text = f"--{error}"
        for argument, option in _OPTIONS.items():
            text = text.replace(argument, option)
        raise click.UsageError(text) from None


def _read_ratings(study: StudyFolder) -> Ratings | None:
    """Read what the ratings say of each reducer, if there are any."""
    from feel321.analysis.tradeoff.advise.scene import judge_ratings
    from feel321.study.analyze import find_ratings
    from feel321.study.settings.read import read_settings

    table = find_ratings(study)
    if table is None:
        return None
    margin = read_settings(study.settings).analysis.margin if study.settings.is_file() else None
    return judge_ratings(table, margin=margin)
