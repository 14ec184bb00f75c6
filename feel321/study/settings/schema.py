"""The schema of `study.toml`: every table, key and default.

The models are closed and frozen. Names of reducers, scenes, protocols, levels, units and languages are those of
the registries; none is written down here again.
"""

from __future__ import annotations

import re
from math import prod
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, Discriminator, Field, Tag

from feel321.protocols.order import ORDERS
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import list_languages
from feel321.protocols.trial import CHOOSING, FLAGS
from feel321.stimuli.match import PLANNED
from feel321.stimuli.recording import UNITS
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.anchors import CONTACTOR, THRESHOLDS
from feel321.stimuli.sets.recipe import GAINS, LEVELS, NO_REFERENCE, ONE_GAIN, ORIGINAL, check_names
from feel321.stimuli.synthesis import SCENES
from feel321.study import columns
from feel321.study.session.plan import POLICIES
from feel321.study.settings.fields import (
    Count,
    Distinct,
    Finite,
    NotNegative,
    OrOff,
    Positive,
    PositiveOrOff,
    Share,
    Some,
    Table,
    Words,
    check_some,
    number_or,
    one_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

# Factors in which participants differ: what they may be called, and how many groups they may make.

MOST_GROUPS = 64
"""A balanced design wants several participants in each group; more groups than this are a slip."""

TAKEN = frozenset({
    *columns.PARTICIPANT_COLUMNS,
    *columns.LAST_PARTICIPANT_COLUMNS,
    *columns.RATING_COLUMNS,
}) - set(CHOOSING)
"""Names of columns: a factor becomes one of `participants.csv`, which is joined with `ratings.csv`."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


def check_factor(name: str) -> str:
    """Demand a name that can head a column of its own.

    Examples
    --------
    >>> check_factor("Levels")
    Traceback (most recent call last):
    ValueError: did you mean level? Allowed is that, or a label of your own
    """
    plain = name.casefold()
    if name not in CHOOSING and plain.removesuffix("s") in CHOOSING:
        raise ValueError(
            f"did you mean {plain.removesuffix('s')}? Allowed is that, or a label of your own"
        )
    if not _NAME.fullmatch(name):
        raise ValueError(
            "allowed are up to 40 letters (A-Z), digits and _, beginning with a letter"
        )
    if plain in TAKEN:
        raise ValueError(
            "is a column of participants.csv or ratings.csv already, allowed is a name of its own"
        )
    return name


def check_groups(between: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Demand that the factors do not make more groups than a study can fill."""
    if (groups := count_groups(between)) > MOST_GROUPS:
        raise ValueError(
            f"got {groups} groups, allowed are at most {MOST_GROUPS}; use fewer factors or levels"
        )
    return between


def count_groups(between: Mapping[str, tuple[str, ...]]) -> int:
    """Count the groups that factors make."""
    return prod(len(levels) for levels in between.values())


# The tables of `study.toml` on what participants do: `[session]`, `[tasks]` and `[between]`.

LANGUAGE_FILE = ".toml"
"""How the name of a lab's own file of texts ends."""


def _check_language(language: str) -> str:
    if language not in list_languages() and not language.endswith(LANGUAGE_FILE):
        raise ValueError(
            f'allowed: {", ".join(list_languages())}, or a file beside study.toml such as "texts/fr.toml"'
        )
    return language


class RehearsalTable(Table):
    """`[session.rehearsal]`: what comes before the trials that count."""

    training: Annotated[Count, Field(le=100)] = 4
    practice: Annotated[Count, Field(le=100)] = 2
    pass_share: Share = 0.75
    rounds: Annotated[int, Field(ge=1, le=100)] = 3


class BreaksTable(Table):
    """`[session.breaks]`: when the hand rests."""

    every_trials: Annotated[Annotated[int, Field(ge=1)] | None, OrOff] = 60
    every_min: Annotated[Annotated[Positive, Field(le=1440)] | None, OrOff] = 10.0
    break_s: Annotated[NotNegative, Field(le=3600)] = 30.0
    rest_s: Annotated[NotNegative, Field(le=3600)] = 60.0


class QualityTable(Table):
    """`[session.quality]`: which trials are tried again."""

    min_response_s: Annotated[NotNegative, Field(le=5)] = 0.2
    max_attempts: Annotated[int, Field(ge=1, le=100)] = 3
    reject: Annotated[tuple[Annotated[str, one_of(FLAGS)], ...], Distinct] = (
        "underrun",
        "device_error",
        "too_fast",
        "not_felt",
    )
    gap_s: Annotated[NotNegative, Field(le=30)] = 0.5


class StaleTable(Table):
    """`[session.stale]`: what becomes of a session that is resumed late."""

    after_h: Annotated[Annotated[Positive, Field(le=8760)] | None, OrOff] = 6.0
    policy: Annotated[str, one_of(POLICIES)] = "warm_up"


class SessionTable(Table):
    """`[session]`: what participants do."""

    protocols: Annotated[tuple[Annotated[str, one_of(PROTOCOLS)], ...], Some] = (
        "realism",
        "similarity",
    )
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    order: Annotated[str, one_of(ORDERS)] = "williams"
    language: Annotated[str, AfterValidator(_check_language)] = "en"
    consent: Words | None = None
    rehearsal: RehearsalTable = RehearsalTable()
    breaks: BreaksTable = BreaksTable()
    quality: QualityTable = QualityTable()
    stale: StaleTable = StaleTable()


class TaskTable(Table):
    """`[tasks.NAME]`: how a protocol is used; what is left out is as the protocol has it."""

    timing: Words | None = None
    reference: Words | None = None
    surface: bool = False


Tasks = dict[Annotated[str, one_of(PROTOCOLS)], TaskTable]
Between = Annotated[
    dict[Annotated[str, AfterValidator(check_factor)], Annotated[tuple[Words, ...], Some]],
    AfterValidator(check_groups),
]


# The tables of `study.toml`: what may stand in them, and the defaults.


class StudyTable(Table):
    """`[study]`: name and seed."""

    name: Words = "pilot"
    seed: Count = 321


class SourceTable(Table):
    """`[[recordings]]`: what every entry may say."""

    name: str = ""
    sample: Words | None = None
    picture: Words | None = None
    rotation: Count | None = None

    def entitle(self, source: str) -> str:
        """Tell what the recording is called that comes from a source: `oak`, and `oak-r1` in orientation 1."""
        return self.name or (source if self.rotation is None else f"{source}-r{self.rotation}")


class SceneTable(SourceTable):
    """`[[recordings]]` with `scene`: a bundled synthetic scene."""

    scene: Annotated[str, one_of(SCENES)]
    seed: Count = 0
    rate_hz: Positive = 10000.0
    duration_s: Positive = 4.0

    @property
    def title(self) -> str:
        """What the recording is called."""
        return self.entitle(self.scene)


class FileTable(SourceTable):
    """`[[recordings]]` with `file`: a recording of the lab's own."""

    file: Words
    unit: Annotated[str, one_of(UNITS)] | None = None
    rate_hz: Positive | None = None
    columns: tuple[str | int, ...] | None = None
    full_scale: Positive | None = None
    resample: bool = False

    @property
    def title(self) -> str:
        """What the recording is called: `recordings/oak.csv` is `oak`."""
        return self.entitle(PurePath(self.file).stem)


def _tell_kind(entry: object) -> str:
    is_scene = isinstance(entry, SceneTable) or (isinstance(entry, dict) and "scene" in entry)
    return "scene" if is_scene else "file"


RecordingTable = Annotated[
    Annotated[SceneTable, Tag("scene")] | Annotated[FileTable, Tag("file")],
    Discriminator(_tell_kind),
]


def _check_titles(
    recordings: tuple[SceneTable | FileTable, ...],
) -> tuple[SceneTable | FileTable, ...]:
    titles = check_some(tuple(recording.title for recording in recordings))
    check_names(titles)
    return recordings


class ConditioningTable(Table):
    """`[stimuli.conditioning]`: what is done to a recording before it is reduced."""

    remove_offset: bool = True
    high_pass_hz: PositiveOrOff = 20.0
    low_pass_hz: PositiveOrOff = 1000.0
    crop_s: tuple[NotNegative, Positive] | None = None


ACCEPT = "accept"
BELOW_THRESHOLD = ("refuse", ACCEPT)
"""Whether stimuli that are weaker than the detection threshold keep a study from running."""


class StimuliTable(Table):
    """`[stimuli]`: what is made of each recording."""

    reducers: Annotated[tuple[Annotated[str, one_of(REDUCERS)], ...], Some] = DEFAULT_REDUCERS
    levels: Annotated[tuple[Annotated[str, one_of(LEVELS)], ...], Some] = LEVELS[:1]
    anchors: bool = True
    reference: Annotated[str, one_of((ORIGINAL, NO_REFERENCE, *REDUCERS))] = ORIGINAL
    gain: Annotated[float | str, number_or(GAINS, least=1e-6, most=1e6)] = ONE_GAIN
    fade_s: NotNegative = 0.01
    threshold: Annotated[str, one_of(THRESHOLDS)] = CONTACTOR
    below_threshold: Annotated[str, one_of(BELOW_THRESHOLD)] = "refuse"
    conditioning: ConditioningTable = ConditioningTable()


class RigTable(Table):
    """`[rig]`: what the stimuli are rendered for."""

    rate_hz: Positive = 48000.0
    full_scale_m_s2: Annotated[Positive, Field(le=1e6)] = 100.0
    headroom: Annotated[float, Field(gt=0, le=1)] = 0.9


class ObserverTable(Table):
    """`[observer]`: how simulated participants feel and differ; the fields are those of `ObserverModel`."""

    intercept: Finite = 10.0
    spectral: Finite = 45.0
    temporal: Finite = 35.0
    threshold_spectral: Finite = 0.0
    envelope: Finite = 0.0
    level: Finite = 0.0
    bias_sd: NotNegative = 6.0
    gain_sd: NotNegative = 0.15
    noise_sd: NotNegative = 8.0
    noise_spread: NotNegative = 0.25
    lapse_rate: Share = 0.0
    order: Finite = 0.0
    fatigue: Finite = 0.0
    fatigue_noise: NotNegative = 0.0
    straight_liners: Share = 0.0
    random_clickers: Share = 0.0
    scale_reversers: Share = 0.0


class AnalysisTable(Table):
    """`[analysis]`: how ratings are related to metrics; chosen before they are seen."""

    metrics: Annotated[tuple[Words, ...], Some] = PLANNED
    draws: Annotated[int, Field(ge=100)] = 2000
    margin: Annotated[float, Field(gt=0, le=100)] | None = None


class Settings(Table):
    """The whole of `study.toml`."""

    recordings: Annotated[tuple[RecordingTable, ...], AfterValidator(_check_titles)]
    study: StudyTable = StudyTable()
    stimuli: StimuliTable = StimuliTable()
    rig: RigTable = RigTable()
    session: SessionTable = SessionTable()
    tasks: Tasks = Field(default_factory=dict)
    between: Between = Field(default_factory=dict)
    observer: ObserverTable = ObserverTable()
    analysis: AnalysisTable = AnalysisTable()
