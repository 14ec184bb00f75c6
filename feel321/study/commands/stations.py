"""The verb of several stations: `collect`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from feel321.study.collect import Collected


@click.command(
    epilog="Example: feel321 collect /mnt/lab2/my-study /media/usb/my-study --into my-study"
)
@click.argument("sources", metavar="FROM...", nargs=-1, required=True, type=shared.FILE)
@click.option(
    "--into", "folder", metavar="STUDY", type=shared.FILE, default=Path(), show_default="current folder",
    help="The study to collect into.",
)  # fmt: skip
@shared.json_option
@click.pass_context
def collect(
    context: click.Context, *, sources: tuple[Path, ...], folder: Path, as_json: bool
) -> None:
    """Collect the sessions of other stations into one study.

    FROM are study folders, mounted or copied; they are only read. Plans, journals and what was delivered are
    verified before and after the copy; a longer journal takes the place of one that it continues. Sessions that
    conflict with the study are refused by name; nothing is overwritten. If interrupted, run it again; a second run
    copies nothing. A participant who withdrew at one station is withdrawn here.
    """
    from feel321.study.collect import collect_sessions

    study = shared.open_study(folder)
    with shared.show_progress("collect") as progress:
        found = collect_sessions(study.folder, sources, now=study.now, follow=progress)
    if as_json:
        shared.print_json(asdict(found))
    else:
        shared.echo("\n".join(_describe(found, folder)))
    context.exit(1 if found.refused else 0)


def _describe(found: Collected, folder: Path) -> list[str]:
    lines = [f"{folder}: nothing to copy"]
    if found.files:
        size, who = found.size / 1e6, ", ".join(found.participants)
        lines = [f"{folder}: {found.files} files ({size:.1f} MB) of {who}"]
    return [*lines, *(f"refused: {line}" for line in found.refused), *found.notes]
