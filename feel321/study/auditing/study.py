"""Audit: verify every journal and plan of a study, and compare its files with its checkpoints.

Every finding names the file, and the line where there is one; a file that cannot be read hides no other. The digest
that plans and journals keep of the stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows
are compared with that; its recipe, units and versions are covered by checkpoints only, and `check` compares the recipe
with the settings.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from feel321.doors import announce
from feel321.stimuli.sets.manifest import check_stimuli, describe_row, read_details, read_stimuli
from feel321.study.auditing.evidence import weigh
from feel321.study.auditing.journals import audit_journals, guard
from feel321.study.auditing.replay import MALFORMED
from feel321.study.auditing.tables import compare_tables, list_tables
from feel321.study.folder import StudyFolder
from feel321.study.numbers import Holder, find_doubles, read_holder
from feel321.study.people import RigUse, describe_rigs, find_leftovers, find_rig_use
from feel321.study.persons.withdrawal import find_data_left, list_stale
from feel321.study.session.journal import list_journals, read_journal
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, require_plan


@dataclass(frozen=True, slots=True)
class Examined:
    """What an audit found; checkpoint: the newest, sentence: how far the evidence reaches."""

    findings: tuple[str, ...]
    remarks: tuple[str, ...]
    sentence: str
    checkpoint: str


def examine(
    study: StudyFolder,
    *,
    expect: str = "",
    remotes: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Examined:
    """Verify a study by itself, and by its checkpoints; expect: one that must be there, remotes: further ones."""
    findings = [
        f"{path}: not a participant's folder; move it out of {study.sessions}"
        for path in study.strangers
    ]
    folders, tables, stimuli_sha256 = study.participants, list_tables(study), None
    if folders or study.stimuli.exists():
        problems, stimuli_sha256 = _audit_stimuli(study.stimuli)
        findings += problems
    holders: list[Holder] = []
    uses: list[RigUse] = []
    for done, folder in enumerate(folders, start=1):
        announce(folder.name)
        findings += guard(folder, _audit_participant(folder, stimuli_sha256))
        with suppress(OSError, ValueError):  # of a plan that is among the findings
            holders += filter(None, [read_holder(folder)])
        for table in tables:
            table.take(folder)
        uses += _find_rig(folder)
        progress(done, len(folders))
    findings += [*find_doubles(holders), *guard(study.path, find_data_left(study))]
    wrong, older = compare_tables(study, tables)
    evidence = weigh(study, expect=expect, remotes=remotes)
    stale = guard(study.path, list_stale(study))
    remarks = [*evidence.remarks, *older, *describe_rigs(uses), *stale]
    every = dict.fromkeys([*findings, *wrong, *evidence.findings])
    return Examined(tuple(every), tuple(remarks), evidence.sentence, evidence.checkpoint)


def audit_study(study: StudyFolder) -> list[str]:
    """Verify all plans, journals and stimuli of a study, the tables and the checkpoints."""
    return list(examine(study).findings)


def list_remarks(study: StudyFolder) -> list[str]:
    """List what no record contradicts and is worth knowing: participants on another rig, onsets that are estimates."""
    return list(describe_rigs(use for folder in study.participants for use in _find_rig(folder)))


def _find_rig(folder: Path) -> Iterator[RigUse]:
    with suppress(*MALFORMED, OSError, ValueError):  # among the findings
        if (journals := list_journals(folder)) and not (folder / TOMBSTONE_FILE).exists():
            yield find_rig_use(folder.name, read_journal(journals[-1]).records)


def _audit_stimuli(folder: Path) -> tuple[list[str], str | None]:
    """Verify the set; its digest comes too, where the manifest can be read."""
    findings = check_stimuli(folder)
    try:
        stimuli = read_stimuli(folder)
    except (OSError, ValueError):
        return findings, None  # Among the findings already.
    try:
        pairs = zip_longest(read_details(folder).stimuli, map(describe_row, stimuli))
        is_same = all(_digest_row(one) == _digest_row(other) for one, other in pairs)
    except ValueError as error:
        return [*findings, str(error)], stimuli.sha256
    if not is_same:
        findings.append(
            f"{folder}: manifest.csv and manifest.json differ; one was changed, build the set again"
        )
    return findings, stimuli.sha256


def _digest_row(row: object) -> str:
    return json.dumps(row, sort_keys=True)


def _audit_participant(folder: Path, stimuli_sha256: str | None) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        yield from find_leftovers(folder)
        return
    path = folder / PLAN_FILE
    if folder.is_symlink():
        yield f"{folder}: is a link; put the folder itself there"
    plan = require_plan(path)
    if plan.participant != folder.name:
        yield f"{path}: is the plan of {plan.participant!r}, it was copied here"
    if stimuli_sha256 not in {None, plan.stimuli_sha256}:
        yield f"{path}: names another stimulus set than the one that is built"
    yield from audit_journals(folder, plan)
