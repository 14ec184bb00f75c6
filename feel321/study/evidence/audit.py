"""Audit: verify every journal and plan of a study, its tables, and compare its files with its checkpoints.

Every finding names the file, and the line where there is one; a file that cannot be read hides no other. The digest
that plans and journals keep of the stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows
are compared with that; its recipe, units and versions are covered by checkpoints only, and `check` compares the recipe
with the settings. Each participant's plan and journals are read once.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import chain as join
from itertools import pairwise, zip_longest
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.files import digest_file, list_csv, open_text, read_bytes
from feel321.stimuli.sets.manifest import check_stimuli, describe_row, read_details, read_stimuli
from feel321.study import ratings
from feel321.study.evidence import checkpoints
from feel321.study.evidence.checkpoints import EVIDENCE, Checkpoint, FileMark, is_journal
from feel321.study.evidence.freeze import describe_frozen, find_faults
from feel321.study.evidence.replay import MALFORMED, audit_steps
from feel321.study.folder import RATING_COLUMNS, Audit, list_delivered
from feel321.study.participants import answers, roster
from feel321.study.participants.traces import find_data_left, list_stale
from feel321.study.session import events, journal
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, Dossier, Plan, require_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder

APART_S = 10.0  # how far the time of day and the presenter's clock may part between two records
_CLOCKS_APART = {
    kind.event for kind in (events.SessionBegun, events.SessionResumed, events.ClockStepped)
}
# In a pause or on a page the computer may sleep, and the presenter's clock with it.
_CLOCKS_ASLEEP = {
    kind.event
    for kind in (events.PageRead, events.QuestionAnswered, events.TrialContinued, events.DeviceOpened)
}  # fmt: skip


# How far a participant is, and the rows in each table; None where the files cannot be read, as the findings say.
Derived = tuple[roster.Progress, dict[str, list[dict[str, Any]]]]


class Remark(str):
    """What is worth knowing and no finding."""

    __slots__ = ()


def examine(
    study: StudyFolder,
    *,
    expect: str = "",
    remotes: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Audit:
    """Verify a study by itself, and by its checkpoints; expect: one that must be there, remotes: further ones."""
    remedy = f"not a participant's folder; move it out of {study.sessions}"
    said = [f"{path}: {remedy}" for path in study.strangers]
    folders, stimuli = study.participants, None
    if folders or study.stimuli.exists():
        said += check_stimuli(study.stimuli)
        with suppress(OSError, ValueError):  # among the findings already
            stimuli = read_stimuli(study.stimuli)
            said += _guard(study.stimuli, _audit_details(stimuli))
    derived, holders = dict[str, Derived | None](), list[roster.Holder]()
    for done, folder in enumerate(folders, start=1):
        said += _guard(folder, _audit_participant(study, folder, stimuli, derived=derived))
        with suppress(OSError, ValueError):  # of a plan that is among the findings
            holders += filter(None, [roster.read_holder(folder)])
        progress(done, len(folders))
    said += [*roster.find_doubles(holders), *_guard(study.path, find_data_left(study))]
    newest = sentence = ""
    if not study.is_rehearsal:
        compared, newest, sentence = weigh(study, expect=expect, remotes=remotes)
        said += [*compared, *_compare_tables(study, stimuli, derived)]
    people = [one[0] for one in derived.values() if one]
    stale = [*roster.describe_rigs(people), *_guard(study.path, list_stale(study))]
    known = filter(None, [describe_frozen(study)])
    said += map(Remark, [*_audit_inputs(study), *stale, *known])
    said += find_faults(study)
    remarks = tuple(one for one in said if isinstance(one, Remark))
    findings = dict.fromkeys(one for one in said if not isinstance(one, Remark))
    return Audit(tuple(findings), remarks, sentence, newest, len(study.journals))


def _guard(place: Path, findings: Iterable[str]) -> Iterator[str]:
    """Make one finding of what cannot be looked at, so that everything else is."""
    try:
        yield from findings
    except (OSError, ValueError) as error:
        named = getattr(error, "filename", None)  # the system's own words name it last
        text = f"{named}: {getattr(error, 'strerror', '')}" if named else str(error)
        yield text if str(place) in text else f"{place}: {text}"
    except MALFORMED as error:
        text = f"holds what feel321 does not write ({type(error).__name__}: {error})"
        yield f"{place}: {text}; restore it from a copy"


def _audit_details(stimuli: StimulusSet) -> Iterator[str]:
    """Compare the rows of `manifest.json` with those of `manifest.csv`."""
    pairs = zip_longest(read_details(stimuli.folder).stimuli, map(describe_row, stimuli))
    if any(len({json.dumps(one, sort_keys=True) for one in pair}) > 1 for pair in pairs):
        text = "manifest.csv and manifest.json differ; one was changed, build the set again"
        yield f"{stimuli.folder}: {text}"


def _audit_inputs(study: StudyFolder) -> Iterator[str]:
    """Find which files that the report was made of are other ones now."""
    path = study.report / "results.json"
    try:
        inputs = json.loads(read_bytes(path))["inputs"]
        made = {inputs[role]: inputs[f"{role}_sha256"] for role in ("ratings", "manifest")}
    except (*MALFORMED, OSError, ValueError):
        return
    for own in (study.ratings, study.manifest):
        if own.is_file() and made.get(own.name, "") not in {"", digest_file(own)}:
            text = f"was computed from another {own.name} than the one here"
            yield f"{path}: {text}; compute it anew: feel321 analyze"


def _audit_participant(
    study: StudyFolder,
    folder: Path,
    stimuli: StimulusSet | None,
    *,
    derived: dict[str, Derived | None],
) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        yield from roster.find_leftovers(folder)
        return
    derived[folder.name] = dossier = None
    with suppress(*MALFORMED, OSError, ValueError):  # found below, part by part
        dossier = study.read_person(folder)
        own: dict[str, list[dict[str, Any]]] = {}
        if stimuli:
            own["ratings.csv"] = ratings.list_judgements(dossier, stimuli)
            own[ratings.MATCHES_FILE] = [*ratings.list_matches(dossier, stimuli)]
            own[answers.ANSWERS_FILE] = answers.list_answers(dossier)
        derived[folder.name] = roster.make_progress(dossier), own
    if folder.is_symlink():
        yield f"{folder}: is a link; put the folder itself there"
    path = folder / PLAN_FILE
    plan = require_plan(path)
    if plan.participant != folder.name:
        yield f"{path}: is the plan of {plan.participant!r}, it was copied here"
    if stimuli and stimuli.sha256 != plan.stimuli_sha256:
        yield f"{path}: names another stimulus set than the one that is built"
    yield from audit_journals(folder, plan, dossier)


# Journals: each chain, its header and times, and how one session follows another.


def audit_journals(folder: Path, plan: Plan, dossier: Dossier | None = None) -> Iterator[str]:
    """Verify all journals of a participant; dossier: as they were read, where all could be."""
    journals, known = journal.list_journals(folder), dict[Path, journal.Chain]()
    if dossier:
        known = dict(zip(journals, dossier.chains, strict=True))
    for path in sorted(folder.glob("session-*.jsonl")):  # Copies under other names too.
        yield from _guard(path, _audit_journal(path, plan, known))
    for session, path in enumerate(journals, start=1):
        if path.name != journal.name_journal(session):
            yield f"{path}: is there without {journal.name_journal(session)} before it"
            return
        if path == journals[-1] or path not in known:
            continue
        superseded = events.SessionSuperseded.event
        by = [one.data.get("by") for one in known[path].records if one.event == superseded]
        if session + 1 not in by:
            yield f"{path}: does not mention {journal.name_journal(session + 1)}, which stands beside it"


def _audit_journal(path: Path, plan: Plan, known: dict[Path, journal.Chain]) -> Iterator[str]:
    chain = known[path] = known.get(path) or journal.read_journal(path)
    records = chain.records
    if chain.torn:
        yield f"{path}: ends in {len(chain.torn)} bytes of an unfinished line; resuming moves them aside"
    try:
        header = records.find_header()
    except ValueError as error:
        yield f"{path}, {error}"
        return
    if header is None:  # A crash may have come before it, and nobody come back.
        allowed = {kind.event for kind in (*events.REPAIRS, events.SessionReleased)}
        if not {record.event for record in records} <= allowed:
            yield f"{path}: has no header"
        return
    for findings in (
        ratings.find_misplaced(path, header, plan),
        _audit_header(header, plan, path),
        _audit_clocks(header, records),
        _audit_content(records, plan, path.parent),
    ):
        yield from (f"{path}{finding}" for finding in findings)


def _audit_header(header: events.SessionBegun, plan: Plan, path: Path) -> Iterator[str]:
    """Compare the header with the plan, and with where the journal is."""
    presenter = header.identity.get("presenter", {})
    is_simulated = presenter.get("simulated")
    if is_simulated is not plan.simulated:
        yield f", line 1: has simulated {is_simulated}, the plan says {plan.simulated}"
    if not is_simulated and "observer" in presenter:
        yield ", line 1: has simulated false, and a simulated observer in the place of a participant"
    if presenter.get("rehearsal") and path.parent.parent.name == "sessions":
        yield ", line 1: is a rehearsal; move it out of sessions/"
    for name in ("seed", "stimuli_sha256"):
        if (got := getattr(header, name)) != (planned := getattr(plan, name)):
            yield f", line 1: has {name} {got}, the plan says {planned}"


def _audit_clocks(header: events.SessionBegun, records: Sequence[journal.Record]) -> Iterator[str]:
    """Find where the time of day and the presenter's clock part, and nothing says why."""
    if header.identity.get("presenter", {}).get("simulated", True):
        return  # Simulated participants have a clock of their own.
    before, is_asleep = None, False
    for record in records:
        before = None if record.event in _CLOCKS_APART else before
        is_asleep |= record.event in _CLOCKS_ASLEEP
        # What was spoiled has the time of its onset, which may be long before its end.
        is_onset = record.event == events.TrialSpoiled.event
        if is_onset or not isinstance(record.data.get("time_s"), int | float):
            continue
        if before is not None:
            day = datetime.fromisoformat(record.utc) - datetime.fromisoformat(before.utc)
            day_s, own_s = day.total_seconds(), record.data["time_s"] - before.data["time_s"]
            if own_s - day_s > APART_S or (day_s - own_s > APART_S and not is_asleep):
                yield (
                    f", line {record.sequence + 1}: {day_s:.0f} s after line {before.sequence + 1} by the time of day, "
                    f"{own_s:.0f} s by the clock of the session, and nothing says why"
                )
        before, is_asleep = record, False


def _audit_content(records: journal.Records, plan: Plan, folder: Path) -> Iterator[str]:
    """Check that time runs forwards, run the session again, and where that holds look at the files that it names."""
    for before, record in pairwise(records):
        if record.utc < before.utc and record.event != events.ClockStepped.event:
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"
    steps = list(audit_steps(records, plan))
    yield from steps
    if steps:  # records need not be as they should
        return
    for record, path, sha256 in list_delivered(records, folder):
        name = f", line {record.sequence + 1}: {path.parent.name}/{path.name}"
        if not path.is_file():
            yield f"{name} is gone; restore it from a copy"
        elif digest_file(path) != sha256:
            yield f"{name} was changed since it was written; restore it from a copy"
    yield from answers.audit_personal(folder, records)


# Tables: one may lack what was recorded since it was derived, and nothing else; what it holds is compared row by row.

Row = Mapping[str, str]

ANEW = "derive it anew: feel321 analyze"

KEYS = {  # columns that name a row
    roster.ROSTER_FILE: ("participant",),
    "ratings.csv": ("participant", "session", "trial", "stimulus_id", "reference_id", "scale", "other_id"),
    answers.ANSWERS_FILE: ("participant", "session", "question", "occasion"),
    ratings.MATCHES_FILE: ("participant", "trial", "stimulus_id"),
}  # fmt: skip

COLUMNS: Mapping[str, Sequence[str]] = {
    "ratings.csv": RATING_COLUMNS, ratings.MATCHES_FILE: ratings.MATCH_COLUMNS, answers.ANSWERS_FILE: answers.COLUMNS,
}  # fmt: skip

FIXED = {"participant", "number", "simulated", "first_utc", "total"}
"""Columns of the roster that do not change as a session goes on."""


def _compare_tables(
    study: StudyFolder, stimuli: StimulusSet | None, derived: Mapping[str, Derived | None]
) -> Iterator[str]:
    """Compare all tables that are there with the journals."""
    known = [one for one in derived.values() if one]
    unread = {name for name, one in derived.items() if one is None}
    columns, people = roster.list_roster([progress for progress, _ in known])
    tables = {roster.ROSTER_FILE: people}
    if stimuli and study.participants:  # without, ratings may come from elsewhere
        tables |= {name: [row for _, own in known for row in own[name]] for name in COLUMNS}
    for name, rows in tables.items():
        path, lines = study.path / name, [*list_csv(COLUMNS.get(name, columns), rows)]
        if not path.is_file() or path.read_bytes() == "".join(lines).encode():
            continue
        try:
            with open_text(path) as file:
                reader = csv.DictReader(file)
                written = [(reader.line_num, row) for row in reader]
        except (ValueError, csv.Error) as error:
            yield f"{path}: cannot be read ({error}); {ANEW}"
            continue
        # What changes as a session goes on; one that was begun anew is rejected as a whole.
        lagging = {*columns} - FIXED if name == roster.ROSTER_FILE else {"rejected"}
        kept = [one for one in written if one[1].get("participant") not in unread]
        wrong, late = _compare([*csv.DictReader(lines)], kept, key=KEYS[name], lagging=lagging)
        yield from (f"{path}{text}; {ANEW}" for text in wrong)
        if late:
            text = (
                f"lacks rows that the journals have ({late}); unless they are newer, it was edited"
            )
            yield Remark(f"{path}: {text}; {ANEW}")


def _compare(
    derived: Sequence[Row],
    written: Sequence[tuple[int, Row]],
    *,
    key: Sequence[str],
    lagging: set[str],
) -> tuple[list[str], int]:
    """Compare row by row; returns what is wrong, and how many rows are missing at the end."""

    def name(row: Row) -> tuple[str, ...]:
        return tuple(row.get(one) or "" for one in key)

    left: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in derived:  # a trial that was rejected comes again, under the same number
        left[name(row)].append(row)
    others, wrong = [], []
    for line, row in written:
        same = next((one for one in left[name(row)] if not _find_wrong(row, one, lagging)), None)
        if same is None:
            others.append((line, row))
        else:
            left[name(row)].remove(same)
    for line, row in others:
        text = f"holds a row of {row.get('participant') or 'nobody'} that the journals do not have"
        if own := left[name(row)]:
            text = _find_wrong(row, own.pop(0), lagging)
        wrong.append(f", line {line}: {text}")
    missing, there = [*join.from_iterable(left.values())], {name(row) for _, row in written}
    amid = _find_amid(missing, [row for row in derived if name(row) in there])
    for row in amid:
        label = ", ".join(f"{one} {row[one]}" for one in key if row[one])
        wrong.append(f": lacks the row of {label}, which the journals have")
    return wrong, len(missing) - len(amid)


def _find_amid(missing: Sequence[Row], present: Sequence[Row]) -> list[Row]:
    """Find rows that were left out amid others; those at the end of a session may be newer than the table."""

    def place(row: Row) -> tuple[tuple[str, str], float]:
        # Trials that were spoiled come again later, so their numbers do not say when.
        return (row["participant"], row.get("session", "")), float(row.get("onset_s") or math.inf)

    last: dict[tuple[str, str], float] = defaultdict(lambda: -math.inf)
    for session, onset in map(place, present):
        if math.isfinite(onset):
            last[session] = max(last[session], onset)
    return [row for row in missing if place(row)[1] < last[place(row)[0]]]


def _find_wrong(row: Row, own: Row, lagging: set[str]) -> str:
    """Find the first cell that the journals contradict."""
    got, last = row.get("last_utc") or "", own.get("last_utc", "")
    if got > last:
        said = f"the journals end at {last}" if last else "but there is no journal"
        return f"last_utc is {got}, {said}"
    is_old = got < last or (own.get("rejected"), row.get("rejected")) == ("true", "false")
    for name, value in own.items():
        if (got := row.get(name, "")) != value and not (is_old and name in lagging):
            return f"{name} is {got!r}, the journals say {value!r}"
    return ""


# Checkpoints: what they, here and at the remotes, say of the files as they are now.

NOTED = {"rig.toml", "frozen.json"}
"""May change at any time: each session's header holds the rig, and frozen.json its own history."""
# Compared with the journals, row by row.
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


def weigh(
    study: StudyFolder, *, expect: str = "", remotes: Sequence[str] = ()
) -> tuple[list[str], str, str]:
    """Compare a study with its checkpoints; expect: the id of one that must be here.

    Returns findings and remarks, the id of the newest checkpoint, and a sentence on how far the evidence reaches.
    """
    home, own, today = (
        study.path / EVIDENCE,
        checkpoints.read_own(study),
        checkpoints.take_marks(study),
    )
    history, held, said = own.history, list[str](), [*filter(None, [own.problem])]
    binding = [history] if history else []
    for url in dict.fromkeys([*own.pushed, *remotes]):
        try:
            branches = checkpoints.fetch_branches(url, history)
        except OSError as error:
            said.append(Remark(f"{url}: could not be looked at ({error})"))
            held.append(f"{url} could not be looked at")
            continue
        for branch in sorted(own.pushed.get(url, set()) - set(branches)):
            text = f"{url}: had the checkpoints of {branch} and has none now; ask whoever keeps it"
            said.append(text)
        there = {one.id for theirs in branches.values() for one in theirs}
        held += [f"{url} has those until {one.utc}" for one in history if one.id in there][-1:]
        contradict = []
        for branch, theirs in branches.items():
            unknown = [one for one in theirs if one.id not in {own.id for own in history}]
            said += _find_back(study, unknown)
            if difference := _compare_branch(own, theirs, len(unknown), place=(branch, url)):
                said.append(type(difference)(f"{home}: {difference}"))
                contradict.append(theirs)
        binding += [max(contradict, key=lambda one: one[-1].utc)] if contradict else []
    if expect and not any(one.id.startswith(expect) for one in history):
        text = f"has no checkpoint {expect}; if the id is right, the history was made anew or turned back"
        said.append(f"{home}: {text}")
    said += [line for one in binding for line in _compare_files(study, one, today)]
    if not history:
        return said, "", "without evidence: no checkpoint"
    last, now = history[-1], {name: mark for name, mark in today.items() if is_journal(name)}
    begun = sum(name not in last.marks for name in now)
    changed = sum(last.marks.get(name, mark) != mark for name, mark in now.items())
    alone = "no remote holds them, so the folder could be rewritten unnoticed (feel321 seal --to REMOTE)"
    count = f"{len(history)} checkpoint{'s' * (len(history) > 1)}"
    return (
        said,
        last.id,
        (
            f"compared with {count}, the last {last.id[:12]} of {last.utc} on {len(last.marks)} files; "
            f"{'; '.join(held) or alone}; since then: new journals {begun}, longer or changed {changed}"
        ),
    )


def _find_back(study: StudyFolder, unknown: Sequence[Checkpoint]) -> Iterator[str]:
    """Find who withdrew at checkpoints that are not here, and was brought back by a backup."""
    for one in unknown:
        folder = study.sessions / one.who
        is_there = (folder / PLAN_FILE).exists() and not (folder / TOMBSTONE_FILE).exists()
        if one.by == "withdraw" and not one.begins and is_there:
            again = f"feel321 withdraw {quote(str(study.path))} --participant {one.who}"
            text = f"withdrew at the checkpoint of {one.utc}, and is back from a copy; remove again: {again}"
            yield f"{folder}: {text}"


def _compare_branch(
    own: checkpoints.Own, theirs: Sequence[Checkpoint], unknown: int, *, place: tuple[str, str]
) -> str:
    """Compare the history here with a remote's (place: branch and URL); what differs if that must hold here too."""
    branch, url = place
    said = f"{branch} at {url}, the newest of {theirs[-1].utc}"
    if not own.history:
        return Remark(f"has none; compared with the checkpoints of {said}")
    if unknown == len(theirs):
        return f"shares none of the checkpoints of {said}; made anew, or another study"
    if unknown and branch == own.branch:
        return (
            f"lacks {unknown} checkpoints of {said}; an old copy was restored, or it was made anew; if a backup was "
            "restored, say so: feel321 seal --reason TEXT"
        )
    return ""  # another copy of the study may have gone on from a checkpoint that is here


def _compare_files(
    study: StudyFolder, history: Sequence[Checkpoint], today: Mapping[str, FileMark]
) -> Iterator[str]:
    """Compare a history with the files of today."""
    # Of each file, the last checkpoint that may have changed it, and what it was then.
    base: dict[str, tuple[Checkpoint, FileMark]] = {}
    strayed = set[str]()  # files that were something else since
    begun: dict[tuple[str, str], Checkpoint] = {}  # and did not end
    for one in history:
        _follow(one, base, strayed)
        begun.pop((one.by, one.who), None)
        if one.begins:
            begun[one.by, one.who] = one
        elif one.by == "withdraw":
            yield Remark(f"{study.sessions / one.who}: withdrew at the checkpoint of {one.utc}")
        if one.reason:
            said = f"the checkpoint of {one.utc} declares: {one.reason}"
            yield Remark(f"{study.path / EVIDENCE}: {said}")
    for name, (one, mark) in sorted(base.items()):
        path, now = study.path / name, today.get(name)
        # The number was given back before anything was recorded.
        is_back = (
            not path.parent.exists()
            and name.replace(PLAN_FILE, journal.name_journal(1)) not in base
        )
        if now is not None and is_journal(name):
            seen = {own.marks[name]: own for own in reversed(history) if name in own.marks}
            yield from _judge_journal(path, seen)
        elif (now != mark or name in strayed) and not is_back:
            is_open = any(_may_change(other, name, now) for other in begun.values())
            yield from _judge(path, name, (one, mark, now), is_open=is_open)


def _follow(
    one: Checkpoint, base: dict[str, tuple[Checkpoint, FileMark]], strayed: set[str]
) -> None:
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
    path: Path, name: str, became: tuple[Checkpoint, FileMark, FileMark | None], *, is_open: bool
) -> Iterator[str]:
    """Judge a file that is not what it was, or was not all the time; is_open: by what did not end."""
    area, (one, mark, now) = name.partition("/")[0], became
    text = (
        f"{path}: {'is gone' if now is None else 'was changed'} since the checkpoint of {one.utc}"
    )
    if name in DERIVED or (now is None and area == "report"):
        return
    if is_open or name in NOTED:
        yield Remark(text + " by what did not end" * is_open)
        return
    if now not in {None, mark}:
        plain = path.read_bytes().replace(b"\r\n", b"\n")
        if mark.sha256 in {journal.digest(plain), journal.digest(plain.replace(b"\n", b"\r\n"))}:
            yield Remark(f"{path}: {LINE_ENDS}")
            return
    remedy = REMEDIES.get(area, REMEDY)
    if area == "sessions" and path.with_name(TOMBSTONE_FILE).is_file():
        remedy = f"no checkpoint declares the tombstone there; {REMEDY}"
    yield f"{text}; {remedy}"


def _judge_journal(path: Path, seen: Mapping[FileMark, Checkpoint]) -> Iterator[str]:
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
        yield Remark(f"{path}: {LINE_ENDS}")
