"""Compare a participant's ledger entry with the journals; lost data are checked elsewhere.

The ledger may lag behind a journal: a process may be killed between a record and its note. It may not be ahead, and
must note every session that got past its opening.
"""

from collections.abc import Iterator
from pathlib import Path
from shlex import quote

from feel321.study.auditing.steps import MALFORMED
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import Entry
from feel321.study.ledger.rigs import describe_rigs, find_rig_use
from feel321.study.ledger.slots import name_place
from feel321.study.session import events
from feel321.study.session.journal import find_cut, list_journals, read_journal
from feel321.study.session.plan import TOMBSTONE_FILE, read_dossier, replay


def audit_entry(study: StudyFolder, folder: Path, entry: Entry) -> Iterator[str]:
    """Compare the ledger's entry of one participant with the journals."""
    if entry.state == "withdrawn" and entry.station:
        return  # At another station: `find_lost` says what to do.
    try:
        dossier = read_dossier(folder)
        reached = max((replay(dossier.plan, c.records).done for c in dossier.chains), default=0)
    except (*MALFORMED, OSError, ValueError):
        return
    rebuild = f"rebuild it: feel321 ledger {quote(str(study.path))} --rebuild"
    who = f"{name_place(study)}: {entry.participant}"
    # A session that ended in its opening need not be noted.
    opening = (*events.UNTOUCHED, events.WarmUpBegun, events.SessionReleased)
    unnoted = {kind.event for kind in opening}
    noted = {anchor.journal for anchor in entry.anchors}
    for path, chain in zip(list_journals(folder), dossier.chains, strict=True):
        if path.name not in noted and not {record.event for record in chain.records} <= unnoted:
            yield f"{who} has no note of {path.name}, which has {len(chain.records)} lines; {rebuild}"
    if any(find_cut(anchor, folder) for anchor in entry.anchors):
        return  # `find_lost` reports what is lost.
    total = sum(trial.phase == "main" for trial in dossier.plan.trials)
    if entry.done > reached:
        yield f"{who} has done {entry.done}, the journals say {reached}; {rebuild}"
    if entry.total not in {0, total}:
        yield f"{who} has total {entry.total}, the plan says {total}; {rebuild}"


def list_remarks(study: StudyFolder) -> Iterator[str]:
    """List what no record contradicts and is worth knowing: participants on another rig, onsets that are estimates."""
    uses = []
    for folder in study.participants:
        journals = list_journals(folder)
        try:
            if journals and not (folder / TOMBSTONE_FILE).exists():
                uses.append(find_rig_use(folder.name, read_journal(journals[-1]).records))
        except (*MALFORMED, OSError, ValueError):
            continue  # among the findings
    yield from describe_rigs(uses)
