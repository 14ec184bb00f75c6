"""The steps of a study, from settings to report, each one call."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING

from analysis.report.write import write_report
from stimuli.manifest import read_stimuli
from stimuli.sets import build_stimuli
from study.ledger.roster import write_roster
from study.preparing import require_current_set
from study.provenance import find_changes, is_in_use
from study.ratings import write_ratings
from study.rotations import measure_rotations
from study.session.opening import PLAN_FILE
from study.settings.reading import read_settings
from study.settings.sources import list_origins, make_recipe, open_recordings
from study.simulate import Simulation, run_simulation
from study.strength import find_unfelt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from stimuli.manifest import StimulusSet
    from stimuli.recipe import Recipe
    from stimuli.recording import Recording
    from study.folder import StudyFolder
    from study.session.journal import Clock

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

    Raises
    ------
    ValueError
        If a recording cannot be read, or another set would take the place of one that sessions were run with.
    """
    settings = read_settings(study.settings)
    recordings = open_recordings(settings, study.path)
    recipe = make_recipe(settings)
    _spare_used_set(study, recipe, recordings)
    stimuli = build_stimuli(recordings, study.stimuli, recipe=recipe, workers=workers, progress=progress)
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
    warn : callable, optional
        Called with each line on what was mended in resuming.

    Returns
    -------
    int
        Rows of the table.

    Raises
    ------
    ValueError
        If the set is not the one that the settings ask for, or a session was begun in another way.
    """
    settings = read_settings(study.settings)
    stimuli = read_stimuli(study.stimuli)
    require_current_set(study, settings)
    seed = settings.study.seed if seed is None else seed
    unfelt = find_unfelt(settings, stimuli)
    notices = run_simulation(Simulation(study, settings, stimuli, seed, now), participants, progress=progress)
    if warn is not None:
        for notice in filter(None, (unfelt, *notices)):
            warn(notice)
    write_roster(study)
    return write_ratings(study, stimuli)


def analyze_study(
    study: StudyFolder,
    *,
    metrics: Sequence[str] | None = None,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Path:
    """Derive the table of ratings and write the report.

    Parameters
    ----------
    study : StudyFolder
        The study; its stimuli are built and sessions have begun.
    metrics : sequence of str, optional
        Metrics of the primary analysis, instead of those that the study declares.
    out : Path, optional
        The report's folder; the study's own if left out.
    progress : callable, optional
        Called with the numbers of sections done and to do.

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
    write_roster(study)
    stimuli = read_stimuli(study.stimuli)
    if not write_ratings(study, stimuli):
        simulate = f"feel321 simulate {quote(str(study.path))}"
        raise ValueError(f"{study.path}: holds no ratings yet; run sessions first, or {simulate}")
    folder = out or study.report
    chosen, origins = settings.analysis, list_origins(settings)
    write_report(
        study.ratings, study.manifest, folder, draws=chosen.draws, margin=chosen.margin,
        metrics=metrics or chosen.metrics, sources=origins,
        further=measure_rotations(study, settings, stimuli), seed=settings.study.seed, progress=progress,
    )  # fmt: skip
    return folder


def _spare_used_set(study: StudyFolder, recipe: Recipe, recordings: Sequence[Recording]) -> None:
    """Refuse to replace a set that sessions were run with, or may have been."""
    if not study.stimuli.exists() or not any(study.sessions.glob(f"*/{PLAN_FILE}")):
        return
    try:
        sha256 = read_stimuli(study.stimuli).sha256
        changes = find_changes(study.stimuli, recipe, {recording.name: recording.sha256 for recording in recordings})
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{study.stimuli}: nobody can tell whether sessions were run with this set ({error}); "
            f"restore it from a copy, or move {study.sessions} away"
        ) from None
    if changes and is_in_use(study, sha256):
        remedy = f"sessions were run with this set; make a new study, or move {study.sessions} away"
        raise ValueError("\n".join(f"{change}; {remedy}" for change in changes))
