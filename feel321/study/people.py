"""Participants, read from plans, journals and tombstones: how far they are, on which rig; and `participants.csv`."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from shlex import quote
from typing import Any

from feel321.files import write_table, write_text
from feel321.study.folder import (
    LAST_PARTICIPANT_COLUMNS,
    PARTICIPANT_COLUMNS,
    StudyFolder,
    name_all,
)
from feel321.study.session import events
from feel321.study.session import plan as plans
from feel321.study.session.journal import Anchor, Chain, Records, digest
from feel321.study.thresholds import list_columns, read_thresholds

ROSTER_FILE = "participants.csv"

REMOVING, REMOVED = "removing", "removed"
"""States of a withdrawal: begun, and finished."""

LOCK_FILE = ".lock"
"""Held while a session runs or a participant leaves."""


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
    """Write a tombstone and seal it with its digest, replacing the one that is there."""
    entry = asdict(tombstone)
    sealed = entry | {"sha256": digest(json.dumps(entry, sort_keys=True))}
    text = json.dumps(sealed, indent=1, ensure_ascii=False)
    write_text(folder / plans.TOMBSTONE_FILE, f"{text}\n", private=True)


def read_tombstone(folder: Path) -> Tombstone | None:
    """Read a tombstone, if there is one."""
    path = folder / plans.TOMBSTONE_FILE
    if not path.exists():
        return None
    try:
        entry = json.loads(path.read_bytes())
        is_sealed = entry.pop("sha256") == digest(json.dumps(entry, sort_keys=True))
        journals = tuple(Anchor(**anchor) for anchor in entry["journals"])
        tombstone = Tombstone(**entry | {"journals": journals})
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        is_sealed, tombstone = False, None
    if not is_sealed:
        raise ValueError(
            f"{path}: not a tombstone, or changed after it was written; restore the file from a copy"
        )
    return tombstone


def find_leftovers(folder: Path) -> list[str]:
    """Find what lies beside a tombstone: no data of someone who withdrew may stay, or come back with a copy."""
    if (stone := read_tombstone(folder)) is None:
        return []
    if stone.state == REMOVING:
        again = f"feel321 withdraw {quote(str(folder.parents[1]))} --participant {folder.name}"
        return [f"{folder}: the withdrawal was interrupted; finish it: {again}"]
    kept = {folder / plans.TOMBSTONE_FILE, folder / LOCK_FILE}
    files = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    return [
        f"{path}: lies beside a tombstone, the participant withdrew; remove it"
        for path in sorted(files - kept)
    ]


# Rigs.


LETTERS = 12
"""Of a rig's digest, where it is shown."""

ESTIMATED = "latency"
"""How an onset was got (`dac_source`) where the device gave no time of it: `actuator.device.FROM_LATENCY`."""


@dataclass(frozen=True, slots=True)
class RigUse:
    """The rig of one session: first letters of its digest, the id of its certificate, or `uncalibrated`.

    changes: accepted in mid-session (`run --accept-rig`); estimated: onset times that the device did not give.
    """

    participant: str
    rig: str = ""
    calibration: str = ""
    changes: tuple[str, ...] = ()
    estimated: int = 0


def find_rig_use(participant: str, records: Records) -> RigUse:
    """Find on which rig a session was held, as it was left; simulated participants have none."""
    if (header := records.find_header()) is None:
        return RigUse(participant)
    rig = header.identity.get("presenter", {}).get("rig")
    calibration, changes = header.identity.get("calibration"), []
    for event in records.find(events.RigAccepted):
        rig, calibration = event.rig, event.calibration
        changes += event.changes
    played = (one for one in records if one.event == events.PartPlayed.event)
    return RigUse(
        participant,
        rig=digest_settings(json.dumps(rig, sort_keys=True))[:LETTERS] if rig else "",
        calibration=calibration["id"] if isinstance(calibration, dict) else calibration or "",
        changes=tuple(changes),
        estimated=sum(one.data.get("dac_source") == ESTIMATED for one in played),
    )


@cache
def digest_settings(text: str) -> str:
    """Make the digest of a rig from its settings as a journal's header holds them, in JSON."""
    from feel321.study.actuator.rig import Rig
    from feel321.study.actuator.rig import digest as digest_rig

    try:
        return digest_rig(Rig.model_validate_json(text))
    except (ValueError, OverflowError):  # of another version
        return digest(text)


def describe_rigs(uses: Iterable[RigUse]) -> Iterator[str]:
    """Describe who was on another rig or certificate than most, whose rig was changed, whose onsets are estimates."""
    used = [use for use in uses if use.rig]
    rigs = Counter(use.rig for use in used)
    usual = max(rigs, key=lambda one: rigs[one], default="")
    for what, values in (
        ("rig", {use.participant: use.rig for use in used}),
        ("certificate", {use.participant: use.calibration for use in used if use.rig == usual}),
    ):
        counts = Counter(
            values.values()
        )  # of several that are as frequent, the first counts as usual
        most = max(counts, key=lambda one: counts[one], default="")
        for odd in sorted(set(counts) - {most}):
            who = ", ".join(name for name, value in values.items() if value == odd)
            others = f"the other {counts[most]} ({most or 'none'})"
            yield f"{who}: another {what} ({odd or 'none'}) than {others}"
    for use in used:
        if use.changes:
            yield f"{use.participant}: the rig was changed in mid-session ({'; '.join(use.changes)})"
    for use in used:
        if use.estimated:
            yield f"{use.participant}: {use.estimated} onset times are estimated from the latency: the device gave none"


# Progress and `participants.csv`.


@dataclass(frozen=True, slots=True)
class Note:
    """A note of the experimenter, and when it was taken."""

    utc: str
    text: str


def list_notes(chains: Iterable[Chain]) -> Iterator[Note]:
    """List the notes in all journals of a participant, in order."""
    for record in (one for chain in chains for one in chain.records):
        if record.event == events.NoteTaken.event:
            yield Note(record.utc, str(record.data.get("text", "")))


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a participant is, by plan and journals."""

    participant: str
    simulated: bool
    number: int
    groups: Mapping[str, str]
    total: int
    answered: int = 0
    given_up: int = 0
    state: str = "claimed"
    sessions: int = 0
    first_utc: str = ""
    last_utc: str = ""
    rated_utc: str = ""
    training_passed: bool | None = None
    rig: str = ""
    calibration: str = ""
    estimated: int = 0
    problem: str = ""
    thresholds: Mapping[str, float | str] = field(default_factory=dict)


def list_progress(study: StudyFolder) -> list[Progress]:
    """Read the progress of all participants who have a plan or a journal and did not withdraw."""
    return name_all(partial(read_progress, read=study.read_person), study.planned)


def read_progress(
    folder: Path, read: Callable[[Path], plans.Dossier] = plans.read_dossier
) -> Progress:
    """Read the progress of one participant, also while a session runs."""
    try:
        return make_progress(read(folder))
    except ValueError as error:
        # A broken plan raises again; of a broken journal the plan still says who it is.
        planned = make_progress(plans.Dossier(folder, plans.require_own_plan(folder), ()))
        return replace(planned, state="running", problem=str(error))


def make_progress(dossier: plans.Dossier) -> Progress:
    """Derive the progress of one participant from plan and journals."""
    plan, newest = dossier.plan, dossier.records
    records = [record for chain in dossier.chains for record in chain.records]
    times = [record.utc for record in records if record.event != events.NoteTaken.event]
    rated = (one.utc for one in records if one.event == events.TrialRated.event)
    with plans.read_as_written(dossier.newest):
        use = find_rig_use(plan.participant, newest)
        agenda = plans.replay(plan, newest)
        pages = {page.key for page in newest.find(events.PageRead)}
        return Progress(
            participant=plan.participant,
            simulated=plan.simulated,
            number=plan.number,
            groups=plan.groups,
            total=sum(trial.phase == "main" for trial in plan.trials),
            answered=agenda.answered,
            given_up=agenda.given_up,
            state=_find_state(newest),
            sessions=len(dossier.chains),
            first_utc=times[0] if times else "",
            last_utc=times[-1] if times else "",
            rated_utc=max(rated, default=""),
            training_passed="training_failed" not in pages
            if pages & {"training_failed", "training_passed"}
            else None,
            rig=use.rig,
            calibration=use.calibration,
            estimated=use.estimated,
            thresholds=list_columns(read_thresholds(plan, newest)),
        )


def _find_state(records: Records) -> str:
    """Find the state in which a session was left, by its newest journal."""
    for kind in (events.SessionReleased, events.SessionFinished):
        if records.has(kind):
            return kind.event
    return "running" if records.find_header() else "claimed"


def note_estimates(everybody: Iterable[Progress]) -> Iterator[str]:
    """Say whose onset times the device did not give, for the report."""
    if estimated := [f"{one.participant} ({one.estimated})" for one in everybody if one.estimated]:
        yield (
            f"Onset times of participants {', '.join(estimated)} are estimated from the latency: their device gave "
            "none."
        )


def note_given_up(everybody: Iterable[Progress]) -> Iterator[str]:
    """Say who gave up trials, for the report: they have no rating."""
    if gone := [f"{one.participant} ({one.given_up})" for one in everybody if one.given_up]:
        yield f"Trials without a valid answer after all attempts, of participants {', '.join(gone)}: no ratings."


def write_roster(study: StudyFolder, everybody: Sequence[Progress] | None = None) -> Path:
    """Write `participants.csv`: one row per participant, without those who withdrew."""
    everybody = list_progress(study) if everybody is None else everybody
    if problems := [one.problem for one in everybody if one.problem]:
        raise ValueError("\n".join(problems))
    write_table(study.path / ROSTER_FILE, *list_roster(everybody), private=True)
    study.share(study.path / ROSTER_FILE)
    return study.path / ROSTER_FILE


def list_roster(everybody: Sequence[Progress]) -> tuple[list[str], list[dict[str, Any]]]:
    """List the columns and rows of `participants.csv`."""
    factors = dict.fromkeys(factor for progress in everybody for factor in progress.groups)
    measured = dict.fromkeys(name for progress in everybody for name in progress.thresholds)
    columns = [*PARTICIPANT_COLUMNS, *factors, *LAST_PARTICIPANT_COLUMNS, *measured]
    rows = []
    flags = {True: "true", False: "false", None: ""}
    for progress in everybody:
        row = {name: getattr(progress, name) for name in Progress.__slots__}
        row |= {**progress.groups, **progress.thresholds}
        row |= {name: flags[row[name]] for name in ("simulated", "training_passed")}
        rows.append(row)
    return columns, rows
