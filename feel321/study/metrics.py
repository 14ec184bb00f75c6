"""Further metrics of a study's stimuli, measured from its recordings: rivals, and over orientations of the sensor."""

import os
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from feel321.analysis.table.metrics import ROTATIONS, list_rivals
from feel321.analysis.table.reading import Further
from feel321.names import MATCHES
from feel321.stimuli.condition import condition
from feel321.stimuli.recording import Recording
from feel321.stimuli.rivals import RIVALS, measure_batch
from feel321.stimuli.rotation import match_rotations, random_rotations
from feel321.stimuli.sets.manifest import StimulusSet, read_stimuli
from feel321.stimuli.sets.recipe import Recipe, Unread, read_given
from feel321.stimuli.sets.render import find_reducer
from feel321.study.folder import StudyFolder
from feel321.study.sessions import find_changes
from feel321.study.settings.read import list_unread, make_recipe
from feel321.study.settings.schema import Settings

# Rival metrics, for an analysis that compares them with the match metrics.


def measure_rivals(
    recordings: Sequence[Recording | Unread], stimuli: StimulusSet, recipe: Recipe
) -> pd.DataFrame:
    """Measure every rival metric that the manifest lacks, for every test stimulus.

    Like the manifest's match metrics they are those of the reduction: of the recording conditioned by the recipe, at
    its own rate, before level, resampling and fades. Index stimulus_id, a column per metric, NaN where there is nothing
    to compare.
    """
    tests = [stimulus for stimulus in stimuli if stimulus.role == "test"]
    made: dict[str, set[str]] = defaultdict(set)
    for one in tests:
        made[one.recording].add(one.reducer)

    def measure(given: Recording | Unread) -> dict[tuple[str, str], dict[str, float]]:
        ready = condition(read_given(given), recipe.conditioning)
        signal, rate_hz = ready.acceleration, ready.rate_hz
        found = {}
        for name in made[ready.name]:
            reduced = np.asarray(find_reducer(recipe, name, ready.name)(signal, rate_hz))
            values = measure_batch(signal, reduced, rate_hz)
            found[ready.name, name] = {metric: float(one) for metric, one in values.items()}
        return found

    # Threads: nearly all of the work is done by libraries that release the interpreter.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = {key: row for one in pool.map(measure, recordings) for key, row in one.items()}
    rows = {one.stimulus_id: found[one.recording, one.reducer] for one in tests}
    lacking = [name for name in RIVALS if name not in stimuli.to_frame().columns]
    return pd.DataFrame.from_dict(rows, orient="index")[lacking].rename_axis("stimulus_id")


def add_rivals(
    study: StudyFolder, settings: Settings | None, manifest: Path, *, further: Further
) -> Further:
    """Let all metrics of a manifest be compared, and in a study those too that the manifest lacks."""
    names, measured, reason = list_rivals(manifest), pd.DataFrame(), ""
    if settings:
        recordings, recipe, reason = _read_unchanged(study, settings)
        try:
            if not reason:
                measured = measure_rivals(recordings, read_stimuli(study.stimuli), recipe)
        except ValueError as error:
            reason = str(error)
    note = (f"Metrics that the manifest lacks are not compared: {reason}.",) if reason else ()
    rivals = tuple(dict.fromkeys([*names, *map(str, measured)]))
    metrics = further.metrics.join(measured, how="outer") if len(measured) else further.metrics
    return replace(further, metrics=metrics, notes=(*further.notes, *note), rivals=rivals)


def _read_unchanged(study: StudyFolder, settings: Settings) -> tuple[list[Unread], Recipe, str]:
    """List a study's recordings, if the stimuli are still those of them; else give the reason."""
    sources: list[Unread] = []
    digests: dict[str, str | None] = {}
    recipe = make_recipe(settings, study.path)
    lead, problems = "The recordings cannot be read as they were when the set was built", []
    for source in list_unread(settings, study.path):
        try:
            recording = source.read()
        except (OSError, TypeError, ValueError) as error:
            problems.append(f"recording {source.name!r}: {error}")
            continue
        digests[source.name] = recording.sha256
        sources.append(replace(source, size=recording.acceleration.size))
    try:
        if not problems and (problems := find_changes(study.stimuli, recipe, digests)):
            lead = "The settings differ from those of the built set, which this analysis is about"
    except (OSError, ValueError) as error:
        problems = [str(error)]
    reason = f"{lead} ({problems[0].splitlines()[0].rstrip('.')})" if problems else ""
    return sources, recipe, reason


# How the metrics of a study's stimuli depend on the way the sensor was mounted: explored, or declared as predictors.
# The manifest has the metrics of each recording as it is. Another orientation of the sensor would have given another
# signal and other metrics, though people would have felt the same tool: mean and spread over orientations (Park &
# Kuchenbecker 2019, doi:10.1109/WHC.2019.8816148) belong to the recording and the reducer alone.

MOST, LEAST = 64, 16
"""Orientations: the mean is then known to 1/8 of their spread, or to 1/4 where there is so much to reduce."""

AFFORDABLE = 400_000_000
"""Samples, of all orientations, reducers and axes, that are reduced: about five seconds on two cores."""

DECLARED = 4
"""Times as many orientations, and as much work, for statistics that the analysis declares as predictors: an
association is weakened by what a predictor is uncertain."""

DIGITS = 9
"""Decimals: below, a spread that should be zero is rounding error."""


def measure_rotations(
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    *,
    metrics: Sequence[str] | None = None,
) -> Further:
    """Compute mean and spread of the metrics over sensor orientations for every test stimulus.

    metrics: those that the analysis is about; left out, as the study declares them.
    """
    recordings, recipe, reason = _read_unchanged(study, settings)
    if reason:
        note = f"{reason}. Rotation statistics of the metrics are left out."
        warnings.warn(note, stacklevel=2)
        return Further(pd.DataFrame(), (note,))
    wanted = settings.analysis.metrics if metrics is None else metrics
    # The first entry that differs from each in nothing but how the sensor was mounted.
    first: dict[str, str] = {}
    own = {"name", "sample", "picture", "rotation"}
    copies = {
        entry.title: first.setdefault(repr(entry.model_dump(exclude=own)), entry.title)
        for entry in settings.recordings
    }
    return compute_rotations(
        recordings,
        stimuli,
        recipe=recipe,
        seed=settings.study.seed,
        effort=DECLARED if set(wanted) & set(ROTATIONS) else 1,
        copies=copies,
    )


def measure_declared(study: StudyFolder, settings: Settings) -> Further | None:
    """Compute the rotation statistics of a study whose analysis declares any."""
    if not set(settings.analysis.metrics) & set(ROTATIONS):
        return None
    return measure_rotations(study, settings, read_stimuli(study.stimuli))


def compute_rotations(
    recordings: Sequence[Recording | Unread],
    stimuli: StimulusSet,
    *,
    recipe: Recipe,
    seed: int,
    effort: int = 1,
    copies: Mapping[str, str] | None = None,
) -> Further:
    """Condition recordings, rotate them, reduce them, and describe their metrics; a command would take too long.

    effort: how many times the usual orientations; copies: recording -> the one that it is a turned copy of, or itself.
    Copies share their statistics: over all orientations these are the same, and only chance would tell them apart.
    """
    copies = copies or {}
    commands = {one.name for one in recipe.methods if not one.is_python}
    tests = [one for one in stimuli.stimuli if one.role == "test" and one.reducer not in commands]
    reducers = list(dict.fromkeys(stimulus.reducer for stimulus in tests))
    if not reducers:
        note = "Rotation statistics: all reducers are commands or files; left out."
        return Further(pd.DataFrame(), (note,))
    own = [find_reducer(recipe, name) for name in reducers]
    first = {one.name: one for one in recordings if copies.get(one.name, one.name) == one.name}
    sizes = [
        one.size if isinstance(one, Unread) else one.acceleration.size for one in first.values()
    ]
    affordable = effort * AFFORDABLE // (sum(sizes) * len(reducers))
    n_turns = min(effort * MOST, max(effort * LEAST, affordable))
    turns = random_rotations(n_turns, np.random.default_rng(seed))

    def match(given: Recording | Unread) -> np.ndarray:
        ready = condition(read_given(given), recipe.conditioning)
        return match_rotations(ready.acceleration, ready.rate_hz, reducers=own, turns=turns)

    # Threads: nearly all of the work is done by libraries that release the interpreter. A lab's own code gets one.
    with ThreadPoolExecutor(1 if recipe.methods else os.cpu_count()) as pool:
        of_first = dict(zip(first, pool.map(match, first.values()), strict=True))
    matches = {one.name: of_first[copies.get(one.name, one.name)] for one in recordings}
    note = (
        f"Rotation statistics: each recording, conditioned as for its stimuli, was turned into {n_turns} random "
        f"orientations of the sensor (seed {seed}, the same ones for all), reduced and matched with itself; level, "
        "resampling and fades, which stimuli go through afterwards, are not included."
        + (" Turned copies of a recording share theirs." if len(first) < len(recordings) else "")
        + (f" Left out, as commands or files: {', '.join(sorted(commands))}." if commands else "")
    )
    moments = {
        name: np.stack([one.mean(axis=-1), one.std(axis=-1, ddof=1)], axis=-1).round(DIGITS)
        for name, one in matches.items()
    }
    table = pd.DataFrame(
        [moments[one.recording][reducers.index(one.reducer)].ravel() for one in tests],
        index=pd.Index([one.stimulus_id for one in tests], name="stimulus_id"),
        columns=[f"{metric}_rotation_{kind}" for metric in MATCHES for kind in ("mean", "sd")],
    )
    shares = {"q05": 0.05, "q50": 0.5, "q95": 0.95}
    mountings = [
        {"recording": recording, "reducer": reducer, "metric": metric}
        | {"mounting_mean": float(values.mean())}
        | dict(zip(shares, np.quantile(values, [*shares.values()]).tolist(), strict=True))
        for recording, found in matches.items()
        for reducer, of_reducer in zip(reducers, found, strict=True)
        for metric, values in zip(MATCHES, of_reducer, strict=True)
    ]
    return Further(table, (note,), mountings=pd.DataFrame(mountings))
