"""What the checkpoints of a study, here and at its remotes, say of its files as they are now."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from shlex import quote
from typing import TYPE_CHECKING

from feel321.study import checkpoints
from feel321.study.checkpoints import EVIDENCE, Checkpoint, FileMark, is_journal
from feel321.study.session.journal import digest
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder

NOTED = {"rig.toml", "frozen.json"}
"""May change at any time: each session's header holds the rig, and frozen.json its own history."""

DERIVED = {"ratings.csv", "participants.csv", "matches.csv"}
"""Compared with the journals, row by row (`tables`)."""

OCCASIONS = {"report": {"analyze", "withdraw"}, "stimuli": {"build"}}
"""Folder -> occasions on which what is in it may change."""

REMEDIES = {
    "sessions": "restore it from a copy",
    "report": "not by an analysis; write it anew: feel321 analyze",
    "stimuli": "not by feel321 build; restore it from a copy",
}
REMEDY = "if that was intended, give the reason: feel321 seal --reason TEXT"


@dataclass(slots=True)
class Evidence:
    """What was found and is worth knowing; the newest checkpoint; a sentence on how far the evidence reaches."""

    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    checkpoint: str = ""
    sentence: str = "without evidence: no checkpoint"


def weigh(study: StudyFolder, *, expect: str = "", remotes: Sequence[str] = ()) -> Evidence:
    """Compare a study with its checkpoints, here and at its remotes; expect: the id of one that must be here."""
    found = Evidence()
    own, today, home = (
        checkpoints.read_own(study),
        checkpoints.take_marks(study),
        study.path / EVIDENCE,
    )
    history, binding, held = own.history, [own.history], list[str]()
    found.findings += filter(None, [own.problem])
    for url in dict.fromkeys([*own.pushed, *remotes]):
        try:
            branches = checkpoints.fetch_branches(url, history)
        except OSError as error:
            found.remarks.append(f"{url}: could not be looked at ({error})")
            held.append(f"{url} could not be looked at")
            continue
        for branch in sorted(own.pushed.get(url, set()) - set(branches)):
            text = f"{url}: had the checkpoints of {branch} and has none now; ask whoever keeps it"
            found.findings.append(text)
        there = {one.id for theirs in branches.values() for one in theirs}
        held += [f"{url} has those until {one.utc}" for one in history if one.id in there][-1:]
        others = [
            (branch == own.branch, theirs[-1].utc, theirs)
            for branch, theirs in branches.items()
            if _compare_branch(study, own, (branch, url, theirs), found=found, today=today)
        ]
        binding.append(max(others, default=(False, "", []), key=lambda one: one[:2])[-1])
    if expect and not any(one.id.startswith(expect) for one in history):
        text = f"has no checkpoint {expect}; if the id is right, the history was made anew or turned back"
        found.findings.append(f"{home}: {text}")
    for one in filter(None, binding):
        _Comparison(study, today, found).run(one)
    if history:
        found.checkpoint, found.sentence = history[-1].id, _describe(history, held, today)
    return found


def _compare_branch(
    study: StudyFolder,
    own: checkpoints.Own,
    other: tuple[str, str, Sequence[Checkpoint]],
    *,
    found: Evidence,
    today: Mapping[str, FileMark],
) -> bool:
    """Compare the history here with a remote's; whether that one must hold of this folder, too."""
    home, known = study.path / EVIDENCE, {one.id for one in own.history}
    branch, url, theirs = other
    unknown = [one for one in theirs if one.id not in known]
    said = f"{branch} at {url}, the newest of {theirs[-1].utc}"
    for one in unknown:  # a backup brings back whoever withdrew since
        folder = study.sessions / one.who
        is_there = (folder / PLAN_FILE).exists() and not (folder / TOMBSTONE_FILE).exists()
        if one.by == "withdraw" and not one.begins and is_there:
            again = f"feel321 withdraw {quote(str(study.path))} --participant {one.who}"
            text = f"withdrew at the checkpoint of {one.utc}, and is back from a copy; remove again: {again}"
            found.findings.append(f"{folder}: {text}")
    if not own.history:
        found.remarks.append(f"{home}: has none; compared with the checkpoints of {said}")
    elif len(unknown) == len(theirs):
        text = (
            f"shares none of the checkpoints of {said}; it was made anew, or this is another study"
        )
        found.findings.append(f"{home}: {text}")
    elif unknown and branch == own.branch:
        text = f"lacks {len(unknown)} checkpoints of {said}; an old copy was restored, or it was made anew"
        remedy = "if a backup was restored, say so: feel321 seal --reason TEXT"
        found.findings.append(f"{home}: {text}; {remedy}")
    elif unknown:
        lost = ", ".join(checkpoints.list_lost(theirs[-1].marks, today))
        more = f"; not here: {lost}" if lost else ""
        found.remarks.append(f"{home}: another copy of this study went on as {said}{more}")
        return False
    return bool(unknown)


def _describe(
    history: Sequence[Checkpoint], held: Sequence[str], today: Mapping[str, FileMark]
) -> str:
    """Say how far the evidence reaches, and how much came after it."""
    last, now = history[-1], {name: mark for name, mark in today.items() if is_journal(name)}
    begun = sum(name not in last.marks for name in now)
    changed = sum(last.marks.get(name, mark) != mark for name, mark in now.items())
    alone = "no remote holds them, so the folder could be rewritten unnoticed (feel321 seal --to REMOTE)"
    return (
        f"compared with {len(history)} checkpoint{'s' * (len(history) > 1)}, the last {last.id[:12]} of {last.utc} on "
        f"{len(last.marks)} files; {'; '.join(held) or alone}; since then: new journals {begun}, longer or changed "
        f"{changed}"
    )


@dataclass(slots=True)
class _Comparison:
    """A history against the files of today.

    base: of each file, the last checkpoint that may have changed it, and what it was then; strayed: files that were
    something else since; seen: all that a journal ever was; begun: what began and did not end.
    """

    study: StudyFolder
    today: Mapping[str, FileMark]
    own: Evidence
    base: dict[str, tuple[Checkpoint, FileMark]] = field(default_factory=dict)
    strayed: set[str] = field(default_factory=set)
    seen: dict[str, dict[FileMark, Checkpoint]] = field(default_factory=lambda: defaultdict(dict))
    begun: dict[tuple[str, str], Checkpoint] = field(default_factory=dict)

    def run(self, history: Sequence[Checkpoint]) -> None:
        """Follow the history, and judge what became of each file."""
        for one in history:
            self._follow(one)
            self._note(one)
        lost: dict[str, list[str]] = defaultdict(list)
        for name, (_, mark) in sorted(self.base.items()):
            now = self.today.get(name)
            is_open = any(_may_change(one, name, now) for one in self.begun.values())
            if name.startswith("sessions/") and now is None and not is_open:
                lost[name.split("/")[1]].append(name)
            elif now is not None and is_journal(name):
                self.own.findings += self._judge_journal(name)
            elif now != mark or name in self.strayed:
                self._judge(name, now, mark, is_open=is_open)
        for who, names in lost.items():
            self._judge_lost(who, names)

    def _follow(self, one: Checkpoint) -> None:
        for name in self.base.keys() | one.marks.keys():
            mark = one.marks.get(name)
            is_free = not one.begins and _may_change(one, name, mark)
            if mark is not None and is_journal(name):
                self.seen[name].setdefault(mark, one)
            if mark is None and is_free:
                del self.base[name]
            elif mark is not None and (is_free or name not in self.base):
                self.base[name] = one, mark
                self.strayed.discard(name)
            elif mark != self.base[name][1] and not name.startswith("sessions/"):
                self.strayed.add(name)

    def _note(self, one: Checkpoint) -> None:
        """Note what began and did not end, and what was declared."""
        ended = one.who.partition(" ")[::2] if one.by == "failed" else (one.by, one.who)
        self.begun.pop(ended, None)
        if one.begins:
            self.begun[one.by, one.who] = one
        elif one.by == "withdraw":
            text = f"withdrew at the checkpoint of {one.utc}"
            self.own.remarks.append(f"{self.study.sessions / one.who}: {text}")
        if one.reason:
            text = f"the checkpoint of {one.utc} declares: {one.reason}"
            self.own.remarks.append(f"{self.study.path / EVIDENCE}: {text}")

    def _judge(self, name: str, now: FileMark | None, mark: FileMark, *, is_open: bool) -> None:
        """Judge a file that is not what it was, or was not all the time."""
        area, path = name.partition("/")[0], self.study.path / name
        since = f"since the checkpoint of {self.base[name][0].utc}"
        if name in DERIVED or (now is None and area == "report"):
            return
        became = "is gone" if now is None else "was changed"
        if is_open or name in NOTED:
            self.own.remarks.append(f"{path}: {became} {since}" + " by what did not end" * is_open)
        elif now not in {None, mark} and _has_other_ends(path.read_bytes(), mark):
            self.own.remarks.append(f"{path}: has other line endings {since}, and no other change")
        else:
            remedy = REMEDIES.get(area, REMEDY)
            self.own.findings.append(f"{path}: {became} {since}; {remedy}")

    def _judge_journal(self, name: str) -> Iterator[str]:
        """Demand that a journal begins with all that it ever was."""
        path, good = self.study.path / name, 0
        content = checkpoints.read_lines(path)
        for mark, one in sorted(self.seen[name].items(), key=lambda item: item[0].size):
            when = f"at the checkpoint of {one.utc}; restore it from a copy"
            if len(content) < mark.size:
                yield f"{path}: was cut, {len(content)} bytes are left of {mark.size} {when}"
                return
            if digest(content[: mark.size]) != mark.sha256:
                first, last = (content[:size].count(b"\n") for size in (good, mark.size))
                yield f"{path}, lines {first + 1} to {last}: are not those {when}"
                return
            good = mark.size
        if b"\r\n" in path.read_bytes():
            self.own.remarks.append(f"{path}: has other line endings, and no other change")

    def _judge_lost(self, who: str, names: Sequence[str]) -> None:
        folder, files = self.study.sessions / who, [one.rpartition("/")[2] for one in names]
        if files == [PLAN_FILE] and not folder.exists():
            return  # the number was given back before anything was recorded
        utc = max(self.base[one][0].utc for one in names)
        remedy = "restore it from a copy"
        if (folder / TOMBSTONE_FILE).is_file():
            remedy = f"no checkpoint declares the tombstone there; {REMEDY}"
        text = f"lost {', '.join(files)} since the checkpoint of {utc}; {remedy}"
        self.own.findings.append(f"{folder}: {text}")


def _has_other_ends(content: bytes, mark: FileMark) -> bool:
    plain = content.replace(b"\r\n", b"\n")
    return mark.sha256 in {digest(plain), digest(plain.replace(b"\n", b"\r\n"))}


def _may_change(one: Checkpoint, name: str, mark: FileMark | None) -> bool:
    """Check whether a file may have become this on the occasion of a checkpoint: a withdrawal only removes files."""
    area, _, rest = name.partition("/")
    if area == "sessions":
        who = rest.partition("/")[0]
        stone = f"sessions/{who}/{TOMBSTONE_FILE}"
        is_declared = one.reason and stone in one.marks
        return bool(is_declared or (one.by, one.who) == ("withdraw", who)) and (
            mark is None or name == stone
        )
    return one.by in OCCASIONS[area] if area in OCCASIONS else name in NOTED or bool(one.reason)
