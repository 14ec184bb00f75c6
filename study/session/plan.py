"""The plan of one participant: a frozen, seeded list of trials, stored before the first of them is shown.

Its trials name stimuli by blind codes.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from protocols.design import make_order
from protocols.flow import Flow
from protocols.groups import place_in_groups, select_items, select_tasks
from protocols.protocol import Task
from protocols.rehearsal import make_rehearsal
from protocols.trial import Item, Judgement, Part, Trial
from study.files import create_text
from study.session.blinding import make_codes
from study.session.chain import digest
from study.session.differences import find_differences

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from stimuli.manifest import StimulusSet

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
        items, tasks, number=place, repeats=design.repeats, order=design.order, rng=np.random.default_rng(design.seed)
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
    """List the stimuli of a set as protocols see them: by their blind codes.

    Parameters
    ----------
    stimuli : StimulusSet
        The set.
    seed : int
        The study's seed.

    Returns
    -------
    list of Item
        One per stimulus, in the set's order.
    """
    codes = list_codes(stimuli, seed=seed)
    return [
        Item(codes[row.stimulus_id], row.recording, row.reducer, row.level, row.role) for row in stimuli.stimuli
    ]


def list_codes(stimuli: StimulusSet, *, seed: int) -> dict[str, str]:
    """Give every stimulus of a study its blind code.

    Parameters
    ----------
    stimuli : StimulusSet
        The set.
    seed : int
        The study's seed.

    Returns
    -------
    dict of str to str
        Stimulus -> code.
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
        raise ValueError(f"{path}: got a plan of format {stored}, allowed is {FORMAT}; use the feel321 that wrote it")
    try:
        return _restore(entry, sha256=digest(body))
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: got a plan of another make ({error}); use the feel321 that wrote it") from None


def compare_plans(plan: Plan, other: Plan) -> list[str]:
    """Say in which inputs two plans differ.

    Parameters
    ----------
    plan, other : Plan
        The stored plan, and the one that today's settings give.

    Returns
    -------
    list of str
        One entry per input. The trials themselves are not compared: the stored ones are those that count.
    """
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
    return Trial(parts=tuple(Part(**part) for part in entry.pop("parts")), judgements=judgements, **entry)


def _restore_judgement(entry: dict[str, Any]) -> Judgement:
    expected = entry.pop("expected")
    return Judgement(expected=None if expected is None else tuple(expected), **entry)


def _seal(body: bytes) -> bytes:
    """Put the digest of a JSON object into it as its last entry."""
    return body.removesuffix(b"\n}") + _SEAL + digest(body).encode() + b'"\n}\n'
