"""The nouns of an experiment: stimuli, trials, scales, pages, tasks, and the groups of a design.

A trial names its stimuli by id; what an id feels like is known to the room above only.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, product
from math import prod
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from annotated_types import Interval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

RATING_RANGE = (0.0, 100.0)  # lowest and highest rating of every scale, in points

FREE = "free"
TIMINGS = ("strict", "replay", FREE)  # felt once in order; then again at will; at will throughout
SURFACE = "surface"  # stands for the id of a stimulus where the real surface is felt
ORIGINAL = "original"  # name of the recording itself as a reference
MATCHING, THRESHOLD = "matching", "threshold"  # protocol, scale and phase of these blocks' trials

Flag = Literal["underrun", "clipped", "device_error", "not_delivered", "too_fast", "not_felt"]
FLAGS: tuple[Flag, ...] = get_args(Flag)  # what can be wrong with an attempt at a trial
DEVICE_FLAGS = FLAGS[:4]
VALID, LOST, SPOILED = "valid", "lost", "spoiled"
"""What becomes of an attempt. The device lost it, which uses up no attempt of the participant, or they spoiled it."""

MOST_LOST = 12  # times that the device lost a trial before it is given up: nobody listens, or the stimulus is to blame

ASIDE = ("ready", "call_us", "timed_out")
"""Pages that no plan holds: after an interruption, a failure of the device, or an answer that did not come in time."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale of an answer: a slider, perhaps with words (anchors) along it, or a choice between parts."""

    name: str
    question: str
    low_label: str
    high_label: str
    anchors: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    further: tuple[Scale, ...] = ()  # of a trial that asks on several

    def find(self, name: str) -> Scale:
        """Find the scale of a judgement: one of the others of its trial, or this one."""
        return next((scale for scale in self.further if scale.name == name), self)


@dataclass(frozen=True, slots=True)
class Item:
    """A stimulus as a protocol sees it.

    Parameters
    ----------
    stimulus_id : str
        Name of the stimulus.
    recording : str
        The recording that it was made from.
    reducer : str
        The reducer that made it; `original` for the recording itself.
    level : str
        The level arm that it belongs to.
    role : str
        `test`, `reference` or `anchor`.

    Examples
    --------
    >>> from feel321 import protocols
    >>> protocols.Item("oak-dft321", "oak", "dft321", "as_is", "test").role
    'test'
    """

    stimulus_id: str
    recording: str
    reducer: str
    level: str
    role: str


@dataclass(frozen=True, slots=True)
class Part:
    """One thing that is felt in a trial: a stimulus, or the real surface of a recording; its name reveals nothing."""

    name: str
    stimulus_id: str | None = None
    surface: str | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """One answer that a trial asks for; it becomes one row of `ratings.csv`."""

    part: str
    stimulus_id: str
    reference_id: str | None = None  # or `surface`; None where the judgement is absolute
    expected: tuple[float, float] | None = None  # ratings of who has understood; None for any
    scale: str = ""  # where it is not that of the trial

    @property
    def key(self) -> str:
        """What names its answer: the part, and the scale where it is not that of the trial."""
        return f"{self.part}:{self.scale}" if self.scale else self.part


@dataclass(frozen=True, slots=True)
class Comparison:
    """Parts that are felt and judged together, before they have a place in a session."""

    parts: tuple[Part, ...]
    judgements: tuple[Judgement, ...]
    catch: str = ""  # `identical`, `hidden_reference` or `anchor`, where the right answer is known


@dataclass(frozen=True, slots=True)
class Trial:
    """One comparison at its place in the session of one participant."""

    number: int  # from 1, the main phase first
    block: int  # from 1; 0 in training and practice
    repeat: int  # of this comparison within its protocol, from 1; 0 outside the main phase
    protocol: str
    scale: str
    timing: str
    recording: str
    parts: tuple[Part, ...]  # in order; each must be felt to its end before an answer is taken
    judgements: tuple[Judgement, ...]
    phase: str = "main"  # whose trials become ratings; `training`, `practice`, or that of a block
    catch: str = ""

    @property
    def judged(self) -> list[str]:
        """Names of the answers, such as `test` and `test:roughness`: parts, and scales beyond the trial's own."""
        return [judgement.key for judgement in self.judgements]


class Trials(tuple[Trial, ...]):
    """The trials of one participant, in order: a tuple, with a table of them."""

    __slots__ = ()

    def to_frame(self) -> DataFrame:
        """Return the judgements of all trials as a table: one row per judgement, in order."""
        import pandas as pd

        own = ["number", "phase", "block", "repeat", "protocol", "scale", "timing", "recording"]
        judged = ["part", "stimulus_id", "reference_id"]
        rows = [
            {name: getattr(trial, name) for name in (*own, "catch")}
            | {name: getattr(judgement, name) for name in judged}
            | {"scale": judgement.scale or trial.scale}
            for trial in self
            for judgement in trial.judgements
        ]
        return pd.DataFrame(rows, columns=[*own, "catch", *judged])

    def __repr__(self) -> str:
        """Describe the trials in one line."""
        protocols = ", ".join(dict.fromkeys(trial.protocol for trial in self))
        return f"Trials({len(self)} trials of {protocols or 'no protocol'})"


# The rules of a session besides its trials are settings: `settings/meanings.toml` says what each is.

AnHour = Annotated[float, Interval(ge=0, le=3600)]


@dataclass(frozen=True)
class Breaks:
    """When the hand rests; `[session.breaks]` of study.toml."""

    break_trials: Annotated[int, Interval(ge=1, le=10**6)] | None = 60
    break_min: Annotated[float, Interval(gt=0, le=1440)] | None = 10.0
    break_s: AnHour = 30.0
    rest_s: AnHour = 60.0


@dataclass(frozen=True)
class Rounds:
    """When training has been understood."""

    training_pass: Annotated[float, Interval(ge=0, le=1)] = 0.75
    training_rounds: Annotated[int, Interval(ge=1, le=100)] = 3


@dataclass(frozen=True)
class Quality:
    """Which trials are repeated; `[session.quality]` of study.toml."""

    min_response_s: Annotated[float, Interval(ge=0, le=5)] = 0.2
    max_attempts: Annotated[int, Interval(ge=1, le=100)] = 3
    reject: tuple[Flag, ...] = ("underrun", "device_error", "too_fast", "not_felt")
    gap_s: Annotated[float, Interval(ge=0, le=30)] = 0.5
    level_error_db: Annotated[float, Interval(gt=0, le=1e9)] | None = 3.0
    min_coherence: Annotated[float, Interval(ge=0, le=1)] = 0.3

    def __post_init__(self) -> None:
        """Refuse a reason that is named twice."""
        if len(set(self.reject)) < len(self.reject):
            raise ValueError(f"reject must hold each name once, got {', '.join(self.reject)}")


@dataclass(frozen=True)
class Flow(Quality, Rounds, Breaks):  # in the plan, breaks come first
    """The rules of a session besides its trials, part of the plan."""


@dataclass(frozen=True, slots=True)
class Page:
    """A page to read, by its key in the catalogue, shown for so long at least, until `by` ends it."""

    key: str
    least_s: float = 0.0
    by: str = "participant"


@dataclass(frozen=True, slots=True)
class Task:
    """A protocol with the options of a study, which `make_task` checks.

    training, practice: numbers of trials, with feedback and without, before the first that counts. pairs: of each
    recording and level. gap_s: silence before each part. onset_s: from the onset of a trial to that of the next.
    """

    protocol: str
    timing: str
    reference: str = ORIGINAL
    surface: bool = False
    training: int = 0
    practice: int = 0
    pairs: int | None = None
    scales: tuple[str, ...] = ()
    gap_s: float | None = None
    answer_timeout_s: float | None = None
    onset_s: float | None = None


CHOOSING = ("level", "protocol")
"""Factors between participants that decide which stimuli or tasks they have; any other is a label."""


def place_in_groups(
    between: Mapping[str, Sequence[str]], number: int
) -> tuple[dict[str, str], int]:
    """Find the group of participant `number` (from 1), and the participant's number within it (from 1)."""
    place, turn = divmod(number - 1, prod(map(len, between.values())))
    levels = next(islice(product(*between.values()), turn, None))  # the last factor changes fastest
    return dict(zip(between, levels, strict=True)), place + 1


def select_items(items: Sequence[Item], groups: Mapping[str, str]) -> tuple[Item, ...]:
    """Select the stimuli of a group: its level, and references that no level has of its own."""
    if (level := groups.get("level")) is None:
        return tuple(items)
    own = [item for item in items if item.level == level]
    served = {item.recording for item in own if item.role == "reference"}
    shared = (item for item in items if item.role == "reference" and item.recording not in served)
    return (*own, *shared)


def select_group(
    items: Sequence[Item], tasks: Sequence[Task], groups: Mapping[str, str]
) -> tuple[tuple[Item, ...], tuple[Task, ...]]:
    """Select the stimuli and the tasks of a group."""
    own = groups.get("protocol")
    return select_items(items, groups), tuple(t for t in tasks if own in {None, t.protocol})
