"""What must hold after a power cut: nothing acknowledged is lost, nobody is accused, and the same step goes on."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from feel321.files import sweep
from feel321.stimuli.sets.manifest import check_stimuli, read_stimuli
from feel321.study.auditing.study import audit_study
from feel321.study.folder import StudyFolder
from feel321.study.ledger import progress
from feel321.study.session.events import TrialRated
from feel321.study.session.journal import Records, digest, read_journal
from tests.crash import steps

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from tests.crash.disk import Cut

UNFINISHED = re.compile(r"ends in \d+ bytes of an unfinished line; resuming moves them aside$")


class Lost(AssertionError):  # noqa: N818 - that is what happened
    """Something did not survive."""


def demand(holds: object, text: str) -> None:
    if not holds:
        raise Lost(text)


def check_records(cut: Cut, folder: Path) -> None:
    """Every record whose writing returned is on the disk, in its place."""
    last: dict[tuple[str, str], tuple[int, str]] = {}
    for mark in cut.marks:
        kind, *facts = mark.split("/")
        if kind == "record":
            last[facts[0], facts[1]] = int(facts[2]), facts[3]
    for (participant, name), (count, tip) in last.items():
        path = folder / "sessions" / participant / name
        demand(path.is_file(), f"{path} is gone, {count} records were acknowledged")
        lines = path.read_bytes().split(b"\n")[:-1]
        demand(len(lines) >= count, f"{path} has {len(lines)} lines, {count} were acknowledged")
        demand(digest(lines[count - 1]) == tip, f"{path}: line {count} is another")


def audit(folder: Path, *, allowed: Collection[str] = ()) -> list[str]:
    """Return what the audit finds besides unfinished lines and what is allowed."""
    found = audit_study(StudyFolder(folder))
    return [
        text
        for text in found
        if not UNFINISHED.search(text) and not any(part in text for part in allowed)
    ]


def list_ratings(path: Path) -> list[object]:
    records: Records = read_journal(path).records
    return [(one.trial, one.attempt, one.values) for one in records.find(TrialRated)]


# After each step.


def check_session(cut: Cut, folder: Path, _whole: Path) -> None:
    check_records(cut, folder)
    found = audit(folder)
    demand(not found, f"accused: {found}")


def resume_session(cut: Cut, folder: Path, whole: Path) -> None:
    sweep(folder)  # as every verb does
    steps.Tired.left = True
    steps.lead(folder)
    check_records(cut, folder)
    name = "sessions/sim001/session-01.jsonl"
    demand(list_ratings(folder / name) == list_ratings(whole / name), "other ratings")
    found = audit(folder)
    demand(not found, f"accused after going on: {found}")


def check_built(cut: Cut, folder: Path, _whole: Path) -> None:
    stimuli = folder / "stimuli"
    try:
        read_stimuli(stimuli)
    except FileNotFoundError:
        demand(not cut.marks, "the set is gone")
        return
    demand(not cut.marks or not check_stimuli(stimuli), f"{check_stimuli(stimuli)}")


def build_again(_cut: Cut, folder: Path, whole: Path) -> None:
    steps.build(folder)
    for name in ("manifest.csv", "manifest.json"):
        same = (folder / "stimuli" / name).read_bytes() == (whole / "stimuli" / name).read_bytes()
        demand(same, f"{name} is another")
    demand(not check_stimuli(folder / "stimuli"), f"{check_stimuli(folder / 'stimuli')}")


def build_more_again(cut: Cut, folder: Path, whole: Path) -> None:
    (folder / "study.toml").write_text(steps.MORE, encoding="utf-8")
    build_again(cut, folder, whole)


def _list_traces(folder: Path) -> list[str]:
    """List the files that hold data of who withdrew."""
    mine = folder / "sessions" / steps.GONE
    kept = {mine / ".lock", mine / progress.plans.TOMBSTONE_FILE}
    found = [str(path) for path in steps.list_files(mine) if path not in kept]
    tables = [folder / "ratings.csv", folder / "participants.csv"]
    return (
        found
        + [
            str(path)
            for path in tables
            if path.exists() and f"\n{steps.GONE},".encode() in path.read_bytes()
        ][:1]
    )


def check_withdrawn(cut: Cut, folder: Path, _whole: Path) -> None:
    if "withdrawn" in cut.marks:
        demand(progress.read_tombstone(folder / "sessions" / steps.GONE), "the tombstone is gone")
        demand(not _list_traces(folder), f"came back: {_list_traces(folder)}")
        return
    found = audit(folder, allowed=["lies beside a tombstone", "withdr"])
    demand(not found, f"accused: {found}")


def withdraw_again(_cut: Cut, folder: Path, _whole: Path) -> None:
    try:
        steps.withdraw(folder)
    except ValueError as error:
        demand("all data are gone" in str(error), str(error))
    demand(not _list_traces(folder), f"left: {_list_traces(folder)}")
    found = audit(folder)
    demand(not found, f"accused after withdrawing again: {found}")


def check_rebuilt(cut: Cut, folder: Path, _whole: Path) -> None:
    if "rebuilt" in cut.marks:
        found = audit(folder, allowed=["and forgot"])
        demand(not found, f"accused: {found}")


def rebuild_again(_cut: Cut, folder: Path, _whole: Path) -> None:
    steps.rebuild(folder)
    found = audit(folder, allowed=["and forgot"])
    demand(not found, f"accused after rebuilding: {found}")


def check_collected(cut: Cut, folder: Path, _whole: Path) -> None:
    found = audit(folder / "station")
    demand(not found, f"station accused: {found}")
    if cut.marks:
        _compare_journals(folder)


def _compare_journals(folder: Path) -> None:
    name = "sessions/sim001/session-01.jsonl"
    path = folder / "main" / name
    demand(
        path.is_file() and path.read_bytes() == (folder / "station" / name).read_bytes(),
        "not collected",
    )


def collect_again(_cut: Cut, folder: Path, _whole: Path) -> None:
    steps.collect(folder)
    _compare_journals(folder)
    found = audit(folder / "main")
    demand(not found, f"accused after collecting: {found}")


Check = "Callable[[Cut, Path, Path], None]"

CHECKS: dict[str, tuple[Callable[[Cut, Path, Path], None], Callable[[Cut, Path, Path], None]]] = {
    "session": (check_session, resume_session),
    "build": (check_built, build_again),
    "build more": (check_built, build_more_again),
    "withdraw": (check_withdrawn, withdraw_again),
    "rebuild": (check_rebuilt, rebuild_again),
    "collect": (check_collected, collect_again),
}
"""What must hold at once, and what must come of doing the step again."""
