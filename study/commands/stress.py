"""The verb stress: its work is done in analysis/stress."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options

if TYPE_CHECKING:
    from study.commands.methods import Task


@click.command(epilog="Example: feel321 stress my-study --scenes")
@method_options("stress")
def stress(*, task: Task, as_json: bool) -> None:
    """Find where methods fail, and how badly."""
    del task, as_json
    raise NotImplementedError
