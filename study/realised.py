"""Balance of a design as it was actually run, drop-outs and second attempts included. Blind."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.balance import measure_balance, pool_balances
from protocols.design import count_cycle
from study.journal import read_journal
from study.opening import PLAN_FILE
from study.plan import require_plan
from study.replay import has_event, list_journals

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from pathlib import Path

    from protocols.trial import Trial
    from study.folder import StudyFolder

    Run = tuple[str, list[str]]


@dataclass(frozen=True, slots=True)
class Realised:
    """How evenly conditions met places, and each other, in all sessions so far.

    Parameters
    ----------
    participants, finished : int
        Those of whom a trial counts, and those of them who came to their end.
    cycle : int
        Number of participants over whom the orders come full circle; 0 for orders by chance.
    positions, carry_over : tuple of int
        Smallest and largest count: how often a condition stood at a place, and next after another one.
    position_index, carry_over_index : float
        Coefficient of variation of the counts, 0 for perfect balance.
    """

    participants: int
    finished: int
    cycle: int
    positions: tuple[int, int]
    carry_over: tuple[int, int]
    position_index: float
    carry_over_index: float


def measure_realised(study: StudyFolder) -> Realised | None:
    """Measure the balance of all that was run.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    Realised or None
        Places and neighbours are counted within each block of comparisons, such as those of one recording; on a page
        of sliders, along its slots. None if no trial counts yet. Participants whose plan or journal is broken are
        left out; `audit` names them.
    """
    groups: dict[str, list[list[str]]] = defaultdict(list)
    participants, finished, cycle = 0, 0, 0
    for folder in study.participants:
        try:
            runs, is_finished, own_cycle = _read_runs(folder)
        except (OSError, ValueError):
            continue
        participants, finished = participants + bool(runs), finished + is_finished
        cycle = max(cycle, own_cycle)
        for group, conditions in runs:
            groups[group].append(conditions)
    if not groups:
        return None
    balance = pool_balances(measure_balance(sequences) for sequences in groups.values())
    return Realised(
        participants=participants,
        finished=finished,
        cycle=cycle,
        positions=_find_ends(balance.positions.values()),
        carry_over=_find_ends(balance.carry_over.values()),
        position_index=balance.position_index,
        carry_over_index=balance.carry_over_index,
    )


def describe_balance(realised: Realised | None) -> str:
    """Say how balanced a study is so far.

    Parameters
    ----------
    realised : Realised or None
        What was measured.

    Returns
    -------
    str
        One line.

    Examples
    --------
    >>> describe_balance(Realised(4, 4, 6, (0, 1), (0, 2), 0.5, 0.75))
    'balance: 4 finished, 2 more for full circle; so far 0 to 1 times at each place, 0 to 2 times after each other'
    """
    if realised is None:
        return "balance: no trial was run yet"
    places, neighbours = (" to ".join(map(str, counts)) for counts in (realised.positions, realised.carry_over))
    to_go = f", {-realised.finished % realised.cycle} more for full circle" if realised.cycle else ""
    return (
        f"balance: {realised.finished} finished{to_go}; so far {places} times at each place, "
        f"{neighbours} times after each other"
    )


def _find_ends(counts: Collection[int]) -> tuple[int, int]:
    return min(counts, default=0), max(counts, default=0)


def _read_runs(folder: Path) -> tuple[list[Run], bool, int]:
    """Read what one participant went through: blocks with their conditions, in the order in which they counted."""
    journals = list_journals(folder)
    if not journals:
        return [], False, 0
    plan = require_plan(folder / PLAN_FILE)
    records = read_journal(journals[-1]).records
    trials = {trial.number: trial for trial in plan.trials if trial.phase == "main"}
    counted = [
        trials[record.data["trial"]]
        for record in records
        if record.event == "rated" and record.data["trial"] in trials and not record.data["rejected"]
    ]
    finished = has_event(records, "finished") and not has_event(records, "released")
    cycle = count_cycle(plan.trials) if plan.order == "williams" else 0
    return list(_split_runs(counted)), finished, cycle


def _split_runs(trials: Iterable[Trial]) -> Iterator[Run]:
    blocks: dict[int, list[Trial]] = defaultdict(list)
    for trial in trials:  # A second attempt may come after other blocks; it is the last of its own.
        blocks[trial.block].append(trial)
    for run in blocks.values():
        recordings = sorted({trial.recording for trial in run})
        pages = [trial for trial in run if len(trial.judgements) > 1]
        for page in pages:
            yield f"{page.protocol} {page.recording}", [f"slot {j.stimulus_id}" for j in page.judgements]
        if not pages:
            yield f"{run[0].protocol} {recordings}", [_name_condition(trial) for trial in run]


def _name_condition(trial: Trial) -> str:
    """Name what is judged against what, whichever of the two comes first."""
    judgement = trial.judgements[0]
    return " ".join([trial.protocol, *sorted({judgement.stimulus_id, judgement.reference_id or judgement.stimulus_id})])
