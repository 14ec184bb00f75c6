"""Verbs to look at sessions: monitor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared
from feel321.study.folder import require_study

if TYPE_CHECKING:
    from collections.abc import Sequence


@click.command(
    epilog="""\b
Example: feel321 monitor my-study
         feel321 monitor /lab/station1 /lab/station2 --port 8321
"""
)
@click.argument("folders", metavar="[STUDY]...", nargs=-1, type=shared.FILE)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port.  [default: a free one]"
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="An address of this machine that no other one reaches.",
)
@shared.rehearsals_option
def monitor(folders: Sequence[Path], *, port: int, host: str, rehearsals: bool) -> None:
    """Show running sessions on a live page, blind and read-only.

    The page has progress, time left, underruns, delivery errors, catch trials, training and notes, but no rating and
    no name of a condition. It answers on this machine only, at an address with a token: keep it to yourself. Ctrl-C
    ends it.
    """
    from feel321.study.monitor.live import serve_monitor
    from feel321.study.session.journal import utc_now

    studies = [
        replace(require_study(folder), is_rehearsal=rehearsals) for folder in folders or (Path(),)
    ]
    try:
        serve_monitor(studies, host=host, port=port, now=utc_now, announce=click.echo)
    except KeyboardInterrupt:  # the usual end
        click.echo("monitor: ended", err=True)
