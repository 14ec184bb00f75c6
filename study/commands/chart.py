"""The verb that sets the speed of every reducer against its accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options
from study.commands.shared import show_progress

if TYPE_CHECKING:
    from study.commands.methods import Task


@click.command(epilog="Example: feel321 chart my-study --scenes")
@method_options("chart")
@click.option(
    "--full/--quick",
    help="Whole recordings, 200 orientations, signals up to 10^7 samples; takes many times as long.  [default: quick]",
)
def chart(*, task: Task, full: bool, as_json: bool) -> None:
    """Set the speed of every reducer against its accuracy.

    Writes a page to explore, figures for print, CSV and JSON. Times are measured on this machine: leave it idle.
    """
    from analysis.tradeoff.chart.compute import FULL, QUICK, compute_chart
    from analysis.tradeoff.chart.write import write_chart
    from study.methods import find_ratings

    recordings, ratings = task.gather(), find_ratings(task.study)
    with show_progress("chart") as progress:
        measured = compute_chart(
            recordings, ratings=ratings, effort=FULL if full else QUICK, seed=task.seed, progress=progress
        )
    write_chart(measured, task.output)
    if as_json:
        click.echo((task.output / "results.json").read_text(encoding="utf-8"))
    else:
        click.echo(task.output / "index.html")
