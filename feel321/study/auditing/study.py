"""Audit: verify every journal and plan of a study, and compare its files with its checkpoints.

Every finding names the file, and the line where there is one. The digest that plans and journals keep of the
stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows are compared with that; its
recipe, units and versions are covered by checkpoints only, and `check` compares the recipe with the settings.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from feel321.doors import announce
from feel321.stimuli.sets.manifest import check_stimuli, describe_row, read_details, read_stimuli
from feel321.study.auditing.entries import list_remarks
from feel321.study.auditing.evidence import weigh
from feel321.study.auditing.journals import audit_journals
from feel321.study.auditing.tables import audit_tables
from feel321.study.folder import StudyFolder
from feel321.study.numbers import Holder, find_doubles, read_holder
from feel321.study.people import find_leftovers
from feel321.study.persons.withdrawal import find_data_left, list_stale
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
    progress: Callable[[int, int], None] | None = None,
) -> Examined:
    """Verify a study by itself, and by its checkpoints; expect: one that must be there, remotes: further ones."""
    findings = _audit_alone(study, progress)
    wrong, older = audit_tables(study)
    evidence = weigh(study, expect=expect, remotes=remotes)
    remarks = [*evidence.remarks, *older, *list_remarks(study), *list_stale(study)]
    every = dict.fromkeys([*findings, *wrong, *evidence.findings])
    return Examined(tuple(every), tuple(remarks), evidence.sentence, evidence.checkpoint)


def audit_study(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Verify all plans, journals and stimuli of a study, the tables and the checkpoints."""
    return list(examine(study, progress=progress).findings)


def _audit_alone(study: StudyFolder, progress: Callable[[int, int], None] | None) -> list[str]:
    """Verify plans, journals and stimuli."""
    findings = [
        f"{path}: not a participant's folder; move it out of {study.sessions}"
        for path in study.strangers
    ]
    folders = study.participants
    stimuli_sha256 = None
    if folders or study.stimuli.exists():
        problems, stimuli_sha256 = _audit_stimuli(study.stimuli)
        findings += problems
    holders: list[Holder] = []
    for done, folder in enumerate(folders, start=1):
        announce(folder.name)
        findings += _audit_participant(folder, stimuli_sha256)
        with suppress(OSError, ValueError):  # of a plan that is among the findings
            holders += filter(None, [read_holder(folder)])
        if progress is not None:
            progress(done, len(folders))
    return [*findings, *find_doubles(holders), *find_data_left(study)]


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
        try:
            yield from find_leftovers(folder)
        except ValueError as error:
            yield str(error)
        return
    path = folder / PLAN_FILE
    if folder.is_symlink():
        yield f"{folder}: is a link; put the folder itself there"
    try:
        plan = require_plan(path)
    except (OSError, ValueError) as error:
        yield str(error)
        return
    if plan.participant != folder.name:
        yield f"{path}: is the plan of {plan.participant!r}, it was copied here"
    if stimuli_sha256 not in {None, plan.stimuli_sha256}:
        yield f"{path}: names another stimulus set than the one that is built"
    yield from audit_journals(folder, plan)
