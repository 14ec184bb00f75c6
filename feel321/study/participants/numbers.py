"""Numbers of participants in the design, from 1: the plan on disk holds the number, and one lock gives the next.

A number is taken as long as the plan is there, and free again once its participant was released or withdrew. Simulated
and real people are counted apart. Stations give numbers of fixed shares, so that they need not ask each other.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import NamedTuple

from feel321.files import hold_lock, make_folder
from feel321.study.folder import StudyFolder
from feel321.study.session.events import SessionReleased
from feel321.study.session.journal import list_journals
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, Plan, create_plan

PATIENCE_S = 60.0  # how long others are waited for that plan sessions

_HEAD = re.compile(
    rb'"participant": "([^"]+)",\s*"number": (\d+),\s*"simulated": (true|false)', re.ASCII
)
_HEAD_BYTES = 600
_RELEASED = f'"event": "{SessionReleased.event}"'.encode()

PLANNED, RELEASED, WITHDRAWN = "planned", "released", "withdrawn"


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


def read_holders(study: StudyFolder) -> list[Holder]:
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


def hold_numbers(study: StudyFolder) -> AbstractContextManager[None]:
    """Keep all other processes from giving numbers in this study."""
    busy = "others are planning sessions here; try again"
    return hold_lock(study.sessions / ".numbers.lock", busy=busy, wait_s=PATIENCE_S)


def plan_participants(
    study: StudyFolder,
    names: Sequence[str],
    make: Callable[[str, int], Plan],
    *,
    simulated: bool,
    station: Station,
) -> list[Plan]:
    """Store plans under the lowest free numbers; whoever was planned keeps the number and the plan that is stored."""
    study.make_sessions()
    # Who has a plan waits for nobody, and for no damaged plan of somebody else.
    folders = {folder.name: folder for folder in study.participants}
    own = {name: read_holder(folders[name]) if name in folders else None for name in names}
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
        plans = [
            make(name, known[name].keep(simulated=simulated) if name in known else next(free))
            for name in dict.fromkeys(names)
        ]
        for plan in (one for one in plans if one.participant not in known):
            folder = study.sessions / plan.participant
            make_folder(folder, private=True)
            create_plan(folder / PLAN_FILE, plan)
    return plans
