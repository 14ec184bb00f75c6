"""The tables of `study.toml`: what may stand in them, and the defaults.

The models are closed and frozen. Names of reducers, scenes, protocols, levels, units and languages are those of
the registries; none is written down here again. What participants do stands in `session_tables`.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated

from pydantic import AfterValidator, Discriminator, Field, Tag

from analysis.table.schema import PLANNED
from stimuli.perception import CONTACTOR, THRESHOLDS
from stimuli.recipe import GAINS, LEVELS, NO_REFERENCE, ONE_GAIN, ORIGINAL
from stimuli.recording import UNITS
from stimuli.reduce import DEFAULT_REDUCERS, REDUCERS
from stimuli.sets import check_names
from stimuli.synthesis import SCENES
from study.settings.fields import (
    Count,
    Finite,
    NotNegative,
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
from study.settings.session_tables import Between, SessionTable, Tasks


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
        """Tell what the recording is called that comes from a source: `oak`, and `oak-r1` in orientation 1.

        Parameters
        ----------
        source : str
            What it comes from.

        Returns
        -------
        str
            Its own name, if it has one.
        """
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
    Annotated[SceneTable, Tag("scene")] | Annotated[FileTable, Tag("file")], Discriminator(_tell_kind)
]


def _check_titles(recordings: tuple[SceneTable | FileTable, ...]) -> tuple[SceneTable | FileTable, ...]:
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
