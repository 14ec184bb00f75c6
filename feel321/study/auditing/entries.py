"""Remarks of an audit: what no record contradicts and is worth knowing."""

from collections.abc import Iterator

from feel321.study.auditing.replay import MALFORMED
from feel321.study.folder import StudyFolder
from feel321.study.people import describe_rigs, find_rig_use
from feel321.study.session.journal import list_journals, read_journal
from feel321.study.session.plan import TOMBSTONE_FILE


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
