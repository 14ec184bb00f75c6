"""The verb chart: its work is done in analysis/chart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options

if TYPE_CHECKING:
    from study.commands.methods import Task


@click.command(epilog="Example: feel321 chart my-study --scenes")
@method_options("chart")
def chart(*, task: Task, as_json: bool) -> None:
    """Speed against accuracy of every reducer."""
    del task, as_json
    raise NotImplementedError
