"""Read `study.toml`: parse it, refuse conflicts, remark on what is odd, open its recordings, make the design.

A recording with a `rotation` is turned before anything else is done to it, as if its sensor had been glued on
otherwise. The number seeds an orientation uniform over all rotations: the same number turns every recording alike.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.texts import read_texts
from feel321.protocols.trial import CHOOSING, SURFACE, Flow, Item, select_items, select_tasks
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.sets.recipe import NO_REFERENCE, Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.study.observer.judging import ObserverModel
from feel321.study.session.journal import digest
from feel321.study.session.opening import Stale
from feel321.study.session.plan import Design
from feel321.study.settings.fields import parse_toml
from feel321.study.settings.schema import (
    LANGUAGE_FILE,
    AnalysisTable,
    BreaksTable,
    ConditioningTable,
    FileTable,
    ObserverTable,
    QualityTable,
    RehearsalTable,
    RigTable,
    SceneTable,
    SessionTable,
    Settings,
    StaleTable,
    StimuliTable,
    StudyTable,
    TaskTable,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from feel321.protocols.trial import Task
    from feel321.stimuli.recording import Recording
    from feel321.study.settings.fields import Table

# What is allowed in `study.toml` and still worth knowing.


def list_remarks(settings: Settings) -> list[str]:
    """List what a study lead may not have meant."""
    return [*_remark_on_tasks(settings), *_remark_on_session(settings)]


def _remark_on_tasks(settings: Settings) -> Iterator[str]:
    for name in settings.tasks:
        if name not in settings.session.protocols:
            yield f"tasks.{name}: changes nothing: {name} is not in session.protocols; add it there, or take this out"
    if "mushra" in settings.session.protocols and not settings.stimuli.anchors:
        yield (
            "stimuli.anchors: got false, but mushra is meant to have two anchors on each page (ITU-R BS.1534-3); "
            "set it to true"
        )


def _remark_on_session(settings: Settings) -> Iterator[str]:
    session = settings.session
    if (
        session.stale.policy == "warm_up"
        and session.stale.after_h is not None
        and not session.rehearsal.practice
    ):
        yield (
            "session.stale.policy: got 'warm_up', but session.rehearsal.practice is 0: there is nothing to warm up "
            "with; ask for practice, or set the policy to 'continue'"
        )
    if not session.breaks.rest_s:
        yield "session.breaks.rest_s: got 0, so fingertips never rest from vibration; 60 s are usual"


# From settings to signals: the recordings that a study names, and the recipe for its stimuli.


@dataclass(frozen=True, slots=True)
class Surface:
    """The real surface that a recording was taken from."""

    sample: str | None
    picture: Path | None


def list_surfaces(settings: Settings, folder: Path) -> dict[str, Surface]:
    """Look up the surfaces that participants stroke or see; a trial names them by their recordings."""
    return {
        entry.title: Surface(entry.sample, folder / entry.picture if entry.picture else None)
        for entry in settings.recordings
    }


def list_origins(settings: Settings) -> dict[str, str]:
    """Look up what recordings were made from: those that are one, turned, are not independent of each other."""
    return {
        entry.title: f"{entry.scene} {entry.seed}" if isinstance(entry, SceneTable) else entry.file
        for entry in settings.recordings
    }


def open_recordings(settings: Settings, folder: Path) -> list[Recording]:
    """Read every recording of a study."""
    recordings, mistakes = try_recordings(settings, folder)
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return recordings


def try_recordings(settings: Settings, folder: Path) -> tuple[list[Recording], list[str]]:
    """Read every recording of a study that can be read, and say why the others cannot."""
    recordings: list[Recording] = []
    mistakes: list[str] = []
    for entry in settings.recordings:
        try:
            recordings.append(_open_recording(entry, folder))
        except (OSError, ValueError) as error:
            mistakes.append(f"recording {entry.title!r}: {error}")
    return recordings, mistakes


def make_recipe(settings: Settings) -> Recipe:
    """Put the settings of the stimuli and the rig into a recipe."""
    stimuli, rig = settings.stimuli, settings.rig
    steps = stimuli.conditioning
    return Recipe(
        conditioning=Conditioning(
            remove_offset=steps.remove_offset,
            high_pass_hz=steps.high_pass_hz,
            low_pass_hz=steps.low_pass_hz,
            crop_s=steps.crop_s,
        ),
        reducers=stimuli.reducers,
        levels=stimuli.levels,
        anchors=stimuli.anchors,
        reference=stimuli.reference,
        gain=stimuli.gain,
        fade_s=stimuli.fade_s,
        threshold=stimuli.threshold,
        rate_hz=rig.rate_hz,
        full_scale_m_s2=rig.full_scale_m_s2,
        headroom=rig.headroom,
    )


def turn_recording(recording: Recording, rotation: int) -> Recording:
    """Turn a recording into a random orientation of its sensor."""
    import numpy as np

    from feel321.stimuli.rotation import random_rotations

    turn = random_rotations(1, np.random.default_rng(rotation))[0]
    return replace(
        recording,
        acceleration=np.einsum("ij,jn->in", turn, recording.acceleration),
        sha256=hashlib.sha256(f"{recording.sha256} rotation {rotation}".encode()).hexdigest(),
    )


def _open_recording(entry: SceneTable | FileTable, folder: Path) -> Recording:
    if isinstance(entry, SceneTable):
        recording = make_scene(
            entry.scene, seed=entry.seed, rate_hz=entry.rate_hz, duration_s=entry.duration_s
        )
    else:
        recording = read_recording(
            folder / entry.file,
            rate_hz=entry.rate_hz,
            unit=entry.unit,
            columns=entry.columns,
            full_scale=entry.full_scale,
            resample=entry.resample,
        )
    if entry.rotation is not None:
        recording = turn_recording(recording, entry.rotation)
    return replace(recording, name=entry.title)


# The words of a study: a language of the catalogue or a file of the lab's own, and its own consent.

CONSENT = "consent"
"""The page whose text a lab can set by itself."""


def find_language(settings: Settings, folder: Path) -> str | Path:
    """Tell where the texts of a study stand."""
    language = settings.session.language
    return folder / language if language.endswith(LANGUAGE_FILE) else language


def read_study_texts(settings: Settings, folder: Path) -> dict[str, Any]:
    """Read all texts of a study, the lab's own consent among them."""
    texts = read_texts(find_language(settings, folder))
    if own := settings.session.consent:
        texts["pages"][CONSENT]["text"] = own
    return texts


# What the settings of a study mean for its sessions.


def make_design(settings: Settings) -> Design:
    """Read off what a study decides about the sessions of all its participants."""
    session, rehearsal = settings.session, settings.session.rehearsal
    breaks, quality = session.breaks, session.quality
    own = {
        name: settings.tasks[name].model_dump() if name in settings.tasks else {}
        for name in session.protocols
    }
    return Design(
        seed=settings.study.seed,
        order=session.order,
        repeats=session.repeats,
        tasks=tuple(
            make_task(name, training=rehearsal.training, practice=rehearsal.practice, **own[name])
            for name in session.protocols
        ),
        between=dict(settings.between),
        flow=Flow(
            break_trials=breaks.every_trials,
            break_min=breaks.every_min,
            break_s=breaks.break_s,
            rest_s=breaks.rest_s,
            training_pass=rehearsal.pass_share,
            training_rounds=rehearsal.rounds,
            min_response_s=quality.min_response_s,
            max_attempts=quality.max_attempts,
            reject=quality.reject,
            gap_s=quality.gap_s,
        ),
    )


def make_identity(settings: Settings, folder: Path, presenter: dict[str, Any]) -> dict[str, Any]:
    """Say what must not change within a session besides its plan, for the header of its journal."""
    texts = read_study_texts(settings, folder)
    return {
        "locale": settings.session.language,
        "texts_sha256": digest(json.dumps(texts, sort_keys=True)),
        "consent": texts["pages"]["consent"]["text"],
        "rig": settings.rig.model_dump(),
        "calibration": None,
        "presenter": presenter,
    }


def make_stale(settings: Settings) -> Stale:
    """Read off what becomes of a session that was left for long."""
    return Stale(**settings.session.stale.model_dump())


# What each table of `study.toml` may say by itself, but not together with the others.

MOST_TRIALS = 10_000
"""Trials in a session; people do a few hundred, simulated ones somewhat more."""


def find_conflicts(settings: Settings) -> list[str]:
    """Find settings that do not go together."""
    # What is wrong here would only be said again, and less clearly, by what follows from it.
    checks = (_check_reference, _check_tasks, _check_between, _check_observer)
    if found := [line for check in checks for line in check(settings)]:
        return found
    tasks = make_design(settings).tasks
    found = [*_check_samples(settings, tasks), *dict.fromkeys(_check_comparisons(settings, tasks))]
    return found or list(_check_length(settings, tasks))


def _check_reference(settings: Settings) -> Iterator[str]:
    if (reference := settings.stimuli.reference) in settings.stimuli.reducers:
        yield (
            f"stimuli.reference: got {reference!r}, which is one of stimuli.reducers: it would go by two names; "
            "take it out of the reducers"
        )


def _check_tasks(settings: Settings) -> Iterator[str]:
    for name, table in settings.tasks.items():
        for key, value in table.model_dump().items():
            try:
                make_task(name, **{key: value})
            except ValueError as error:
                yield str(error)


def _check_between(settings: Settings) -> Iterator[str]:
    places = {"level": ("stimuli.levels", settings.stimuli.levels)}
    places["protocol"] = ("session.protocols", settings.session.protocols)
    for factor, (place, allowed) in places.items():
        for name in settings.between.get(factor, ()):
            if name not in allowed:
                yield f"between.{factor}: got {name!r}, allowed: {', '.join(allowed)}; or add it to {place}"


def _check_observer(settings: Settings) -> Iterator[str]:
    try:
        ObserverModel(**settings.observer.model_dump())
    except ValueError as error:
        yield f"observer: {error}"


def _check_samples(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[str]:
    """Who is to stroke a real surface must be told which."""
    on_surfaces = [task.protocol for task in tasks if task.surface or task.reference == SURFACE]
    for number, recording in enumerate(settings.recordings, start=1):
        if on_surfaces and not recording.sample:
            yield (
                f"recordings[{number}].sample: is missing, but {' and '.join(on_surfaces)} let the real surface be "
                "felt; add what it is called in the lab"
            )


def _check_comparisons(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[str]:
    """Try out whether the stimuli to be built are what the tasks need."""
    for items, own in _list_groups(settings, tasks):
        for task in own:
            try:
                PROTOCOLS[task.protocol].compare(items, task)
            except ValueError as error:
                yield f"tasks.{task.protocol}: {error}"


def _check_length(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[str]:
    """Count the trials of each group, which are as many for each recording."""
    each = len(settings.recordings) * settings.session.repeats
    groups = _list_groups(settings, tasks)
    trials = max(
        each * sum(len(PROTOCOLS[t.protocol].compare(items, t)) for t in own)
        for items, own in groups
    )
    if trials > MOST_TRIALS:
        yield (
            f"session.repeats: got {settings.session.repeats}, which makes {trials} trials in a session, allowed are "
            f"at most {MOST_TRIALS}; ask for fewer repeats, reducers or recordings"
        )


def _list_groups(
    settings: Settings, tasks: tuple[Task, ...]
) -> Iterator[tuple[tuple[Item, ...], tuple[Task, ...]]]:
    """List what is felt and done in the groups that differ in that."""
    factors = {name: settings.between[name] for name in CHOOSING if name in settings.between}
    for levels in product(*factors.values()):
        groups = dict(zip(factors, levels, strict=True))
        yield select_items(_list_items(settings), groups), select_tasks(tasks, groups)


def _list_items(settings: Settings) -> list[Item]:
    """List what will be built from the first recording, as protocols see it; the others fare alike."""
    from feel321.stimuli.sets.anchors import ANCHORS

    stimuli, recording = settings.stimuli, settings.recordings[0].title
    made = [(name, "test") for name in stimuli.reducers]
    made += [(stimuli.reference, "reference")] * (stimuli.reference != NO_REFERENCE)
    made += [(name, "anchor") for name in ANCHORS] * stimuli.anchors
    return [
        Item(f"{recording}-{role}-{reducer}-{level}", recording, reducer, level, role)
        for level in stimuli.levels
        for reducer, role in made
    ]


# Reading `study.toml`.

TABLES: dict[tuple[str, ...], type[Table]] = {
    (): Settings,
    ("analysis",): AnalysisTable,
    ("observer",): ObserverTable,
    ("recordings", "file"): FileTable,
    ("recordings", "scene"): SceneTable,
    ("rig",): RigTable,
    ("session",): SessionTable,
    ("session", "breaks"): BreaksTable,
    ("session", "quality"): QualityTable,
    ("session", "rehearsal"): RehearsalTable,
    ("session", "stale"): StaleTable,
    ("stimuli",): StimuliTable,
    ("stimuli", "conditioning"): ConditioningTable,
    ("study",): StudyTable,
    ("tasks",): TaskTable,  # of no protocol: the name itself is refused
    **{("tasks", name): TaskTable for name in PROTOCOLS},
}
"""Which keys are allowed where."""


def read_settings(path: Path) -> Settings:
    """Read and check a `study.toml`."""
    settings = parse_toml(path, Settings, tables=TABLES)
    mistakes = find_conflicts(settings)
    if mistakes:
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return settings
