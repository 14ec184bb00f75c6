"""Balance of a design as it was actually run, drop-outs and second attempts included. Blind."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import groupby
from math import lcm, prod
from typing import TYPE_CHECKING

from protocols.balance import measure_balance, pool_balances
from protocols.square import williams_square
from study.session.replay import has_event

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    from protocols.trial import Trial
    from study.session.dossier import Dossier
    from study.session.plan import Plan

    Sequences = dict[tuple[str, ...], list[list[str]]]


@dataclass(frozen=True, slots=True)
class Evenness:
    """How evenly conditions met places, and each other.

    Parameters
    ----------
    task : str
        The protocol.
    what : str
        What was put in order: `stimuli` within their block, `slots` on a page of sliders, or `recordings` as blocks.
    cycle : int
        Number of participants over whom the order comes full circle; 0 for orders by chance.
    positions, carry_over : tuple of int
        Smallest and largest count: how often each stood at each place, and right after each other one.
    position_index, carry_over_index : float
        Coefficient of variation of the counts, 0 for perfect balance.
    """

    task: str
    what: str
    cycle: int
    positions: tuple[int, int]
    carry_over: tuple[int, int]
    position_index: float
    carry_over_index: float


@dataclass(frozen=True, slots=True)
class Realised:
    """Balance of all sessions so far.

    Parameters
    ----------
    simulated : bool
        Whether it is that of simulated participants; once there are real ones, it is theirs alone.
    participants, finished : int
        Those of whom a trial counts, and those of them who came to their end.
    evenness : tuple of Evenness
        Per task, and what was put in order there.
    """

    simulated: bool
    participants: int
    finished: int
    evenness: tuple[Evenness, ...]


@dataclass(frozen=True, slots=True)
class _Session:
    """What one participant went through."""

    plan: Plan
    trials: Sequence[Trial]
    is_finished: bool


def measure_realised(dossiers: Iterable[Dossier]) -> Realised | None:
    """Measure the balance of all that was run.

    Parameters
    ----------
    dossiers : iterable of Dossier
        Plans and journals of all participants.

    Returns
    -------
    Realised or None
        None if no trial counts yet.
    """
    sessions = [session for session in map(_gather_session, dossiers) if session.trials]
    simulated = all(session.plan.simulated for session in sessions)
    sessions = [session for session in sessions if session.plan.simulated == simulated]
    if not sessions:
        return None
    groups: dict[tuple[str, str], Sequences] = defaultdict(lambda: defaultdict(list))
    for session in sessions:
        for task, what, among, conditions in _split(session):
            groups[task, what][among].append(conditions)
    # Successive participants belong to successive groups, and each group has its own circle.
    circles = max(_count_circles(session.plan) for session in sessions)
    return Realised(
        simulated=simulated,
        participants=len(sessions),
        finished=sum(session.is_finished for session in sessions),
        evenness=tuple(
            _measure(task, what, sequences, circles=circles) for (task, what), sequences in groups.items()
        ),
    )


def describe_balance(realised: Realised | None) -> list[str]:
    """Say how balanced a study is so far.

    Parameters
    ----------
    realised : Realised or None
        What was measured.

    Returns
    -------
    list of str
        One line on the participants, one per task and what was put in order there.

    Examples
    --------
    >>> evenness = Evenness("abx", "stimuli", 6, (0, 1), (0, 2), 0.5, 0.75)
    >>> describe_balance(Realised(False, 4, 4, (evenness,)))[1]
    '  abx, stimuli: 0 to 1 at each place, 0 to 2 after each other; even over 6, 2 to go'
    """
    if realised is None:
        return ["balance: no trial was run yet"]
    lines = [f"balance: {realised.finished} finished{' (simulated)' if realised.simulated else ''}"]
    for entry in realised.evenness:
        places, neighbours = (" to ".join(map(str, ends)) for ends in (entry.positions, entry.carry_over))
        circle = f"; even over {entry.cycle}, {-realised.finished % entry.cycle} to go" if entry.cycle else ""
        lines.append(f"  {entry.task}, {entry.what}: {places} at each place, {neighbours} after each other{circle}")
    return lines


def _gather_session(dossier: Dossier) -> _Session:
    """Gather what one participant went through: trials of the main phase, in the order in which they counted."""
    plan, records = dossier.plan, dossier.records
    trials = {trial.number: trial for trial in plan.trials if trial.phase == "main"}
    counted = [
        trials[record.data["trial"]]
        for record in records
        if record.event == "rated" and record.data["trial"] in trials and not record.data["rejected"]
    ]
    return _Session(plan, counted, has_event(records, "finished") and not has_event(records, "released"))


def _count_circles(plan: Plan) -> int:
    return prod(map(len, plan.between.values())) if plan.order == "williams" else 0


def _split(session: _Session) -> Iterator[tuple[str, str, tuple[str, ...], list[str]]]:
    """Yield task, what was put in order, among which, and the order that it was run in."""
    planned = _gather_blocks(trial for trial in session.plan.trials if trial.phase == "main")
    run = _gather_blocks(session.trials)
    for block, trials in run.items():
        task = trials[0].protocol
        pages = [trial for trial in trials if len(trial.judgements) > 1]
        for page in pages:
            slots = [judgement.stimulus_id for judgement in page.judgements]
            yield task, "slots", tuple(sorted(slots)), slots
        if not pages:
            # Only what was planned together can meet.
            among = tuple(sorted(map(_name_condition, planned[block])))
            yield task, "stimuli", among, [_name_condition(trial) for trial in trials]
    recordings = {trial.protocol: set[str]() for trial in session.plan.trials}
    for trial in session.plan.trials:
        recordings[trial.protocol].add(trial.recording)
    blocks = [trials[0] for trials in run.values() if len({trial.recording for trial in trials}) == 1]
    for (task, _), heads in groupby(blocks, key=lambda trial: (trial.protocol, trial.repeat)):
        yield task, "recordings", tuple(sorted(recordings[task])), [head.recording for head in heads]


def _gather_blocks(trials: Iterable[Trial]) -> dict[int, list[Trial]]:
    """Gather trials by block; a second attempt may come after other blocks, it is the last of its own."""
    blocks: dict[int, list[Trial]] = defaultdict(list)
    for trial in trials:
        blocks[trial.block].append(trial)
    return blocks


def _measure(task: str, what: str, sequences: Sequences, *, circles: int) -> Evenness:
    balance = pool_balances(measure_balance(group) for group in sequences.values())
    return Evenness(
        task=task,
        what=what,
        cycle=circles * lcm(*(len(williams_square(len(among))) for among in sequences)),
        positions=_find_ends(balance.positions.values()),
        carry_over=_find_ends(balance.carry_over.values()),
        position_index=balance.position_index,
        carry_over_index=balance.carry_over_index,
    )


def _find_ends(counts: Collection[int]) -> tuple[int, int]:
    return min(counts, default=0), max(counts, default=0)


def _name_condition(trial: Trial) -> str:
    """Name what is judged against what, whichever of the two comes first."""
    judgement = trial.judgements[0]
    return "|".join(sorted({judgement.stimulus_id, judgement.reference_id or judgement.stimulus_id}))
