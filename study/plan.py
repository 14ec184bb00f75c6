"""The plan of one participant: a frozen, seeded list of trials, stored before the first of them is shown."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from protocols.design import make_order
from protocols.registry import PROTOCOLS
from protocols.trial import Item, Trial
from study.chain import digest
from study.files import create_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from stimuli.manifest import StimulusSet

PARTICIPANT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
"""What a participant may be called: it names a folder."""

FORMAT = 1
"""Form of the stored plan; a file says which one it has."""

INPUTS = ("participant", "number", "seed", "protocols", "repeats", "stimuli_sha256")
"""What the trials follow from."""

_SEAL = b',\n "sha256": "'


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that is decided about a participant's session before it begins.

    Parameters
    ----------
    participant : str
        The participant's code.
    number : int
        The participant's number in the design, from 1.
    seed : int
        The study's seed.
    protocols : tuple of str
        The parts of the session, in order.
    repeats : int
        How often each comparison is judged.
    stimuli_sha256 : str
        The stimulus set that the trials name.
    trials : tuple of Trial
        The trials, in order.
    sha256 : str
        Digest of the plan as it was stored; empty before that.
    """

    participant: str
    number: int
    seed: int
    protocols: tuple[str, ...]
    repeats: int
    stimuli_sha256: str
    trials: tuple[Trial, ...]
    sha256: str = field(default="", compare=False)


def make_plan(
    stimuli: StimulusSet, participant: str, *, number: int, seed: int, protocols: Sequence[str], repeats: int
) -> Plan:
    """Plan the session of one participant; the same arguments always give the same plan.

    Parameters
    ----------
    stimuli : StimulusSet
        The stimuli to judge.
    participant : str
        The participant's code: letters, digits, `-` and `_`.
    number : int
        The participant's number in the design, from 1.
    seed : int
        The study's seed.
    protocols : sequence of str
        Names in `PROTOCOLS`.
    repeats : int
        How often each comparison is judged.

    Returns
    -------
    Plan
        The plan.

    Raises
    ------
    ValueError
        If a name is not allowed, or the stimuli do not serve the protocols.
    """
    import numpy as np

    if not PARTICIPANT_ID.fullmatch(participant):
        raise ValueError(f"participant: got {participant!r}, allowed are letters, digits, - and _")
    if unknown := [name for name in protocols if name not in PROTOCOLS]:
        raise ValueError(f"protocols: got {unknown[0]!r}, allowed: {', '.join(PROTOCOLS)}")
    trials = make_order(
        [Item(s.stimulus_id, s.recording, s.level, s.role) for s in stimuli.stimuli],
        [PROTOCOLS[name] for name in protocols],
        number=number,
        repeats=repeats,
        rng=np.random.default_rng(seed),
    )
    return Plan(participant, number, seed, tuple(protocols), repeats, stimuli.sha256, trials)


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
    if (stored := entry.pop("format")) != FORMAT:
        raise ValueError(f"{path}: got a plan of format {stored}, allowed is {FORMAT}; use the feel321 that wrote it")
    trials = tuple(Trial(**trial) for trial in entry.pop("trials"))
    return Plan(**entry | {"protocols": tuple(entry["protocols"])}, trials=trials, sha256=digest(body))


def find_differences(plan: Plan, other: Plan) -> list[str]:
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
    return [
        f"{name} {getattr(plan, name)!r} -> {getattr(other, name)!r}"
        for name in INPUTS
        if getattr(plan, name) != getattr(other, name)
    ]


def _seal(body: bytes) -> bytes:
    """Put the digest of a JSON object into it as its last entry."""
    return body.removesuffix(b"\n}") + _SEAL + digest(body).encode() + b'"\n}\n'
