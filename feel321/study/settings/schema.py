"""The schema of `study.toml`: every table, key and default. The tables are closed and frozen.

Names of reducers, scenes, protocols, levels, units and languages are those of the registries.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from feel321.arguments import name_of
from feel321.files import check_samples
from feel321.protocols import texts
from feel321.protocols.order import ORDERS, TASK_ORDERS
from feel321.protocols.tasks import make_task
from feel321.protocols.threshold import (
    PROCEDURES,
    USUAL,
    MatchingBlock,
    ThresholdBlock,
    ThresholdPlan,
    name_tone,
)
from feel321.protocols.trial import CHOOSING, Breaks, Quality, Rounds, Task
from feel321.records import NO_NUMBER, PaperClaim, Provenance
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ, PLANNED
from feel321.stimuli.recording import AXES, UNITS
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.recipe import (
    GAINS,
    LEVELS,
    NO_REFERENCE,
    ONE_GAIN,
    ORIGINAL,
    RigSettings,
    StimulusSettings,
    check_names,
)
from feel321.stimuli.synthesis import SCENES
from feel321.stimuli.thresholds import CONTACTOR, THRESHOLDS
from feel321.study.folder import LAST_PARTICIPANT_COLUMNS, PARTICIPANT_COLUMNS, RATING_COLUMNS
from feel321.study.own_protocols import OURS, name_protocols
from feel321.study.session.plan import Stale
from feel321.study.settings import fields as kinds
from feel321.types import ANCHOR_NAMES

_BLOCK = ThresholdBlock("bayesian", (), USUAL)  # whose defaults are the study's

LANGUAGE_FILE = ".toml"  # how the name of a lab's own file of texts ends

Level = Annotated[float, Field(ge=-120, le=60)]
LevelName = Annotated[str, kinds.one_of(LEVELS)]
UpTo100 = Annotated[kinds.Count, Field(le=100)]
Label = Annotated[str, AfterValidator(texts.check_label)]


class StudyTable(kinds.TomlTable):
    """`[study]`: name and seed."""

    name: kinds.Words = ""  # the folder's, once the file is read
    seed: kinds.Seed = 321


SCENE_RATE_HZ = 10000.0  # sampling rate of scenes; that of a file is what the file says
_NOT_OF = {  # what a recording is -> what its table cannot say
    "scene": {"unit", "columns", "full_scale", "resample"},
    "file": {"seed", "duration_s"},
    "files": {"seed", "duration_s", "name", "picture"},
}


def _check_scene(scene: str) -> str:
    for part in scene.split("+"):
        kinds.check_one_of(part, SCENES)
    return scene


class RecordingTable(kinds.TomlTable):
    """`[[recordings]]`: a bundled synthetic `scene`, a `file` of the lab's own, or all `files` of a pattern."""

    name: str = ""
    scene: Annotated[str, AfterValidator(_check_scene)] | None = None
    file: kinds.Words | None = None
    files: kinds.Words | None = None
    sample: kinds.Words | None = None
    picture: kinds.Words | None = None
    rotation: kinds.Seed | None = None
    rate_hz: kinds.Rate | None = None
    seed: kinds.Seed = 0
    duration_s: Annotated[kinds.Positive, Field(le=3600)] = 4.0
    unit: Annotated[str, kinds.one_of(UNITS)] | None = None
    columns: tuple[str | kinds.Count, ...] | None = None
    full_scale: kinds.Positive | None = None
    resample: bool = False
    crop_s: tuple[kinds.Seconds, kinds.Seconds] | None = None
    high_pass_hz: kinds.Positive | None = None
    gain: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        given = [kind for kind in _NOT_OF if getattr(self, kind)]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise ValueError(f"must have one of {', '.join(_NOT_OF)}, got {got}")
        if wrong := sorted(self.model_fields_set & _NOT_OF[given[0]]):
            raise ValueError(f"{wrong[0]} does not go with {given[0]}; leave it out")
        if self.scene:
            rate_hz = self.rate_hz or SCENE_RATE_HZ
            check_samples(math.ceil(self.duration_s * rate_hz), AXES, rate_hz)
        return self

    @property
    def title(self) -> str:
        """The recording's name: `oak` by default for `recordings/oak.csv`, in orientation 1 `oak-r1`."""
        turned = "" if self.rotation is None else f"-r{self.rotation}"
        source = self.scene.replace("+", "-") if self.scene else PurePath(self.file or "").stem
        return self.name or f"{source}{turned}"

    @property
    def exceptions(self) -> dict[str, Any]:
        """What is done to this recording otherwise than `[stimuli]` says."""
        own = self.model_fields_set & {"crop_s", "high_pass_hz", "gain"}
        return {name: getattr(self, name) for name in sorted(own)}

    def list_entries(self, folder: Path) -> list["RecordingTable"]:
        """List itself, or an entry for each file of a pattern, sorted by path relative to the study's folder."""
        if self.files is None:
            return [self]
        if Path(self.files).is_absolute():
            raise ValueError(f"must be within the study's folder, got {self.files!r}; link it")
        found = (path for path in folder.glob(self.files) if path.name[0] != "." and path.is_file())
        names = sorted(path.relative_to(folder).as_posix() for path in found)
        if not names:
            raise ValueError(
                f"must match at least one file, got {self.files!r}; write a pattern such as 'corpus/*.wav'"
            )
        return [self.model_copy(update={"files": None, "file": name}) for name in names]


def _check_titles(recordings: tuple[RecordingTable, ...]) -> tuple[RecordingTable, ...]:
    """Check the names of recordings, as far as they are known before patterns are followed."""
    titles = [one.title for one in recordings if one.files is None]
    if titles or not recordings:
        check_names(kinds.check_some(tuple(titles)))
    return recordings


ACCEPT = "accept"
BELOW_THRESHOLD = ("refuse", ACCEPT)
"""Whether stimuli that are weaker than the detection threshold keep a study from running."""

OwnReducer = Annotated[str, kinds.own_or_one_of(REDUCERS, "reducer", "reducers")]
Reference = kinds.own_or_one_of((ORIGINAL, NO_REFERENCE, *REDUCERS), "reducer", "reducers")


def _check_gain(gain: float | str) -> float | str:
    if gain not in GAINS and (isinstance(gain, str) or not 1e-6 <= gain <= 1e6):  # noqa: PLR2004 - any rig's
        raise ValueError('must be "set", "per_recording", or a number from 1e-6 to 1e6')
    return gain


@dataclass(frozen=True)
class StimuliTable(StimulusSettings):
    """`[stimuli]`: what is made of each recording."""

    reducers: Annotated[tuple[OwnReducer, ...], kinds.Some] = DEFAULT_REDUCERS
    levels: Annotated[tuple[LevelName, ...], kinds.Some] = (LEVELS[0],)
    reference: Annotated[str, Reference] = ORIGINAL
    gain: Annotated[float | str, AfterValidator(_check_gain)] = ONE_GAIN
    threshold: Annotated[str, kinds.one_of(THRESHOLDS)] = CONTACTOR
    metrics: Annotated[tuple[kinds.Words, ...], kinds.Distinct] = ()
    below_threshold: Annotated[str, kinds.one_of(BELOW_THRESHOLD)] = "refuse"


@dataclass(frozen=True)
class RigTable(RigSettings):
    """`[rig]`: what the stimuli are rendered for."""

    certificate: Annotated[str, kinds.one_of(("warn", "require"))] = "warn"

    def of_stimuli(self) -> dict[str, Any]:
        """Return what decides what the stimuli are."""
        return {one.name: getattr(self, one.name) for one in fields(RigSettings)}


class MethodTable(kinds.TomlTable):
    """A lab's own method: code, or a command; what it declares is believed."""

    use: kinds.Words | None = None
    command: kinds.Words | None = None
    timeout_s: kinds.Positive | None = None

    def to_facts(self) -> dict[str, Any]:
        """Return what is said, without what is left out."""
        return self.model_dump(exclude_none=True)


class ReducerTable(MethodTable):
    """`[reducers.NAME]`: a lab's own reducer."""

    operations: str | float | None = None
    state: str | float | None = None
    latency: str | float | None = None
    batches: bool | None = None


class MetricTable(MethodTable):
    """`[metrics.NAME]`: a lab's own metric, or what a column of the manifest means."""

    label: kinds.Words | None = None
    higher: Annotated[str, kinds.one_of(("better", "worse"))] | None = None
    low: kinds.Finite | None = None
    high: kinds.Finite | None = None
    unit: str | None = None

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low must be below high, got {self.low:g} and {self.high:g}")
        return self


@dataclass(frozen=True)
class Rehearsal(Rounds):
    """`[session.rehearsal]`: what comes before the trials that count."""

    training: UpTo100 = 4
    practice: UpTo100 = 2


class ThresholdTable(kinds.TomlTable):
    """`[session.threshold]`: the detection threshold of each participant, at four to five minutes a frequency."""

    frequencies_hz: Annotated[
        tuple[Annotated[float, Field(ge=LOWEST_HZ, le=HIGHEST_HZ)], ...],
        Field(min_length=1, max_length=8),
    ]
    procedure: Annotated[str, kinds.one_of(PROCEDURES)] = _BLOCK.procedure
    trials: Annotated[int, Field(ge=5, le=200)] = USUAL.trials
    catch_every: Annotated[kinds.Count, Field(le=200)] = USUAL.catch_every
    practice: UpTo100 = _BLOCK.practice
    duration_s: Annotated[float, Field(ge=0.1, le=2)] = _BLOCK.duration_s
    gap_s: Annotated[kinds.NotNegative, Field(le=5)] = _BLOCK.gap_s
    start_db: Level = USUAL.start_db
    lowest_db: Level = USUAL.lowest_db
    highest_db: Level = USUAL.highest_db

    @model_validator(mode="after")
    def _check_levels(self) -> Self:
        kinds.check_distinct(tuple(name_tone(frequency) for frequency in self.frequencies_hz))
        self.make_block()
        return self

    def make_block(self) -> ThresholdBlock:
        """Make the block of a design; which refuses levels that are out of order."""
        names = {"trials", "catch_every", "start_db", "lowest_db", "highest_db"}
        plan = ThresholdPlan(**self.model_dump(include=names))
        return ThresholdBlock(plan=plan, **self.model_dump(exclude=names))


class MatchingTable(kinds.TomlTable):
    """`[session.matching]`: stimuli matched in strength with the recording itself, before the trials."""

    level: LevelName | None = None
    repeats: Annotated[int, Field(ge=1, le=20)] = MatchingBlock("").repeats


def _check_language(language: str) -> str:
    if language not in (known := texts.list_languages()) and not language.endswith(LANGUAGE_FILE):
        raise ValueError(
            f'must be one of {", ".join(known)}, or a file beside study.toml such as "texts/fr.toml"'
        )
    return language


def _check_questions(questions: tuple[texts.Question, ...]) -> tuple[texts.Question, ...]:
    kinds.check_distinct(tuple(one.name for one in questions))
    if len(questions) > (most := texts.MOST_QUESTIONS):
        raise ValueError(f"must be at most {most} questions, got {len(questions)}")
    return questions


OwnProtocol = Annotated[str, kinds.own_or_one_of(OURS, "protocol", "protocols")]


class SessionTable(kinds.TomlTable):
    """`[session]`: what participants do."""

    protocols: Annotated[tuple[OwnProtocol, ...], kinds.Some] = ("realism", "similarity")
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    recordings_per_participant: kinds.AtLeastOne | None = None
    order: Annotated[str, kinds.one_of(ORDERS)] = "williams"
    task_order: Annotated[str, kinds.one_of(TASK_ORDERS)] = TASK_ORDERS[0]
    language: Annotated[str, AfterValidator(_check_language)] = "en"
    consent: kinds.Words | None = None
    lsl: bool = False
    rehearsal: Rehearsal = Rehearsal()
    breaks: Breaks = Breaks()
    quality: Quality = Quality()
    stale: Stale = Stale()
    threshold: ThresholdTable | None = None
    matching: MatchingTable | None = None
    questions: Annotated[tuple[texts.Question, ...], AfterValidator(_check_questions)] = ()


def _check_task(name: str, info: ValidationInfo) -> str:
    """Demand the name of one of feel321's protocols, or the short name of one of the study's own."""
    session = (info.context or {}).get("session")
    given = session.get("protocols") if isinstance(session, dict) else ()
    return kinds.check_one_of(name, (*OURS, *name_protocols(given)))


class TaskTable(kinds.TomlTable):
    """`[tasks.NAME]`: how a protocol is used; what is left out is as the protocol has it."""

    timing: kinds.Words | None = None
    reference: kinds.Words | None = None
    surface: bool = False
    pairs: kinds.AtLeastOne | None = None
    scales: tuple[kinds.Words, ...] = ()
    gap_s: kinds.NotNegative | None = None
    answer_timeout_s: kinds.Positive | None = None
    onset_s: kinds.Positive | None = None

    def make_task(self, name: str, *, training: int = 0, practice: int = 0) -> Task:
        """Make the task of a design; which refuses what its protocol has not."""
        return make_task(name, training=training, practice=practice, **self.model_dump())


class ScaleTable(kinds.TomlTable):
    """`[scales.NAME]`: a scale of the lab's own, or other words for one of feel321's."""

    question: kinds.Words
    low: kinds.Words
    high: kinds.Words
    anchors: tuple[kinds.Words, ...] = ()

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        if self.low == self.high:
            raise ValueError(f"low and high must differ, got {self.low!r} for both")
        return self

    def to_texts(self) -> dict[str, str | list[str]]:
        """Return its texts as a language holds them."""
        words = {"question": self.question, "low_label": self.low, "high_label": self.high}
        return words | ({"anchors": list(self.anchors)} if self.anchors else {})


MOST_GROUPS = 64  # a balanced design wants several participants in each group; more groups than this are a slip

TAKEN = {*PARTICIPANT_COLUMNS, *LAST_PARTICIPANT_COLUMNS, *RATING_COLUMNS} - set(CHOOSING)
"""Names of columns: a factor becomes one of `participants.csv`, which is joined with `ratings.csv`."""


def _check_factor(name: str) -> str:
    """Demand a name that can head a column of its own."""
    singular = name.casefold().removesuffix("s")
    if name not in CHOOSING and singular in CHOOSING:
        raise ValueError(f"must be {singular!r} or a label of your own")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", name):
        raise ValueError("must be up to 40 letters (A-Z), digits and _, beginning with a letter")
    if name.casefold() in TAKEN or re.fullmatch(r"threshold_\w+hz", name.casefold()):
        raise ValueError("must not be a column of participants.csv or ratings.csv; rename it")
    return name


def count_groups(between: Mapping[str, tuple[str, ...]]) -> int:
    """Count the groups that factors make."""
    return math.prod(len(levels) for levels in between.values())


def _check_groups(between: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    if (groups := count_groups(between)) > MOST_GROUPS:
        raise ValueError(
            f"there must be at most {MOST_GROUPS} groups, got {groups}; use fewer factors or levels"
        )
    return between


Factor = Annotated[str, AfterValidator(_check_factor)]
Levels = Annotated[tuple[kinds.Words, ...], kinds.Some]


class StationsTable(kinds.TomlTable):
    """`[stations]`: which of several computers that run the study this one is; each gives numbers of its own."""

    this: kinds.AtLeastOne = 1
    of: kinds.AtLeastOne = 1

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.this > self.of:
            raise ValueError(f"this must be 1 to {self.of}, got {self.this}")
        return self


class AnalysisTable(kinds.TomlTable):
    """`[analysis]`: how ratings are related to metrics; chosen before they are seen."""

    metrics: Annotated[tuple[kinds.Words, ...], kinds.Some] = PLANNED
    draws: Annotated[int, Field(ge=100, le=100_000)] = 2000
    margin: Annotated[float, Field(gt=0, le=100)] | None = None
    hypotheses: tuple[kinds.Words, ...] = ()


# What is besides the study itself: simulated participants, the paper that is replicated, the publication.


def _check_terms(terms: dict[str, float], info: ValidationInfo) -> dict[str, float]:
    """Demand reducers as the manifest names them; without a whole file, a lab's own are not known."""
    if info.context is None:
        return terms
    stimuli, own = (info.context.get(table) for table in ("stimuli", "reducers"))
    felt = stimuli.get("reducers") if isinstance(stimuli, dict) else ()
    known = [*REDUCERS, *ANCHOR_NAMES, *(own if isinstance(own, dict) else ())]
    known += [name_of(name) for name in felt or () if isinstance(name, str)]
    for name in terms:
        kinds.check_one_of(name, known)
    return terms


class ObserverTable(kinds.TomlTable):
    """`[observer]`: how simulated participants feel and differ."""

    intercept: kinds.Finite = 10.0
    spectral: kinds.Finite = 45.0
    temporal: kinds.Finite = 35.0
    reducers: Annotated[dict[str, kinds.Finite], AfterValidator(_check_terms)] = Field(
        default_factory=dict
    )
    bias_sd: kinds.NotNegative = 6.0
    gain_sd: kinds.NotNegative = 0.15
    slope_sd: kinds.NotNegative = 0.0
    noise_sd: kinds.NotNegative = 8.0
    noise_spread: kinds.NotNegative = 0.25
    lapse_rate: kinds.Share = 0.0
    detection_sd: kinds.NotNegative = 4.0
    detection_slope: kinds.Positive = 3.0
    matching_sd: kinds.NotNegative = 1.0
    straight_liners: kinds.Share = 0.0
    random_clickers: kinds.Share = 0.0
    scale_reversers: kinds.Share = 0.0

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        bad = self.straight_liners + self.random_clickers + self.scale_reversers
        if bad > 1 + 1e-9:
            raise ValueError(
                f"straight_liners, random_clickers, scale_reversers must be at most 1 together, got {bad:g}"
            )
        return self


class PublishedTable(kinds.TomlTable):
    """`[[paper.published]]`: numbers of a metric that the paper gives for one of its recordings."""

    table: kinds.Words
    source: Provenance
    recording: kinds.Words
    shown: kinds.Words = "a recording of the paper"
    metric: kinds.Words
    numbers: Annotated[dict[str, kinds.Finite], Field(min_length=1)]


class PaperTable(kinds.TomlTable):
    """`[paper]`: the paper that is replicated."""

    citation: kinds.Words
    doi: kinds.Words
    seen: Literal["full text", "abstract"]
    claims: tuple[PaperClaim, ...] = ()
    published: tuple[PublishedTable, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        kinds.check_distinct(tuple(claim.name for claim in self.claims))
        for claim in self.claims:
            if claim.paper is not NO_NUMBER and all(map(math.isnan, claim.paper)):
                needs = "paper must have a value, or low and high, got none"
                raise ValueError(f"claim {claim.name!r}: {needs}; add them, or leave it out")
        given = [(one, reducer) for one in self.published for reducer in one.numbers]
        kinds.check_distinct(
            tuple(f"{one.recording}, {one.metric}, {reducer}" for one, reducer in given)
        )
        return self


# What an export says of the study besides its data.

LICENCES = (  # SPDX names of the licences that data are published under
    "CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0", "CC-BY-NC-ND-4.0",
    "PDDL-1.0", "ODC-By-1.0", "ODbL-1.0", "CDLA-Permissive-2.0", "CDLA-Sharing-1.0",
)  # fmt: skip

_ORCID = kinds.like(
    r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])",
    "an ORCID iD such as '0000-0002-1825-0097'",
)
_DOI = kinds.like(
    r"(?:https://doi\.org/|doi:)?(10\.\d{4,9}/\S+)", "a DOI such as '10.5281/zenodo.123456'"
)
_DAY = kinds.like(
    r"(\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01]))", "a day such as '2026-11-23'"
)


class AuthorTable(kinds.TomlTable):
    """`[[publication.authors]]`: somebody who made the study."""

    given: kinds.Words
    family: kinds.Words
    orcid: Annotated[str, _ORCID] | None = None
    affiliation: kinds.Words | None = None


class PublicationTable(kinds.TomlTable):
    """`[publication]`: what an export says of the study besides its data."""

    title: kinds.Words | None = None
    description: kinds.Words | None = None
    version: kinds.Words = "1.0.0"
    released: Annotated[str, _DAY] | None = None
    licence: Annotated[str, kinds.one_of(LICENCES)] | None = None
    authors: tuple[AuthorTable, ...] = ()
    institution: kinds.Words | None = None
    department: kinds.Words | None = None
    address: kinds.Words | None = None
    ethics: tuple[kinds.Words, ...] = ()
    funding: tuple[kinds.Words, ...] = ()
    acknowledgements: kinds.Words | None = None
    keywords: tuple[kinds.Words, ...] = ()
    references: tuple[kinds.Words, ...] = ()
    doi: Annotated[str, _DOI] | None = None


class Settings(kinds.TomlTable):
    """The whole of `study.toml`."""

    recordings: Annotated[tuple[RecordingTable, ...], AfterValidator(_check_titles)]
    study: StudyTable = StudyTable()
    stimuli: StimuliTable = StimuliTable()
    reducers: dict[str, ReducerTable] = Field(default_factory=dict)
    metrics: dict[str, MetricTable] = Field(default_factory=dict)
    rig: RigTable = RigTable()
    session: SessionTable = SessionTable()
    tasks: dict[Annotated[str, AfterValidator(_check_task)], TaskTable] = Field(
        default_factory=dict
    )
    scales: dict[Label, ScaleTable] = Field(default_factory=dict)
    between: Annotated[dict[Factor, Levels], AfterValidator(_check_groups)] = Field(
        default_factory=dict
    )
    observer: ObserverTable = ObserverTable()
    analysis: AnalysisTable = AnalysisTable()
    stations: StationsTable = StationsTable()
    paper: PaperTable | None = None
    publication: PublicationTable = PublicationTable()

    def list_tasks(self) -> tuple[Task, ...]:
        """List the tasks of a session."""
        counts = self.session.rehearsal
        rounds = {"training": counts.training, "practice": counts.practice}
        tables = {name: self.tasks.get(name, TaskTable()) for name in self.session.protocols}
        return tuple(table.make_task(name, **rounds) for name, table in tables.items())
