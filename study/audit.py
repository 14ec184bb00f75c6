"""Whether what lies in a study is what was once written there: plans, journals, stimuli, ledger.

Every finding names the file, and the line where there is one. The digest that plans and journals keep of the
stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows are compared with that; its
recipe, units and versions stand under no digest but the seal (`study.auditing.seal`), and `check` compares the
recipe with the settings.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from stimuli.inspection import check_stimuli
from stimuli.manifest import FURTHER, describe_row, read_stimuli
from study.auditing.journals import audit_journals
from study.auditing.ledgered import audit_entry, read_entries
from study.ledger.rebuilding import find_lost
from study.ledger.tombstone import find_leftovers
from study.provenance import read_origin
from study.session.opening import PLAN_FILE, TOMBSTONE_FILE
from study.session.plan import require_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from study.folder import StudyFolder


def audit_study(study: StudyFolder, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Verify all plans, journals and stimuli of a study, and what the ledger says of them.

    Parameters
    ----------
    study : StudyFolder
        The study.
    progress : callable, optional
        Called with the numbers of participants done and to do.

    Returns
    -------
    list of str
        Everything that is not as it was written, one line each; empty if all is well.
    """
    findings = [f"{path}: is no participant's folder; move it out of {study.sessions}" for path in study.strangers]
    folders = study.participants
    stimuli_sha256 = None
    if folders or study.stimuli.exists():
        problems, stimuli_sha256 = _audit_stimuli(study.stimuli)
        findings += problems
    entries = read_entries(study)
    for done, folder in enumerate(folders, start=1):
        findings += _audit_participant(folder, stimuli_sha256)
        if folder.name in entries:
            findings += audit_entry(study, folder, entries[folder.name])
        if progress is not None:
            progress(done, len(folders))
    return findings + find_lost(study)


def _audit_stimuli(folder: Path) -> tuple[list[str], str | None]:
    """Verify the set; its digest comes too, where the manifest can be read."""
    findings = check_stimuli(folder)
    try:
        stimuli = read_stimuli(folder)
    except (OSError, ValueError):
        return findings, None  # Among the findings already.
    try:
        rows = read_origin(folder).rows
    except ValueError as error:
        return [*findings, str(error)], stimuli.sha256
    # An earlier version wrote fewer columns.
    listed = [{**dict.fromkeys(FURTHER), **row} for row in rows]
    same = json.dumps(listed, sort_keys=True) == json.dumps([*map(describe_row, stimuli.stimuli)], sort_keys=True)
    if not same:
        findings.append(f"{folder}: manifest.csv and manifest.json differ; one was changed, build the set again")
    return findings, stimuli.sha256


def _audit_participant(folder: Path, stimuli_sha256: str | None) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        yield from find_leftovers(folder)  # Whether the withdrawal was finished is the ledger's business.
        return
    path = folder / PLAN_FILE
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
