"""Participants: who has which number in the design, how far they are, on which rig; and `participants.csv`.

All is read from plans, journals and tombstones. A number, from 1, is taken as long as the plan is there, and free again
once its participant was released or withdrew; one lock gives the next. Simulated and real people are counted apart.
Stations give numbers of fixed shares, so that they need not ask each other.
"""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from itertools import count
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, TypeVar

from feel321.files import hold_lock, make_folder, write_text
from feel321.study import folder as folders
from feel321.study.session import events
from feel321.study.session import plan as plans
from feel321.study.session.journal import Anchor, Records, digest, list_journals
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, Plan, create_plan
from feel321.study.thresholds import list_columns, read_thresholds

T = TypeVar("T")

ROSTER_FILE = "participants.csv"
LOCK_FILE = ".lock"  # held while a session runs or a participant leaves

# States of a number, and of a withdrawal: begun, and finished.
PLANNED, RELEASED, WITHDRAWN = "planned", "released", "withdrawn"
REMOVING, REMOVED = "removing", "removed"

PATIENCE_S = 60.0  # how long others are waited for that plan sessions
LETTERS = 12  # of a rig's digest, where it is shown
ESTIMATED = "latency"
"""How an onset was got (`dac_source`) where the device gave no time of it: `actuator.device.FROM_LATENCY`."""

# The head of a plan or tombstone, and what a journal holds of somebody who was released.
_HEAD = re.compile(
    rb'"participant": "([^"]+)",\s*"number": (\d+),\s*"simulated": (true|false)', re.ASCII
)
_HEAD_BYTES = 600
_RELEASED = f'"event": "{events.SessionReleased.event}"'.encode()


def write_sealed(path: Path, entry: Mapping[str, Any], *, private: bool = False) -> str:
    """Write a JSON file that holds the digest of itself, which is returned."""
    sha256 = digest(json.dumps(entry, sort_keys=True))
    text = json.dumps({**entry, "sha256": sha256}, indent=1, ensure_ascii=False)
    write_text(path, f"{text}\n", private=private)
    return sha256


def read_sealed(path: Path, make: Callable[[dict[str, Any]], T]) -> T | None:
    """Read a file of `write_sealed`, if it is there, and make a record of it; an edited one is refused."""
    if not path.exists():
        return None
    try:
        entry = json.loads(path.read_bytes())
        if entry.pop("sha256") == digest(json.dumps(entry, sort_keys=True)):
            return make(entry)
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        pass
    raise ValueError(
        f"{path}: changed after it was written (its SHA-256 does not match), or not a file of feel321; restore it from "
        "a copy"
    )


@dataclass(frozen=True, slots=True)
class Tombstone:
    """What stays of a participant who withdrew: a code that is not used again, and digests of what was removed."""

    participant: str
    number: int
    simulated: bool
    utc: str
    reason: str
    journals: tuple[Anchor, ...]
    state: str


def write_tombstone(folder: Path, tombstone: Tombstone) -> None:
    """Write a tombstone, replacing the one that is there."""
    write_sealed(folder / TOMBSTONE_FILE, asdict(tombstone), private=True)


def read_tombstone(folder: Path) -> Tombstone | None:
    """Read a tombstone, if there is one."""

    def make(entry: dict[str, Any]) -> Tombstone:
        anchors = tuple(Anchor(**anchor) for anchor in entry["journals"])
        return Tombstone(**entry | {"journals": anchors})

    return read_sealed(folder / TOMBSTONE_FILE, make)


def find_leftovers(folder: Path) -> list[str]:
    """Find what lies beside a tombstone: no data of someone who withdrew may stay, or come back with a copy."""
    if (stone := read_tombstone(folder)) is None:
        return []
    if stone.state == REMOVING:
        again = f"feel321 withdraw {quote(str(folder.parents[1]))} --participant {folder.name}"
        return [f"{folder}: the withdrawal was interrupted; finish it: {again}"]
    kept = {folder / TOMBSTONE_FILE, folder / LOCK_FILE}
    files = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    said = "lies beside a tombstone, the participant withdrew; remove it"
    return [f"{path}: {said}" for path in sorted(files - kept)]


# Numbers in the design.


@dataclass(frozen=True, slots=True)
class Holder:
    """Who has a number in the design, or had it before being released or withdrawn."""

    participant: str
    number: int
    simulated: bool
    state: str = PLANNED

    def keep(self, *, simulated: bool) -> int:
        """Keep the number of someone who comes back."""
        who = f"participant {self.participant}"
        if self.state != PLANNED:
            raise ValueError(f"{who}: was {self.state}; no code is used twice, use another")
        if self.simulated != simulated:
            got, known = ("simulated", "real") if simulated else ("real", "simulated")
            text = f"was planned as a {known} one, got a {got} one; use another code"
            raise ValueError(f"{who}: {text}")
        return self.number


class Station(NamedTuple):
    """The numbers that a station gives: of every `of` blocks the `this`-th, from 1; a block has one of each group."""

    this: int = 1
    of: int = 1
    block: int = 1

    def has(self, number: int) -> bool:
        """Check whether a number is this station's to give."""
        return (number - 1) // self.block % self.of == self.this - 1


def read_holder(folder: Path) -> Holder | None:
    """Read the number of a participant's folder from its plan or tombstone; None if nothing was planned there."""
    state = WITHDRAWN if (folder / TOMBSTONE_FILE).exists() else PLANNED
    path = folder / (TOMBSTONE_FILE if state == WITHDRAWN else PLAN_FILE)
    journals = list_journals(folder)
    if not (path.exists() or journals):
        return None
    head = b""
    if path.exists():
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    if not (found := _HEAD.search(head)):
        raise ValueError(
            f"{path}: is missing or damaged, so the participant's number is unknown; restore the file from a copy"
        )
    if state == PLANNED and journals:
        whole, _, _torn = journals[-1].read_bytes().rpartition(b"\n")  # torn: never acknowledged
        state = RELEASED if _RELEASED in whole else PLANNED
    return Holder(folder.name, int(found[2]), found[3] == b"true", state)


def read_holders(study: folders.StudyFolder) -> list[Holder]:
    """Read the numbers of everybody who was ever planned here."""
    return [one for one in map(read_holder, study.participants) if one]


def find_doubles(holders: Iterable[Holder]) -> Iterator[str]:
    """Find numbers that several participants have, and codes that differ in capitals only."""
    named: dict[str, list[str]] = defaultdict(list)
    for one in holders:
        named[f"the code {one.participant.lower()!r}, but for capitals"].append(one.participant)
        if one.state == PLANNED:
            kind = "of simulated ones" if one.simulated else "in the design"
            named[f"number {one.number} {kind}"].append(one.participant)
    for what, names in named.items():
        if len(names) > 1:
            yield f"{what} is that of {' and '.join(names)}; release one, or move its folder away"


def hold_numbers(study: folders.StudyFolder) -> AbstractContextManager[None]:
    """Keep all other processes from giving numbers in this study."""
    busy = "others are planning sessions here; try again"
    return hold_lock(study.sessions / ".numbers.lock", busy=busy, wait_s=PATIENCE_S)


def plan_participants(
    study: folders.StudyFolder,
    names: Sequence[str],
    make: Callable[[str, int], Plan],
    *,
    simulated: bool,
    station: Station,
) -> list[Plan]:
    """Store plans under the lowest free numbers; whoever was planned keeps the number and the plan that is stored."""
    study.make_sessions()
    # Who has a plan waits for nobody, and for no damaged plan of somebody else.
    present = {folder.name: folder for folder in study.participants}
    own = {name: read_holder(present[name]) if name in present else None for name in names}
    if all(own.values()):
        return [make(name, one.keep(simulated=simulated)) for name, one in own.items() if one]
    with hold_numbers(study):
        known = {one.participant: one for one in read_holders(study)}
        kept = [one for one in known.values() if one.state == PLANNED]
        taken = {one.number for one in kept if one.simulated == simulated}
        free = (number for number in count(1) if station.has(number) and number not in taken)
        folded: dict[str, str] = {}
        for name in (*known, *names):  # on many systems they name one folder
            if (other := folded.setdefault(name.lower(), name)) != name:
                text = f"differs from {other} in capitals only; use another code"
                raise ValueError(f"participant {name}: {text}")
        planned = [
            make(name, known[name].keep(simulated=simulated) if name in known else next(free))
            for name in dict.fromkeys(names)
        ]
        for plan in (one for one in planned if one.participant not in known):
            folder = study.sessions / plan.participant
            make_folder(folder, private=True)
            create_plan(folder / PLAN_FILE, plan)
    return planned


# How far participants are.


@dataclass(frozen=True, slots=True)
class Note:
    """A note of the experimenter, and when it was taken."""

    utc: str
    text: str


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a participant is, by plan and journals.

    rig: first letters of its digest; calibration: the id of its certificate, or `uncalibrated`; rig_changes: accepted
    in mid-session; estimated: onset times that the device did not give. left_min: minutes that are left; None of those
    who do not go on. problem: why nothing is known.
    """

    participant: str
    state: str = ""
    number: int = 0
    groups: Mapping[str, str] = field(default_factory=dict)
    answered: int = 0
    given_up: int = 0
    left: int = 0
    total: int = 0
    simulated: bool = False
    sessions: int = 0
    first_activity: str = ""
    last_activity: str = ""
    last_rated: str = ""
    training_passed: bool | None = None
    rig: str = ""
    calibration: str = ""
    rig_changes: tuple[str, ...] = ()
    estimated: int = 0
    thresholds: Mapping[str, float | str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    left_min: float | None = None
    problem: str = ""

    @property
    def done(self) -> int:
        """Trials that need no further attempt."""
        return self.answered + self.given_up


def list_progress(study: folders.StudyFolder) -> list[Progress]:
    """Read the progress of all participants who have a plan or a journal and did not withdraw."""
    return folders.name_all(lambda one: make_progress(study.read_person(one)), study.planned)


def make_progress(dossier: plans.Dossier) -> Progress:
    """Derive the progress of one participant from plan and journals."""
    plan, newest = dossier.plan, dossier.records
    records = [record for chain in dossier.chains for record in chain.records]
    noted = [one for one in records if one.event == events.NoteTaken.event]
    times = [one.utc for one in records if one.event != events.NoteTaken.event]
    with plans.read_as_written(dossier.newest):
        agenda = plans.replay(plan, newest)
        pages = {page.key for page in newest.find(events.PageRead)}
        trained = pages & {"training_failed", "training_passed"}
        total = sum(trial.phase == "main" for trial in plan.trials)
        state = "running" if newest.find_header() else "claimed"
        for end in (events.SessionFinished, events.SessionReleased):
            state = end.event if newest.has(end) else state
        return Progress(
            participant=plan.participant,
            state=state,
            number=plan.number,
            groups=plan.groups,
            answered=agenda.answered,
            given_up=agenda.given_up,
            left=total - agenda.answered - agenda.given_up,
            total=total,
            simulated=plan.simulated,
            sessions=len(dossier.chains),
            first_activity=times[0] if times else "",
            last_activity=times[-1] if times else "",
            last_rated=max(
                (one.utc for one in records if one.event == events.TrialRated.event), default=""
            ),
            training_passed="training_failed" not in trained if trained else None,
            thresholds=list_columns(read_thresholds(plan, newest)),
            notes=tuple(Note(one.utc, str(one.data.get("text", ""))) for one in noted),
            **_find_rig(newest),
        )


def _find_rig(records: Records) -> dict[str, Any]:
    """Find on which rig a session was held, as it was left; simulated participants have none."""
    if (header := records.find_header()) is None:
        return {}
    rig = header.identity.get("presenter", {}).get("rig")
    calibration, changes = header.identity.get("calibration"), []
    for event in records.find(events.RigAccepted):
        rig, calibration = event.rig, event.calibration
        changes += event.changes
    played = [one.data for one in records if one.event == events.PartPlayed.event]
    return {
        "rig": _digest_rig(rig)[:LETTERS] if rig else "",
        "calibration": calibration["id"] if isinstance(calibration, dict) else calibration or "",
        "rig_changes": tuple(changes),
        "estimated": sum(one.get("dac_source") == ESTIMATED for one in played),
    }


def _digest_rig(rig: Mapping[str, Any]) -> str:
    """Make the digest that a certificate names, `actuator.rig.digest`, of a rig as a header holds it."""

    def drop(entry: Any) -> Any:  # noqa: ANN401 - what JSON holds
        if isinstance(entry, list):
            return [drop(one) for one in entry]
        known = entry.items() if isinstance(entry, dict) else ()
        found = {key: drop(one) for key, one in known if one is not None and key != "latency_s"}
        return found if isinstance(entry, dict) else entry

    own = {name: rig.get(name) for name in ("device", "actuators")}
    return digest(json.dumps(drop(own), sort_keys=True))


def describe_rigs(everybody: Iterable[Progress]) -> Iterator[str]:
    """Describe who was on another rig or certificate than most, whose rig was changed, whose onsets are estimates."""
    used = [one for one in everybody if one.rig]
    usual = Counter(one.rig for one in used).most_common(1)  # of several, the first is usual
    same = [one for one in used if one.rig in dict(usual)]
    for what, name, people in (("rig", "rig", used), ("certificate", "calibration", same)):
        values = {one.participant: getattr(one, name) for one in people}
        ranked = Counter(values.values()).most_common()
        for odd, _ in sorted(ranked[1:]):
            who = ", ".join(one for one, value in values.items() if value == odd)
            others = f"the other {ranked[0][1]} ({ranked[0][0] or 'none'})"
            yield f"{who}: another {what} ({odd or 'none'}) than {others}"
    for one in used:
        if one.rig_changes:
            said = "; ".join(one.rig_changes)
            yield f"{one.participant}: the rig was changed in mid-session ({said})"
        if one.estimated:
            said = f"{one.estimated} onset times are estimated from the latency"
            yield f"{one.participant}: {said}: the device gave none"


def list_remarks(everybody: Iterable[Progress]) -> Iterator[str]:
    """List whose onset times the device did not give, and who gave up trials, for the report."""
    for name, text in (
        ("estimated", "Onset times of participants {} are estimated from the latency: their device gave none."),
        ("given_up", "Trials without a valid answer after all attempts, of participants {}: no ratings."),
    ):  # fmt: skip
        known = [(one.participant, getattr(one, name)) for one in everybody]
        if some := ", ".join(f"{who} ({count})" for who, count in known if count):
            yield text.format(some)


def write_roster(study: folders.StudyFolder, everybody: Sequence[Progress] | None = None) -> Path:
    """Write `participants.csv`: one row per participant, without those who withdrew."""
    everybody = list_progress(study) if everybody is None else everybody
    return study.write_table(ROSTER_FILE, *list_roster(everybody))


def list_roster(everybody: Sequence[Progress]) -> tuple[list[str], list[dict[str, Any]]]:
    """List the columns and rows of `participants.csv`."""
    factors = dict.fromkeys(factor for one in everybody for factor in one.groups)
    measured = dict.fromkeys(name for one in everybody for name in one.thresholds)
    columns = [*folders.PARTICIPANT_COLUMNS, *factors, *folders.LAST_PARTICIPANT_COLUMNS, *measured]
    rows, flags = [], {True: "true", False: "false", None: ""}
    for one in everybody:
        row: dict[str, Any] = {name: getattr(one, name, "") for name in columns}
        row |= {"first_utc": one.first_activity, "last_utc": one.last_activity}
        row |= {name: flags[row[name]] for name in ("simulated", "training_passed")}
        rows.append(row | {**one.groups, **one.thresholds})
    return columns, rows
