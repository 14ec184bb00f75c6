"""Verbs about people's data: inventory, withdraw, backup, restore."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from feel321.study.study import Study


@click.command(
    epilog="""\b
Example: feel321 inventory my-study
         feel321 inventory my-study --participant p07 --json
"""
)
@shared.study_argument
@click.option("--participant", metavar="ID", default="", help="Only what is kept of this one.")
@shared.flag("--due", "Only what is due for removal by [data] in study.toml.")
@shared.flag("--tighten", "Close files and folders that others may read.")
@shared.json_option
def inventory(*, study: Study, participant: str, due: bool, tighten: bool, as_json: bool) -> None:
    """List what a study keeps of people, for an ethics form.

    What is kept, where, of whom, since when and until when, who may read it, whether it is encrypted, what of it leaves
    the lab with an export, and what a withdrawal does to it.
    """
    from feel321.study.persons import inventory as inventories

    if tighten:
        for path in inventories.tighten(study.folder):
            click.echo(f"{path}: closed", err=True)
    today = datetime.now(UTC).date()
    found = inventories.read_inventory(study.folder, today=today, participant=participant)
    if as_json:
        shared.print_json(found.to_dict())
    elif due:
        click.echo("\n".join(found.due) or "nothing is due")
    else:
        click.echo(found.summary())


@click.command(
    epilog="""\b
Example: feel321 withdraw my-study --participant p07 --yes
         feel321 withdraw my-study --participant p07 --personal
         feel321 withdraw my-study --due
"""
)
@shared.study_argument
@click.option("--participant", metavar="ID", help="The participant's code.")
@click.option("--reason", default="", help="The reason, for the tombstone.")
@shared.flag("--personal", "Only the personal answers; ratings stay.")
@shared.flag("--due", "Instead of one participant: all that is due by [data] in study.toml.")
@shared.flag("--yes", "Do not ask.", "is_sure")
@click.pass_context
def withdraw(  # noqa: PLR0913 - one per option
    context: click.Context,
    *,
    study: Study,
    participant: str | None,
    reason: str,
    personal: bool,
    due: bool,
    is_sure: bool,
) -> None:
    """Remove the data of a participant for good.

    From sessions, rehearsals, tables, results and outputs elsewhere that are as feel321 wrote them; what is left to do
    by hand is named. The code is not used again; the design slot is free. With --personal only the personal answers go.
    """
    if (participant is None) != due:
        raise click.UsageError("withdraw needs --participant ID, or --due; give one of them")
    tasks = [(participant, personal)] if participant else _list_due(study)
    what = "personal answers" if personal else "data"
    names = ", ".join(f"{name}{' (personal answers)' * own}" for name, own in tasks) or "nobody"
    question = f"Remove {'what is due' if due else f'all {what}'} of {names} in {study.folder.path} for good?"
    if not is_sure and not sys.stdin.isatty():
        raise click.UsageError("a terminal is needed to ask whether you are sure; else add --yes")
    if not tasks or (not is_sure and not click.confirm(question, err=True)):
        click.echo(f"{study.folder.path}: nothing was removed")
        context.exit(0 if not tasks else 1)
    for name, only_personal in tasks:
        click.echo((_remove_personal if only_personal else _remove_all)(study, name, reason))


def _list_due(study: Study) -> list[tuple[str, bool]]:
    from feel321.study.persons.retention import list_due

    due = list_due(study.folder, today=datetime.now(UTC).date())
    return [(one.participant, one.what == "personal") for one in due]


def _remove_personal(study: Study, participant: str, _reason: str) -> str:
    from feel321.study.persons.retention import remove_personal

    asked = remove_personal(study.folder, participant, now=study.now)
    return f"{participant}: removed the answers to {', '.join(asked)}; the journal records it, ratings stay"


def _remove_all(study: Study, participant: str, reason: str) -> str:
    from feel321.study.persons.withdrawal import withdraw_participant

    folder = study.folder
    removed = withdraw_participant(
        folder, participant, now=study.now, reason=reason, warn=shared.warn
    )
    return (
        f"{folder.sessions / participant}: removed {len(removed)} files; a tombstone keeps the code. "
        "Copies that feel321 did not make are yours to remove"
    )
