"""The plan of one participant, a frozen, seeded list of trials, and a session by it as its journal leaves it.

A plan names stimuli by blind codes, and so does all that is read before the analysis: a stimulus's own name holds its
recording and reducer. Codes are no secret, for the software turns them back; they keep experimenters from learning by
accident what a participant feels.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Interval

from feel321.files import create_text, word_fault
from feel321.protocols import order as orders
from feel321.protocols import threshold as blocks
from feel321.protocols import trial as trials_of
from feel321.protocols.agenda import Agenda
from feel321.protocols.tasks import digest_protocols, is_as_expected
from feel321.protocols.texts import PREFIX, Question
from feel321.protocols.threshold import Detection, MatchingBlock, ThresholdBlock
from feel321.protocols.trial import VALID, Flow, Item, Task, Trial, Trials
from feel321.stimuli.sets.manifest import find_methods
from feel321.study.own_protocols import require_protocols
from feel321.study.session import events
from feel321.study.session import journal as journals
from feel321.study.session.journal import Chain, Record, Records

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet

FORMAT = 2  # of the stored plan, which says so

PLAN_FILE = "plan.json"
TOMBSTONE_FILE = "withdrawn.json"

Policy = Literal["warm_up", "continue", "restart"]
"""Ways to resume a session after a long break: practice first, go on at once, or begin anew beside it."""

_BEGIN = f'{{\n "format": {FORMAT},'.encode()
_SEAL = b',\n "sha256": "'


def list_by_code(stimuli: StimulusSet, *, seed: int) -> dict[str, Stimulus]:
    """List the stimuli of a study by blind code, of letters and digits."""
    key, rows = f"{stimuli.sha256} {seed}", stimuli.stimuli
    digests = [hashlib.sha256(f"{key}\n{row.stimulus_id}".encode()).digest() for row in rows]
    whole = [base64.b32encode(digest).decode() for digest in digests]
    letters = 6  # more where two codes would be the same
    while len({text[:letters] for text in whole}) < len(whole):
        letters += 1
    return {text[:letters]: row for text, row in zip(whole, rows, strict=True)}


@dataclass(frozen=True, slots=True)
class Stale:
    """The rule for a session that was left for `after_h` hours (None for never); `[session.stale]` of study.toml."""

    after_h: Annotated[float, Interval(gt=0, le=8760)] | None = 6.0
    policy: Policy = "warm_up"


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
    """The trials and rules of a participant's session, decided before it begins."""

    participant: str
    number: int  # in the design, from 1
    simulated: bool
    seed: int  # the study's
    between: Mapping[str, tuple[str, ...]]  # factors in which participants differ
    groups: Mapping[str, str]  # the participant's own levels of these
    order: str
    repeats: int  # times that each comparison is judged
    tasks: tuple[Task, ...]  # the sections, in order
    flow: Flow
    stimuli_sha256: str
    trials: tuple[Trial, ...]  # main phase in order, training and practice, blocks; by blind codes
    threshold: ThresholdBlock | None = None
    task_order: str = orders.TASK_ORDERS[0]
    matching: MatchingBlock | None = None
    questions: tuple[Question, ...] = ()
    recordings_per_participant: int | None = None  # None for all
    methods: Mapping[str, str] = field(default_factory=dict)  # digests of the lab's own, by name
    sha256: str = field(default="", compare=False)  # of the plan as it was stored

    def to_frame(self) -> DataFrame:
        """Return the judgements of all trials as a table: one row per judgement, in order."""
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
    items = [Item(code, row.recording, row.reducer, row.level, row.role) for code, row in by_code]
    plan = make_trials(design, items, number=number)
    methods = find_methods(stimuli.folder) | digest_protocols(task.protocol for task in plan.tasks)
    plan = replace(plan, participant=participant, simulated=simulated, methods=methods)
    return replace(plan, stimuli_sha256=stimuli.sha256)


def make_trials(design: Design, stimuli: Sequence[Item], *, number: int) -> Plan:
    """Make the trials of participant `number` (from 1): a plan of nobody."""
    import numpy as np

    seed = design.seed
    groups, place = trials_of.place_in_groups(design.between, number)
    items, tasks = trials_of.select_group(stimuli, design.tasks, groups)
    items = orders.select_share(items, design.recordings_per_participant, number=place, seed=seed)
    repeats, order, rng = design.repeats, design.order, np.random.default_rng(seed)
    main = orders.make_order(items, tasks, number=place, repeats=repeats, order=order, rng=rng)
    # Rehearsal is the participant's own; it may not move the orders, which balance over participants.
    own = np.random.default_rng([seed, number])
    rehearsal = orders.make_rehearsal(items, tasks, first_number=len(main) + 1, rng=own)
    if design.task_order != orders.TASK_ORDERS[0]:
        main, tasks = orders.arrange_sections(main, tasks, number=place)
    trials, block = [*main, *rehearsal], design.threshold
    if block:
        block = blocks.draw_block(block, seed=seed, number=number)
        trials += blocks.make_block(block, first_number=len(trials) + 1)
    first, key = len(trials) + 1, [seed, number, len(trials)]
    matching, last = blocks.draw_matching(design.matching, items, first_number=first, key=key)
    decided: dict[str, Any] = {one.name: getattr(design, one.name) for one in fields(design)}
    decided |= {"tasks": tasks, "threshold": block, "matching": matching, "groups": groups}
    decided |= {"trials": (*trials, *last), "simulated": False, "stimuli_sha256": ""}
    return Plan("", number, **decided)


def create_plan(path: Path, plan: Plan) -> None:
    """Store a plan where none is yet; its folder must exist."""
    entry = {"format": FORMAT, **asdict(plan)}
    del entry["sha256"]
    create_text(path, _seal(json.dumps(entry, indent=1).encode()).decode(), private=True)


def require_plan(path: Path) -> Plan:
    """Read a stored plan; what is not as it was stored is refused."""
    if not path.exists():
        raise ValueError(f"{path}: is gone; restore the file from a copy")
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
    text = b"{" + body.removeprefix(_BEGIN) if body.startswith(_BEGIN) else body
    try:
        plan: Plan = events.make_adapter(Plan).validate_json(text, strict=True, extra="forbid")
    except (ValueError, AttributeError, RecursionError) as error:
        reason = word_fault(error, is_blind=True) if isinstance(error, ValueError) else error
        raise ValueError(
            f"{path}: not a plan as this version writes it ({reason}); use the feel321 that wrote it"
        ) from None
    return replace(plan, sha256=journals.digest(body))


def _seal(body: bytes) -> bytes:
    """Put the digest of a JSON object into it as its last entry."""
    return body.removesuffix(b"\n}") + _SEAL + journals.digest(body).encode() + b'"\n}\n'


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
    files = journals.list_journals(folder)
    return Dossier(folder, plan, tuple(journals.read_journal(path) for path in files))


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
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        words = f"{path}: holds what feel321 does not write ({type(error).__name__}: {error})"
        raise ValueError(f"{words}; restore the file from a copy") from None
    except ValueError as error:
        if not str(error).startswith("line "):
            raise
        raise ValueError(f"{path}, {error}; restore the file from a copy") from None


STEPS = {"page", "answered", "rated", "spoiled", "warm_up"}  # events that change what comes next


def replay(plan: Plan, records: Iterable[Record], *, detection: Detection | None = None) -> Agenda:
    """Make the agenda of a session as its journal leaves it; detection: learns what was detected."""
    agenda = Agenda(plan.trials, plan.flow, plan.questions)
    trials = {trial.number: trial for trial in plan.trials}
    for record in records:
        if record.event in STEPS:
            event = record.content
            try:
                advance(agenda, event, trials, detection=detection)
            except ValueError as error:
                raise ValueError(f"line {record.sequence + 1}: {error}") from None
    return agenda


def recall_detection(plan: Plan, records: Iterable[Record]) -> Detection | None:
    """Make the threshold block of a session as its journal leaves it; None where there is none."""
    detection = Detection(plan.threshold) if plan.threshold else None
    if detection:
        replay(plan, records, detection=detection)
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
        case events.TrialRated(values=answer) if trial := trials.get(event.trial):
            outcome, as_expected = events.judge(event, agenda.flow), is_as_expected(trial, answer)
            agenda.tell_trial(event.trial, outcome, as_expected=as_expected, time_s=event.time_s)
            if detection and outcome == VALID:
                detection.tell(trial, answer)
        case events.TrialRated() | events.TrialSpoiled():
            outcome = events.judge(event, agenda.flow)
            agenda.tell_trial(event.trial, outcome, as_expected=None, time_s=event.time_s)
        case events.WarmUpBegun():
            agenda.warm_up()
