"""Verbs that look after who takes part."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from study.commands.shared import json_option, now, print_json, study_argument, warn

if TYPE_CHECKING:
    from study.folder import StudyFolder

participant_option = click.option("--participant", metavar="ID", required=True, help="The participant's code.")


@click.command(epilog="Example: feel321 withdraw my-study --participant p07 --yes")
@study_argument
@participant_option
@click.option("--reason", default="", help="Why, for the tombstone.")
@click.option("--yes", "is_sure", is_flag=True, help="Do not ask.")
@click.pass_context
def withdraw(context: click.Context, *, study: StudyFolder, participant: str, reason: str, is_sure: bool) -> None:
    """Remove the data of one participant for good; the code stays taken, the slot is free."""
    from study.ledger.withdrawal import withdraw_participant

    if not is_sure and not _ask(f"Remove all data of {participant} in {study.path} for good?"):
        click.echo(f"{study.path}: nothing was removed")
        context.exit(1)
    removed = withdraw_participant(study, participant, now=now, reason=reason, warn=warn)
    click.echo(f"{study.sessions / participant}: removed {len(removed)} files; a tombstone keeps the code")


@click.command(epilog="Example: feel321 release my-study --participant p07")
@study_argument
@participant_option
def release(*, study: StudyFolder, participant: str) -> None:
    """Give up one participant who will not come back: data stay, the next one gets the slot."""
    from study.ledger.withdrawal import release_participant

    number = release_participant(study, participant, now=now)
    click.echo(f"{study.path}: {participant} is released, number {number} is free")


@click.command(epilog="Example: feel321 ledger my-study")
@study_argument
@click.option("--rebuild", is_flag=True, help="Make it anew from plans, journals and tombstones.")
@json_option
def ledger(*, study: StudyFolder, rebuild: bool, as_json: bool) -> None:
    """Show who takes part under which number; rebuild the ledger."""
    from study.ledger.rebuilding import read_study_ledger, rebuild_ledger

    for line in rebuild_ledger(study, now=now) if rebuild else []:
        warn(line)
    entries = read_study_ledger(study)
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    click.echo(f"{'number':>6}  {'participant':<16}{'state':<12}{'done':>5} of")
    for entry in entries:
        mark = " (simulated)" if entry.simulated else ""
        click.echo(
            f"{entry.number:>6}  {entry.participant:<16}{entry.state:<12}{entry.done:>5} {entry.total}{mark}"
        )


def _ask(question: str) -> bool:
    if not sys.stdin.isatty():
        raise click.UsageError("got no terminal to ask on; if it is meant for good, say --yes")
    return click.confirm(question, err=True)
