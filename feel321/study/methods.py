"""A study's own reducers and metrics, by the names that its settings and the command line use."""

from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import cast

from feel321.doors import refuse_name
from feel321.extensions import FORMS, Method, find_method, list_entry_points
from feel321.names import WRITTEN
from feel321.stimuli.guard import OwnMetric, OwnReducer
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.recipe import NO_REFERENCE, ORIGINAL
from feel321.study.folder import SETTINGS_FILE
from feel321.study.settings.read import find_metric, find_reducer, read_settings
from feel321.study.settings.schema import RecordingTable, Settings
from feel321.types import Metric, Reducer

PAIR = ("acceleration", "reduced", "rate_hz")  # of a metric; a reducer lacks the second


def open_reducer(name: str, folder: Path) -> Reducer:
    """Open a reducer: feel321's, or one of the study in a folder, of its files, or of an installed package."""
    settings = _read_if_there(folder)
    if name in {ORIGINAL, NO_REFERENCE}:
        allowed = (*REDUCERS, *settings.reducers)
        raise ValueError(f"{refuse_name(name, allowed, 'reducer')}; {FORMS}")
    found = find_reducer(settings, name, folder)
    return REDUCERS[name] if isinstance(found, str) else OwnReducer(found)


def open_metric(name: str, folder: Path) -> Metric:
    """Open a metric likewise."""
    found = find_metric(_read_if_there(folder), name, folder)
    return METRICS[name] if isinstance(found, str) else OwnMetric(found)


def open_method(name: str, folder: Path, kind: str | None = None) -> Method:
    """Open one of the lab's own methods; without a kind, a metric is what takes three arguments."""
    settings = _read_if_there(folder)
    if name in {*REDUCERS, *METRICS, ORIGINAL, NO_REFERENCE}:
        raise ValueError(f"{name} is feel321's own; name a reducer or metric of yours")
    if kind is None and name not in settings.reducers:
        takes_pair = name in settings.metrics or name in list_entry_points("metric")
        if ":" in name and not takes_pair:
            found = find_method("reducer", name, folder=folder)
            with suppress(ValueError, TypeError):  # whatever is wrong with it is found again
                takes_pair = len(signature(found.load()).parameters) == len(PAIR)
        kind = "metric" if takes_pair else None
    find = find_metric if kind == "metric" else find_reducer
    return cast("Method", find(settings, name, folder))


def list_own_reducers(settings: Settings, folder: Path) -> dict[str, OwnReducer]:
    """List the reducers that a study names or declares and feel321 lacks, by their short names."""
    named = (*settings.stimuli.reducers, settings.stimuli.reference, *settings.reducers)
    found = {name: find_reducer(settings, name, folder) for name in dict.fromkeys(named)}
    return {one.name: OwnReducer(one) for one in found.values() if not isinstance(one, str)}


def list_methods(settings: Settings, folder: Path) -> list[Method]:
    """List the lab's own reducers and metrics that a study uses or declares."""
    # Tables without code say what a column means.
    declared = [name for name, table in settings.metrics.items() if table.use or table.command]
    named = dict.fromkeys((*settings.stimuli.metrics, *declared))
    metrics = [find_metric(settings, name, folder) for name in named]
    reducers = [one.method for one in list_own_reducers(settings, folder).values()]
    return [*reducers, *(one for one in metrics if not isinstance(one, str))]


def list_for_tradeoff(
    settings: Settings, folder: Path
) -> tuple[dict[str, Reducer], dict[str, Metric]]:
    """List the lab's own reducers, but those made elsewhere, which reduce nothing else; and metrics beside ours."""
    own = list_own_reducers(settings, folder).items()
    reducers: dict[str, Reducer] = {name: one for name, one in own if one.method.origin != "made"}
    asked = [name for name in settings.stimuli.metrics if name in METRICS and name not in WRITTEN]
    metrics: dict[str, Metric] = {name: METRICS[name] for name in asked}
    methods = [one for one in list_methods(settings, folder) if one.kind == "metric"]
    return reducers, metrics | {one.name: OwnMetric(one) for one in methods}


def _read_if_there(folder: Path) -> Settings:
    path = folder / SETTINGS_FILE
    if path.is_file():
        return read_settings(path)
    return Settings(recordings=(RecordingTable(scene="bumps"),))
