"""What the ledger says of a participant against the journals, besides what is lost.

The ledger may lag behind a journal: a kill may come between a record and the note of it. It may not run ahead, and
has noted every session that came beyond its opening.
"""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING

from study.auditing.steps import MALFORMED
from study.ledger.rebuilding import read_study_ledger
from study.ledger.sightings import find_cut
from study.session.dossier import read_dossier
from study.session.opening import OPENING_EVENTS
from study.session.replay import list_journals, replay

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from study.folder import StudyFolder
    from study.ledger.entries import Entry
    from study.session.chain import Record
    from study.session.dossier import Dossier

_UNNOTED = frozenset({*OPENING_EVENTS, "begun", "warm_up", "aborted", "superseded", "released"})
"""What a session may hold that came to no note: one that ended in its opening."""


def read_entries(study: StudyFolder) -> dict[str, Entry]:
    """Read what the ledger knows, by participant.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    dict of str to Entry
        Nobody if there is no ledger, or a damaged one; `find_lost` says so.
    """
    try:
        return {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError):
        return {}


def audit_entry(study: StudyFolder, folder: Path, entry: Entry) -> Iterator[str]:
    """Compare what the ledger says of one participant with the journals.

    Parameters
    ----------
    study : StudyFolder
        The study.
    folder : Path
        The participant's folder.
    entry : Entry
        The ledger's entry.

    Yields
    ------
    str
        One finding per line; none where the journals do not tell, which is a finding of its own.
    """
    try:
        dossier = read_dossier(folder)
        reached = max((replay(dossier.plan, chain.records).done for chain in dossier.chains), default=0)
    except (*MALFORMED, OSError, ValueError):
        return
    rebuild = f"rebuild it: feel321 ledger {quote(str(study.path))} --rebuild"
    total = sum(trial.phase == "main" for trial in dossier.plan.trials)
    for path, lines in _find_unnoted(entry, dossier):
        yield f"{study.ledger}: {entry.participant} has no note of {path.name}, which has {lines} lines; {rebuild}"
    if any(find_cut(anchor, folder) for anchor in entry.anchors):
        return  # Of what is lost, `find_lost` tells.
    if entry.done > reached:
        yield f"{study.ledger}: {entry.participant} has done {entry.done}, the journals say {reached}; {rebuild}"
    if entry.total not in {0, total}:
        yield f"{study.ledger}: {entry.participant} has total {entry.total}, the plan says {total}; {rebuild}"


def _find_unnoted(entry: Entry, dossier: Dossier) -> Iterator[tuple[Path, int]]:
    noted = {anchor.journal for anchor in entry.anchors}
    for path, chain in zip(list_journals(dossier.folder), dossier.chains, strict=True):
        if path.name not in noted and _is_noteworthy(chain.records):
            yield path, len(chain.records)


def _is_noteworthy(records: Iterable[Record]) -> bool:
    return not {record.event for record in records} <= _UNNOTED
