"""The seal: one digest of all plans, tombstones, ends of journals and the stimulus set."""

from pathlib import Path

from feel321.study.folder import MANIFEST_JSON, StudyFolder
from feel321.study.session.journal import digest, list_journals, read_anchor
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE


def make_seal(study: StudyFolder) -> str:
    """Digest all plans, tombstones, ends of journals and the stimulus set.

    Whoever can write to a study can write all of it anew, ledger and digests included. A seal that is kept elsewhere
    shows it: it changes with every record, and with every record that was changed.
    """
    files = [study.manifest, study.stimuli / MANIFEST_JSON]
    lines = []
    for folder in [None, *study.participants]:
        if folder is not None:
            files = [folder / PLAN_FILE, folder / TOMBSTONE_FILE]
        lines += [
            f"{_name(path, study)} {digest(path.read_bytes())}" for path in files if path.is_file()
        ]
        journals = [] if folder is None else [p for p in list_journals(folder) if p.is_file()]
        anchors = {path: read_anchor(path) for path in journals}
        lines += [f"{_name(path, study)} {a.lines} {a.tip}" for path, a in anchors.items()]
    return digest("\n".join(lines))


def _name(path: Path, study: StudyFolder) -> str:
    return path.relative_to(study.path).as_posix()
