"""Verbs about people's data: inventory, withdraw, backup, restore."""

from __future__ import annotations

import sys
from dataclasses import asdict
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.persons.backup import BackedUp
    from feel321.study.study import Study


@click.command(
    epilog="""\b
Example: feel321 inventory my-study
         feel321 inventory my-study --participant p07 --json
"""
)
@shared.study_argument
@click.option("--participant", metavar="ID", default="", help="Only data of this participant.")
@shared.flag("--due", "Only what is due for removal by [data] in study.toml.")
@shared.flag("--tighten", "Make files and folders that others may read private.")
@shared.json_option
def inventory(*, study: Study, participant: str, due: bool, tighten: bool, as_json: bool) -> None:
    """List the personal data that a study keeps, for an ethics form.

    Shows what is kept, where, about whom, since and until when, who may read it, whether it is encrypted, what an
    export passes on, and what a withdrawal does to it.
    """
    from feel321.study.persons import inventory as inventories
    from feel321.study.persons import modes

    if tighten:
        for path in modes.tighten(study.folder):
            shared.echo(f"{path}: closed", err=True)
    today = datetime.now(UTC).date()
    found = inventories.read_inventory(study.folder, today=today, participant=participant)
    if as_json:
        shared.print_json(found.to_dict())
    elif due:
        shared.echo("\n".join(found.due) or "nothing is due")
    else:
        shared.echo(found.summary())


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

    Data go from sessions, rehearsals, tables, results and unedited outputs elsewhere; anything left to remove by hand
    is listed. The code is not reused; the design slot is freed. --personal removes the personal answers only.
    """
    if (participant is None) != due:
        raise click.UsageError("withdraw needs --participant ID, or --due; give one of them")
    tasks = [(participant, personal)] if participant else _list_due(study)
    what = "personal answers" if personal else "data"
    names = ", ".join(f"{name}{' (personal answers)' * own}" for name, own in tasks) or "nobody"
    question = f"Remove {'what is due' if due else f'all {what}'} of {names} in {study.folder.path} for good?"
    if not is_sure and not sys.stdin.isatty():
        raise click.UsageError("no terminal to ask for confirmation; add --yes")
    if not tasks or (not is_sure and not click.confirm(question, err=True)):
        shared.echo(f"{study.folder.path}: nothing was removed")
        context.exit(0 if not tasks else 1)
    for name, only_personal in tasks:
        shared.echo((_remove_personal if only_personal else _remove_all)(study, name, reason))


def _list_due(study: Study) -> list[tuple[str, bool]]:
    from feel321.study.persons.retention import list_due

    due = list_due(study.folder, today=datetime.now(UTC).date())
    return [(one.participant, one.what == "personal") for one in due]


def _remove_personal(study: Study, participant: str, _reason: str) -> str:
    from feel321.study.persons.retention import remove_personal

    asked = remove_personal(study.folder, participant, now=study.now)
    return f"{participant}: removed the answers to {', '.join(asked)}; the journal records it, ratings stay"


def _remove_all(study: Study, participant: str, reason: str) -> str:
    from feel321.study.auditing.sealing import seal_withdrawal
    from feel321.study.persons.withdrawal import withdraw_participant

    folder = study.folder
    removed = withdraw_participant(
        folder, participant, now=study.now, reason=reason, warn=shared.warn
    )
    if problem := seal_withdrawal(folder, participant, now=study.now):
        shared.warn(problem)
    return (
        f"{folder.sessions / participant}: removed {len(removed)} files; a tombstone keeps the code. "
        "Copies that feel321 did not make must be removed by hand"
    )


@click.command(epilog="Example: feel321 backup my-study --to /mnt/safe/my-study")
@shared.study_argument
@click.option(
    "--to", "target", metavar="DIR", type=shared.FILE, required=True, help="Folder of the backup."
)
@shared.json_option
def backup(*, study: Study, target: Path, as_json: bool) -> None:
    """Copy a study into a folder of backups, also while sessions run.

    Each file is stored once, under its SHA-256; a later backup copies only what is new and replaces the earlier one in
    one step. Data of those who withdrew are removed. Encrypted personal answers stay encrypted.
    """
    from feel321.study.persons.backup import back_up

    with shared.show_progress("backup") as progress:
        done = back_up(study.folder, target, now=study.now, follow=progress)
    _report(
        f"{target}: {done.files} files ({done.size / 1e6:.1f} MB), {done.new} new",
        done,
        as_json=as_json,
    )


@click.command(epilog="Example: feel321 restore /mnt/safe/my-study --to my-study")
@click.argument("source", metavar="DIR", type=shared.FILE)
@click.option(
    "--to", "folder", metavar="STUDY", type=shared.FILE, required=True, help="A new folder."
)
@shared.json_option
@click.pass_context
def restore(context: click.Context, *, source: Path, folder: Path, as_json: bool) -> None:
    """Restore a study from a backup, and audit it.

    Nothing is overwritten: STUDY must be new or empty. Those who withdrew since the backup are left out. If
    interrupted, run it again.
    """
    from feel321.study.auditing.study import audit_study
    from feel321.study.folder import StudyFolder
    from feel321.study.persons.backup import restore as bring_back
    from feel321.study.session.journal import utc_now

    done = bring_back(source, folder, now=utc_now)
    _report(f"{folder}: {done.files} files ({done.size / 1e6:.1f} MB)", done, as_json=as_json)
    for finding in (findings := audit_study(StudyFolder(folder))):
        shared.warn(finding)
    context.exit(1 if findings else 0)


def _report(line: str, done: BackedUp, *, as_json: bool) -> None:
    if as_json:
        shared.print_json(asdict(done))
        return
    shared.echo(line)
    for note in done.notes:
        shared.warn(note)
