"""Checkpoints: a chained record, beside `study.toml`, of what a study held after each session and seal.

`checkpoints.jsonl` is a journal like those of sessions: each line holds the digest of the one before, and is on
the disk when it is written. A checkpoint holds the marks (`marks`) of what is new or changed since the one before, so
every past change stays visible. Unless a copy is kept, anyone who can write to the folder can rewrite the chain;
`anchors` keep its end elsewhere.
"""

import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from socket import gethostname
from typing import Any

from feel321.study import server
from feel321.study.auditing.marks import GROWING, HEAD, FileMark, continues, find_kind, take_marks
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import Entry, read_place
from feel321.study.session.journal import (
    Clock,
    Journal,
    Record,
    create_journal,
    digest,
    read_journal,
    require_journal,
)

CHECKPOINTS = "checkpoints.jsonl"
CHECKPOINT, ANALYSING = "checkpoint", "analysing"
"""Events: what the study holds; an analysis begins, so the report may change until the next checkpoint."""

LOCK_FILE = ".checkpoints.lock"
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Tip:
    """The end of the chain: which chain it is, its lines, the digest of the last, and when that was written."""

    chain: str
    lines: int
    sha256: str
    utc: str


@dataclass(slots=True)
class Holdings:
    """What a chain says that a study holds: its marks by name."""

    marks: dict[str, FileMark] = field(default_factory=dict)

    def take(
        self, data: Mapping[str, Any]
    ) -> Iterator[tuple[str, FileMark | None, FileMark | None]]:
        """Take a checkpoint; yield what it changes: name, mark before, mark after (None: gone)."""
        for name, entry in data["marks"].items():
            before = self.marks.pop(name, None)
            after = None
            if entry is not None:
                after = FileMark.read(entry)
                kept = (
                    before.heads[: int(entry["from"]) * HEAD] if before and "from" in entry else ""
                )
                after = self.marks[name] = FileMark(after.sha256, after.lines, kept + after.heads)
            yield name, before, after


def find_chain(study: StudyFolder) -> Path:
    """Find where the checkpoints of a study are."""
    return study.path / CHECKPOINTS


def fold(records: Iterable[Record]) -> Holdings:
    """Gather what all checkpoints together say."""
    state = Holdings()
    for record in records:
        if record.event == CHECKPOINT:
            list(state.take(record.data))
    return state


def describe_tip(records: Sequence[Record], tip: str) -> Tip:
    """Describe the end of a chain, whose first checkpoint names it."""
    return Tip(name_chain(records), len(records), tip, records[-1].utc)


def list_branches(records: Iterable[Record]) -> dict[str, int]:
    """List the names of a chain, each with its last line: a copy of a study goes on under a name of its own."""
    branches: dict[str, int] = {}
    name = ""
    for line, record in enumerate(records, start=1):
        name = str(record.data.get("chain", name))
        branches |= {name: line} if name else {}
    return branches


def name_chain(records: Iterable[Record]) -> str:
    """Find the name under which a chain goes on; empty as long as it has no checkpoint."""
    return next(reversed(list_branches(records)), "")


def _name_home(study: StudyFolder) -> str:
    return digest(f"{gethostname()}:{study.path.absolute()}")[:16]


def read_tip(study: StudyFolder) -> Tip | None:
    """Read the end of a study's chain; None where there is none yet."""
    path = find_chain(study)
    if not path.is_file():
        return None
    chain = read_journal(path)
    return describe_tip(chain.records, chain.tip) if chain.records else None


def read_entries(study: StudyFolder) -> list[Entry]:
    """Read the ledger where it is a file that is there and can be read."""
    if not study.ledger.is_file() or server.find_server(study.settings):
        return []
    try:
        return read_place(study.ledger)[1]
    except (OSError, ValueError):
        return []  # The audit names it.


def take_checkpoint(
    study: StudyFolder,
    *,
    by: str,
    now: Clock,
    reason: str = "",
    participants: Sequence[str] | None = None,
    entries: Iterable[Entry] | None = None,
) -> Tip:
    """Append a checkpoint of what is new or changed, if anything is; of some participants, or of all.

    by: `session`, `simulate`, `analysis` or `seal`; reason: why settings, texts or methods changed.
    """
    with _open_chain(study, now=now) as journal:
        state = fold(journal.records)
        folders = study.participants
        if participants is not None:
            folders = [study.sessions / name for name in participants]
        entries = read_entries(study) if entries is None else entries
        marks = take_marks(study, folders, entries)
        delta = find_delta(study, state, marks, participants=participants)
        home = _name_home(study)
        is_begun = (
            next((one.data["home"] for one in reversed(journal.records) if "home" in one.data), "")
            == home
        )
        if delta["marks"] or reason or not is_begun or by == "analysis":
            begun = {} if is_begun else {"chain": uuid.uuid4().hex, "home": home}
            given = {"reason": reason} if reason else {}
            journal.write(CHECKPOINT, {**begun, "by": by, **given, **delta})
        return describe_tip(journal.records, journal.tip)


def note_analysis(study: StudyFolder, *, now: Clock) -> None:
    """Note that an analysis begins: if it is interrupted, the report may be an old or a new one."""
    if find_chain(study).is_file():
        with _open_chain(study, now=now) as journal:
            if journal.records:
                journal.write(ANALYSING)


@contextmanager
def _open_chain(study: StudyFolder, *, now: Clock) -> Iterator[Journal]:
    from filelock import FileLock

    path = find_chain(study)
    with FileLock(path.with_name(LOCK_FILE), timeout=PATIENCE_S):
        try:
            journal = (require_journal if path.is_file() else create_journal)(path, now=now)
        except ValueError as error:
            raise ValueError(f"{error}; feel321 audit tells which anchors hold one") from None
        yield journal
        study.share(path)


def find_delta(
    study: StudyFolder,
    state: Holdings,
    marks: Mapping[str, FileMark],
    *,
    participants: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Find what differs from what the chain says: marks, and the names of files that should only grow and did not."""
    entries: dict[str, Any] = {}
    rewritten = []
    for name, mark in marks.items():
        before = state.marks.get(name)
        if before is not None and before.sha256 == mark.sha256 and before.lines == mark.lines:
            continue
        entry: dict[str, Any] = {"sha256": mark.sha256, "heads": mark.heads}
        if find_kind(name) == GROWING:
            entry["lines"] = mark.lines
            if before is not None and continues(study.path / name, before):
                entry |= {"from": before.lines, "heads": mark.heads[before.lines * HEAD :]}
            elif before is not None:
                rewritten.append(name)
        entries[name] = entry
    gone = [name for name in state.marks if name not in marks and _is_in(name, participants)]
    entries |= dict.fromkeys(gone)
    return {"marks": entries, **({"rewritten": rewritten} if rewritten else {})}


def _is_in(name: str, participants: Sequence[str] | None) -> bool:
    """Check whether a mark is of the study or of some participants."""
    if participants is None or not name.startswith("sessions/"):
        return True
    who = name.partition("/")[2].removeprefix("ledger.sqlite: ").partition("/")[0]
    return who in {*participants, "ledger.log"}
