"""The verb advise: its work is done in analysis/advise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from study.commands.methods import method_options

if TYPE_CHECKING:
    from study.commands.methods import Task


@click.command(epilog="Example: feel321 advise my-study --scenes")
@method_options("advice")
def advise(*, task: Task, as_json: bool) -> None:
    """Name the simplest sufficient reducer of every scene."""
    del task, as_json
    raise NotImplementedError
