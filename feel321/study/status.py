"""How far every participant is, and how balanced the design is as realised. Blind."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import groupby
from math import lcm, prod
from typing import TYPE_CHECKING

from feel321.protocols.balance import measure_balance, pool_balances, williams_square
from feel321.protocols.tasks import is_as_expected
from feel321.study.ledger.standing import make_standing
from feel321.study.session.opening import TOMBSTONE_FILE, read_as_written, read_dossier
from feel321.study.session.plan import has_event

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from feel321.protocols.trial import Trial
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Chain, Record
    from feel321.study.session.opening import Dossier
    from feel321.study.session.plan import Plan

    Sequences = dict[tuple[str, ...], list[list[str]]]

# Balance of a design as it was actually run, drop-outs and second attempts included. Blind.


@dataclass(frozen=True, slots=True)
class Evenness:
    """How evenly conditions met places, and each other."""

    task: str
    what: str
    cycle: int
    positions: tuple[int, int]
    carry_over: tuple[int, int]
    position_index: float
    carry_over_index: float


@dataclass(frozen=True, slots=True)
class Realised:
    """Balance of all sessions so far."""

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
    """Measure the balance of all that was run."""
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
            _measure(task, what, sequences, circles=circles)
            for (task, what), sequences in groups.items()
        ),
    )


def describe_balance(realised: Realised | None) -> list[str]:
    """Say how balanced a study is so far.

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
        places, neighbours = (
            " to ".join(map(str, ends)) for ends in (entry.positions, entry.carry_over)
        )
        circle = (
            f"; even over {entry.cycle}, {-realised.finished % entry.cycle} to go"
            if entry.cycle
            else ""
        )
        lines.append(
            f"  {entry.task}, {entry.what}: {places} at each place, {neighbours} after each other{circle}"
        )
    return lines


def _gather_session(dossier: Dossier) -> _Session:
    """Gather what one participant went through: trials of the main phase, in the order in which they counted."""
    plan, records = dossier.plan, dossier.records
    trials = {trial.number: trial for trial in plan.trials if trial.phase == "main"}
    counted = [
        trials[record.data["trial"]]
        for record in records
        if record.event == "rated"
        and record.data["trial"] in trials
        and not record.data["rejected"]
    ]
    return _Session(
        plan, counted, has_event(records, "finished") and not has_event(records, "released")
    )


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
    blocks = [
        trials[0] for trials in run.values() if len({trial.recording for trial in trials}) == 1
    ]
    for (task, _), heads in groupby(blocks, key=lambda trial: (trial.protocol, trial.repeat)):
        yield (
            task,
            "recordings",
            tuple(sorted(recordings[task])),
            [head.recording for head in heads],
        )


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
    return "|".join(
        sorted({judgement.stimulus_id, judgement.reference_id or judgement.stimulus_id})
    )


# How far every participant of a study has come, and what the study lead should know about it. Blind.


@dataclass(frozen=True, slots=True)
class Progress:
    """How far one participant has come."""

    participant: str
    state: str = ""
    number: int = 0
    groups: str = ""
    done: int = 0
    left: int = 0
    simulated: bool = False
    last_activity: str = ""
    warnings: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """How far a study has come."""

    participants: tuple[Progress, ...]
    balance: Realised | None


def read_status(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> Status:
    """Read how far a study has come, also while sessions run."""
    entries, dossiers = [], []
    folders = study.participants
    for count, folder in enumerate(folders, start=1):
        entry, dossier = _read_progress(folder)
        entries.append(entry)
        if dossier is not None:
            dossiers.append(dossier)
        if progress is not None:
            progress(count, len(folders))
    return Status(tuple(entries), measure_realised(dossiers))


def _read_progress(folder: Path) -> tuple[Progress, Dossier | None]:
    """Read how far a participant has come; the dossier comes too if it counts for the balance."""
    if (folder / TOMBSTONE_FILE).exists():
        return Progress(folder.name, state="withdrawn"), None
    try:
        dossier = read_dossier(folder)
        with read_as_written(folder):
            return _make_progress(dossier), dossier
    except (OSError, ValueError) as error:
        return Progress(folder.name, problem=str(error)), None


def _make_progress(dossier: Dossier) -> Progress:
    standing = make_standing(dossier)
    return Progress(
        participant=standing.participant,
        state=standing.state,
        number=standing.number,
        groups=", ".join(f"{factor}={level}" for factor, level in standing.groups.items()),
        done=standing.done,
        left=standing.total - standing.done,
        simulated=standing.simulated,
        last_activity=standing.last_utc,
        warnings=tuple(
            warning
            for chain in dossier.chains[-1:]
            for warning in _find_warnings(dossier.plan, chain)
        ),
    )


def _find_warnings(plan: Plan, chain: Chain) -> Iterator[str]:
    if chain.torn:
        yield f"{len(chain.torn)} torn bytes, mended on resuming"
    counts = Counter(flag for record in chain.records for flag in record.data.get("flags", ()))
    yield from (f"{count} x {flag.replace('_', ' ')}" for flag, count in counts.items())
    if any(
        record.event == "page" and record.data["key"] == "training_failed"
        for record in chain.records
    ):
        yield "training not passed"
    if given_up := sum(
        record.data.get("given_up", 0) for record in chain.records if record.event == "finished"
    ):
        yield f"{given_up} {'trial' if given_up == 1 else 'trials'} given up"
    caught = find_catches(plan, chain.records)
    if missed := sum(not as_expected for as_expected in caught):
        yield f"{missed} of {len(caught)} catch trials not as expected"


def find_catches(plan: Plan, records: Sequence[Record]) -> list[bool]:
    """Find out how a participant did in the catch trials whose right answer is known."""
    caught = {trial.number: trial for trial in plan.trials if trial.phase == "main" and trial.catch}
    answers = [
        is_as_expected(caught[record.data["trial"]], record.data["values"])
        for record in records
        if record.event == "rated"
        and record.data["trial"] in caught
        and not record.data["rejected"]
    ]
    return [answer for answer in answers if answer is not None]
