"""The schema of `study.toml`: every table, key and default. The tables are closed and frozen.

Names of reducers, scenes, protocols, levels, units and languages are those of the registries. A setting that the
stimuli or the protocols know under another name has that name as its `serialization_alias`.
"""

import math
import re
from collections.abc import Mapping
from math import prod
from pathlib import Path, PurePath
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from feel321 import intake
from feel321.doors import name_of
from feel321.protocols.blocks import MatchingBlock, ThresholdBlock, name_tone
from feel321.protocols.order import ORDERS, TASK_ORDERS
from feel321.protocols.tasks import make_task, refine_task
from feel321.protocols.texts import list_languages
from feel321.protocols.threshold import PROCEDURES, USUAL, ThresholdPlan
from feel321.protocols.trial import CHOOSING, FLAGS, Flow, Task
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ, PLANNED
from feel321.stimuli.recording import AXES, UNITS
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.recipe import (
    ANCHORS,
    GAINS,
    LEVELS,
    NO_REFERENCE,
    ORIGINAL,
    Recipe,
    check_names,
)
from feel321.stimuli.synthesis import SCENES
from feel321.stimuli.thresholds import THRESHOLDS
from feel321.study.admission import OURS, name_protocols
from feel321.study.columns import LAST_PARTICIPANT_COLUMNS, PARTICIPANT_COLUMNS, RATING_COLUMNS
from feel321.study.session.plan import POLICIES, Stale
from feel321.study.settings import fields as kinds
from feel321.study.settings.asking import Questions, Scales
from feel321.study.settings.paper import PaperTable
from feel321.study.settings.publication import PublicationTable

_FLOW, _STALE, _RECIPE, _STEPS = Flow(), Stale(), Recipe(), Conditioning()
_BLOCK, _MATCHING = ThresholdBlock("bayesian", (), USUAL), MatchingBlock("")
"""What the floors below do where nothing is asked for: their defaults are the study's."""

# Factors in which participants differ.

MOST_GROUPS = 64
"""A balanced design wants several participants in each group; more groups than this are a slip."""

TAKEN = {*PARTICIPANT_COLUMNS, *LAST_PARTICIPANT_COLUMNS, *RATING_COLUMNS} - set(CHOOSING)
"""Names of columns: a factor becomes one of `participants.csv`, which is joined with `ratings.csv`."""


def check_factor(name: str) -> str:
    """Demand a name that can head a column of its own."""
    singular = name.casefold().removesuffix("s")
    if name not in CHOOSING and singular in CHOOSING:
        raise ValueError(f"must be {singular!r} or a label of your own")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", name):
        raise ValueError("must be up to 40 letters (A-Z), digits and _, beginning with a letter")
    if name.casefold() in TAKEN or re.fullmatch(r"threshold_\w+hz", name.casefold()):
        raise ValueError("must not be a column of participants.csv or ratings.csv; rename it")
    return name


def _check_groups(between: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    if (groups := count_groups(between)) > MOST_GROUPS:
        raise ValueError(
            f"there must be at most {MOST_GROUPS} groups, got {groups}; use fewer factors or levels"
        )
    return between


def count_groups(between: Mapping[str, tuple[str, ...]]) -> int:
    """Count the groups that factors make."""
    return prod(len(levels) for levels in between.values())


# What participants do: `[session]`, `[tasks]` and `[between]`.

LANGUAGE_FILE = ".toml"
"""How the name of a lab's own file of texts ends."""


def _check_language(language: str) -> str:
    if language not in list_languages() and not language.endswith(LANGUAGE_FILE):
        raise ValueError(
            f'must be one of {", ".join(list_languages())}, or a file beside study.toml such as "texts/fr.toml"'
        )
    return language


class RehearsalTable(kinds.TomlTable):
    """`[session.rehearsal]`: what comes before the trials that count."""

    training: Annotated[kinds.Count, Field(le=100)] = 4
    practice: Annotated[kinds.Count, Field(le=100)] = 2
    pass_share: kinds.Share = Field(
        default=_FLOW.training_pass, serialization_alias="training_pass"
    )
    rounds: int = Field(
        default=_FLOW.training_rounds, ge=1, le=100, serialization_alias="training_rounds"
    )


class BreaksTable(kinds.TomlTable):
    """`[session.breaks]`: when the hand rests."""

    every_trials: Annotated[kinds.AtLeastOne | None, kinds.OrOff] = Field(
        default=_FLOW.break_trials, serialization_alias="break_trials"
    )
    every_min: Annotated[Annotated[kinds.Positive, Field(le=1440)] | None, kinds.OrOff] = Field(
        default=_FLOW.break_min, serialization_alias="break_min"
    )
    break_s: Annotated[kinds.NotNegative, Field(le=3600)] = _FLOW.break_s
    rest_s: Annotated[kinds.NotNegative, Field(le=3600)] = _FLOW.rest_s


class QualityTable(kinds.TomlTable):
    """`[session.quality]`: which trials are repeated."""

    min_response_s: Annotated[kinds.NotNegative, Field(le=5)] = _FLOW.min_response_s
    max_attempts: Annotated[int, Field(ge=1, le=100)] = _FLOW.max_attempts
    reject: Annotated[tuple[Annotated[str, kinds.one_of(FLAGS)], ...], kinds.Distinct] = (
        _FLOW.reject
    )
    gap_s: Annotated[kinds.NotNegative, Field(le=30)] = _FLOW.gap_s
    level_error_db: kinds.PositiveOrOff = _FLOW.level_error_db
    min_coherence: kinds.Share = _FLOW.min_coherence


class StaleTable(kinds.TomlTable):
    """`[session.stale]`: what becomes of a session that is resumed late."""

    after_h: Annotated[Annotated[kinds.Positive, Field(le=8760)] | None, kinds.OrOff] = (
        _STALE.after_h
    )
    policy: Annotated[str, kinds.one_of(POLICIES)] = _STALE.policy


MOST_FREQUENCIES = 8
"""Each frequency takes four to five minutes."""


Level = Annotated[float, Field(ge=-120, le=60)]


def _check_apart(frequencies: tuple[float, ...]) -> tuple[float, ...]:
    kinds.check_distinct(tuple(name_tone(frequency) for frequency in frequencies))
    return frequencies


class ThresholdTable(kinds.TomlTable):
    """`[session.threshold]`: the detection threshold of each participant, measured before the trials."""

    frequencies_hz: Annotated[
        tuple[Annotated[float, Field(ge=LOWEST_HZ, le=HIGHEST_HZ)], ...],
        Field(min_length=1, max_length=MOST_FREQUENCIES),
        AfterValidator(_check_apart),
    ]
    procedure: Annotated[str, kinds.one_of(PROCEDURES)] = _BLOCK.procedure
    trials: Annotated[int, Field(ge=5, le=200)] = USUAL.trials
    catch_every: Annotated[kinds.Count, Field(le=200)] = USUAL.catch_every
    practice: Annotated[kinds.Count, Field(le=100)] = _BLOCK.practice
    duration_s: Annotated[float, Field(ge=0.1, le=2)] = _BLOCK.duration_s
    gap_s: Annotated[kinds.NotNegative, Field(le=5)] = _BLOCK.gap_s
    start_db: Level = USUAL.start_db
    lowest_db: Level = USUAL.lowest_db
    highest_db: Level = USUAL.highest_db

    @model_validator(mode="after")
    def _check_levels(self) -> Self:
        self.make_block()
        return self

    def make_block(self) -> ThresholdBlock:
        """Make the block of a design; which refuses levels that are out of order."""
        names = {"trials", "catch_every", "start_db", "lowest_db", "highest_db"}
        own = self.model_dump(exclude=names)
        return ThresholdBlock(plan=ThresholdPlan(**self.model_dump(include=names)), **own)


class MatchingTable(kinds.TomlTable):
    """`[session.matching]`: stimuli matched in strength with the recording itself, before the trials."""

    level: Annotated[str, kinds.one_of(LEVELS)] | None = None
    repeats: Annotated[int, Field(ge=1, le=20)] = _MATCHING.repeats

    def make_block(self, levels: tuple[str, ...]) -> MatchingBlock:
        """Make the block of a design; the last of the set's levels is matched where none is named."""
        return MatchingBlock(self.level or levels[-1], self.repeats)


_OWN_PROTOCOL = kinds.own_or_one_of(OURS, "protocol", "protocols")


def _check_task(name: str, info: ValidationInfo) -> str:
    """Demand the name of one of feel321's protocols, or the short name of one of the study's own."""
    session = (info.context or {}).get("session")
    given = session.get("protocols") if isinstance(session, dict) else ()
    return kinds.check_one_of(name, (*OURS, *name_protocols(given)))


class SessionTable(kinds.TomlTable):
    """`[session]`: what participants do."""

    protocols: Annotated[tuple[Annotated[str, _OWN_PROTOCOL], ...], kinds.Some] = (
        "realism",
        "similarity",
    )
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    recordings_per_participant: kinds.AtLeastOne | None = None
    order: Annotated[str, kinds.one_of(ORDERS)] = "williams"
    task_order: Annotated[str, kinds.one_of(TASK_ORDERS)] = TASK_ORDERS[0]
    language: Annotated[str, AfterValidator(_check_language)] = "en"
    consent: kinds.Words | None = None
    lsl: bool = False
    rehearsal: RehearsalTable = RehearsalTable()
    breaks: BreaksTable = BreaksTable()
    quality: QualityTable = QualityTable()
    stale: StaleTable = StaleTable()
    threshold: ThresholdTable | None = None
    matching: MatchingTable | None = None
    questions: Questions = ()


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
        own = self.model_dump(include={"timing", "reference", "surface", "pairs"})
        options = self.model_dump(exclude=set(own))
        return refine_task(make_task(name, training=training, practice=practice, **own), **options)


Tasks = dict[Annotated[str, AfterValidator(_check_task)], TaskTable]
Between = Annotated[
    dict[
        Annotated[str, AfterValidator(check_factor)], Annotated[tuple[kinds.Words, ...], kinds.Some]
    ],
    AfterValidator(_check_groups),
]


# What is felt: `[[recordings]]`, `[stimuli]` and `[rig]`; who feels it, and what becomes of the ratings.


class StudyTable(kinds.TomlTable):
    """`[study]`: name and seed."""

    name: kinds.Words = ""  # the folder's, once the file is read
    seed: kinds.Seed = 321


class SourceTable(kinds.TomlTable):
    """`[[recordings]]`: what every entry may say."""

    name: str = ""
    sample: kinds.Words | None = None
    interaction: kinds.Words | None = None
    picture: kinds.Words | None = None
    rotation: kinds.Seed | None = None

    @property
    def title(self) -> str:
        """The recording's name: `oak` by default for `recordings/oak.csv`, in orientation 1 `oak-r1`."""
        turned = "" if self.rotation is None else f"-r{self.rotation}"
        return self.name or f"{self._find_source()}{turned}"

    def _find_source(self) -> str:
        raise NotImplementedError


def _check_scene(scene: str) -> str:
    for part in scene.split("+"):
        kinds.check_one_of(part, SCENES)
    return scene


class SceneTable(SourceTable):
    """`[[recordings]]` with `scene`: a bundled synthetic scene."""

    scene: Annotated[str, AfterValidator(_check_scene)]
    seed: kinds.Seed = 0
    rate_hz: kinds.Rate = 10000.0
    duration_s: Annotated[kinds.Positive, Field(le=3600)] = 4.0

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        n_samples = math.ceil(self.duration_s * self.rate_hz)
        intake.check_samples(n_samples, AXES, self.rate_hz)
        return self

    def _find_source(self) -> str:
        return self.scene.replace("+", "-")


class FileTable(SourceTable):
    """`[[recordings]]` with `file`: a recording of the lab's own."""

    file: kinds.Words
    unit: Annotated[str, kinds.one_of(UNITS)] | None = None
    rate_hz: kinds.Rate | None = None
    columns: tuple[str | kinds.Count, ...] | None = None
    full_scale: kinds.Positive | None = None
    resample: bool = False

    def _find_source(self) -> str:
        return PurePath(self.file).stem


class FilesTable(FileTable):
    """`[[recordings]]` with `files`: as many entries with `file` as there are files that match a pattern."""

    files: kinds.Words
    file: str = Field(default="", exclude=True)

    @model_validator(mode="after")
    def _check_single(self) -> Self:
        if single := [name for name in ("file", "name", "picture") if getattr(self, name)]:
            raise ValueError(
                f"must not have {single[0]} beside files: it applies to a single file; leave it out"
            )
        return self

    def list_entries(self, folder: Path) -> list[FileTable]:
        """List an entry for each file, sorted by path; the paths are relative to the study's folder."""
        if Path(self.files).is_absolute():
            raise ValueError(
                f"must be within the study's folder, got {self.files!r}; link it there"
            )
        found = (path for path in folder.glob(self.files) if path.name[0] != "." and path.is_file())
        own = self.model_dump(exclude={"files"})
        names = sorted(path.relative_to(folder).as_posix() for path in found)
        if not names:
            raise ValueError(
                f"must match at least one file, got {self.files!r}; write a pattern such as 'corpus/*.wav'"
            )
        return [FileTable(file=name, **own) for name in names]


def _find_kind(entry: object) -> str:
    tables = {"scene": SceneTable, "files": FilesTable}
    for kind, table in tables.items():
        if isinstance(entry, table) or (isinstance(entry, dict) and kind in entry):
            return kind
    return "file"


RecordingTable = Annotated[
    Annotated[SceneTable, Tag("scene")]
    | Annotated[FileTable, Tag("file")]
    | Annotated[FilesTable, Tag("files")],
    Discriminator(_find_kind),
]


def _check_titles(
    recordings: tuple[SceneTable | FileTable, ...],
) -> tuple[SceneTable | FileTable, ...]:
    """Check the names of recordings, as far as they are known before patterns are followed."""
    titles = [one.title for one in recordings if not isinstance(one, FilesTable)]
    if titles or not recordings:
        check_names(kinds.check_some(tuple(titles)))
    return recordings


class ConditioningTable(kinds.TomlTable):
    """`[stimuli.conditioning]`: what is done to a recording before it is reduced."""

    remove_offset: bool = _STEPS.remove_offset
    high_pass_hz: kinds.PositiveOrOff = _STEPS.high_pass_hz
    low_pass_hz: kinds.PositiveOrOff = _STEPS.low_pass_hz
    crop_s: tuple[kinds.Seconds, kinds.Seconds] | None = _STEPS.crop_s


ACCEPT = "accept"
BELOW_THRESHOLD = ("refuse", ACCEPT)
"""Whether stimuli that are weaker than the detection threshold keep a study from running."""


_OWN_REDUCER = kinds.own_or_one_of(REDUCERS, "reducer", "reducers")
_OWN_REFERENCE = kinds.own_or_one_of((ORIGINAL, NO_REFERENCE, *REDUCERS), "reducer", "reducers")


class StimuliTable(kinds.TomlTable):
    """`[stimuli]`: what is made of each recording."""

    reducers: Annotated[tuple[Annotated[str, _OWN_REDUCER], ...], kinds.Some] = DEFAULT_REDUCERS
    levels: Annotated[tuple[Annotated[str, kinds.one_of(LEVELS)], ...], kinds.Some] = tuple(
        _RECIPE.levels
    )
    anchors: bool = _RECIPE.anchors
    reference: Annotated[str, _OWN_REFERENCE] = _RECIPE.reference
    gain: Annotated[float | str, kinds.number_or(GAINS, least=1e-6, most=1e6)] = _RECIPE.gain
    fade_s: kinds.Seconds = _RECIPE.fade_s
    threshold: Annotated[str, kinds.one_of(THRESHOLDS)] = _RECIPE.threshold
    below_threshold: Annotated[str, kinds.one_of(BELOW_THRESHOLD)] = "refuse"
    metrics: Annotated[tuple[kinds.Words, ...], kinds.Distinct] = ()
    conditioning: ConditioningTable = ConditioningTable()


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

    file: kinds.Words | None = None
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


class RigTable(kinds.TomlTable):
    """`[rig]`: what the stimuli are rendered for."""

    rate_hz: kinds.Rate = _RECIPE.rate_hz
    full_scale_m_s2: Annotated[kinds.Positive, Field(le=1e6)] = _RECIPE.full_scale_m_s2
    headroom: Annotated[float, Field(gt=0, le=1)] = _RECIPE.headroom
    certificate: Annotated[str, kinds.one_of(("warn", "require"))] = "warn"

    def of_stimuli(self) -> dict[str, Any]:
        """Return what decides what the stimuli are."""
        return self.model_dump(exclude={"certificate"})


def _check_terms(terms: dict[str, float], info: ValidationInfo) -> dict[str, float]:
    """Demand reducers as the manifest names them; without a whole file, a lab's own are not known."""
    if info.context is None:
        return terms
    stimuli, own = (info.context.get(table) for table in ("stimuli", "reducers"))
    felt = stimuli.get("reducers") if isinstance(stimuli, dict) else ()
    known = [*REDUCERS, *ANCHORS, *(own if isinstance(own, dict) else ())]
    known += [name_of(name) for name in felt or () if isinstance(name, str)]
    for name in terms:
        kinds.check_one_of(name, known)
    return terms


class ObserverTable(kinds.TomlTable):
    """`[observer]`: how simulated participants feel and differ."""

    intercept: kinds.Finite = 10.0
    spectral: kinds.Finite = 45.0
    temporal: kinds.Finite = 35.0
    threshold_spectral: kinds.Finite = 0.0
    envelope: kinds.Finite = 0.0
    level: kinds.Finite = 0.0
    direction: kinds.Finite = 0.0
    vector_magnitude: kinds.Finite = 0.0
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
    order: kinds.Finite = 0.0
    fatigue: kinds.Finite = 0.0
    fatigue_noise: kinds.NotNegative = 0.0
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


class AnalysisTable(kinds.TomlTable):
    """`[analysis]`: how ratings are related to metrics; chosen before they are seen."""

    metrics: Annotated[tuple[kinds.Words, ...], kinds.Some] = PLANNED
    screening: tuple[kinds.Words, ...] = ()
    draws: Annotated[int, Field(ge=100, le=100_000)] = 2000
    margin: Annotated[float, Field(gt=0, le=100)] | None = None
    hypotheses: tuple[kinds.Words, ...] = ()


class StationsTable(kinds.TomlTable):
    """`[stations]`: which of several computers that run the study this one is; each gives numbers of its own."""

    this: kinds.AtLeastOne = 1
    of: kinds.AtLeastOne = 1

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.this > self.of:
            raise ValueError(f"this must be 1 to {self.of}, got {self.this}")
        return self


class Settings(kinds.TomlTable):
    """The whole of `study.toml`."""

    recordings: Annotated[tuple[RecordingTable, ...], AfterValidator(_check_titles)]
    study: StudyTable = StudyTable()
    stimuli: StimuliTable = StimuliTable()
    reducers: dict[str, ReducerTable] = Field(default_factory=dict)
    metrics: dict[str, MetricTable] = Field(default_factory=dict)
    formats: dict[str, kinds.Words] = Field(default_factory=dict)
    rig: RigTable = RigTable()
    session: SessionTable = SessionTable()
    tasks: Tasks = Field(default_factory=dict)
    scales: Scales = Field(default_factory=dict)
    between: Between = Field(default_factory=dict)
    observer: ObserverTable = ObserverTable()
    analysis: AnalysisTable = AnalysisTable()
    stations: StationsTable = StationsTable()
    paper: PaperTable | None = None
    publication: PublicationTable = PublicationTable()
