"""The verb advise: its work is done in analysis/tradeoff/advise."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options
from study.commands.shared import print_json, show_progress

if TYPE_CHECKING:
    from collections.abc import Iterator

    from analysis.tradeoff.advise.verdict import Rated
    from study.commands.methods import Task
    from study.folder import StudyFolder

    Ratings = dict[str, dict[str, Rated]]


@click.command(epilog="Example: feel321 advise my-study --scenes --online --latency-ms 45")
@method_options("advice")
@click.option("--online", is_flag=True, help="The reducer runs while the vibration is made.")
@click.option(
    "--latency-ms", type=float, help="Longest delay online, of reducer, block and device, in ms.  [default: 45]"
)
@click.option("--block-ms", type=float, help="Length of a block online, in ms.  [default: 64 samples at 48 kHz, 1.33]")
@click.option("--device-ms", type=float, help="Delay of sensor, driver and actuator online, in ms.  [default: 5]")
@click.option(
    "--mounting", type=click.Choice(["any", "recorded"]), default="any", show_default=True,
    help="Whether advice must hold however the sensor is mounted, or for the mounting that was recorded.",
)
@click.option("--axes", type=int, default=1, show_default=True, help="Axes that the actuator can move, 1 to 3.")
@click.option("--tolerance", type=float, help="Weber fraction of energy that nobody feels.  [default: 0.22]")
@click.option("--segment", "segment_s", type=float, help="Advise for segments of so many seconds.")
def advise(  # noqa: PLR0913 - every option has a name of its own
    *,
    task: Task,
    as_json: bool,
    online: bool,
    latency_ms: float | None,
    block_ms: float | None,
    device_ms: float | None,
    mounting: str,
    axes: int,
    tolerance: float | None,
    segment_s: float | None,
) -> None:
    """Name the simplest sufficient reducer for every scene.

    The first, by simplicity, that is equivalent to the best within tolerance, by metrics, in every segment of 2 s and
    however the sensor is mounted; and by ratings where the study has them.
    """
    from analysis.tradeoff.advise.report import advise_recordings, write_advice
    from analysis.tradeoff.advise.scene import Context, check_segment
    from analysis.tradeoff.advise.tolerance import Tolerance

    given = {"block_ms": block_ms, "device_ms": device_ms, "latency_ms": latency_ms}
    with _as_options():
        limits = Tolerance() if tolerance is None else Tolerance(tolerance)
        times = {name: value for name, value in given.items() if value is not None}
        context = Context(online=online, axes=axes, tolerance=limits, mounting=mounting, **times)
        segment = None if segment_s is None else check_segment(segment_s)
    recordings, ratings = task.gather(), _hear(task.study)
    with show_progress("advise") as progress:
        study = advise_recordings(
            recordings, context, seed=task.seed, segment_s=segment, ratings=ratings, progress=progress
        )
        content = write_advice(study, task.output)
    if as_json:
        print_json(content)
        return
    for advice in study.advices:
        click.echo(advice.line)
    for line in filter(None, (study.summary, study.note)):
        click.echo(line)
    click.echo(task.output / "index.html")


@contextmanager
def _as_options() -> Iterator[None]:
    """Turn what is wrong with a value into what is wrong with the option of that name."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(f"--{error}") from None


def _hear(study: StudyFolder) -> Ratings | None:
    """Read what people said, if they have said something."""
    from analysis.tradeoff.advise.rated import judge_ratings
    from study.methods import find_ratings
    from study.settings.reading import read_settings

    table = find_ratings(study)
    if table is None:
        return None
    margin = read_settings(study.settings).analysis.margin if study.settings.is_file() else None
    return judge_ratings(table, margin=margin)
