"""The tables of `study.toml`: what may stand in them, and the defaults.

The models are closed and frozen. Names of reducers, scenes, protocols, levels, units and languages are those of
the registries; none is written down here again.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag

from protocols.registry import PROTOCOLS
from protocols.texts import list_languages
from stimuli.recipe import LEVELS, NO_REFERENCE, ORIGINAL
from stimuli.recording import UNITS
from stimuli.reduce import REDUCERS
from stimuli.sets import check_names
from stimuli.synthesis import SCENES

if TYPE_CHECKING:
    from collections.abc import Collection


def _one_of(names: Collection[str]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"allowed: {', '.join(names)}")
        return name

    return AfterValidator(check)


def _check_distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    if not names:
        raise ValueError("allowed is one name or more")
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"allowed is each name once; more than once: {', '.join(doubled)}")
    return names


Some = AfterValidator(_check_distinct)
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Corner = Annotated[Positive | None, BeforeValidator(lambda value: None if value == "off" else value)]
"""A corner frequency in Hz, or "off": TOML has no null."""


class Table(BaseModel):
    """A table of `study.toml`: no unknown keys, no guessing of types, no changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class StudyTable(Table):
    """`[study]`: name and seed."""

    name: Annotated[str, Field(min_length=1)] = "pilot"
    seed: Annotated[int, Field(ge=0)] = 321


class SceneTable(Table):
    """`[[recordings]]` with `scene`: a bundled synthetic scene."""

    scene: Annotated[str, _one_of(SCENES)]
    name: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    rate_hz: Positive = 10000.0
    duration_s: Positive = 4.0

    @property
    def title(self) -> str:
        """What the recording is called."""
        return self.name or self.scene


class FileTable(Table):
    """`[[recordings]]` with `file`: a recording of the lab's own."""

    file: Annotated[str, Field(min_length=1)]
    name: str = ""
    unit: Annotated[str, _one_of(UNITS)] | None = None
    rate_hz: Positive | None = None
    columns: tuple[str | int, ...] | None = None
    full_scale: Positive | None = None
    resample: bool = False

    @property
    def title(self) -> str:
        """What the recording is called: `recordings/oak.csv` is `oak`."""
        return self.name or PurePath(self.file).stem


def _tell_kind(entry: object) -> str:
    is_scene = isinstance(entry, SceneTable) or (isinstance(entry, dict) and "scene" in entry)
    return "scene" if is_scene else "file"


RecordingTable = Annotated[
    Annotated[SceneTable, Tag("scene")] | Annotated[FileTable, Tag("file")], Discriminator(_tell_kind)
]


def _check_titles(recordings: tuple[SceneTable | FileTable, ...]) -> tuple[SceneTable | FileTable, ...]:
    titles = _check_distinct(tuple(recording.title for recording in recordings))
    check_names(titles)
    return recordings


class ConditioningTable(Table):
    """`[stimuli.conditioning]`: what is done to a recording before it is reduced."""

    remove_offset: bool = True
    high_pass_hz: Corner = 20.0
    low_pass_hz: Corner = 1000.0
    crop_s: tuple[NotNegative, Positive] | None = None


class StimuliTable(Table):
    """`[stimuli]`: what is made of each recording."""

    reducers: Annotated[tuple[Annotated[str, _one_of(REDUCERS)], ...], Some] = tuple(REDUCERS)
    levels: Annotated[tuple[Annotated[str, _one_of(LEVELS)], ...], Some] = LEVELS[:1]
    anchors: bool = True
    reference: Annotated[str, _one_of((ORIGINAL, NO_REFERENCE, *REDUCERS))] = ORIGINAL
    gain: Positive | None = None
    fade_s: NotNegative = 0.01
    conditioning: ConditioningTable = ConditioningTable()


class RigTable(Table):
    """`[rig]`: what the stimuli are rendered for."""

    rate_hz: Positive = 48000.0
    full_scale_m_s2: Positive = 100.0
    headroom: Annotated[float, Field(gt=0, le=1)] = 0.9


class SessionTable(Table):
    """`[session]`: what participants do."""

    protocols: Annotated[tuple[Annotated[str, _one_of(PROTOCOLS)], ...], Some] = tuple(PROTOCOLS)
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    language: Annotated[str, _one_of(list_languages())] = "en"


class ObserverTable(Table):
    """`[observer]`: how simulated participants feel and differ; the fields are those of `ObserverModel`."""

    intercept: Finite = 10.0
    spectral: Finite = 45.0
    temporal: Finite = 35.0
    bias_sd: NotNegative = 6.0
    gain_sd: NotNegative = 0.15
    noise_sd: NotNegative = 8.0
    noise_spread: NotNegative = 0.25


class AnalysisTable(Table):
    """`[analysis]`: how ratings are set against metrics."""

    draws: Annotated[int, Field(ge=100)] = 2000


class Settings(Table):
    """The whole of `study.toml`."""

    recordings: Annotated[tuple[RecordingTable, ...], AfterValidator(_check_titles)]
    study: StudyTable = StudyTable()
    stimuli: StimuliTable = StimuliTable()
    rig: RigTable = RigTable()
    session: SessionTable = SessionTable()
    observer: ObserverTable = ObserverTable()
    analysis: AnalysisTable = AnalysisTable()
