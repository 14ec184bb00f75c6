"""Steps of a study before the analysis: check, build, simulate."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from feel321.protocols.order import find_crowding
from feel321.protocols.texts import read_scales
from feel321.protocols.trial import CHOOSING
from feel321.stimuli.condition import condition, fade
from feel321.stimuli.sets.anchors import quietest_hz
from feel321.stimuli.sets.build import build_stimuli, foresee_stimuli
from feel321.stimuli.sets.manifest import check_stimuli, read_stimuli
from feel321.study.actuator.render import find_mix
from feel321.study.actuator.rig import read_rig
from feel321.study.ledger.standing import write_roster
from feel321.study.provenance import find_changes, is_in_use
from feel321.study.ratings import write_ratings
from feel321.study.session.opening import PLAN_FILE
from feel321.study.session.plan import make_plan
from feel321.study.sessions import (
    Simulation,
    list_rig_problems,
    require_current_set,
    run_simulation,
)
from feel321.study.settings.read import (
    find_language,
    list_remarks,
    make_design,
    make_recipe,
    open_recordings,
    read_settings,
    read_study_texts,
    try_recordings,
)
from feel321.study.settings.schema import count_groups
from feel321.study.strength import (
    Findings,
    find_clipping,
    find_reach,
    find_rig_limits,
    find_strength,
    find_unfelt,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.stimuli.sets.recipe import Recipe
    from feel321.study.actuator.rig import Rig
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock
    from feel321.study.settings.schema import Settings

    Progress = Callable[[int, int], None]

# The steps of a study, from settings to report, each one call.


def build_study(
    study: StudyFolder, *, workers: int = 1, progress: Progress | None = None
) -> tuple[list[Recording], StimulusSet]:
    """Build the stimulus set of a study."""
    settings = read_settings(study.settings)
    recordings = open_recordings(settings, study.path)
    recipe = make_recipe(settings)
    _spare_used_set(study, recipe, recordings)
    stimuli = build_stimuli(
        recordings, study.stimuli, recipe=recipe, workers=workers, progress=progress
    )
    return recordings, stimuli


def simulate_study(
    study: StudyFolder,
    *,
    participants: int,
    seed: int | None,
    now: Clock,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> int:
    """Lead simulated participants through a study and derive the table of ratings."""
    settings = read_settings(study.settings)
    stimuli = read_stimuli(study.stimuli)
    require_current_set(study, settings)
    seed = settings.study.seed if seed is None else seed
    unfelt = find_unfelt(settings, stimuli)
    notices = run_simulation(
        Simulation(study, settings, stimuli, seed, now), participants, progress=progress
    )
    if warn is not None:
        for notice in filter(None, (unfelt, *notices)):
            warn(notice)
    write_roster(study)
    return write_ratings(study, stimuli)


def _spare_used_set(study: StudyFolder, recipe: Recipe, recordings: Sequence[Recording]) -> None:
    """Refuse to replace a set that sessions were run with, or may have been."""
    if not study.stimuli.exists() or not any(study.sessions.glob(f"*/{PLAN_FILE}")):
        return
    try:
        sha256 = read_stimuli(study.stimuli).sha256
        changes = find_changes(
            study.stimuli, recipe, {recording.name: recording.sha256 for recording in recordings}
        )
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{study.stimuli}: nobody can tell whether sessions were run with this set ({error}); "
            f"restore it from a copy, or move {study.sessions} away"
        ) from None
    if changes and is_in_use(study, sha256):
        remedy = f"sessions were run with this set; make a new study, or move {study.sessions} away"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))


# Everything that stands in the way of a study, found in one go.


class Checked(NamedTuple):
    """What a check found."""

    recordings: list[Recording]
    problems: list[str]
    strength: Findings


def check_study(
    study: StudyFolder, *, progress: Callable[[int, int], None] | None = None
) -> Checked:
    """Check settings, recordings, pictures, texts, strength of the stimuli, rig and, once built, the stimulus set."""
    try:
        settings = read_settings(study.settings)
    except ValueError as error:
        return Checked([], str(error).splitlines(), Findings())
    recordings, unread = try_recordings(settings, study.path)
    rig, rig_problems = _check_rig(study, settings)
    problems = [
        *unread,
        *_check_pictures(study, settings),
        *_check_texts(study, settings),
        *rig_problems,
    ]
    recipe, unusable = _check_recipe(study, settings, recordings)
    problems += unusable
    strength = Findings()
    if recipe is not None and not unread and not unusable:
        try:
            strength = _find_strength(
                study, settings, recordings, recipe=recipe, rig=rig, progress=progress
            )
        except ValueError as error:
            problems.append(str(error))
    problems += strength.problems
    if study.stimuli.exists():
        problems += check_stimuli(study.stimuli) or _check_plan(study, settings)
        if recipe is not None:
            sources = {recording.name: recording.sha256 for recording in recordings}
            named = {entry.title: sources.get(entry.title) for entry in settings.recordings}
            problems += _check_origin(study, recipe, named)
    elif study.participants:
        problems.append(
            f"{study.stimuli}: is missing, but sessions were run with it; put it back or build it again"
        )
    return Checked(recordings, problems, strength)


def _check_recipe(
    study: StudyFolder, settings: Settings, recordings: Sequence[Recording]
) -> tuple[Recipe | None, list[str]]:
    try:
        recipe = make_recipe(settings)
    except ValueError as error:
        return None, [f"{study.settings.name}: {error}"]
    return recipe, list(_check_recordings(recordings, recipe))


def _find_strength(
    study: StudyFolder,
    settings: Settings,
    recordings: Sequence[Recording],
    *,
    recipe: Recipe,
    rig: Rig | None,
    progress: Callable[[int, int], None] | None,
) -> Findings:
    """Find out how strong stimuli are, and, where there is a rig, how it brings them to the hand."""
    foreseen = foresee_stimuli(recordings, study.stimuli, recipe=recipe, progress=progress)
    found = find_strength(settings, foreseen, recipe)
    is_built = (study.stimuli / "manifest.csv").exists()  # then its files are examined themselves
    found.problems.extend([] if is_built else find_clipping(foreseen, recipe))
    if rig is None:
        return found
    name = study.rig.name
    limits = [] if is_built else find_rig_limits(rig, foreseen, recipe.reference)
    reach = find_reach(rig, recordings, recipe)
    return Findings(
        [*found.problems, *(f"{name}: {line}" for line in limits)],
        [*found.warnings, *(f"{name}: {line}" for line in reach.warnings)],
        [*(f"{name}: {line}" for line in reach.notes), *found.notes],
        {**found.figures, **reach.figures},
    )


def _check_origin(
    study: StudyFolder, recipe: Recipe, recordings: Mapping[str, str | None]
) -> list[str]:
    """Check that the set that is there is the one that the settings ask for."""
    try:
        return [
            f"{change}; run feel321 build"
            for change in find_changes(study.stimuli, recipe, recordings)
        ]
    except ValueError as error:
        return [str(error)]


def _check_recordings(recordings: Sequence[Recording], recipe: Recipe) -> Iterator[str]:
    """Try out what a build does to every recording, but for what takes long."""
    for recording in recordings:
        try:
            ready = condition(recording, recipe.conditioning)
            fade(ready.acceleration, ready.rate_hz, fade_s=recipe.fade_s)
            if recipe.anchors:
                quietest_hz(ready)
        except ValueError as error:
            yield f"recording {recording.name!r}: {error}"


def _check_pictures(study: StudyFolder, settings: Settings) -> list[str]:
    return [
        f"recording {entry.title!r}: {study.path / entry.picture}: there is no such picture; put it there"
        for entry in settings.recordings
        if entry.picture and not (study.path / entry.picture).is_file()
    ]


def _check_texts(study: StudyFolder, settings: Settings) -> list[str]:
    from feel321.study.screen.layout import find_overflows
    from feel321.study.screen.view import make_screen_texts

    language = find_language(settings, study.path)
    try:
        texts, scales = read_study_texts(settings, study.path), read_scales(language)
    except OSError as error:
        return [
            f"{error.filename}: {error.strerror}; put your texts there, or name a language of the catalogue"
        ]
    except ValueError as error:
        return str(error).splitlines()
    return [
        f"texts in {language}: {problem}"
        for problem in find_overflows(make_screen_texts(texts), scales.values())
    ]


def find_warnings(study: StudyFolder) -> list[str]:
    """Find what is allowed in a study and still worth knowing."""
    settings = read_settings(study.settings)
    remarks = [f"{study.settings.name}: {remark}" for remark in list_remarks(settings)]
    if settings.session.order != "random" or not study.stimuli.exists():
        return remarks
    plan = make_plan(
        make_design(settings), read_stimuli(study.stimuli), "check", number=1, simulated=False
    )
    return remarks + [f"order 'random': {line}" for line in find_crowding(plan.trials)]


def _check_rig(study: StudyFolder, settings: Settings) -> tuple[Rig | None, list[str]]:
    """Check the rig, where there is one: simulated participants need none. One that serves for nothing is None."""
    if not study.rig.is_file():
        return None, []
    try:
        rig = read_rig(study.rig)
    except ValueError as error:
        return None, str(error).splitlines()
    try:
        find_mix(rig)
    except ValueError as error:
        return None, [f"{study.rig.name}: {error}"]
    try:
        stimuli = read_stimuli(study.stimuli)
    except (OSError, ValueError):
        return rig, []  # Not built yet, or damaged: others look at that.
    return rig, list_rig_problems(study, rig, settings=settings, stimuli=stimuli)


def _check_plan(study: StudyFolder, settings: Settings) -> list[str]:
    """Check that the tasks of every group find the stimuli that they need; labels make no difference to that."""
    design, stimuli = make_design(settings), read_stimuli(study.stimuli)
    choosing = {factor: levels for factor, levels in design.between.items() if factor in CHOOSING}
    design = replace(design, between=choosing)
    problems: dict[str, None] = {}
    for number in range(1, count_groups(choosing) + 1):
        try:
            make_plan(design, stimuli, "check", number=number, simulated=False)
        except ValueError as error:
            problems[str(error)] = None
    return list(problems)
