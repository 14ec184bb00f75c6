"""Verbs that keep evidence: audit, seal, freeze."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
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
         feel321 audit my-study --code 000C-7QZK-R2M4-9V8T-XH3D-5
         feel321 audit my-study --anchors /media/usb/anchors
"""
)
@shared.study_argument
@click.option("--code", default="", help="A code that feel321 seal printed.")
@click.option(
    "--anchors", "places", metavar="DIR", type=shared.FILE, multiple=True,
    help="A folder with anchors, in addition to those chosen for this rig; repeatable.",
)  # fmt: skip
@click.option(
    "--expect",
    metavar="DIGEST",
    help="The seal that an earlier audit printed; fail if it has changed.",
)
@shared.rehearsals_option
@shared.json_option
@click.pass_context
def audit(  # noqa: PLR0913 - one per option
    context: click.Context,
    *,
    study: Study,
    code: str,
    places: Sequence[Path],
    expect: str | None,
    rehearsals: bool,
    as_json: bool,
) -> None:
    """Verify plans, journals and stimuli; list every change.

    Compares the journals with plans, ledger, tables and report, and all of it with the checkpoints of the study and
    with the anchors that feel321 seal put elsewhere.
    """
    study = replace(study, folder=replace(study.folder, is_rehearsal=rehearsals))
    found = study.audit(code=code, anchors=places)
    path, findings = study.folder.path, list(found.findings)
    if expect not in {None, found.seal}:
        text = (
            f"the seal must be {expect}, got {found.seal}; something was recorded or changed since"
        )
        findings.append(f"{path}: {text}")
    found = replace(found, findings=tuple(findings))
    if as_json:
        shared.print_json(asdict(found))
    else:
        shared.echo("\n".join(_describe(found, study)))
        shared.echo(f"seal: {found.seal}; keep it elsewhere")
    context.exit(1 if findings else 0)


def _describe(found: Audit, study: Study) -> list[str]:
    """Describe an audit for people: the findings by file, then what they were compared with."""
    n, path = len(study.folder.journals), study.folder.path
    state = "all as they were written" if found.anchored_utc else "no contradiction in them"
    good = f"{path}: {n} {'journal' if n == 1 else 'journals'}, {state}"
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
         feel321 seal my-study --to /mnt/elsewhere/anchors
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
    "--to", "folder", metavar="DIR", type=shared.FILE,
    help="Keep anchors in this folder too, from now on; it must not be in the study.",
)  # fmt: skip
@click.option(
    "--git",
    "remote",
    metavar="REMOTE",
    default="",
    help="Push anchors to this git remote, from now on.",
)
@shared.flag("--make-key", "Make a key for this rig, and sign anchors with it from now on.")
@shared.flag("--passphrase", "Protect the new key with a passphrase, which you are asked for.")
@shared.json_option
def seal(  # noqa: PLR0913 - one per option
    *,
    study: Study,
    reason: str,
    folder: Path | None,
    remote: str,
    make_key: bool,
    passphrase: bool,
    as_json: bool,
) -> None:
    """Take a checkpoint of the study, and anchor it elsewhere.

    A checkpoint of all journals, plans, settings and tables is appended to checkpoints.jsonl, as after each session.
    Its code (print it or write it down) and the copies kept elsewhere reveal every later change (feel321 audit).
    Places and the key belong to this rig, not to the study; they are kept in anchors.toml of the user's
    configuration, and a new one only if it took this anchor. A passphrase may also stand in FEEL321_KEY_PASSPHRASE.
    """
    from feel321.study.auditing import keys, sealing

    secret = os.environ.get(keys.PASSPHRASE, "")
    if passphrase and not make_key:
        raise click.UsageError("--passphrase needs --make-key")
    if passphrase and not secret:
        secret = click.prompt("Passphrase", hide_input=True, confirmation_prompt=True, err=True)
    if make_key:
        path, fingerprint = sealing.choose_key(passphrase=secret if passphrase else "")
        shared.echo(f"{path}: key {fingerprint}; keep a copy of it elsewhere", err=True)
    found = sealing.seal_into(
        study.folder, folder=folder, remote=remote, reason=reason, passphrase=secret, now=study.now
    )
    for problem in found.problems:
        shared.warn(problem)
    if as_json:
        shared.print_json(asdict(found))
        return
    places = [f"anchor: {place}" for place in found.places] or [
        "anchor: none outside the folder; see --to, --git"
    ]
    shared.echo("\n".join([
        f"{study.folder.path}: checkpoint {found.checkpoints} of {found.utc}", *places, f"code: {found.code}"
    ]))  # fmt: skip


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
