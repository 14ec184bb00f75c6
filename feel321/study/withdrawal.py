"""Participants between and after sessions: notes about them, and those who leave.

One who withdraws takes all data along, one who is released leaves them. Either way the slot is free for the next. A
withdrawal that is interrupted at any instant has left everything as it was, or a tombstone that says so; the same call
finishes it. Links go, and what they lead to is named and left.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from feel321 import files
from feel321.files import hold_lock, make_folder, sync_folder
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.evidence.checkpoints import declaring, find_newest, note_checkpoint
from feel321.study.folder import OpenStudy, Outcome, StudyFolder, UsageError
from feel321.study.participants import roster, traces
from feel321.study.participants.answers import write_answers
from feel321.study.ratings import WIDE, write_matches, write_ratings
from feel321.study.session import journal as journals
from feel321.study.session.events import NoteTaken, SessionFinished, SessionReleased
from feel321.study.session.plan import TOMBSTONE_FILE
from feel321.study.terminal import ask, is_answerable

Say = Callable[[str], None]


def report_leaving(
    lab: OpenStudy, participant: str, reason: str, *, keep_data: bool, is_sure: bool
) -> Outcome:
    """Remove a participant's data, once that was confirmed, or only free the slot."""
    study, facts = lab.folder, {"participant": participant}
    if keep_data:
        number = release_participant(study, participant, now=lab.now)
        line = f"{study.path}: {participant} is released, number {number} is free"
        return Outcome({**facts, "number": number, "removed": []}, [line])
    if not is_sure:
        if not is_answerable():
            raise UsageError("no terminal to ask for confirmation; add --yes")
        question = f"Remove all data of {participant} in {study.path} for good? [y/N]: "
        if ask(question) not in {"y", "yes"}:
            return Outcome(facts, [f"{study.path}: nothing was removed"], failed=True)
    removed = withdraw_participant(study, participant, now=lab.now, reason=reason, warn=lab.say)
    has_tombstone = (study.sessions / participant).exists()
    kept = "; a tombstone keeps the code" if has_tombstone else ""
    line = (
        f"{study.path}: removed {len(removed)} files of {participant}{kept}. "
        "Copies that feel321 did not make must be removed by hand"
    )
    return Outcome({**facts, "removed": removed, "tombstone": has_tombstone}, [line])


def withdraw_participant(
    study: StudyFolder,
    participant: str,
    *,
    now: journals.Clock,
    reason: str = "",
    warn: Say = lambda _: None,
) -> list[str]:
    """Remove the data of a participant for good; a tombstone keeps the code from being used again."""
    removed = _withdraw_rehearsals(study, participant, warn)
    if removed and not (study.sessions / participant).exists():
        return removed
    folder = require_folder(study, participant)
    stone = roster.read_tombstone(folder)
    is_over = stone is not None and stone.state == roster.REMOVED
    left = (*roster.find_leftovers(folder), *traces.find_data_left(study)) if is_over else ()
    if stone and is_over and not left:
        newest = find_newest(study, "withdraw", participant)
        if newest and newest.begins:  # killed before its last checkpoint
            if problem := note_checkpoint(study, "withdraw", who=participant):
                warn(problem)
        elif not removed:
            gone = f"withdrew at {stone.utc}, all data are gone"
            raise ValueError(f"participant {participant}: {gone}")
        return removed
    if stone is None:  # else a withdrawal was interrupted
        known = roster.Holder(participant, 0, simulated=False)
        with suppress(ValueError):  # a damaged plan keeps nobody from withdrawing
            known = roster.read_holder(folder) or known
        anchors = tuple(journals.read_anchor(path) for path in journals.list_journals(folder))
        utc = now().isoformat(timespec="seconds")
        own = (participant, known.number, known.simulated, utc, reason, anchors)
        stone = roster.Tombstone(*own, state=roster.REMOVING)
    _remove_link(folder, warn)
    with hold_folder(folder, ends=True), declaring(study, "withdraw", who=participant, warn=warn):
        roster.write_tombstone(folder, replace(stone, state=roster.REMOVING))
        removed += _remove_data(folder, warn)
        _clear_derived(study, stone, warn)
        roster.write_tombstone(folder, replace(stone, state=roster.REMOVED))
    return removed


def _withdraw_rehearsals(study: StudyFolder, participant: str, say: Say) -> list[str]:
    """Remove what was rehearsed under the participant's code."""
    rehearsals = replace(study, is_rehearsal=True).sessions
    folder = rehearsals / str(participant)
    is_code = not study.is_rehearsal and journals.PARTICIPANT_ID.fullmatch(str(participant))
    if not is_code or not (folder.is_symlink() or folder.is_dir()):
        return []
    _remove_link(folder, say)
    with hold_folder(folder, ends=True):
        removed = _remove_data(folder, say)
    folder.rmdir()
    return [f"{rehearsals.name}/{participant}/{name}" for name in removed]


def _clear_derived(study: StudyFolder, stone: roster.Tombstone, say: Say) -> None:
    """Remove the participant from all that was derived, whatever a kill left of it included; say what is left."""
    files.sweep(study.path)
    files.sweep_temporary()
    left = (files.UNFINISHED, files.TEMPORARY)
    for path in sorted(study.path.rglob("*")):
        if any(one.fullmatch(path.name) for one in left) and not _remove_link(path, say):
            say(f"{path}: is still being written; when it is finished, run feel321 audit")
    _remove_link(study.path / WIDE, say)
    _remove_file(study.path / WIDE / f"{stone.participant}.csv", say)
    writers: tuple[Callable[[], object], ...] = (
        lambda: write_ratings(study, read_stimuli(study.stimuli)),
        lambda: roster.write_roster(study),
        lambda: write_answers(study),
        lambda: write_matches(study, read_stimuli(study.stimuli)),
    )
    for path, write in zip([study.path / name for name in traces.TABLES], writers, strict=True):
        is_there = path.exists()
        _remove_link(path, say)
        try:
            if is_there:
                write()
        except (OSError, ValueError) as error:
            # A derived table can be made again; the data of someone who withdrew may not stay.
            path.unlink(missing_ok=True)
            say(f"{path}: was removed, because it could not be rewritten ({error})")
    for folder in traces.list_results(study) if stone.journals else ():
        _clear_results(folder, say)
    for path, text in traces.list_outputs(study, before=stone.utc if stone.journals else ""):
        say(text if path.exists() else f"{text}; nothing is there now")


def _clear_results(folder: Path, say: Say) -> None:
    """Remove a folder of results that were made of ratings."""
    from feel321.analysis.report.folder import remove_results

    if _remove_link(folder, say):
        return
    remove_results(folder)
    verb = {"report": "analyze"}.get(folder.name, folder.name)
    held = "results were removed because they held the participant's data"
    say(f"{folder}: {held}; make them again: feel321 {verb}")
    if folder.exists():
        say(f"{folder}: holds other files; remove those with the participant's data")


def release_participant(study: StudyFolder, participant: str, *, now: journals.Clock) -> int:
    """Free the slot of a participant who will not come back; of one who never began, the code is free too."""
    folder = require_folder(study, participant)
    with hold_folder(folder):
        holder, (journal, has_begun) = roster.read_holder(folder), _open_newest(folder, now)
        refused = ""
        if roster.read_tombstone(folder) is not None:
            refused = "withdrew, there is nothing to release"
        elif holder is None:
            refused = "has no number, there is nothing to release"
        elif holder.state == roster.RELEASED:
            refused = f"was released before; number {holder.number} is free"
        elif journal and journal.records.has(SessionFinished):
            refused = "has finished, so the slot stays taken; to remove the data: feel321 withdraw"
        if refused or holder is None:
            raise ValueError(f"participant {participant}: {refused}")
        if journal and (len(journals.list_journals(folder)) > 1 or has_begun):
            journal.write(SessionReleased())
            return holder.number
        _remove_data(folder, lambda _: None)
    (folder / roster.LOCK_FILE).unlink(missing_ok=True)
    folder.rmdir()
    return holder.number


def take_note(study: StudyFolder, participant: str, text: str, *, now: journals.Clock) -> str:
    """Write a note into the newest journal of a participant; returns what the experimenter should know besides."""
    note, folder = NoteTaken(text), require_folder(study, participant)
    if roster.read_tombstone(folder) is not None:
        raise ValueError(f"participant {participant}: withdrew, nothing is recorded any longer")
    with hold_folder(folder):
        journal, has_begun = _open_newest(folder, now)
        if journal is None or not has_begun:
            text = "no session has begun, so there is no journal; begin one, then add the note"
            raise ValueError(f"participant {participant}: {text}")
        journal.write(note)
    return journal.notice


def _open_newest(folder: Path, now: journals.Clock) -> tuple[journals.Journal | None, bool]:
    """Open the newest journal of a participant, if there is one; whether it has its header."""
    if not (paths := journals.list_journals(folder)):
        return None, False
    journal = journals.require_journal(paths[-1], now=now)
    return journal, journal.records.find_header() is not None


def require_folder(study: StudyFolder, participant: str) -> Path:
    """Find the folder of a participant, and say who is known if there is none."""
    known = {folder.name: folder for folder in study.participants}
    if participant not in known:
        names = ", ".join(known) or "nobody yet"
        raise ValueError(f"participant {participant!r} has no session here; known: {names}")
    return known[participant]


@contextmanager
def hold_folder(folder: Path, *, ends: bool = False) -> Iterator[None]:
    """Keep sessions from writing to a participant's folder; ends: for the last time."""
    make_folder(folder, private=True)
    busy = "a session is running here; let it finish or stop it first"
    with hold_lock(folder / roster.LOCK_FILE, busy=busy):
        yield
    if ends:
        (folder / roster.LOCK_FILE).unlink(missing_ok=True)


def _remove_data(folder: Path, say: Say) -> list[str]:
    """Remove everything in a folder but its tombstone and the lock that is held; returns the names."""
    kept = {folder / TOMBSTONE_FILE, folder / roster.LOCK_FILE}
    removed = sorted({*folder.rglob("*")} - kept, reverse=True)
    for path in removed:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            _remove_file(path, say)
    sync_folder(folder)
    return sorted(path.relative_to(folder).as_posix() for path in removed)


def _remove_file(path: Path, say: Say) -> None:
    """Remove a file, or a link to one."""
    if not _remove_link(path, say):
        path.unlink(missing_ok=True)


def _remove_link(path: Path, say: Say) -> bool:
    """Remove a link, and name what it leads to: that is left as it is; whether it was one."""
    if not path.is_symlink():
        return False
    target = path.resolve()
    path.unlink()
    remedy = f"{target} is left, remove the participant's data there"
    say(f"{path}: was a link and is removed; {remedy}")
    return True
