"""Audit: verify every journal and plan of a study, its tables, and compare its files with its checkpoints.

Every finding names the file, and the line where there is one; a file that cannot be read hides no other. The digest
that plans and journals keep of the stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows
are compared with that; its recipe, units and versions are covered by checkpoints only, and `check` compares the recipe
with the settings. Each participant's plan and journals are read once.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.doors import announce
from feel321.stimuli.sets.manifest import check_stimuli, describe_row, read_details, read_stimuli
from feel321.study.auditing.evidence import Evidence, weigh
from feel321.study.auditing.journals import audit_journals, guard
from feel321.study.auditing.replay import MALFORMED
from feel321.study.auditing.tables import Tables, audit_inputs
from feel321.study.numbers import Holder, find_doubles, read_holder
from feel321.study.people import RigUse, describe_rigs, find_leftovers, find_rig_use
from feel321.study.persons.withdrawal import find_data_left, list_stale
from feel321.study.session.journal import Chain, list_journals
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, Dossier, require_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder


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
    folders, stimuli = study.participants, None
    if folders or study.stimuli.exists():
        findings += check_stimuli(study.stimuli)
        with suppress(OSError, ValueError):  # among the findings already
            stimuli = read_stimuli(study.stimuli)
            findings += guard(study.stimuli, _audit_details(stimuli))
    tables, holders, uses = Tables(study, stimuli), list[Holder](), list[RigUse]()
    for done, folder in enumerate(folders, start=1):
        announce(folder.name)
        findings += guard(folder, _audit_participant(folder, stimuli, tables, uses=uses))
        with suppress(OSError, ValueError):  # of a plan that is among the findings
            holders += filter(None, [read_holder(folder)])
        progress(done, len(folders))
    findings += [*find_doubles(holders), *guard(study.path, find_data_left(study))]
    wrong, older = tables.compare()
    evidence = Evidence() if study.is_rehearsal else weigh(study, expect=expect, remotes=remotes)
    stale = guard(study.path, list_stale(study))
    remarks = [*evidence.remarks, *older, *audit_inputs(study), *describe_rigs(uses), *stale]
    every = dict.fromkeys([*findings, *wrong, *evidence.findings])
    return Examined(tuple(every), tuple(remarks), evidence.sentence, evidence.checkpoint)


def audit_study(study: StudyFolder) -> list[str]:
    """Verify all plans, journals and stimuli of a study, the tables and the checkpoints."""
    return list(examine(study).findings)


def _audit_details(stimuli: StimulusSet) -> Iterator[str]:
    """Compare the rows of `manifest.json` with those of `manifest.csv`."""
    pairs = zip_longest(read_details(stimuli.folder).stimuli, map(describe_row, stimuli))
    if any(len({json.dumps(one, sort_keys=True) for one in pair}) > 1 for pair in pairs):
        text = "manifest.csv and manifest.json differ; one was changed, build the set again"
        yield f"{stimuli.folder}: {text}"


def _audit_participant(
    folder: Path, stimuli: StimulusSet | None, tables: Tables, *, uses: list[RigUse]
) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        yield from find_leftovers(folder)
        return
    path, chains = folder / PLAN_FILE, dict[Path, Chain]()
    tables.unread.add(folder.name)
    if folder.is_symlink():
        yield f"{folder}: is a link; put the folder itself there"
    plan = require_plan(path)
    if plan.participant != folder.name:
        yield f"{path}: is the plan of {plan.participant!r}, it was copied here"
    if stimuli and stimuli.sha256 != plan.stimuli_sha256:
        yield f"{path}: names another stimulus set than the one that is built"
    yield from audit_journals(folder, plan, chains)
    journals = list_journals(folder)
    if plan.participant != folder.name or not set(journals) <= set(chains):
        return
    dossier = Dossier(folder, plan, tuple(chains[one] for one in journals))
    with suppress(*MALFORMED, OSError, ValueError):  # among the findings
        tables.take(dossier)
        tables.unread.discard(folder.name)
    with suppress(*MALFORMED, OSError, ValueError):
        uses.append(find_rig_use(folder.name, dossier.records))
