"""Sealing: a checkpoint of a study, and its end put elsewhere; after each session, too."""

from collections.abc import Iterable
from pathlib import Path

from feel321.study.auditing import anchors, checkpoints, keys
from feel321.study.auditing.codes import write_code
from feel321.study.findings import Seal
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import Entry
from feel321.study.session.journal import Clock


def seal_study(
    study: StudyFolder, *, reason: str = "", by: str = "seal", passphrase: str = "", now: Clock
) -> Seal:
    """Take a checkpoint of the whole study, and put its end into all places that were chosen."""
    tip = checkpoints.take_checkpoint(study, by=by, reason=reason, now=now)
    places, problems = anchors.put_anchors(study, tip, passphrase=passphrase)
    return Seal(tip.utc, tip.lines, write_code(tip), tuple(places), tuple(problems))


def note_session(
    study: StudyFolder, participant: str, *, entries: Iterable[Entry], now: Clock
) -> str:
    """Take a checkpoint after a session, of its participant and of the study's own files; returns what went wrong."""
    if study.is_rehearsal:
        return ""
    try:
        tip = checkpoints.take_checkpoint(
            study, by="session", participants=[participant], entries=entries, now=now
        )
        _, problems = anchors.put_anchors(study, tip)
    except (OSError, ValueError) as error:
        return f"no checkpoint was taken ({error}); take it later: feel321 seal"
    return "; ".join(problems)


def choose_key(*, passphrase: str = "") -> tuple[Path, str]:
    """Make a key for this rig in its configuration, and sign with it from now on; returns its file and fingerprint."""
    path = anchors.find_config() / keys.KEY_FILE
    fingerprint = keys.make_key(path, passphrase=passphrase)
    anchors.add_rules(key=path)
    return path, fingerprint
