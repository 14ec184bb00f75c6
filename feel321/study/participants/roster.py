"""Participants, read from plans, journals and tombstones: how far they are, on which rig; and `participants.csv`."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from shlex import quote
from typing import Any, TypeVar

from feel321.files import write_table, write_text
from feel321.study import folder as folders
from feel321.study.session import events
from feel321.study.session import plan as plans
from feel321.study.session.journal import Anchor, Records, digest
from feel321.study.thresholds import list_columns, read_thresholds

T = TypeVar("T")

ROSTER_FILE = "participants.csv"

REMOVING, REMOVED = "removing", "removed"  # states of a withdrawal: begun, and finished
LOCK_FILE = ".lock"  # held while a session runs or a participant leaves
LETTERS = 12  # of a rig's digest, where it is shown

ESTIMATED = "latency"
"""How an onset was got (`dac_source`) where the device gave no time of it: `actuator.device.FROM_LATENCY`."""


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
    write_sealed(folder / plans.TOMBSTONE_FILE, asdict(tombstone), private=True)


def read_tombstone(folder: Path) -> Tombstone | None:
    """Read a tombstone, if there is one."""

    def make(entry: dict[str, Any]) -> Tombstone:
        anchors = tuple(Anchor(**anchor) for anchor in entry["journals"])
        return Tombstone(**entry | {"journals": anchors})

    return read_sealed(folder / plans.TOMBSTONE_FILE, make)


def find_leftovers(folder: Path) -> list[str]:
    """Find what lies beside a tombstone: no data of someone who withdrew may stay, or come back with a copy."""
    if (stone := read_tombstone(folder)) is None:
        return []
    if stone.state == REMOVING:
        again = f"feel321 withdraw {quote(str(folder.parents[1]))} --participant {folder.name}"
        return [f"{folder}: the withdrawal was interrupted; finish it: {again}"]
    kept = {folder / plans.TOMBSTONE_FILE, folder / LOCK_FILE}
    files = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    said = "lies beside a tombstone, the participant withdrew; remove it"
    return [f"{path}: {said}" for path in sorted(files - kept)]


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
    return {
        "rig": _digest_rig(rig)[:LETTERS] if rig else "",
        "calibration": calibration["id"] if isinstance(calibration, dict) else calibration or "",
        "rig_changes": tuple(changes),
        "estimated": sum(
            one.data.get("dac_source") == ESTIMATED
            for one in records
            if one.event == events.PartPlayed.event
        ),
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
    path = study.path / ROSTER_FILE
    write_table(path, *list_roster(everybody), private=True)
    study.share(path)
    return path


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
