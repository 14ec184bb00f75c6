"""The steps of a study, from settings to report, each one call."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.report import write_report
from stimuli.manifest import read_stimuli
from stimuli.sets import build_stimuli
from study.ratings import write_ratings
from study.settings import read_settings
from study.simulate import Simulation, run_simulation
from study.sources import make_recipe, open_recordings

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from stimuli.manifest import StimulusSet
    from stimuli.recording import Recording
    from study.folder import StudyFolder
    from study.journal import Clock

    Progress = Callable[[int, int], None]


def build_study(
    study: StudyFolder, *, workers: int = 1, progress: Progress | None = None
) -> tuple[list[Recording], StimulusSet]:
    """Build the stimulus set of a study.

    Parameters
    ----------
    study : StudyFolder
        The study.
    workers : int
        Number of processes.
    progress : callable, optional
        Called with the numbers of steps done and to do.

    Returns
    -------
    recordings : list of Recording
        What was read; each with its warnings.
    stimuli : StimulusSet
        What was built.
    """
    settings = read_settings(study.settings)
    recordings = open_recordings(settings, study.path)
    stimuli = build_stimuli(
        recordings, study.stimuli, recipe=make_recipe(settings), workers=workers, progress=progress
    )
    return recordings, stimuli


def simulate_study(
    study: StudyFolder,
    *,
    participants: int,
    seed: int | None,
    now: Clock,
    progress: Progress | None = None,
) -> int:
    """Lead simulated participants through a study and derive the table of ratings.

    Parameters
    ----------
    study : StudyFolder
        The study; its stimuli are built.
    participants : int
        How many take part.
    seed : int or None
        Seed of the participants; None takes the study's.
    now : callable
        Gives the time of day, with its zone.
    progress : callable, optional
        Called with the numbers of trials done and to do.

    Returns
    -------
    int
        Rows of the table.
    """
    settings = read_settings(study.settings)
    stimuli = read_stimuli(study.stimuli)
    seed = settings.study.seed if seed is None else seed
    run_simulation(Simulation(study, settings, stimuli, seed, now), participants, progress=progress)
    return write_ratings(study, stimuli)


def analyze_study(study: StudyFolder, *, out: Path | None = None) -> Path:
    """Derive the table of ratings and write the report.

    Parameters
    ----------
    study : StudyFolder
        The study; its stimuli are built and sessions have begun.
    out : Path, optional
        The report's folder; the study's own if left out.

    Returns
    -------
    Path
        The report's folder.

    Raises
    ------
    ValueError
        If nobody has rated anything yet.
    """
    settings = read_settings(study.settings)
    if not write_ratings(study, read_stimuli(study.stimuli)):
        raise ValueError(f"{study.path}: holds no ratings yet; run sessions first, or feel321 simulate {study.path}")
    folder = out or study.report
    write_report(
        study.ratings, study.manifest, folder, draws=settings.analysis.draws, seed=settings.study.seed
    )
    return folder
