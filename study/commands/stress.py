"""The verb stress: its work is done in analysis/tradeoff/stress."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options
from study.commands.shared import show_progress, warn

if TYPE_CHECKING:
    from study.commands.methods import Task


@click.command(epilog="Example: feel321 stress my-study --scenes")
@method_options("stress")
def stress(*, task: Task, as_json: bool) -> None:
    """Find where methods fail, how badly, and which recordings come near.

    Every reducer meets a battery of scenes: anti-phase axes, circular motion, clipping, gaps and so on. Each figure
    comes with its limit, each failure with its explanation: index.html, results.json, tables/*.csv, figures/stress.
    """
    from analysis.tradeoff.stress.run import stress_reducers, write_stress

    recordings, sensor = task.gather(), task.gather_raw()
    with show_progress("stress") as progress:
        result = stress_reducers(recordings, sensor=sensor, seed=task.seed, progress=progress)
    page = write_stress(result, task.output)
    for name, lines in result.warnings.items():
        for line in lines:
            warn(f"{name}: {line}")
    click.echo((page.parent / "results.json").read_text(encoding="utf-8") if as_json else page, nl=not as_json)
