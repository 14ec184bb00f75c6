"""Verbs that keep evidence: audit, seal, freeze."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared
from feel321.study.session.identity import FROZEN_FILE

if TYPE_CHECKING:
    from feel321.study.findings import Audit
    from feel321.study.study import Study

PER_FILE = 10
"""Findings of one file that are printed; the others are counted."""


@click.command(
    epilog="""\b
Example: feel321 audit my-study
         feel321 audit my-study --remote /media/usb/evidence.git
         feel321 audit my-study --expect 5f0c2a7e91d4
"""
)
@shared.study_argument
@click.option(
    "--remote", "remotes", metavar="REMOTE", multiple=True,
    help="A git remote with checkpoints, in addition to the study's own; repeatable.",
)  # fmt: skip
@click.option(
    "--expect",
    metavar="ID",
    default="",
    help="Fail if there is no such checkpoint of feel321 seal.",
)
@shared.rehearsals_option
@shared.json_option
@click.pass_context
def audit(
    context: click.Context,
    *,
    study: Study,
    remotes: Sequence[str],
    expect: str,
    rehearsals: bool,
    as_json: bool,
) -> None:
    """Verify plans, journals and stimuli; list every change.

    Compares the journals with plans, tables and report, and the files with the checkpoints in .evidence and at
    its remotes. What no checkpoint covers is not judged: recordings, personal answers, other results.
    """
    study = replace(study, folder=replace(study.folder, is_rehearsal=rehearsals))
    found = study.audit(expect=expect, remotes=remotes)
    if as_json:
        shared.print_json(asdict(found))
    else:
        shared.echo("\n".join(_describe(found, study)))
    context.exit(1 if found.findings else 0)


def _describe(found: Audit, study: Study) -> list[str]:
    """Describe an audit for people: the findings by file, then what they were compared with."""
    n, path = len(study.folder.journals), study.folder.path
    good = f"{path}: {n} {'journal' if n == 1 else 'journals'}, no contradiction in them"
    lines = _group(found.findings) or [good]
    return [*lines, *([found.sentence] if found.sentence else []), *found.remarks]


def _group(findings: Sequence[str]) -> list[str]:
    """Group findings by file; of each only some are printed."""
    files: dict[str, list[str]] = defaultdict(list)
    for text in findings:
        files[text.partition(": ")[0].partition(", line ")[0]].append(text)
    lines = []
    for own in files.values():
        lines += own[:PER_FILE]
        if len(own) > PER_FILE:
            lines.append(f"  and {len(own) - PER_FILE} more in this file (--json lists all)")
    return shared.cap(lines)


@click.command(
    epilog="""\b
Example: feel321 seal my-study
         feel321 seal my-study --to /mnt/elsewhere/my-study.git
         feel321 seal my-study --reason "analysis.draws raised, as preregistered"
"""
)
@shared.study_argument
@click.option(
    "--reason",
    default="",
    help="Why settings, texts or methods were changed since the last checkpoint.",
)
@click.option(
    "--to", metavar="REMOTE", default="",
    help="Push to this git remote from now on: a folder outside the study, or a URL.",
)  # fmt: skip
@shared.json_option
def seal(*, study: Study, reason: str, to: str, as_json: bool) -> None:
    """Take a checkpoint of the study, and push it to its remotes.

    A checkpoint is a commit in the git repository .evidence of the study: the SHA-256 and size of plans, journals,
    settings, texts, methods, stimuli, tables and report, never their contents. run, simulate, build, analyze and
    withdraw take one too. A remote that others cannot write to reveals every later change (feel321 audit); it may be a
    folder that is not there yet, and is kept if it takes this checkpoint.
    """
    found = study.seal(reason, to=to)
    for problem in found.problems:
        shared.warn(problem)
    if as_json:
        shared.print_json(asdict(found))
        return
    places = [f"pushed to {place}" for place in found.places] or [
        "not pushed, because no remote is set: feel321 seal --to REMOTE"
    ]
    shared.echo("\n".join([f"{study.folder.path}: checkpoint {found.checkpoint}", *places]))


@click.command(
    epilog="""\b
Example: feel321 freeze my-study
         feel321 freeze my-study --show
"""
)
@shared.study_argument
@shared.flag("--show", "Only show what is frozen, and what has changed since.", "only_show")
@shared.json_option
def freeze(*, study: Study, only_show: bool, as_json: bool) -> None:
    """Freeze hypotheses, design and analysis before the first rating is seen.

    Writes frozen.json: settings, stimuli, code and hypotheses, with their digests. analyze then marks results as
    confirmatory or exploratory, and names every setting that was changed. It may be written again until a person has
    rated. No rating is shown.
    """
    from feel321.study import freeze as freezing

    if only_show:
        frozen = freezing.read_frozen(study.folder)
        changes = freezing.list_changes(study.folder, study.settings, frozen) if frozen else {}
    else:
        frozen, changes = freezing.freeze_study(study.folder, now=study.now)
    faults = freezing.find_faults(study.folder)
    if as_json:
        own = asdict(frozen) if frozen else None
        shared.print_json({"frozen": own, "changes": [*changes.values()], "faults": faults})
        return
    for line in faults:
        shared.warn(line)
    if frozen is None:
        shared.echo(
            f"{study.folder.path}: nothing is frozen; before the first rating: feel321 freeze"
        )
        return
    lines = [f"{study.folder.path / FROZEN_FILE}: frozen {frozen.utc}, SHA-256 {frozen.sha256}"]
    if only_show:
        own_words = frozen.settings["analysis.hypotheses"]
        lines += [
            "hypotheses:",
            *(f"  {one}" for one in (*frozen.hypotheses, *own_words)),
            "settings:",
        ]
        lines += [
            f"  {name} = {freezing.describe_value(one)}" for name, one in frozen.settings.items()
        ]
    shared.echo(
        "\n".join([
            *lines,
            *(["changed:"] if changes else []),
            *(f"  {one}" for one in changes.values()),
        ])
    )
