"""Progress of every participant, and balance of the design as it was run. Blind."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import groupby
from math import lcm, prod
from typing import TYPE_CHECKING

from feel321.doors import announce
from feel321.files import is_held
from feel321.protocols.agenda import SECONDS
from feel321.protocols.order import TASK_ORDERS, measure_balance
from feel321.protocols.tasks import count_rows, find_other, is_as_expected
from feel321.records import Result
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import minutes, people
from feel321.study.freeze import describe_frozen
from feel321.study.session.events import (
    DeviceFailed,
    PageRead,
    PartPlayed,
    SessionFinished,
    SessionReleased,
    TrialRated,
    find_notices,
)
from feel321.study.session.plan import TOMBSTONE_FILE, Dossier, Plan, read_as_written
from feel321.study.thresholds import find_warnings, read_thresholds

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

    from feel321.protocols.trial import Trial
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Chain

    Sequences = dict[tuple[str, ...], list[list[str]]]

SESSION, TASKS = "session", "tasks"
"""What is put in order where tasks are counterbalanced."""


@dataclass(frozen=True, slots=True)
class Evenness:
    """How often conditions of one task met positions, and each other; cycle: participants of a full cycle."""

    task: str
    what: str
    cycle: int
    positions: tuple[int, int]
    carry_over: tuple[int, int]


@dataclass(frozen=True, slots=True)
class BalanceAsRun:
    """Balance of all sessions so far, drop-outs and second attempts included."""

    simulated: bool
    participants: int
    finished: int
    evenness: tuple[Evenness, ...]


def measure_realised(everybody: Iterable[tuple[Dossier, list[Trial]]]) -> BalanceAsRun | None:
    """Measure the balance of the trials that counted, of real participants if there are any."""
    begun = [(dossier, trials) for dossier, trials in everybody if trials]
    simulated = all(dossier.plan.simulated for dossier, _ in begun)
    run = [(dossier, trials) for dossier, trials in begun if dossier.plan.simulated == simulated]
    if not run:
        return None
    groups: dict[tuple[str, str], Sequences] = defaultdict(lambda: defaultdict(list))
    for dossier, trials in run:
        for task, what, among, conditions in _split(dossier.plan, trials):
            groups[task, what][among].append(conditions)
    # Successive participants belong to successive groups, and each group has its own cycle.
    plans = [dossier.plan for dossier, _ in run]
    cycles = max(prod(map(len, plan.between.values())) for plan in plans)
    # Shares of the recordings have none: who comes a full cycle later feels other recordings.
    whole = [plan for plan in plans if plan.recordings_per_participant is None]
    of_trials = cycles * any(plan.order == "williams" for plan in whole)
    evenness = []
    for (task, what), sequences in groups.items():
        positions, carry_over = measure_balance(sequences.values())
        round_of = lcm(*(count_rows(len(among)) for among in sequences))
        evenness.append(
            Evenness(
                task=task,
                what=what,
                cycle=(cycles if what == TASKS else of_trials) * round_of,
                positions=positions,
                carry_over=carry_over,
            )
        )
    over = [one.records for one, _ in run if one.records.has(SessionFinished)]
    finished = sum(not records.has(SessionReleased) for records in over)
    return BalanceAsRun(simulated, len(run), finished, tuple(evenness))


def describe_balance(realised: BalanceAsRun | None) -> list[str]:
    """Describe the balance of a study so far.

    Examples
    --------
    >>> evenness = Evenness("abx", "stimuli", 6, (0, 1), (0, 2))
    >>> describe_balance(BalanceAsRun(False, 4, 4, (evenness,)))[1]
    '  abx, stimuli: 0 to 1 at each position, 0 to 2 after each other; even over 6, 2 to go'
    """
    if realised is None:
        return ["balance: no trial was run yet"]
    lines = [f"balance: {realised.finished} finished{' (simulated)' if realised.simulated else ''}"]
    for entry in realised.evenness:
        ends = (entry.positions, entry.carry_over)
        places, neighbours = (" to ".join(map(str, end)) for end in ends)
        left = -realised.finished % entry.cycle if entry.cycle else 0
        circle = f"; even over {entry.cycle}, {left} to go" if entry.cycle else ""
        lines.append(
            f"  {entry.task}, {entry.what}: {places} at each position, {neighbours} after each other{circle}"
        )
    return lines


def _split(
    plan: Plan, trials: Sequence[Trial]
) -> Iterator[tuple[str, str, tuple[str, ...], list[str]]]:
    """Yield task (or `SESSION`), what was put in order, among which, and the order that it was run in."""
    if plan.task_order != TASK_ORDERS[0] and len(plan.tasks) > 1:
        among = tuple(sorted(task.protocol for task in plan.tasks))
        yield SESSION, TASKS, among, list(dict.fromkeys(trial.protocol for trial in trials))
    planned = _gather_blocks(trial for trial in plan.trials if trial.phase == "main")
    run = _gather_blocks(trials)
    for block, own in run.items():
        if len({judgement.part for judgement in own[0].judgements}) == 1:
            # Only what was planned together can meet.
            among = tuple(sorted(map(_name_condition, planned[block])))
            yield own[0].protocol, "stimuli", among, [_name_condition(trial) for trial in own]
    recordings: dict[str, set[str]] = defaultdict(set)
    for trial in plan.trials:
        recordings[trial.protocol].add(trial.recording)
    heads = [own[0] for own in run.values() if len({trial.recording for trial in own}) == 1]
    for (task, _), turn in groupby(heads, key=lambda trial: (trial.protocol, trial.repeat)):
        order = [head.recording for head in turn]
        yield task, "recordings", tuple(sorted(recordings[task])), order


def _gather_blocks(trials: Iterable[Trial]) -> dict[int, list[Trial]]:
    """Gather trials by block; a second attempt may come after other blocks, it is the last of its own."""
    blocks: dict[int, list[Trial]] = defaultdict(list)
    for trial in trials:
        blocks[trial.block].append(trial)
    return blocks


def _name_condition(trial: Trial) -> str:
    """Name the two stimuli that are compared, whichever comes first."""
    about = trial.judgements[0]
    other = find_other(trial, about) or about.reference_id or about.stimulus_id
    return "|".join(sorted({about.stimulus_id, other}))


@dataclass(frozen=True, slots=True)
class ParticipantStatus:
    """Progress of one participant; a session that no live process writes is `aborted`, not `running`.

    left_min: minutes that are left; None of those who do not go on, and where there is no stimulus set.
    """

    participant: str
    state: str = ""
    number: int = 0
    groups: str = ""
    answered: int = 0
    given_up: int = 0
    left: int = 0
    simulated: bool = False
    last_activity: str = ""
    warnings: tuple[str, ...] = ()
    problem: str = ""
    notes: tuple[people.Note, ...] = ()
    left_min: float | None = None
    rig: people.RigUse | None = None

    @property
    def done(self) -> int:
        """Trials that need no further attempt."""
        return self.answered + self.given_up


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Status(Result):
    """Progress of a study; frozen: whether its choices are, in a line."""

    participants: tuple[ParticipantStatus, ...]
    balance: BalanceAsRun | None
    length: minutes.Length | None = None
    frozen: str = ""

    def to_frame(self) -> DataFrame:
        """Return one row per participant."""
        import pandas as pd

        columns = [field.name for field in fields(ParticipantStatus)]
        return pd.DataFrame([asdict(entry) for entry in self.participants], columns=columns)

    def summary(self) -> str:
        """Write what `feel321 status` prints."""
        lines = [
            f"{'participant':<14}{'state':<11}{'answered':>9}{'given up':>9}{'left':>5}{'min':>5}  last activity"
        ]
        for entry in self.participants:
            lines += [_describe(entry), *(f"{'':<14}{warning}" for warning in entry.warnings)]
        length = [] if self.length is None else [self.length.describe()]
        uses = [entry.rig for entry in self.participants if entry.rig]
        lines += [*people.describe_rigs(uses), *length, *filter(None, [self.frozen])]
        return "\n".join([*lines, *describe_balance(self.balance)])

    def list_notes(self) -> list[str]:
        """Write what `feel321 status --notes` adds."""
        taken = [(entry.participant, note) for entry in self.participants for note in entry.notes]
        lines = [f"  {who:<12}{note.utc}  {note.text}" for who, note in taken]
        return ["notes:", *lines] if lines else ["notes: none"]

    def __repr__(self) -> str:
        """Count the participants in each state."""
        counts = Counter(entry.state or "unreadable" for entry in self.participants)
        states = ", ".join(f"{count} {state}" for state, count in counts.items())
        return f"Status({states or 'no participants'})"


def _describe(entry: ParticipantStatus) -> str:
    if entry.problem:
        return f"{entry.participant:<14}{'?':<11}{'?':>9}{'?':>9}{'?':>5}{'':5}  {entry.problem}"
    notes = "; ".join(filter(None, ("simulated" if entry.simulated else "", entry.groups)))
    tail = f"  {entry.last_activity}{f' ({notes})' if notes else ''}".rstrip()
    left = "" if entry.left_min is None else f"{entry.left_min:.0f}"
    counts = f"{entry.answered:>9}{entry.given_up:>9}{entry.left:>5}"
    return f"{entry.participant:<14}{entry.state:<11}{counts}{left:>5}{tail}"


def read_status(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> Status:
    """Read the progress of a study, also while sessions run."""
    entries: dict[str, ParticipantStatus] = {}
    counted: list[tuple[Dossier, list[Trial]]] = []
    folders = study.participants
    for count, folder in enumerate(folders, start=1):
        announce(folder.name)
        entries[folder.name], own = read_participant(study, folder)
        if own is not None:
            counted.append(own)
        if progress is not None:
            progress(count, len(folders))
    length = _add_minutes(study, entries, [dossier for dossier, _ in counted])
    frozen = "" if study.is_rehearsal else describe_frozen(study)
    return Status(tuple(entries.values()), measure_realised(counted), length, frozen)


def _add_minutes(
    study: StudyFolder, entries: dict[str, ParticipantStatus], dossiers: Sequence[Dossier]
) -> minutes.Length | None:
    """Add the minutes that participants have left, and measure how long whole sessions take."""
    try:
        durations = minutes.find_durations(read_stimuli(study.stimuli))
    except (OSError, ValueError):
        return None
    pace = minutes.observe_pace(dossiers, durations)
    for dossier in dossiers:
        entry = entries[dossier.plan.participant]
        if entry.state in {"claimed", "running", "aborted"}:
            left = minutes.find_left(dossier.plan, dossier.records, durations=durations, pace=pace)
            entries[entry.participant] = replace(entry, left_min=max(left.values()) / SECONDS)
    sittings = [
        minutes.Sitting.plan(dossier.plan, dossier.plan.flow, durations) for dossier in dossiers
    ]
    return minutes.measure_length(sittings, pace) if sittings else None


def read_participant(
    study: StudyFolder, folder: Path
) -> tuple[ParticipantStatus, tuple[Dossier, list[Trial]] | None]:
    """Read the status of a participant; with the trials that count for the balance, in the order that they were run."""
    if (folder / TOMBSTONE_FILE).exists():
        return ParticipantStatus(folder.name, state="withdrawn"), None
    try:
        dossier = study.read_person(folder)
        progress = people.make_progress(dossier)
        with read_as_written(dossier.newest):
            trials = {trial.number: trial for trial in dossier.plan.trials if trial.phase == "main"}
            rated = list_accepted(dossier)
            warnings = tuple(_find_warnings(dossier, rated))
            notes = tuple(people.list_notes(dossier.chains))
            use = people.find_rig_use(progress.participant, dossier.records)
    except (OSError, ValueError) as error:
        return ParticipantStatus(folder.name, problem=str(error)), None
    is_left = progress.state == "running" and not is_held(folder / people.LOCK_FILE)
    entry = ParticipantStatus(
        participant=progress.participant,
        state="aborted" if is_left else progress.state,
        number=progress.number,
        groups=", ".join(f"{factor}={level}" for factor, level in progress.groups.items()),
        answered=progress.answered,
        given_up=progress.given_up,
        left=progress.total - progress.answered - progress.given_up,
        simulated=progress.simulated,
        last_activity=progress.last_utc,
        warnings=warnings,
        notes=notes,
        rig=use,
    )
    return entry, (dossier, [trials[one.trial] for one in rated])


def list_accepted(dossier: Dossier) -> list[TrialRated]:
    """List the answers of the newest session that count."""
    numbers = {trial.number for trial in dossier.plan.trials if trial.phase == "main"}
    rated = dossier.records.find(TrialRated)
    return [one for one in rated if one.trial in numbers and not one.rejected]


def _find_warnings(dossier: Dossier, rated: Sequence[TrialRated]) -> Iterator[str]:
    for chain in dossier.chains[-1:]:
        yield from find_flags(chain)
        for call in list(chain.records.find(DeviceFailed))[-1:]:
            yield f"last called for: {call.reason}"
    yield from find_warnings(read_thresholds(dossier.plan, dossier.records))
    caught = judge_catches(dossier.plan, rated)
    if missed := caught.count(False):
        yield f"{missed} of {len(caught)} catch trials not as expected"


def find_flags(chain: Chain) -> Iterator[str]:
    """List what went wrong in a session, without looking at any answer."""
    if chain.torn:
        yield f"{len(chain.torn)} bytes of an unfinished line, moved aside on resuming"
    counts = Counter(flag for record in chain.records for flag in record.data.get("flags", ()))
    yield from (f"{count} x {flag.replace('_', ' ')}" for flag, count in counts.items())
    if any(page.key == "training_failed" for page in chain.records.find(PageRead)):
        yield "training not passed"
    if calls := list(chain.records.find(DeviceFailed)):
        yield f"experimenter called: {len(calls)} x"
    for said in find_notices(chain.records.find(PartPlayed)).values():
        yield f"{len(said)} x {said[0]}"


def judge_catches(plan: Plan, rated: Iterable[TrialRated]) -> list[bool]:
    """Check the answers to catch trials against what is expected."""
    trials = {trial.number: trial for trial in plan.trials if trial.catch}
    caught = [one for one in rated if one.trial in trials]
    answers = [is_as_expected(trials[one.trial], one.values) for one in caught]
    return [answer for answer in answers if answer is not None]
