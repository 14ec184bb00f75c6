"""Audit: verify every journal, plan, seal and ledger entry of a study.

Every finding names the file, and the line where there is one. The digest that plans and journals keep of the
stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows are compared with that; its
recipe, units and versions stand under no digest but the seal (`make_seal`), and `check` compares the recipe with the
settings.

The ledger may lag behind a journal: a kill may come between a record and the note of it. It may not run ahead, and
has noted every session that came beyond its opening.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from itertools import pairwise, zip_longest
from math import isclose
from pathlib import Path
from shlex import quote
from typing import Any

from feel321.doors import announce
from feel321.protocols.agenda import Agenda
from feel321.protocols.detection import INTERVALS, THRESHOLD
from feel321.protocols.questions import PREFIX, find_question
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import ASIDE, MATCHING, RATING_RANGE, Page, Trial
from feel321.stimuli.sets.details import iterate_rows
from feel321.stimuli.sets.manifest import FURTHER, check_stimuli, describe_row, read_stimuli
from feel321.study.exploration.track import MOTION, name_track
from feel321.study.folder import (
    DELIVERED,
    MANIFEST_JSON,
    StudyFolder,
    name_delivered,
    reading_origin,
)
from feel321.study.ledger.database import Entry
from feel321.study.ledger.progress import find_leftovers
from feel321.study.ledger.rigs import describe_rigs, find_rig_use
from feel321.study.ledger.slots import find_lost, name_place, read_study_ledger
from feel321.study.ratings import find_misplaced
from feel321.study.session import events
from feel321.study.session.journal import (
    Chain,
    Record,
    digest,
    find_cut,
    list_journals,
    name_journal,
    read_anchor,
    read_journal,
)
from feel321.study.session.pace import TIMED_OUT, Schedule
from feel321.study.session.plan import (
    PLAN_FILE,
    TOMBSTONE_FILE,
    Plan,
    advance,
    read_dossier,
    recall_detection,
    replay,
    require_plan,
)

MALFORMED = (AttributeError, LookupError, TypeError)
"""Errors of reading a plan or record that holds other fields, or other types, than feel321 writes."""


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


# The steps of a session, in order, against what the plan, the rules and the engine allow in that place.

_AFTER: Mapping[str, tuple[type[events.SessionEvent], ...]] = {
    # A session whose header a crash prevented may be given up.
    "": (events.SessionBegun, events.SessionReleased),
    # A crash may keep the end from the ledger; then the lab is opened once more, and Ctrl-C may come.
    events.SessionFinished.event: (events.SessionAborted, events.DeviceOpened, events.NoteTaken),
    # A crash may come before the next session is begun, and nobody come back.
    events.SessionSuperseded.event: (events.SessionReleased, events.NoteTaken),
    # What becomes known later of a session is noted in its journal.
    events.SessionReleased.event: (events.NoteTaken,),
}
"""The events that may follow at the start, and after each event that ends a session; else all may but the header."""


def audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Compare the events, in order, with what the plan and the rules have in that place."""
    try:
        course = _Course(plan)
    except (*MALFORMED, ValueError) as error:
        yield f": its plan cannot be worked through ({error!r})"
        return
    for record in records:
        try:
            course.follow(record)
        except ValueError as error:
            yield f", line {record.sequence + 1}: {error}"
            return
        except MALFORMED:
            yield f", line {record.sequence + 1}: is not a {record.event!r} record as feel321 writes it"
            return


class _Course:
    """A session, followed record by record."""

    def __init__(self, plan: Plan) -> None:
        self._agenda = Agenda(plan.trials, plan.flow, plan.questions)
        self._pace = Schedule({task.protocol: task for task in plan.tasks})
        self._questions, self._asked = plan.questions, Counter[str]()
        self._flow = plan.flow
        self._trials = {trial.number: trial for trial in plan.trials}
        self._detection = recall_detection(plan, ())
        self._attempt: events.Attempt | None = None
        self._toned = (0, 0)
        self._state = ""
        self._aside = ""

    def follow(self, record: Record) -> None:
        kind = events.find_kind(record.event)
        if not issubclass(kind, events.REPAIRS):
            self._check_place(kind)
        event = events.read_event(record.event, record.data)
        if isinstance(event, events.REPAIRS):
            return
        if isinstance(event, events.AttemptEvent) and not isinstance(event, events.TrialShown):
            self._follow_attempt(event, record)
        else:
            self._attempt = None  # Whatever was not answered by then never was.
            self._follow_session(event)
        advance(self._agenda, event, self._trials, detection=self._detection)

    def _check_place(self, kind: type[events.SessionEvent]) -> None:
        allowed = _AFTER.get(self._state)
        if (kind is events.SessionBegun) if allowed is None else not issubclass(kind, allowed):
            place = f"after {self._state!r}" if self._state else "first"
            raise ValueError(f"holds {kind.event!r}, which cannot come {place}")
        if kind.event in _AFTER or kind is events.SessionBegun:
            self._state = kind.event

    def _follow_attempt(self, event: events.AttemptEvent, record: Record) -> None:
        attempt = self._attempt
        if attempt is None or (event.trial, event.attempt) != attempt.key:
            raise ValueError(
                f"{event.event!r} of trial {event.trial}, attempt {event.attempt}, which was not shown"
            )
        attempt.follow(event)
        match event:
            case events.TonePresented():
                self._check_tone(event, attempt.trial)
            case events.PartPlayed():
                _check_part(event, attempt.trial)
            case events.TrialRated():
                self._check_rated(event, attempt, record.data["values"])
                self._attempt = None
            case events.TrialScheduled() if not self._pace.is_fixed(attempt.trial):
                raise ValueError(f"schedules trial {event.trial}, whose onset is not fixed")
            case events.TrialSpoiled():
                self._check_spoiled(event, attempt)
                self._attempt = None

    def _check_spoiled(self, event: events.TrialSpoiled, attempt: events.Attempt) -> None:
        flags = attempt.list_flags(flow=self._flow)
        if TIMED_OUT in event.flags and self._pace.find_limit(attempt.trial) is not None:
            flags, self._aside = [*flags, TIMED_OUT], TIMED_OUT
        elif events.ENDS_UNANSWERED.isdisjoint(flags):
            raise ValueError(f"spoils trial {event.trial}, with which nothing was wrong")
        _check_flags(event.flags, flags)

    def _check_tone(self, event: events.TonePresented, trial: Trial) -> None:
        """Check that a trial of the threshold block presents what follows from the answers before it."""
        self._toned = event.trial, event.attempt
        if self._detection is None or trial.protocol != THRESHOLD:
            raise ValueError(f"presents a tone in trial {trial.number}, which has none")
        wanted = self._detection.present(trial)
        level = event.level_db
        is_same = level is wanted.level_db
        if level is not None and wanted.level_db is not None:
            is_same = isclose(level, wanted.level_db, abs_tol=1e-6)
        if event.interval != wanted.interval or not is_same:
            raise ValueError(
                f"presents {event.level_db} dB in interval {event.interval} of trial {trial.number}, by the answers "
                f"before it is {wanted.level_db} dB in interval {wanted.interval}"
            )

    def _check_rated(
        self, event: events.TrialRated, attempt: events.Attempt, values: Mapping[str, Any]
    ) -> None:
        """Check that an answer could be taken, and that it counts as the rules say."""
        if attempt.trial.protocol == THRESHOLD and self._toned != attempt.key:
            raise ValueError(f"rates trial {event.trial}, in which no level was presented")
        if unfelt := attempt.list_unfelt():
            raise ValueError(
                f"rates trial {event.trial}, of which {', '.join(unfelt)} was not felt to its end"
            )
        _check_values(values, attempt.trial)
        flags = attempt.list_flags(response_time_s=event.response_time_s, flow=self._flow)
        _check_flags(event.flags, flags)
        rejected = not set(self._flow.reject).isdisjoint(flags)
        if event.rejected is not rejected:
            raise ValueError(
                f"has rejected {event.rejected!r}, the rules of the plan say {rejected}"
            )

    def _follow_session(self, event: events.SessionEvent) -> None:
        agenda, step = self._agenda, self._agenda.ask()
        self._aside = _CALLING.get(type(event), self._aside)
        match event:
            case events.TrialShown():
                number = agenda.attempt(step.number) if isinstance(step, Trial) else 0
                if not isinstance(step, Trial) or (event.trial, event.attempt) != (
                    step.number,
                    number,
                ):
                    raise ValueError(
                        f"shows trial {event.trial}, attempt {event.attempt}, which was not next"
                    )
                self._attempt = events.Attempt(step, number)
            case events.PageRead():
                self._check_page(event, step)
            case events.QuestionAnswered():
                self._check_answer(event)
            case events.SessionFinished():
                if step is not None:
                    raise ValueError(f"finished after {agenda.done} of {agenda.total} trials")
                if (event.trials, event.given_up) != (agenda.done, agenda.given_up):
                    raise ValueError(
                        f"finished with {event.trials} trials, {event.given_up} of them given up; "
                        f"the journal holds {agenda.done} and {agenda.given_up}"
                    )

    def _check_answer(self, event: events.QuestionAnswered) -> None:
        question = find_question(self._questions, f"{PREFIX}{event.question}")
        if question is None:
            raise ValueError(f"answers {event.question!r}, which the plan does not ask")
        self._asked[event.question] += 1
        if event.occasion != self._asked[event.question]:
            raise ValueError(
                f"answers {event.question!r} as occasion {event.occasion}, it is {self._asked[event.question]}"
            )
        if question.find_fault(event.value) or event.personal is not question.personal:
            raise ValueError(
                f"answers {event.question!r} against the plan: the value must be one that it offers, and marked "
                f"personal = {question.personal}"
            )

    def _check_page(self, event: events.PageRead, step: Page | Trial | None) -> None:
        if event.key in ASIDE and event.key != self._aside:
            raise ValueError(f"shows page {event.key!r}, for which there was no reason")
        least_s = step.least_s if isinstance(step, Page) and step.key == event.key else 0.0
        if event.stood_s < least_s:
            raise ValueError(
                f"page {event.key!r} was shown for {event.stood_s:g} s, {least_s:g} s are due"
            )


_CALLING: Mapping[type[events.SessionEvent], str] = {
    events.SessionResumed: "ready",
    events.DeviceFailed: "call_us",
    events.TrialShown: "",
}
"""The page aside from the plan that an event gives reason for, or takes it from."""


def _check_part(event: events.PartPlayed, trial: Trial) -> None:
    """Check that a stimulus was played, or the real surface stroked, where the trial has one."""
    part = next((part for part in trial.parts if part.name == event.part), None)
    is_surface = isinstance(event, events.SurfaceStroked)
    if part is None or is_surface != (part.stimulus_id is None):
        raise ValueError(f"{event.event} part {event.part!r}, which trial {trial.number} has not")


def _check_values(values: Mapping[str, Any], trial: Trial) -> None:
    if sorted(values) != sorted(trial.judged):
        got, asked = (", ".join(names) or "nothing" for names in (values, trial.judged))
        raise ValueError(f"rates {got}, trial {trial.number} asks for {asked}")
    choices, (low, high) = find_choices(trial.protocol), RATING_RANGE
    for part, value in values.items():
        is_points = isinstance(value, float) and low <= value <= high
        if not (value in choices if choices else is_points):
            allowed = f"one of {', '.join(choices)}" if choices else f"{low:g} to {high:g} points"
            raise ValueError(f"has {value!r} for {part}, which must be {allowed}")


def find_choices(protocol: str) -> tuple[str, ...]:
    """Find what can be chosen in a trial; nothing where there is a slider."""
    own = {THRESHOLD: INTERVALS, MATCHING: ()}
    return own[protocol] if protocol in own else PROTOCOLS[protocol].choices


def _check_flags(flags: Sequence[str], expected: Sequence[str]) -> None:
    if sorted(flags) != sorted(expected):
        raise ValueError(f"has flags {flags}, by what was felt and answered they are {expected}")


# The journals of one participant: each chain, its header and times, and how one session follows another.


def audit_journals(folder: Path, plan: Plan) -> Iterator[str]:
    """Verify all journals of a participant."""
    chains = {}
    for path in sorted(folder.glob("session-*.jsonl")):  # Copies under other names too.
        try:
            chains[path] = read_journal(path)
        except (OSError, ValueError) as error:
            yield str(error)
        else:
            yield from (f"{path}{finding}" for finding in _audit_journal(chains[path], plan, path))
    yield from _audit_succession(list_journals(folder), chains)


def _audit_journal(chain: Chain, plan: Plan, path: Path) -> Iterator[str]:
    if chain.torn:
        yield f": ends in {len(chain.torn)} bytes of an unfinished line; resuming moves them aside"
    try:
        header = chain.records.find_header()
    except ValueError as error:
        yield f", {error}"
        return
    if header is None:
        # A crash may have come before it, and nobody come back.
        allowed = {kind.event for kind in (*events.REPAIRS, events.SessionReleased)}
        if not {record.event for record in chain.records} <= allowed:
            yield ": has no header"
        return
    yield from find_misplaced(path, header, plan)
    for before, record in pairwise(chain.records):
        is_older = datetime.fromisoformat(record.utc) < datetime.fromisoformat(before.utc)
        if is_older and record.event != events.ClockStepped.event:
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"
    steps = list(audit_steps(chain.records, plan))
    yield from steps
    if not steps:  # else records need not be as they should
        yield from _audit_files(chain.records, path.parent)


def list_files(records: Sequence[Record], folder: Path) -> Iterator[tuple[Record, Path, str]]:
    """List the files of what was rendered, measured or explored: who names them, where they are, their digest."""
    for record in records:
        played = record.content if record.event == events.PartPlayed.event else None
        if not isinstance(played, events.PartPlayed):
            continue
        delivered = name_delivered(int(played.measured.get("file_number", 0)))
        track = name_track(int(played.motion.get("file_number", 0)))
        for path, sha256 in (
            (folder / DELIVERED / delivered, played.delivered_sha256),
            (folder / MOTION / track, played.motion_sha256),
        ):
            if sha256:
                yield record, path, sha256


def _audit_files(records: Sequence[Record], folder: Path) -> Iterator[str]:
    for record, path, sha256 in list_files(records, folder):
        name = f", line {record.sequence + 1}: {path.parent.name}/{path.name}"
        if not path.is_file():
            yield f"{name} is gone; restore it from a copy"
        elif hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            yield f"{name} was changed since it was written; restore it from a copy"


def _audit_succession(journals: Sequence[Path], chains: Mapping[Path, Chain]) -> Iterator[str]:
    """Check that sessions are numbered on, and that each but the newest says which one took its place."""
    for session, path in enumerate(journals, start=1):
        if path.name != name_journal(session):
            yield f"{path}: is there without {name_journal(session)} before it"
            return
    for session, path in enumerate(journals[:-1], start=2):
        if path not in chains:
            continue
        try:
            by = [e.by for e in chains[path].records.find(events.SessionSuperseded)]
        except ValueError:
            by = []
        if session not in by:
            yield f"{path}: does not mention {name_journal(session)}, which stands beside it"


# The ledger's entry of a participant against the journals, besides what is lost.


def audit_entry(study: StudyFolder, folder: Path, entry: Entry) -> Iterator[str]:
    """Compare the ledger's entry of one participant with the journals."""
    if entry.state == "withdrawn" and entry.station:
        return  # At another station: `find_lost` says what to do.
    try:
        dossier = read_dossier(folder)
        reached = max((replay(dossier.plan, c.records).done for c in dossier.chains), default=0)
    except (*MALFORMED, OSError, ValueError):
        return
    rebuild = f"rebuild it: feel321 ledger {quote(str(study.path))} --rebuild"
    who = f"{name_place(study)}: {entry.participant}"
    # A session that ended in its opening need not be noted.
    opening = (*events.UNTOUCHED, events.WarmUpBegun, events.SessionReleased)
    unnoted = {kind.event for kind in opening}
    noted = {anchor.journal for anchor in entry.anchors}
    for path, chain in zip(list_journals(folder), dossier.chains, strict=True):
        if path.name not in noted and not {record.event for record in chain.records} <= unnoted:
            yield f"{who} has no note of {path.name}, which has {len(chain.records)} lines; {rebuild}"
    if any(find_cut(anchor, folder) for anchor in entry.anchors):
        return  # `find_lost` reports what is lost.
    total = sum(trial.phase == "main" for trial in dossier.plan.trials)
    if entry.done > reached:
        yield f"{who} has done {entry.done}, the journals say {reached}; {rebuild}"
    if entry.total not in {0, total}:
        yield f"{who} has total {entry.total}, the plan says {total}; {rebuild}"


def list_remarks(study: StudyFolder) -> Iterator[str]:
    """List what no record contradicts and is worth knowing: participants on another rig, onsets that are estimates."""
    uses = []
    for folder in study.participants:
        journals = list_journals(folder)
        try:
            if journals and not (folder / TOMBSTONE_FILE).exists():
                uses.append(find_rig_use(folder.name, read_journal(journals[-1]).records))
        except (*MALFORMED, OSError, ValueError):
            continue  # among the findings
    yield from describe_rigs(uses)


# The whole study: plans, journals, stimuli, ledger.


def audit_study(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Verify all plans, journals and stimuli of a study, and the ledger."""
    findings = [
        f"{path}: not a participant's folder; move it out of {study.sessions}"
        for path in study.strangers
    ]
    folders = study.participants
    stimuli_sha256 = None
    if folders or study.stimuli.exists():
        problems, stimuli_sha256 = _audit_stimuli(study.stimuli)
        findings += problems
    try:
        entries = {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError):
        entries = {}  # `find_lost` reports it.
    for done, folder in enumerate(folders, start=1):
        announce(folder.name)
        findings += _audit_participant(folder, stimuli_sha256)
        if folder.name in entries:
            findings += audit_entry(study, folder, entries[folder.name])
        if progress is not None:
            progress(done, len(folders))
    return findings + find_lost(study)


def _audit_stimuli(folder: Path) -> tuple[list[str], str | None]:
    """Verify the set; its digest comes too, where the manifest can be read."""
    findings = check_stimuli(folder)
    try:
        stimuli = read_stimuli(folder)
    except (OSError, ValueError):
        return findings, None  # Among the findings already.
    try:
        with reading_origin(folder):
            # An earlier version wrote fewer columns.
            listed = ({**dict.fromkeys(FURTHER), **row} for row in iterate_rows(folder))
            pairs = zip_longest(listed, map(describe_row, stimuli))
            is_same = all(_digest_row(one) == _digest_row(other) for one, other in pairs)
    except ValueError as error:
        return [*findings, str(error)], stimuli.sha256
    if not is_same:
        findings.append(
            f"{folder}: manifest.csv and manifest.json differ; one was changed, build the set again"
        )
    return findings, stimuli.sha256


def _digest_row(row: object) -> str:
    return json.dumps(row, sort_keys=True)


def _audit_participant(folder: Path, stimuli_sha256: str | None) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        # The ledger shows whether the withdrawal was finished.
        yield from find_leftovers(folder)
        return
    path = folder / PLAN_FILE
    try:
        plan = require_plan(path)
    except (OSError, ValueError) as error:
        yield str(error)
        return
    if plan.participant != folder.name:
        yield f"{path}: is the plan of {plan.participant!r}, it was copied here"
    if stimuli_sha256 not in {None, plan.stimuli_sha256}:
        yield f"{path}: names another stimulus set than the one that is built"
    yield from audit_journals(folder, plan)
