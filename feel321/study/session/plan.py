"""The plan of one participant, a frozen, seeded list of trials; and how a session by it is begun or resumed.

Its trials name stimuli by blind codes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import datetime, timedelta
from functools import cache, lru_cache
from importlib.metadata import version
from platform import platform, python_version
from typing import TYPE_CHECKING, Any

from feel321.files import create_text, hold_lock
from feel321.protocols import order as orders
from feel321.protocols.agenda import Agenda
from feel321.protocols.blocks import (
    Detection,
    MatchingBlock,
    ThresholdBlock,
    draw_block,
    draw_matching,
    make_block,
)
from feel321.protocols.questions import PREFIX, Question
from feel321.protocols.tasks import digest_protocols, is_as_expected
from feel321.protocols.trial import (
    THRESHOLD,
    Flow,
    Item,
    Task,
    Trial,
    Trials,
    place_in_groups,
    select_group,
)
from feel321.stimuli.sets.manifest import find_methods
from feel321.study.admission import require_protocols
from feel321.study.session import events
from feel321.study.session import journal as journals
from feel321.study.session.codes import list_by_code
from feel321.study.session.identity import (
    ACCEPTABLE,
    compare_headers,
    describe_refusal,
    find_differences,
)
from feel321.study.session.journal import Chain, Clock, Journal, Record, Records

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame
    from pydantic import TypeAdapter

    from feel321.stimuli.sets.manifest import StimulusSet


FORMAT = 2
"""Format of the stored plan; a file says which one it has."""

POLICIES = ("warm_up", "continue", "restart")
"""Ways to resume a session after a long break: practice first, go on at once, or begin anew beside it."""

_SEAL = b',\n "sha256": "'


@dataclass(frozen=True, slots=True)
class Design:
    """The decisions of a study about the sessions of all its participants; see `Plan` for the fields."""

    seed: int
    order: str
    repeats: int
    tasks: tuple[Task, ...]
    between: Mapping[str, tuple[str, ...]]
    flow: Flow
    threshold: ThresholdBlock | None = None
    task_order: str = orders.TASK_ORDERS[0]
    matching: MatchingBlock | None = None
    questions: tuple[Question, ...] = ()
    recordings_per_participant: int | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Plan:
    """The trials and rules of a participant's session, decided before it begins.

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
    groups : mapping of str to str
        The participant's level of each of them.
    order : str
        Name of the order of trials.
    repeats : int
        Number of times that each comparison is judged.
    tasks : tuple of Task
        The sections of the session, in order.
    flow : Flow
        The rules of the session besides its trials.
    stimuli_sha256 : str
        The stimulus set that the trials name by codes.
    trials : tuple of Trial
        The trials: those of the main phase in order, then training and practice, then the threshold block.
    threshold : ThresholdBlock or None
        The threshold block, where the session has one.
    task_order : str
        Whether the order of tasks is `fixed` or `counterbalanced` between participants.
    matching : MatchingBlock or None
        The block in which strength is matched, where the session has one.
    questions : tuple of Question
        The question pages besides the trials.
    recordings_per_participant : int or None
        Number of recordings that each participant feels; all where it is None.
    methods : Mapping of str to str
        The lab's own reducers, metrics and protocols, by name: digests of their code.
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
    threshold: ThresholdBlock | None = None
    task_order: str = orders.TASK_ORDERS[0]
    matching: MatchingBlock | None = None
    questions: tuple[Question, ...] = ()
    recordings_per_participant: int | None = None
    methods: Mapping[str, str] = field(default_factory=dict)
    sha256: str = field(default="", compare=False)

    def to_frame(self) -> DataFrame:
        """Return the judgements of all trials as a table.

        Returns
        -------
        DataFrame
            One row per judgement, in order.
        """
        return Trials(self.trials).to_frame()

    def __repr__(self) -> str:
        """Describe the plan in one line."""
        return f"Plan(participant={self.participant!r}, number={self.number}, {len(self.trials)} trials)"


def make_plan(
    design: Design, stimuli: StimulusSet, participant: str, *, number: int, simulated: bool
) -> Plan:
    """Plan the session of participant `number` (from 1); the same arguments always give the same plan."""
    if not journals.PARTICIPANT_ID.fullmatch(participant):
        raise ValueError(f"participant must be letters, digits, - and _, got {participant!r}")
    by_code = list_by_code(stimuli, seed=design.seed).items()
    named = [Item(code, row.recording, row.reducer, row.level, row.role) for code, row in by_code]
    own = make_trials(design, named, number=number)
    decided: dict[str, Any] = {
        one.name: getattr(entry, one.name) for entry in (design, own) for one in fields(entry)
    }
    return Plan(
        participant=participant,
        number=number,
        simulated=simulated,
        stimuli_sha256=stimuli.sha256,
        methods=find_methods(stimuli.folder)
        | digest_protocols(task.protocol for task in own.tasks),
        **decided,
    )


@dataclass(frozen=True, slots=True)
class Course:
    """The trials and questions of a participant, and the groups and tasks that they follow from."""

    groups: Mapping[str, str]
    tasks: tuple[Task, ...]
    trials: tuple[Trial, ...]
    threshold: ThresholdBlock | None
    matching: MatchingBlock | None
    questions: tuple[Question, ...] = ()


def make_trials(design: Design, stimuli: Sequence[Item], *, number: int) -> Course:
    """Make the trials of participant `number` (from 1)."""
    import numpy as np

    groups, place = place_in_groups(design.between, number)
    items, tasks = select_group(stimuli, design.tasks, groups)
    items = orders.select_share(
        items, design.recordings_per_participant, number=place, seed=design.seed
    )
    main = orders.make_order(
        items,
        tasks,
        number=place,
        repeats=design.repeats,
        order=design.order,
        rng=np.random.default_rng(design.seed),
    )
    # Rehearsal is the participant's own; it may not move the orders, which balance over participants.
    rehearsal = orders.make_rehearsal(
        items, tasks, first_number=len(main) + 1, rng=np.random.default_rng([design.seed, number])
    )
    if design.task_order != orders.TASK_ORDERS[0]:
        tasks = orders.order_tasks(tasks, number=place)
        main = orders.arrange_sections(main, tasks)
    block, first = design.threshold, len(main) + len(rehearsal) + 1
    if block:
        block = draw_block(block, seed=design.seed, number=number)
    trials = (*main, *rehearsal, *(make_block(block, first_number=first) if block else ()))
    key = [design.seed, number, len(trials)]
    matching, own = draw_matching(design.matching, items, first_number=len(trials) + 1, key=key)
    return Course(groups, tasks, (*trials, *own), block, matching, design.questions)


def create_plan(path: Path, plan: Plan) -> None:
    """Store a plan where none is yet; its folder must exist."""
    entry = {"format": FORMAT, **asdict(plan)}
    del entry["sha256"]
    create_text(path, _seal(json.dumps(entry, indent=1).encode()).decode(), private=True)


def require_plan(path: Path) -> Plan:
    """Read a stored plan; what is not as it was stored is refused."""
    plan = _read_plan(path.read_bytes(), path)
    require_protocols(path, [task.protocol for task in plan.tasks], plan.methods)
    return plan


@lru_cache(maxsize=4)  # whoever derives several tables reads each plan once
def _read_plan(content: bytes, path: Path) -> Plan:
    content = content.replace(b"\r\n", b"\n")  # a checkout may have changed line ends
    body = content.rpartition(_SEAL)[0] + b"\n}"
    if content != _seal(body):
        raise ValueError(
            f"{path}: not a plan, or changed after it was stored; restore the file from a copy"
        )
    try:
        entry = json.loads(body)
        stored = entry.pop("format", None)
        if stored == FORMAT:
            text = json.dumps({**entry, "sha256": journals.digest(body)})
            plan = _make_adapter().validate_json(text, strict=True, extra="forbid")
    except (ValueError, AttributeError, RecursionError) as error:
        listed: Any = getattr(error, "errors", list)()  # pydantic's own, or JSON's single one
        faults = [f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in listed]
        raise ValueError(
            f"{path}: not a plan as this version writes it ({[*faults, error][0]}); use the feel321 that wrote it"
        ) from None
    if stored != FORMAT:
        raise ValueError(
            f"{path}: the plan's format must be {FORMAT}, got {stored}; use the feel321 that wrote it"
        )
    return plan


@cache
def _make_adapter() -> TypeAdapter[Plan]:
    from pydantic import TypeAdapter

    return TypeAdapter(Plan)


def compare_plans(plan: Plan, other: Plan) -> list[str]:
    """List the inputs in which two plans differ."""
    # By way of JSON, which knows lists only, so that what was stored and what was made anew look alike.
    inputs = (replace(entry, trials=()) for entry in (plan, other))
    old, new = (json.loads(json.dumps(asdict(entry))) for entry in inputs)
    return find_differences(old, new, ignore={"sha256"})


def _seal(body: bytes) -> bytes:
    """Put the digest of a JSON object into it as its last entry."""
    return body.removesuffix(b"\n}") + _SEAL + journals.digest(body).encode() + b'"\n}\n'


STEPS = (
    events.PageRead, events.QuestionAnswered, events.TrialRated, events.TrialSpoiled, events.WarmUpBegun,
)  # fmt: skip
"""Events that change what comes next."""


def replay(plan: Plan, records: Iterable[Record]) -> Agenda:
    """Make the agenda of a session as its journal leaves it."""
    agenda = Agenda(plan.trials, plan.flow, plan.questions)
    trials = {trial.number: trial for trial in plan.trials}
    names = {kind.event for kind in STEPS}
    for record in records:
        if record.event in names:
            event = record.content
            try:
                advance(agenda, event, trials)
            except ValueError as error:
                raise ValueError(f"line {record.sequence + 1}: {error}") from None
    return agenda


def recall_detection(plan: Plan, records: Iterable[Record]) -> Detection | None:
    """Make the threshold block of a session as its journal leaves it; None where there is none."""
    if plan.threshold is None:
        return None
    detection = Detection(plan.threshold)
    trials = {trial.number: trial for trial in plan.trials if trial.phase == THRESHOLD}
    for rated in Records(records).find(events.TrialRated):
        if rated.trial in trials and not rated.rejected:
            detection.tell(trials[rated.trial], rated.values)
    return detection


def advance(
    agenda: Agenda,
    event: events.SessionEvent,
    trials: Mapping[int, Trial],
    *,
    detection: Detection | None = None,
) -> None:
    """Tell an agenda, and a threshold block, one event; most change nothing about what comes next."""
    match event:
        case events.PageRead():
            agenda.tell_page(event.key, time_s=event.time_s)
        case events.QuestionAnswered():
            agenda.tell_page(f"{PREFIX}{event.question}", time_s=event.time_s)
        case events.TrialRated():
            trial = trials.get(event.trial)
            agenda.tell_trial(
                event.trial,
                accepted=not event.rejected,
                as_expected=is_as_expected(trial, event.values) if trial else None,
                time_s=event.time_s,
            )
            if detection and trial and not event.rejected:
                detection.tell(trial, event.values)
        case events.TrialSpoiled():
            agenda.tell_trial(
                event.trial,
                accepted=False,
                as_expected=None,
                time_s=event.time_s,
                spent="device_error" not in event.flags,
                lost="not_delivered" in event.flags,
            )
        case events.WarmUpBegun():
            agenda.warm_up()


PLAN_FILE = "plan.json"
TOMBSTONE_FILE = "withdrawn.json"

JOURNAL_FORMAT = 1
"""Format of the journal; its header says which one it has."""

PLANNED = ("participant", "plan_sha256", "stimuli_sha256", "seed")
"""May not even differ where nobody has done anything yet."""


@dataclass(frozen=True, slots=True)
class Stale:
    """The rule for a session that was left for `after_h` hours (None for never): one of `POLICIES`."""

    after_h: float | None = 6.0
    policy: str = "warm_up"


@contextmanager
def open_session(
    folder: Path,
    plan: Plan,
    *,
    identity: Mapping[str, Any],
    now: Clock,
    stale: Stale,
    accept_rig: bool = False,
) -> Iterator[tuple[Plan, Journal]]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    plan: the plan that today's settings give; the stored one must be the same. identity: what must not change within
    the session besides the plan, as JSON can hold it: locale, rig, calibration, and the kind of presenter. Yields the
    plan as it is stored, and the journal with a header and all that was done before.

    A session that was begun with another plan, stimulus set or presenter is refused with what differs; another
    presenter may take over where nobody has done anything yet, in a journal of its own. With accept_rig, another rig or
    certificate is recorded and goes on with the session.
    """
    busy = "another session is writing here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy):
        if (folder / TOMBSTONE_FILE).exists():
            raise ValueError(f"{folder}: {folder.name} was withdrawn; take another code")
        files = journals.list_journals(folder)
        is_begun = any(journals.read_journal(path).records.find_header() for path in files)
        stored = _compare_stored(folder / PLAN_FILE, plan, is_begun=is_begun)
        yield stored, _Opening(folder, stored, dict(identity), now, stale).open(accept_rig)


def _compare_stored(path: Path, plan: Plan, *, is_begun: bool) -> Plan:
    """Read a stored plan, and refuse it where the study has changed since."""
    stored = require_plan(path)
    remedy = (
        f"change it back, begin with another participant, or move {path.parent.parent.name}/ away"
    )
    if differences := compare_plans(stored, plan):
        raise ValueError(
            f"{path}: the study was changed since this plan was stored ({'; '.join(differences)}); {remedy}"
        )
    # A session that was begun keeps its trials, whatever a later version would make of the same inputs.
    if not is_begun and stored.trials != plan.trials:
        raise ValueError(
            f"{path}: holds other trials than the study gives; remove the file, or {remedy}"
        )
    return stored


@dataclass(frozen=True, slots=True)
class _Opening:
    """A session that is begun, resumed, or left for a new one."""

    folder: Path
    plan: Plan
    identity: dict[str, Any]
    now: Clock
    stale: Stale

    def open(self, accept_rig: bool) -> Journal:  # noqa: FBT001 - called once
        """Open the newest journal, or begin the next one."""
        files = journals.list_journals(self.folder)
        if not files:
            return self._begin()
        journal = journals.require_journal(files[-1], now=self.now)
        if journal.records.has(events.SessionReleased):
            raise ValueError(
                f"{journal.path}: {self.folder.name} was released, the place in the design is free; take another code"
            )
        begun = journal.records.find_header()
        if begun is None:
            journal.write(self._make_header(journal))
            return journal
        header = self._make_header(journal).to_data()
        accepted = journal.records.find(events.RigAccepted)
        if differences := compare_headers(begun, header, accepted=accepted):
            names = {line.partition(" ")[0] for line in differences}
            untouched = {kind.event for kind in events.UNTOUCHED}
            if names.isdisjoint(PLANNED) and {one.event for one in journal.records} <= untouched:
                # Another rig, say, does no harm: nobody has done anything yet.
                return self._supersede(journal)
            is_rig = all(name.startswith(ACCEPTABLE) for name in names)
            if not (is_rig and accept_rig):
                raise ValueError(describe_refusal(journal.path, begun, differences, is_rig=is_rig))
            if not journal.records.has(events.SessionFinished):
                rig = header.get("presenter", {}).get("rig")
                journal.write(events.RigAccepted(rig, header.get("calibration"), differences))
        return self._resume(journal)

    def _resume(self, journal: Journal) -> Journal:
        if journal.records.has(events.SessionFinished):
            return journal
        is_stale = self._is_stale(journal.records)
        is_superseded = journal.records.has(events.SessionSuperseded)
        if is_superseded or (is_stale and self.stale.policy == "restart"):
            return self._supersede(journal)
        journal.write(events.SessionResumed(*_describe_opening(journal)))
        if is_stale and self.stale.policy == "warm_up":
            journal.write(events.WarmUpBegun())
        return journal

    def _make_header(self, journal: Journal) -> events.SessionBegun:
        plan, session = self.plan, len(journals.list_journals(self.folder))
        planned = (plan.participant, plan.sha256, plan.stimuli_sha256, plan.seed)
        own = (JOURNAL_FORMAT, *planned, self.identity, session)
        return events.SessionBegun(*own, *_describe_opening(journal))

    def _begin(self) -> Journal:
        number = len(journals.list_journals(self.folder)) + 1
        journal = journals.create_journal(self.folder / journals.name_journal(number), now=self.now)
        journal.write(self._make_header(journal))
        return journal

    def _supersede(self, journal: Journal) -> Journal:
        """Leave a session as it is and begin the next one; after a crash in between, the second step alone is due."""
        if not journal.records.has(events.SessionSuperseded):
            number = len(journals.list_journals(self.folder)) + 1
            journal.write(events.SessionSuperseded(number))
        return self._begin()

    def _is_stale(self, records: Records) -> bool:
        if self.stale.after_h is None:
            return False
        # An opening that was itself broken off leaves fresh records of an old session.
        opening = {kind.event for kind in events.OPENING}
        last = next(record for record in reversed(records) if record.event not in opening)
        away = self.now() - datetime.fromisoformat(last.utc)
        return away > timedelta(hours=self.stale.after_h)


def _describe_opening(journal: Journal) -> tuple[dict[str, str], str, dict[str, float]]:
    """Describe versions, system and clock: the presenter's beside the time of day, for the offset between both."""
    versions = {name: version(name) for name in ("feel321", "numpy", "scipy")}
    clock = {"presenter_s": journal.records.find_elapsed()}
    return {"python": python_version(), **versions}, platform(), clock


@dataclass(frozen=True, slots=True)
class Dossier:
    """A participant's folder, read once: the plan and the journals."""

    folder: Path
    plan: Plan
    chains: tuple[Chain, ...]

    @property
    def records(self) -> Records:
        """The records of the newest journal."""
        return self.chains[-1].records if self.chains else Records()

    @property
    def newest(self) -> Path:
        """The file of the newest journal; that of the plan before the first."""
        return [self.folder / PLAN_FILE, *journals.list_journals(self.folder)][-1]


def read_dossier(folder: Path) -> Dossier:
    """Read a participant's folder, also while a session runs."""
    plan = require_own_plan(folder)
    return Dossier(
        folder, plan, tuple(journals.read_journal(path) for path in journals.list_journals(folder))
    )


def require_own_plan(folder: Path) -> Plan:
    """Read a participant's plan, and refuse one of another participant."""
    plan = require_plan(folder / PLAN_FILE)
    if plan.participant != folder.name:
        raise ValueError(
            f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here; move it away"
        )
    return plan


@contextmanager
def read_as_written(path: Path) -> Iterator[None]:
    """Name the file of a record that feel321 does not write, though its digests are right."""
    try:
        yield
    except ValueError as error:
        if not str(error).startswith("line "):
            raise
        raise ValueError(f"{path}, {error}; restore the file from a copy") from None
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(
            f"{path}: holds what feel321 does not write ({type(error).__name__}: {error}); restore the file from a copy"
        ) from None
