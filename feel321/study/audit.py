"""Audit: verify every journal, plan, seal and ledger entry of a study.

Every finding names the file, and the line where there is one. The digest that plans and journals keep of the
stimulus set covers `manifest.csv`, and by it every WAV. Of `manifest.json` the rows are compared with that; its
recipe, units and versions stand under no digest but the seal (`feel321.study.audit`), and `check` compares the
recipe with the settings.

The ledger may lag behind a journal: a kill may come between a record and the note of it. It may not run ahead, and
has noted every session that came beyond its opening.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise
from numbers import Real
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.protocols.agenda import Agenda
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import RATING_RANGE, Page, Trial
from feel321.stimuli.sets.manifest import FURTHER, check_stimuli, describe_row, read_stimuli
from feel321.study.ledger.slots import find_lost, read_study_ledger
from feel321.study.ledger.standing import find_cut, find_leftovers, read_anchor
from feel321.study.provenance import MANIFEST_JSON, read_origin
from feel321.study.session.journal import digest, read_journal
from feel321.study.session.opening import OPENING_EVENTS, PLAN_FILE, TOMBSTONE_FILE, read_dossier
from feel321.study.session.plan import (
    find_header,
    list_journals,
    name_journal,
    replay,
    require_plan,
    tell,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.protocols.trial import Flow
    from feel321.study.folder import StudyFolder
    from feel321.study.ledger.slots import Entry
    from feel321.study.session.journal import Chain, Record
    from feel321.study.session.opening import Dossier
    from feel321.study.session.plan import Plan

# One digest of everything that a study's results rest on.


def make_seal(study: StudyFolder) -> str:
    """Digest all plans, tombstones, ends of journals and the stimulus set.

    Whoever can write to a study can write all of it anew, ledger and digests included. Who kept the seal elsewhere
    sees it: it changes with every record, and with every record that was changed.
    """
    manifests = [study.manifest, study.stimuli / MANIFEST_JSON]
    lines = [line for path in manifests for line in _digest_file(path, study.path)]
    lines += [
        line for folder in study.participants for line in _digest_participant(folder, study.path)
    ]
    return digest("\n".join(lines))


def _digest_participant(folder: Path, root: Path) -> Iterator[str]:
    for name in (PLAN_FILE, TOMBSTONE_FILE):
        yield from _digest_file(folder / name, root)
    for path in list_journals(folder):
        if path.is_file():
            anchor = read_anchor(path)
            yield f"{path.relative_to(root).as_posix()} {anchor.lines} {anchor.tip}"


def _digest_file(path: Path, root: Path) -> Iterator[str]:
    if path.is_file():
        yield f"{path.relative_to(root).as_posix()} {digest(path.read_bytes())}"


# One attempt at a trial as its records tell it: what was felt, what was answered, what was wrong.

_PLAYBACK: dict[str, type | tuple[type, ...]] = {
    "requested_s": (float, int),
    "onset_s": (float, int, type(None)),
    "underruns": int,
    "clipped": int,
    "completed": bool,
    "error": str,
}
"""What a playback tells, and of which type."""

_ENDS_UNANSWERED = frozenset({"device_error", "not_felt"})


@dataclass(slots=True)
class Attempt:
    """What the journal says of an attempt so far."""

    trial: Trial
    number: int
    playbacks: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def take(self, event: str, data: Mapping[str, Any]) -> None:
        """Take a part as played, or as prompted where it is the real surface."""
        part = next((part for part in self.trial.parts if part.name == data["part"]), None)
        if part is None or event != ("prompted" if part.stimulus_id is None else "played"):
            raise ValueError(
                f"{event} part {data['part']!r}, which trial {self.trial.number} has not"
            )
        for name, kind in _PLAYBACK.items():
            if not isinstance(data[name], kind):
                raise TypeError(f"{name} {data[name]!r}")
        before = self.playbacks.get(part.name)
        if before is None or not before["completed"] or data["completed"] or data["error"]:
            self.playbacks[part.name] = data

    def check_rated(self, data: Mapping[str, Any], flow: Flow) -> None:
        """Check that an answer could be taken, and that it counts as the rules say."""
        if unfelt := self._list_unfelt():
            raise ValueError(
                f"rates trial {self.trial.number}, of which {', '.join(unfelt)} was not felt to its end"
            )
        self._check_values(data["values"])
        flags = self._list_flags()
        if data["response_time_s"] < flow.min_response_s:
            flags.append("too_fast")
        self._check_flags(data, flags)
        rejected = not set(flow.reject).isdisjoint(flags)
        if data["rejected"] is not rejected:
            raise ValueError(
                f"has rejected {data['rejected']!r}, the rules of the plan say {rejected}"
            )

    def check_spoiled(self, data: Mapping[str, Any]) -> None:
        """Check that an attempt had to end without an answer."""
        flags = self._list_flags()
        if self.trial.timing == "strict" and self._list_unfelt():
            flags.append("not_felt")
        if _ENDS_UNANSWERED.isdisjoint(flags):
            raise ValueError(f"spoils trial {self.trial.number}, with which nothing was wrong")
        self._check_flags(data, flags)

    def _list_unfelt(self) -> list[str]:
        felt = {
            name for name, data in self.playbacks.items() if data["completed"] and not data["error"]
        }
        return [part.name for part in self.trial.parts if part.name not in felt]

    def _list_flags(self) -> list[str]:
        fields = {"underrun": "underruns", "clipped": "clipped", "device_error": "error"}
        return [
            flag
            for flag, name in fields.items()
            if any(data[name] for data in self.playbacks.values())
        ]

    def _check_values(self, values: Mapping[str, Any]) -> None:
        judged = [judgement.part for judgement in self.trial.judgements]
        if sorted(values) != sorted(judged):
            got, asked = (", ".join(names) or "nothing" for names in (values, judged))
            raise ValueError(f"rates {got}, trial {self.trial.number} asks for {asked}")
        choices = PROTOCOLS[self.trial.protocol].choices
        low, high = RATING_RANGE
        for part, value in values.items():
            if (
                value not in choices
                if choices
                else not (isinstance(value, float) and low <= value <= high)
            ):
                allowed = ", ".join(choices) or f"{low:g} to {high:g} points"
                raise ValueError(f"has {value!r} for {part}, allowed: {allowed}")

    def _check_flags(self, data: Mapping[str, Any], flags: list[str]) -> None:
        if sorted(data["flags"]) != sorted(flags):
            raise ValueError(
                f"has flags {data['flags']}, by what was felt and answered they are {flags}"
            )


# The steps of a session, in order, against what the plan, the rules and the engine allow in that place.

MALFORMED = (AttributeError, LookupError, TypeError)
"""What reading a record raises that holds other fields, or other types, than feel321 writes."""

MENDING = frozenset({"clock_stepped", "recovered"})
"""What opening a journal may add at any place."""

_OF_ATTEMPT = frozenset({"played", "prompted"}) | {
    "replayed",
    "moved",
    "refused",
    "rated",
    "spoiled",
    "paused",
    "continued",
}
_OF_SESSION = frozenset({
    "page",
    "shown",
    "finished",
    "aborted",
    "resumed",
    "warm_up",
    "superseded",
    "released",
}) | {"device"}

_NEXT = {
    # A session whose header a crash prevented may be given up.
    "": frozenset({"begun", "released"}),
    "begun": _OF_ATTEMPT | _OF_SESSION,
    # A crash may keep the end from the ledger; then the lab is opened once more, and Ctrl-C may come.
    "finished": frozenset({"aborted", "device"}),
    # A crash may come before the next session is begun, and nobody come back.
    "superseded": frozenset({"released"}),
    "released": frozenset(),
}
"""What may follow after each event that changes what may."""


def audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Compare what happened, in order, with what the plan and the rules have in that place."""
    try:
        course = _Course(plan)
    except (*MALFORMED, ValueError) as error:
        yield f": its plan is none to work through ({error!r})"
        return
    for record in records:
        try:
            course.follow(record)
        except ValueError as error:
            yield f", line {record.sequence + 1}: {error}"
            return
        except MALFORMED:
            yield f", line {record.sequence + 1}: is no {record.event!r} record as feel321 writes them"
            return


class _Course:
    """A session, followed record by record."""

    def __init__(self, plan: Plan) -> None:
        self._agenda = Agenda(plan.trials, plan.flow)
        self._flow = plan.flow
        self._trials = {trial.number: trial for trial in plan.trials}
        self._attempt: Attempt | None = None
        self._state = ""

    def follow(self, record: Record) -> None:
        event, data = record.event, record.data
        if event in MENDING:
            return
        self._check_place(event)
        if not isinstance(data.get("time_s", 0.0), Real):
            raise TypeError(event)
        if event in _OF_ATTEMPT:
            self._follow_attempt(event, data)
        else:
            self._attempt = None  # Whatever was not answered by then never was.
            self._follow_session(event, data)
        tell(self._agenda, record, self._trials)

    def _check_place(self, event: str) -> None:
        if event not in _OF_ATTEMPT | _OF_SESSION | {"begun"}:
            raise ValueError(f"holds {event!r}, which no session writes")
        if event not in _NEXT[self._state]:
            place = f"after {self._state!r}" if self._state else "first"
            raise ValueError(f"holds {event!r}, which cannot come {place}")
        if event in _NEXT:
            self._state = event

    def _follow_attempt(self, event: str, data: Mapping[str, Any]) -> None:
        attempt = self._attempt
        if attempt is None or (data["trial"], data["attempt"]) != (
            attempt.trial.number,
            attempt.number,
        ):
            raise ValueError(
                f"{event!r} of trial {data['trial']}, attempt {data['attempt']}, which was not shown"
            )
        match event:
            case "played" | "prompted":
                attempt.take(event, data)
            case "rated":
                attempt.check_rated(data, self._flow)
                self._attempt = None
            case "spoiled":
                attempt.check_spoiled(data)
                self._attempt = None
            case "paused":
                attempt.playbacks.clear()  # It is shown again before it goes on.

    def _follow_session(self, event: str, data: Mapping[str, Any]) -> None:
        step = self._agenda.ask()
        match event:
            case "shown":
                self._attempt = self._show(data)
            case "page" if (
                isinstance(step, Page)
                and step.key == data["key"]
                and data["stood_s"] < step.least_s
            ):
                raise ValueError(
                    f"page {step.key!r} stood for {data['stood_s']:g} s, {step.least_s:g} s are due"
                )
            case "finished":
                self._finish(data)

    def _show(self, data: Mapping[str, Any]) -> Attempt:
        step = self._agenda.ask()
        number = self._agenda.attempt(step.number) if isinstance(step, Trial) else 0
        if not isinstance(step, Trial) or (data["trial"], data["attempt"]) != (step.number, number):
            raise ValueError(
                f"shows trial {data['trial']}, attempt {data['attempt']}, which was not next"
            )
        return Attempt(step, number)

    def _finish(self, data: Mapping[str, Any]) -> None:
        agenda = self._agenda
        if agenda.ask() is not None:
            raise ValueError(f"finished after {agenda.done} of {agenda.total} trials")
        if (data["trials"], data["given_up"]) != (agenda.done, agenda.given_up):
            raise ValueError(
                f"finished with {data['trials']} trials, {data['given_up']} of them given up; "
                f"the journal holds {agenda.done} and {agenda.given_up}"
            )


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
            yield from (
                f"{path}{finding}" for finding in _audit_journal(chains[path], plan, name=path.name)
            )
    yield from _audit_succession(list_journals(folder), chains)


def _audit_journal(chain: Chain, plan: Plan, *, name: str) -> Iterator[str]:
    if chain.torn:
        yield f": ends in {len(chain.torn)} bytes of a line that was never finished; resuming moves them aside"
    header = find_header(chain.records)
    if header is None:
        # A crash may have come before it, and nobody come back.
        if not {record.event for record in chain.records} <= MENDING | {"released"}:
            yield ": has no header"
        return
    try:
        yield from _audit_header(header, plan, name=name)
        yield from _audit_times(chain.records)
    except (*MALFORMED, ValueError):
        yield ": has a header or a time of day that is none as feel321 writes them"
        return
    yield from audit_steps(chain.records, plan)


def _audit_header(header: Mapping[str, Any], plan: Plan, *, name: str) -> Iterator[str]:
    if (header["participant"], name_journal(header["session"])) != (plan.participant, name):
        yield f": is session {header['session']} of {header['participant']!r}, it was copied here"
    if header["plan_sha256"] != plan.sha256:
        yield ": was begun with another plan than the one beside it"


def _audit_times(records: Sequence[Record]) -> Iterator[str]:
    for before, record in pairwise(records):
        if (
            datetime.fromisoformat(record.utc) < datetime.fromisoformat(before.utc)
            and record.event != "clock_stepped"
        ):
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"


def _audit_succession(journals: Sequence[Path], chains: Mapping[Path, Chain]) -> Iterator[str]:
    """Demand that sessions are numbered on, and that each but the newest says which one took its place."""
    for session, path in enumerate(journals, start=1):
        if path.name != name_journal(session):
            yield f"{path}: is there without {name_journal(session)} before it"
            return
    for session, path in enumerate(journals[:-1], start=2):
        if path in chains and not any(
            record.event == "superseded" and record.data.get("by") == session
            for record in chains[path].records
        ):
            yield f"{path}: says nothing of {name_journal(session)}, which stands beside it"


# What the ledger says of a participant against the journals, besides what is lost.

_UNNOTED = frozenset({*OPENING_EVENTS, "begun", "warm_up", "aborted", "superseded", "released"})
"""What a session may hold that came to no note: one that ended in its opening."""


def read_entries(study: StudyFolder) -> dict[str, Entry]:
    """Read what the ledger knows, by participant."""
    try:
        return {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError):
        return {}


def audit_entry(study: StudyFolder, folder: Path, entry: Entry) -> Iterator[str]:
    """Compare what the ledger says of one participant with the journals."""
    try:
        dossier = read_dossier(folder)
        reached = max(
            (replay(dossier.plan, chain.records).done for chain in dossier.chains), default=0
        )
    except (*MALFORMED, OSError, ValueError):
        return
    rebuild = f"rebuild it: feel321 ledger {quote(str(study.path))} --rebuild"
    total = sum(trial.phase == "main" for trial in dossier.plan.trials)
    for path, lines in _find_unnoted(entry, dossier):
        yield f"{study.ledger}: {entry.participant} has no note of {path.name}, which has {lines} lines; {rebuild}"
    if any(find_cut(anchor, folder) for anchor in entry.anchors):
        return  # Of what is lost, `find_lost` tells.
    if entry.done > reached:
        yield f"{study.ledger}: {entry.participant} has done {entry.done}, the journals say {reached}; {rebuild}"
    if entry.total not in {0, total}:
        yield f"{study.ledger}: {entry.participant} has total {entry.total}, the plan says {total}; {rebuild}"


def _find_unnoted(entry: Entry, dossier: Dossier) -> Iterator[tuple[Path, int]]:
    noted = {anchor.journal for anchor in entry.anchors}
    for path, chain in zip(list_journals(dossier.folder), dossier.chains, strict=True):
        if path.name not in noted and _is_noteworthy(chain.records):
            yield path, len(chain.records)


def _is_noteworthy(records: Iterable[Record]) -> bool:
    return not {record.event for record in records} <= _UNNOTED


# Whether what lies in a study is what was once written there: plans, journals, stimuli, ledger.


def audit_study(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Verify all plans, journals and stimuli of a study, and what the ledger says of them."""
    findings = [
        f"{path}: is no participant's folder; move it out of {study.sessions}"
        for path in study.strangers
    ]
    folders = study.participants
    stimuli_sha256 = None
    if folders or study.stimuli.exists():
        problems, stimuli_sha256 = _audit_stimuli(study.stimuli)
        findings += problems
    entries = read_entries(study)
    for done, folder in enumerate(folders, start=1):
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
        rows = read_origin(folder).rows
    except ValueError as error:
        return [*findings, str(error)], stimuli.sha256
    # An earlier version wrote fewer columns.
    listed = [{**dict.fromkeys(FURTHER), **row} for row in rows]
    same = json.dumps(listed, sort_keys=True) == json.dumps(
        [*map(describe_row, stimuli.stimuli)], sort_keys=True
    )
    if not same:
        findings.append(
            f"{folder}: manifest.csv and manifest.json differ; one was changed, build the set again"
        )
    return findings, stimuli.sha256


def _audit_participant(folder: Path, stimuli_sha256: str | None) -> Iterator[str]:
    if (folder / TOMBSTONE_FILE).exists():
        # Whether the withdrawal was finished is the ledger's business.
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
