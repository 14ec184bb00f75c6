"""What the checkpoints of a study, here and at its remotes, say of its files as they are now."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote

from feel321.study import checkpoints
from feel321.study.checkpoints import EVIDENCE, Checkpoint, FileMark, is_journal
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import digest, name_journal
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

NOTED = {"rig.toml", "frozen.json"}
"""May change at any time: each session's header holds the rig, and frozen.json its own history."""

# Compared with the journals, row by row (`tables`).
DERIVED = {"ratings.csv", "participants.csv", "matches.csv"}

OCCASIONS = {"report": {"analyze", "withdraw"}, "stimuli": {"build"}}
"""Folder -> occasions on which what is in it may change."""

REMEDIES = {
    "sessions": "restore it from a copy",
    "report": "not by an analysis; write it anew: feel321 analyze",
    "stimuli": "not by feel321 build; restore it from a copy",
}
REMEDY = "if that was intended, give the reason: feel321 seal --reason TEXT"
LINE_ENDS = "has other line endings, and no other change"


Base = dict[str, tuple[Checkpoint, FileMark]]


@dataclass(slots=True)
class Evidence:
    """What was found and is worth knowing; the newest checkpoint; a sentence on how far the evidence reaches."""

    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    checkpoint: str = ""
    sentence: str = "without evidence: no checkpoint"


def weigh(study: StudyFolder, *, expect: str = "", remotes: Sequence[str] = ()) -> Evidence:
    """Compare a study with its checkpoints, here and at its remotes; expect: the id of one that must be here."""
    found, home = Evidence(), study.path / EVIDENCE
    own, today = checkpoints.read_own(study), checkpoints.take_marks(study)
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
        contradict = [
            theirs
            for branch, theirs in branches.items()
            if _compare_branch(study, own, theirs, place=(branch, url), found=found)
        ]
        binding += [max(contradict, key=lambda one: one[-1].utc)] if contradict else []
    if expect and not any(one.id.startswith(expect) for one in history):
        text = f"has no checkpoint {expect}; if the id is right, the history was made anew or turned back"
        found.findings.append(f"{home}: {text}")
    for one in filter(None, binding):
        _compare_files(study, one, today=today, found=found)
    if history:
        last, now = history[-1], {name: mark for name, mark in today.items() if is_journal(name)}
        begun = sum(name not in last.marks for name in now)
        changed = sum(last.marks.get(name, mark) != mark for name, mark in now.items())
        alone = "no remote holds them, so the folder could be rewritten unnoticed (feel321 seal --to REMOTE)"
        found.checkpoint, count = last.id, f"{len(history)} checkpoint{'s' * (len(history) > 1)}"
        found.sentence = (
            f"compared with {count}, the last {last.id[:12]} of {last.utc} on {len(last.marks)} files; "
            f"{'; '.join(held) or alone}; since then: new journals {begun}, longer or changed {changed}"
        )
    return found


def _compare_branch(
    study: StudyFolder,
    own: checkpoints.Own,
    theirs: Sequence[Checkpoint],
    *,
    place: tuple[str, str],
    found: Evidence,
) -> bool:
    """Compare the history here with a remote's (place: branch and URL); whether that must hold of this folder too."""
    home, known, (branch, url) = study.path / EVIDENCE, {one.id for one in own.history}, place
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
        text = f"shares none of the checkpoints of {said}; made anew, or another study"
        found.findings.append(f"{home}: {text}")
    elif unknown and branch == own.branch:
        text = f"lacks {len(unknown)} checkpoints of {said}; an old copy was restored, or it was made anew"
        remedy = "if a backup was restored, say so: feel321 seal --reason TEXT"
        found.findings.append(f"{home}: {text}; {remedy}")
    else:  # another copy of the study may have gone on from a checkpoint that is here
        return False
    return True


def _compare_files(
    study: StudyFolder,
    history: Sequence[Checkpoint],
    *,
    today: Mapping[str, FileMark],
    found: Evidence,
) -> None:
    """Compare a history with the files of today."""
    # Of each file, the last checkpoint that may have changed it, and what it was then.
    base: Base = {}
    strayed = set[str]()  # files that were something else since
    begun: dict[tuple[str, str], Checkpoint] = {}  # and did not end
    for one in history:
        _follow(one, base, strayed)
        begun.pop((one.by, one.who), None)
        if one.begins:
            begun[one.by, one.who] = one
        elif one.by == "withdraw":
            text = f"withdrew at the checkpoint of {one.utc}"
            found.remarks.append(f"{study.sessions / one.who}: {text}")
        if one.reason:
            text = f"the checkpoint of {one.utc} declares: {one.reason}"
            found.remarks.append(f"{study.path / EVIDENCE}: {text}")
    for name, (one, mark) in sorted(base.items()):
        path, now = study.path / name, today.get(name)
        # The number was given back before anything was recorded.
        is_back = not path.parent.exists() and name.replace(PLAN_FILE, name_journal(1)) not in base
        if now is not None and is_journal(name):
            seen = {own.marks[name]: own for own in reversed(history) if name in own.marks}
            found.findings += _judge_journal(path, seen, found.remarks)
        elif (now != mark or name in strayed) and not is_back:
            is_open = any(_may_change(other, name, now) for other in begun.values())
            _judge(path, name, (one, mark, now), found=found, is_open=is_open)


def _follow(one: Checkpoint, base: Base, strayed: set[str]) -> None:
    """Follow a history by one checkpoint."""
    for name in base.keys() | one.marks.keys():
        mark = one.marks.get(name)
        is_free = not one.begins and _may_change(one, name, mark)
        if mark is None and is_free:
            del base[name]
        elif mark is not None and (is_free or name not in base):
            base[name] = one, mark
            strayed.discard(name)
        elif mark != base[name][1] and not name.startswith("sessions/"):
            strayed.add(name)


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


def _judge(
    path: Path,
    name: str,
    became: tuple[Checkpoint, FileMark, FileMark | None],
    *,
    found: Evidence,
    is_open: bool,
) -> None:
    """Judge a file that is not what it was, or was not all the time; is_open: by what did not end."""
    area, (one, mark, now) = name.partition("/")[0], became
    if name in DERIVED or (now is None and area == "report"):
        return
    what = "is gone" if now is None else "was changed"
    text = f"{path}: {what} since the checkpoint of {one.utc}"
    if is_open or name in NOTED:
        found.remarks.append(text + " by what did not end" * is_open)
        return
    if now not in {None, mark}:
        plain = path.read_bytes().replace(b"\r\n", b"\n")
        if mark.sha256 in {digest(plain), digest(plain.replace(b"\n", b"\r\n"))}:
            found.remarks.append(f"{path}: {LINE_ENDS}")
            return
    remedy = REMEDIES.get(area, REMEDY)
    if area == "sessions" and path.with_name(TOMBSTONE_FILE).is_file():
        remedy = f"no checkpoint declares the tombstone there; {REMEDY}"
    found.findings.append(f"{text}; {remedy}")


def _judge_journal(
    path: Path, seen: Mapping[FileMark, Checkpoint], remarks: list[str]
) -> Iterator[str]:
    """Demand that a journal begins with all that it ever was."""
    content, good, whole = checkpoints.read_lines(path), 0, hashlib.sha256()
    for mark, one in sorted(seen.items(), key=lambda item: item[0]):
        when = f"at the checkpoint of {one.utc}; restore it from a copy"
        if len(content) < mark.size:
            yield f"{path}: was cut, {len(content)} bytes are left of {mark.size} {when}"
            return
        whole.update(content[good : mark.size])
        if whole.hexdigest() != mark.sha256:
            first, last = (content[:size].count(b"\n") for size in (good, mark.size))
            yield f"{path}, lines {first + 1} to {last}: are not those {when}"
            return
        good = mark.size
    if b"\r\n" in path.read_bytes():
        remarks.append(f"{path}: {LINE_ENDS}")
