"""Whether what lies in a study is what was once written there: plans, journals, stimuli.

Every finding names the file, and the line where there is one.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import datetime
from itertools import pairwise
from typing import TYPE_CHECKING

from protocols.agenda import Agenda
from protocols.trial import Trial
from stimuli.inspection import check_stimuli
from stimuli.manifest import read_stimuli
from study.ledger.rebuilding import find_lost
from study.provenance import read_origin
from study.session.journal import read_journal
from study.session.opening import PLAN_FILE, TOMBSTONE_FILE
from study.session.plan import require_plan
from study.session.replay import find_header, name_journal, tell

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from study.folder import StudyFolder
    from study.session.chain import Chain, Record
    from study.session.plan import Plan


def audit_study(study: StudyFolder) -> list[str]:
    """Verify all plans, journals and stimuli of a study.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    list of str
        Everything that is not as it was written, one line each; empty if all is well.
    """
    if not study.participants and not study.stimuli.exists():
        return find_lost(study)
    findings, stimuli_sha256 = _audit_stimuli(study.stimuli)
    for folder in study.participants:
        findings += _audit_participant(folder, stimuli_sha256)
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
    # As text, in which a figure that is NaN equals itself.
    same = json.dumps(rows, sort_keys=True) == json.dumps([asdict(row) for row in stimuli.stimuli], sort_keys=True)
    if not same:
        findings.append(f"{folder}: manifest.csv and manifest.json differ; one was changed, build the set again")
    return findings, stimuli.sha256


def _audit_participant(folder: Path, stimuli_sha256: str | None) -> list[str]:
    if (folder / TOMBSTONE_FILE).exists():
        return []  # Withdrawn; whether that was finished is the ledger's business.
    try:
        plan = require_plan(folder / PLAN_FILE)
    except (OSError, ValueError) as error:
        return [str(error)]
    findings = []
    if plan.participant != folder.name:
        findings.append(f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here")
    if stimuli_sha256 not in {None, plan.stimuli_sha256}:
        findings.append(f"{folder / PLAN_FILE}: names another stimulus set than the one that is built")
    for path in sorted(folder.glob("session-*.jsonl")):
        try:
            chain = read_journal(path)
        except (OSError, ValueError) as error:
            findings.append(str(error))
        else:
            findings += [f"{path}{finding}" for finding in _audit_journal(chain, plan, name=path.stem)]
    return findings


def _audit_journal(chain: Chain, plan: Plan, *, name: str) -> Iterator[str]:
    if chain.torn:
        yield f": ends in {len(chain.torn)} bytes of a line that was never finished; resuming moves them aside"
    header = find_header(chain.records)
    if header is None:
        if chain.records:
            yield ": has no header"
        return
    if (header["participant"], name_journal(header["session"])) != (plan.participant, f"{name}.jsonl"):
        yield f": is session {header['session']} of {header['participant']!r}, it was copied here"
    if header["plan_sha256"] != plan.sha256:
        yield ": was begun with another plan than the one beside it"
    yield from _audit_times(chain.records)
    yield from _audit_steps(chain.records, plan)


def _audit_times(records: Sequence[Record]) -> Iterator[str]:
    for before, record in pairwise(records):
        if datetime.fromisoformat(record.utc) < datetime.fromisoformat(before.utc) and record.event != "clock_stepped":
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"


def _audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Compare what was shown and rated, in order, with what the plan and the rules have in that place."""
    agenda = Agenda(plan.trials, plan.flow)
    trials = {trial.number: trial for trial in plan.trials}
    for record in records:
        try:
            _check_step(agenda, record)
            tell(agenda, record, trials)
        except ValueError as error:
            yield f", line {record.sequence + 1}: {error}"
            return  # All that follows is out of step.
        except (KeyError, TypeError):
            yield f", line {record.sequence + 1}: is no {record.event!r} record as feel321 writes them"
            return


def _check_step(agenda: Agenda, record: Record) -> None:
    step, data = agenda.ask(), record.data
    if record.event == "finished" and step is not None:
        raise ValueError(f"finished after {agenda.done} of {agenda.total} trials")
    if record.event != "shown":
        return
    if not isinstance(step, Trial) or (data["trial"], data["attempt"]) != (step.number, agenda.attempt(step.number)):
        raise ValueError(f"shows trial {data['trial']}, attempt {data['attempt']}, which was not next")
