"""Everything that stands in the way of a study, found in one go."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from protocols.groups import CHOOSING
from protocols.spaced import find_crowding
from protocols.texts import read_scales
from stimuli.anchors import quietest_hz
from stimuli.condition import condition, fade
from stimuli.inspection import check_stimuli
from stimuli.manifest import read_stimuli
from study.actuator.rig import read_rig
from study.preparing import list_rig_problems
from study.provenance import find_changes
from study.session.plan import make_plan
from study.settings.designs import make_design
from study.settings.factors import count_groups
from study.settings.reading import read_settings
from study.settings.remarks import list_remarks
from study.settings.sources import make_recipe, try_recordings
from study.settings.wording import find_language, read_study_texts

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from stimuli.recipe import Recipe
    from stimuli.recording import Recording
    from study.folder import StudyFolder
    from study.settings.tables import Settings


def check_study(study: StudyFolder) -> tuple[list[Recording], list[str]]:
    """Check settings, recordings, pictures, texts, rig and, once it is built, the stimulus set of a study.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    recordings : list of Recording
        Those that can be read; each with its warnings.
    problems : list of str
        One line each; empty if there is nothing to mend.
    """
    try:
        settings = read_settings(study.settings)
    except ValueError as error:
        return [], str(error).splitlines()
    recordings, problems = try_recordings(settings, study.path)
    problems += [*_check_pictures(study, settings), *_check_texts(study, settings), *_check_rig(study, settings)]
    recipe = None
    try:
        recipe = make_recipe(settings)
        problems += _check_recordings(recordings, recipe)
    except ValueError as error:
        problems.append(f"{study.settings.name}: {error}")
    if study.stimuli.exists():
        problems += check_stimuli(study.stimuli) or _check_plan(study, settings)
        if recipe is not None:
            sources = {recording.name: recording.sha256 for recording in recordings}
            named = {entry.title: sources.get(entry.title) for entry in settings.recordings}
            problems += _check_origin(study, recipe, named)
    elif study.participants:
        problems.append(f"{study.stimuli}: is missing, but sessions were run with it; put it back or build it again")
    return recordings, problems


def _check_origin(study: StudyFolder, recipe: Recipe, recordings: Mapping[str, str | None]) -> list[str]:
    """Check that the set that is there is the one that the settings ask for."""
    try:
        return [f"{change}; run feel321 build" for change in find_changes(study.stimuli, recipe, recordings)]
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
    from study.screen.layout import find_overflows
    from study.screen.wording import make_screen_texts

    language = find_language(settings, study.path)
    try:
        texts, scales = read_study_texts(settings, study.path), read_scales(language)
    except OSError as error:
        return [f"{error.filename}: {error.strerror}; put your texts there, or name a language of the catalogue"]
    except ValueError as error:
        return str(error).splitlines()
    return [f"texts in {language}: {problem}" for problem in find_overflows(make_screen_texts(texts), scales.values())]


def find_warnings(study: StudyFolder) -> list[str]:
    """Find what is allowed in a study and still worth knowing.

    Parameters
    ----------
    study : StudyFolder
        A study without problems.

    Returns
    -------
    list of str
        Settings that may not be meant, and, once the stimulus set is built, rules of the order that the first
        participant's trials could not keep: one line each.
    """
    settings = read_settings(study.settings)
    remarks = [f"{study.settings.name}: {remark}" for remark in list_remarks(settings)]
    if settings.session.order != "random" or not study.stimuli.exists():
        return remarks
    plan = make_plan(make_design(settings), read_stimuli(study.stimuli), "check", number=1, simulated=False)
    return remarks + [f"order 'random': {line}" for line in find_crowding(plan.trials)]


def _check_rig(study: StudyFolder, settings: Settings) -> list[str]:
    """Check the rig, where there is one: simulated participants need none."""
    if not study.rig.is_file():
        return []
    try:
        rig = read_rig(study.rig)
    except ValueError as error:
        return str(error).splitlines()
    try:
        stimuli = read_stimuli(study.stimuli)
    except (OSError, ValueError):
        return []  # Not built yet, or damaged: others look at that.
    return list_rig_problems(study, rig, settings=settings, stimuli=stimuli)


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
