"""Sealing: a checkpoint of a study, and its end put elsewhere; after each session, too."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from feel321.study.auditing import anchors, checkpoints, keys
from feel321.study.auditing.codes import write_code
from feel321.study.findings import Seal
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import Entry
from feel321.study.session.journal import Clock, utc_now


def seal_study(
    study: StudyFolder, *, reason: str = "", by: str = "seal", passphrase: str = "", now: Clock
) -> Seal:
    """Take a checkpoint of the whole study, and put its end into all places that were chosen."""
    tip = checkpoints.take_checkpoint(study, by=by, reason=reason, now=now)
    places, problems = anchors.put_anchors(study, tip, passphrase=passphrase)
    return Seal(tip.utc, tip.lines, write_code(tip), tuple(places), tuple(problems))


def seal_into(
    study: StudyFolder,
    *,
    folder: Path | None,
    remote: str,
    reason: str,
    passphrase: str,
    now: Clock,
) -> Seal:
    """Seal a study, and keep a further folder or git remote for anchors where it took this one."""
    before = anchors.read_rules()
    done: tuple[str, ...] = ()
    if folder is not None or remote:
        anchors.add_rules(folder=folder, remote=remote)
    try:
        found = seal_study(study, reason=reason, passphrase=passphrase, now=now)
        done = found.places
    finally:
        anchors.settle_rules(before, done)
    return found


@contextmanager
def sealing_session(
    study: StudyFolder,
    participant: str,
    *,
    recall: Callable[[], Iterable[Entry]],
    now: Clock,
    warn: Callable[[str], None],
) -> Iterator[None]:
    """Take a checkpoint when a session ends, however it does, of its participant and of the study's own files."""
    try:
        yield
    finally:
        if not study.is_rehearsal and (
            problem := _note_session(study, participant, recall, now=now)
        ):
            warn(problem)


def seal_withdrawal(study: StudyFolder, participant: str, *, now: Clock) -> str:
    """Take a checkpoint when somebody withdrew, where a study has some; returns what went wrong."""
    if not checkpoints.find_chain(study).is_file():
        return ""
    return _note_session(study, participant, lambda: checkpoints.read_entries(study), now=now)


def _note_session(
    study: StudyFolder, participant: str, recall: Callable[[], Iterable[Entry]], *, now: Clock
) -> str:
    try:
        tip = checkpoints.take_checkpoint(
            study, by="session", participants=[participant], entries=recall(), now=now
        )
        return "; ".join(anchors.put_anchors(study, tip)[1])
    except (OSError, ValueError) as error:
        return f"no checkpoint was taken ({error}); take it later: feel321 seal"


@contextmanager
def sealing_analysis(study: StudyFolder) -> Iterator[None]:
    """Note that an analysis begins, where a study has checkpoints, and take one when the report is written."""
    if not checkpoints.find_chain(study).is_file():
        yield
        return
    checkpoints.note_analysis(study, now=utc_now)
    yield
    seal_study(study, by="analysis", now=utc_now)


def choose_key(*, passphrase: str = "") -> tuple[Path, str]:
    """Make a key for this rig in its configuration, and sign with it from now on; returns its file and fingerprint."""
    path = anchors.find_config() / keys.KEY_FILE
    fingerprint = keys.make_key(path, passphrase=passphrase)
    anchors.add_rules(key=path)
    return path, fingerprint
