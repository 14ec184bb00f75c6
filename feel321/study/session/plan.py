"""The plan of one participant: a frozen, seeded list of trials, and how far its journal got.

Its trials name stimuli by blind codes.

A stimulus is named by its recording and reducer. Plans and journals, and all that is read from them before the
analysis, hold codes instead. They are no secret, for the software turns them back; they keep those who lead a
session from learning by accident what a participant feels.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.files import create_text
from feel321.protocols.agenda import Agenda
from feel321.protocols.order import make_order, make_rehearsal
from feel321.protocols.tasks import is_as_expected
from feel321.protocols.trial import (
    Flow,
    Item,
    Judgement,
    Part,
    Task,
    Trial,
    place_in_groups,
    select_items,
    select_tasks,
)
from feel321.study.session.journal import digest

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.journal import Record

# Codes in the place of stimulus names, wherever someone looks who should not know what is felt.

LEAST_LETTERS = 6


def make_codes(stimulus_ids: Iterable[str], key: str) -> dict[str, str]:
    """Give every stimulus a code.

    Returns stimulus -> code of letters and digits.

    Examples
    --------
    >>> make_codes(["oak-dft321"], "study 321")
    {'oak-dft321': '7K6ZGV'}
    """
    digests = {name: _write_letters(f"{key}\n{name}") for name in stimulus_ids}
    letters = LEAST_LETTERS
    while len({digest[:letters] for digest in digests.values()}) < len(digests):
        letters += 1
    return {name: digest[:letters] for name, digest in digests.items()}


def _write_letters(text: str) -> str:
    return base64.b32encode(hashlib.sha256(text.encode()).digest()).decode()


# In which values two records of the same form differ, named by their keys.


def find_differences(
    old: Mapping[str, Any], new: Mapping[str, Any], *, ignore: Collection[str] = ()
) -> list[str]:
    """Say in which values two nested mappings differ.

    Examples
    --------
    >>> find_differences({"seed": 1, "rig": {"rate_hz": 48000}}, {"seed": 2, "rig": {"rate_hz": 48000}})
    ['seed 1 -> 2']
    """
    before, after = (
        _flatten({k: v for k, v in entry.items() if k not in ignore}) for entry in (old, new)
    )
    names = [name for name in before | after if before.get(name) != after.get(name)]
    return [f"{name} {before.get(name)!r} -> {after.get(name)!r}" for name in names]


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Name every value of nested mappings by its keys, joined with dots."""
    flat: dict[str, Any] = {}
    for name, value in entry.items():
        flat |= (
            _flatten(value, f"{prefix}{name}.")
            if isinstance(value, dict)
            else {f"{prefix}{name}": value}
        )
    return flat


# The plan of one participant: a frozen, seeded list of trials, stored before the first of them is shown.

PARTICIPANT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
"""What a participant may be called: it names a folder."""

FORMAT = 2
"""Form of the stored plan; a file says which one it has."""

_SEAL = b',\n "sha256": "'


@dataclass(frozen=True, slots=True)
class Design:
    """What a study decides about the sessions of all its participants.

    Parameters
    ----------
    seed : int
        Seed of every order.
    order : str
        How trials are ordered: a name in `ORDERS`.
    repeats : int
        How often each comparison is judged.
    tasks : tuple of Task
        The parts of a session, in order.
    between : mapping of str to tuple of str
        Levels of each factor in which participants differ.
    flow : Flow
        How a session goes besides its trials.
    """

    seed: int
    order: str
    repeats: int
    tasks: tuple[Task, ...]
    between: Mapping[str, tuple[str, ...]]
    flow: Flow


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that is decided about a participant's session before it begins.

    Parameters
    ----------
    participant : str
        The participant's code.
    number : int
        The participant's number in the design, from 1.
    simulated : bool
        Whether the participant is simulated.
    seed : int
        The study's seed.
    between : mapping of str to tuple of str
        Levels of each factor in which participants differ.
    groups : dict of str to str
        The participant's level of each of them.
    order : str
        How the trials were ordered.
    repeats : int
        How often each comparison is judged.
    tasks : tuple of Task
        The parts of the session, in order.
    flow : Flow
        How the session goes besides its trials.
    stimuli_sha256 : str
        The stimulus set that the trials name by codes.
    trials : tuple of Trial
        The trials: those of the main phase in order, then training and practice.
    sha256 : str
        Digest of the plan as it was stored; empty before that.
    """

    participant: str
    number: int
    simulated: bool
    seed: int
    between: Mapping[str, tuple[str, ...]]
    groups: Mapping[str, str]
    order: str
    repeats: int
    tasks: tuple[Task, ...]
    flow: Flow
    stimuli_sha256: str
    trials: tuple[Trial, ...]
    sha256: str = field(default="", compare=False)


def make_plan(
    design: Design, stimuli: StimulusSet, participant: str, *, number: int, simulated: bool
) -> Plan:
    """Plan the session of one participant; the same arguments always give the same plan.

    Parameters
    ----------
    design : Design
        What the study decides.
    stimuli : StimulusSet
        The stimuli to judge.
    participant : str
        The participant's code: letters, digits, `-` and `_`.
    number : int
        The participant's number in the design, from 1.
    simulated : bool
        Whether the participant is simulated.

    Returns
    -------
    Plan
        The plan.

    Raises
    ------
    ValueError
        If a name is not allowed, or the stimuli do not serve the tasks.
    """
    import numpy as np

    if not PARTICIPANT_ID.fullmatch(participant):
        raise ValueError(f"participant: got {participant!r}, allowed are letters, digits, - and _")
    groups, place = place_in_groups(design.between, number)
    tasks = select_tasks(design.tasks, groups)
    items = select_items(list_items(stimuli, seed=design.seed), groups)
    main = make_order(
        items,
        tasks,
        number=place,
        repeats=design.repeats,
        order=design.order,
        rng=np.random.default_rng(design.seed),
    )
    # Rehearsal is the participant's own; it may not move the orders, which balance over participants.
    rehearsal = make_rehearsal(
        items, tasks, first_number=len(main) + 1, rng=np.random.default_rng([design.seed, number])
    )
    return Plan(
        participant=participant,
        number=number,
        simulated=simulated,
        seed=design.seed,
        between=design.between,
        groups=groups,
        order=design.order,
        repeats=design.repeats,
        tasks=tasks,
        flow=design.flow,
        stimuli_sha256=stimuli.sha256,
        trials=main + rehearsal,
    )


def list_items(stimuli: StimulusSet, *, seed: int) -> list[Item]:
    """List the stimuli of a set as protocols see them: by their blind codes."""
    codes = list_codes(stimuli, seed=seed)
    return [
        Item(codes[row.stimulus_id], row.recording, row.reducer, row.level, row.role)
        for row in stimuli.stimuli
    ]


def list_codes(stimuli: StimulusSet, *, seed: int) -> dict[str, str]:
    """Give every stimulus of a study its blind code.

    Returns stimulus -> code.
    """
    return make_codes((row.stimulus_id for row in stimuli.stimuli), f"{stimuli.sha256} {seed}")


def create_plan(path: Path, plan: Plan) -> None:
    """Store a plan where none is yet.

    Parameters
    ----------
    path : Path
        The file to write; its folder must exist.
    plan : Plan
        The plan.

    Raises
    ------
    FileExistsError
        If there is a file already.
    """
    entry = {"format": FORMAT, **asdict(plan)}
    del entry["sha256"]
    create_text(path, _seal(json.dumps(entry, indent=1).encode()).decode())


def require_plan(path: Path) -> Plan:
    """Read a stored plan.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Plan
        The plan.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If it is not what was once stored.
    """
    content = path.read_bytes()
    # The digest is of the bytes on the disk, so that a plan stays what it was when later versions know more fields.
    body = content.rpartition(_SEAL)[0] + b"\n}"
    if content != _seal(body):
        raise ValueError(
            f"{path}: got no plan, or one that was changed after it was stored; restore the file from a copy"
        )
    entry = json.loads(body)
    if (stored := entry.pop("format", None)) != FORMAT:
        raise ValueError(
            f"{path}: got a plan of format {stored}, allowed is {FORMAT}; use the feel321 that wrote it"
        )
    try:
        return _restore(entry, sha256=digest(body))
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{path}: got a plan of another make ({error}); use the feel321 that wrote it"
        ) from None


def compare_plans(plan: Plan, other: Plan) -> list[str]:
    """Say in which inputs two plans differ."""
    # By way of JSON, which knows lists only, so that what was stored and what was made anew look alike.
    old, new = (json.loads(json.dumps(asdict(entry))) for entry in (plan, other))
    return find_differences(old, new, ignore={"trials", "sha256"})


def _restore(entry: dict[str, Any], *, sha256: str) -> Plan:
    """Make records of what JSON holds as lists and objects."""
    flow = entry.pop("flow")
    return Plan(
        tasks=tuple(Task(**task) for task in entry.pop("tasks")),
        flow=Flow(**flow | {"reject": tuple(flow["reject"])}),
        trials=tuple(_restore_trial(trial) for trial in entry.pop("trials")),
        sha256=sha256,
        **entry,
    )


def _restore_trial(entry: dict[str, Any]) -> Trial:
    judgements = tuple(_restore_judgement(judgement) for judgement in entry.pop("judgements"))
    return Trial(
        parts=tuple(Part(**part) for part in entry.pop("parts")), judgements=judgements, **entry
    )


def _restore_judgement(entry: dict[str, Any]) -> Judgement:
    expected = entry.pop("expected")
    return Judgement(expected=None if expected is None else tuple(expected), **entry)


def _seal(body: bytes) -> bytes:
    """Put the digest of a JSON object into it as its last entry."""
    return body.removesuffix(b"\n}") + _SEAL + digest(body).encode() + b'"\n}\n'


POLICIES = ("warm_up", "continue", "restart")
"""What becomes of a session that was left for long: practice first, go on at once, or begin anew beside it."""


# What a journal says about its session: how it was begun, how far it has come, what comes next.

SESSION_FILE = re.compile(r"session-(\d{2,})\.jsonl")
"""Names of the journals in a participant's folder; copies under other names are none."""


def name_journal(session: int) -> str:
    """Name the file of a session's journal.

    session: the session's number, from 1.

    Examples
    --------
    >>> name_journal(1)
    'session-01.jsonl'
    """
    return f"session-{session:02d}.jsonl"


def list_journals(folder: Path) -> list[Path]:
    """List the journals of a participant."""
    found = {path: SESSION_FILE.fullmatch(path.name) for path in folder.glob("session-*.jsonl")}
    return sorted(
        (path for path, match in found.items() if match),
        key=lambda path: int(path.stem.rpartition("-")[2]),
    )


def find_header(records: Iterable[Record]) -> Mapping[str, Any] | None:
    """Find what a session was begun with."""
    return next((record.data for record in records if record.event == "begun"), None)


def find_elapsed(records: Iterable[Record]) -> float:
    """Find how far the presenter's clock had come."""
    # Onsets do not count: an attempt that was broken off never was, and comes again in its own time.
    return max(
        (record.data["time_s"] for record in records if "time_s" in record.data), default=0.0
    )


def has_event(records: Iterable[Record], event: str) -> bool:
    """Tell whether something ever happened in a session."""
    return any(record.event == event for record in records)


def replay(plan: Plan, records: Iterable[Record]) -> Agenda:
    """Tell a new agenda all that a journal holds."""
    agenda = Agenda(plan.trials, plan.flow)
    trials = {trial.number: trial for trial in plan.trials}
    for record in records:
        try:
            tell(agenda, record, trials)
        except ValueError as error:
            raise ValueError(f"line {record.sequence + 1}: {error}") from None
    return agenda


def tell(agenda: Agenda, record: Record, trials: Mapping[int, Trial]) -> None:
    """Tell an agenda what one record says; most say nothing about what comes next."""
    data = record.data
    match record.event:
        case "page":
            agenda.tell_page(data["key"], time_s=data["time_s"])
        case "rated":
            understood = (
                is_as_expected(trials[data["trial"]], data["values"])
                if data["trial"] in trials
                else None
            )
            accepted = not data["rejected"]
            agenda.tell_trial(
                data["trial"], accepted=accepted, as_expected=understood, time_s=data["time_s"]
            )
        case "spoiled":
            spent = "device_error" not in data["flags"]
            agenda.tell_trial(
                data["trial"], accepted=False, as_expected=None, time_s=data["time_s"], spent=spent
            )
        case "warm_up":
            agenda.warm_up()
