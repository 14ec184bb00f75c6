"""Everything that stands in the way of a study, found in one go."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.inspection import check_stimuli
from stimuli.manifest import read_stimuli
from study.plan import make_plan
from study.settings import read_settings
from study.sources import make_recipe, try_recordings

if TYPE_CHECKING:
    from stimuli.recording import Recording
    from study.folder import StudyFolder
    from study.tables import Settings


def check_study(study: StudyFolder) -> tuple[list[Recording], list[str]]:
    """Check settings, recordings and, once it is built, the stimulus set of a study.

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
    try:
        make_recipe(settings)
    except ValueError as error:
        problems.append(f"{study.settings.name}: {error}")
    if study.stimuli.exists():
        problems += check_stimuli(study.stimuli) or _check_plan(study, settings)
    return recordings, problems


def _check_plan(study: StudyFolder, settings: Settings) -> list[str]:
    """Check that the protocols find the stimuli that they need."""
    try:
        make_plan(
            read_stimuli(study.stimuli),
            "check",
            number=1,
            seed=settings.study.seed,
            protocols=settings.session.protocols,
            repeats=settings.session.repeats,
        )
    except ValueError as error:
        return [str(error)]
    return []
