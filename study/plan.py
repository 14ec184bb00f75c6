"""The plan of one participant: a frozen, seeded list of trials, stored before the first of them is shown."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, fields
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
    """

    participant: str
    number: int
    seed: int
    protocols: tuple[str, ...]
    repeats: int
    stimuli_sha256: str
    trials: tuple[Trial, ...]

    @property
    def sha256(self) -> str:
        """Digest of all the fields."""
        return digest(json.dumps(asdict(self), sort_keys=True))


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
    create_text(path, json.dumps({**asdict(plan), "sha256": plan.sha256}, indent=1) + "\n")


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
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
        sha256 = entry.pop("sha256")
        entry["trials"] = tuple(Trial(**trial) for trial in entry["trials"])
        entry["protocols"] = tuple(entry["protocols"])
        plan = Plan(**entry)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: got no plan ({error}); restore the file from a copy") from None
    if plan.sha256 != sha256:
        raise ValueError(f"{path}: was changed after it was stored; restore the file from a copy")
    return plan


def find_differences(plan: Plan, other: Plan) -> list[str]:
    """Say in which fields two plans differ.

    Parameters
    ----------
    plan, other : Plan
        The stored plan, and the one that today's settings give.

    Returns
    -------
    list of str
        One entry per field; of the trials, the first that differs. Empty if the plans are equal.
    """
    found = [
        f"{name} {getattr(plan, name)!r} -> {getattr(other, name)!r}"
        for name in (field.name for field in fields(Plan) if field.name != "trials")
        if getattr(plan, name) != getattr(other, name)
    ]
    if len(plan.trials) != len(other.trials):
        found.append(f"{len(plan.trials)} trials -> {len(other.trials)}")
    pairs = zip(plan.trials, other.trials, strict=False)
    changed = next((number for number, (a, b) in enumerate(pairs, start=1) if a != b), None)
    return found + ([f"order of trials, first at trial {changed}"] if changed else [])
