"""The history of a study by its checkpoints, the folder as it is now being the last step: what may not be so."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from feel321.study.auditing.checkpoints import (
    ANALYSING,
    CHECKPOINT,
    Holdings,
    find_delta,
    fold,
    read_entries,
)
from feel321.study.auditing.marks import (
    DECIDED,
    GROWING,
    FileMark,
    find_kind,
    find_line,
    take_marks,
)
from feel321.study.folder import StudyFolder
from feel321.study.ledger.progress import read_tombstone
from feel321.study.session.journal import Record
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

PRESENT = "present"


@dataclass(slots=True)
class Following:
    """What became of a study: findings, remarks, and what was recorded after the line that was anchored."""

    study: StudyFolder
    anchored: int = 0
    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    counts: dict[str, set[str]] = field(default_factory=dict)
    _state: Holdings = field(default_factory=Holdings)
    _undeclared: list[str] = field(default_factory=list)
    _analysing: str = ""
    _unfinished: dict[str, list[str]] = field(default_factory=dict)
    _is_planned: bool = False
    _when: str = ""

    def follow(self, records: Sequence[Record]) -> None:
        """Follow all checkpoints, and then the folder as it is."""
        for place, record in enumerate(records, start=1):
            if record.event == ANALYSING:
                self._analysing = record.utc
            if record.event == CHECKPOINT:
                self._step(record.data, place)
                self._when = record.utc
        marks = take_marks(self.study, self.study.participants, read_entries(self.study))
        delta = find_delta(self.study, fold(records), marks)
        self._step({**delta, "by": PRESENT}, len(records) + 1)
        self.findings += [
            f"{line}; if intended, give the reason: feel321 seal --reason"
            for line in self._undeclared
        ]
        self.remarks += [
            f"{self.study.report}: was changed after the analysis that began at {utc} and did not finish "
            f"({', '.join(names)}); write it anew: feel321 analyze"
            for utc, names in self._unfinished.items()
        ]

    def _step(self, data: Mapping[str, Any], place: int) -> None:
        rewritten, marks = set(data.get("rewritten", ())), data["marks"]
        self._is_planned = any(
            name.endswith(PLAN_FILE) and marks.get(name, before) is not None
            for name, before in self._state.marks.items()
        )
        for name, before, after in self._state.take(data):
            if place > self.anchored:
                self._count(name, before, after, by=data["by"])
            if before is not None:
                self._judge(name, before, after, is_rewritten=name in rewritten, by=data["by"])
        if data["by"] == "analysis":
            self._unfinished.clear()
        if data["by"] in {"analysis", "seal"}:
            self._analysing = ""
        if reason := data.get("reason"):
            self.remarks += [f"{line} ({reason})" for line in self._undeclared]
            self._undeclared.clear()

    def _count(
        self, name: str, before: FileMark | None, after: FileMark | None, *, by: str
    ) -> None:
        what = ""
        if find_kind(name) == GROWING and after is not None:
            what = "recorded" if name.endswith(".jsonl") else "rebuilt"
        elif name.endswith(TOMBSTONE_FILE) and before is None:
            what = "withdrew"
        elif name == "report/results.json" and after is not None and by == "analysis":
            what = "analysed"
        if what:
            self.counts.setdefault(what, set()).add(name)

    def _judge(
        self, name: str, before: FileMark, after: FileMark | None, *, is_rewritten: bool, by: str
    ) -> None:
        """Judge what became of a file that was there."""
        path, kind = self.study.path / name, self._find_kind(name)
        since = f"since the checkpoint of {self._when}"
        line = find_line(before.heads, after.heads) if after else 0
        where = (
            f"{path}, line {line}"
            if line and not (kind == GROWING and not is_rewritten)
            else f"{path}"
        )
        became = "is gone" if after is None else "was changed"
        text = f"{where}: {became} {since}"
        match kind:
            case "growing":
                self.findings += self._judge_growing(name, before, after, is_rewritten=is_rewritten)
            case "kept" if after is not None or not self._is_explained(name):
                self.findings.append(f"{text}; restore it from a copy")
            case "slot" if after is not None:  # who is missing in the ledger is found there
                self.findings.append(f"{name}: {became} {since}; restore the ledger from a copy")
            case "decided":
                self._undeclared.append(text)
            case "noted":
                self.remarks.append(text)
            case "report" if self._analysing and by != "analysis":
                self._unfinished.setdefault(self._analysing, []).append(path.name)
            case "report" if after is not None and by != "analysis":
                self.findings.append(
                    f"{text}, but not by an analysis; write it again: feel321 analyze"
                )

    def _find_kind(self, name: str) -> str:
        """Find what may become of a file; the lab decides on stimuli that no plan names, and on unused certificates."""
        is_free = name.startswith("stimuli/") and not self._is_planned
        is_free |= name.startswith("calibration/") and not self._is_used(name)
        return DECIDED if is_free else find_kind(name)

    def _is_used(self, name: str) -> bool:
        """Check whether a journal names a certificate."""
        own = self.study.path.joinpath(name).stem.encode()
        return any(own in path.read_bytes() for path in self.study.journals)

    def _judge_growing(
        self, name: str, before: FileMark, after: FileMark | None, *, is_rewritten: bool
    ) -> Iterator[str]:
        path, since = self.study.path / name, f"at the checkpoint of {self._when}"
        if after is None:
            if fault := self._find_unexplained(name, before):
                yield f"{path}: is gone, {before.lines} lines of it were there {since}{fault}"
        elif after.lines < before.lines:
            yield f"{path}: ends with line {after.lines}, {before.lines} lines of it were there {since}"
        elif is_rewritten:
            line = find_line(before.heads, after.heads[: len(before.heads)]) or before.lines
            yield f"{path}, line {line}: is not the line that was there {since}"

    def _is_explained(self, name: str) -> bool:
        """Check whether a plan went with its participant, or was given back before anything was recorded."""
        path = self.study.path / name
        if path.name != PLAN_FILE:
            return False
        journals = [
            one for one in self._state.marks if one.startswith(f"sessions/{path.parent.name}/")
        ]
        return (path.parent / TOMBSTONE_FILE).is_file() or not (journals or path.parent.exists())

    def _find_unexplained(self, name: str, before: FileMark) -> str:
        """Find whether a journal went with its participant: its tombstone has seen all of it."""
        folder, journal = (self.study.path / name).parent, name.rpartition("/")[2]
        try:
            stone = read_tombstone(folder)
        except ValueError as error:
            return f" ({error})"
        if stone is None:
            return "; restore it from a copy"
        seen = {one.journal: one for one in stone.journals}.get(journal)
        if seen is None or seen.lines < before.lines:
            return f"; the tombstone beside it knows of {seen.lines if seen else 0}"
        is_same = seen.lines > before.lines or seen.tip == before.sha256
        return "" if is_same else "; the tombstone beside it is of another journal"


def describe_counts(counts: Mapping[str, set[str]]) -> str:
    """Describe what happened after an anchor, as a clause."""
    words = {
        "recorded": ("session was", "sessions were", "recorded or continued"),
        "withdrew": ("participant", "participants", "withdrew"),
        "rebuilt": ("time the ledger was", "times the ledger was", "rebuilt"),
        "analysed": ("report was", "reports were", "written"),
    }
    told = []
    for what, (one, many, done) in words.items():
        if number := len(counts.get(what, ())):
            told.append(f"{number} {one if number == 1 else many} {done}")
    return ", ".join(told)
