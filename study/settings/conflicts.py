"""What each table of `study.toml` may say by itself, but not together with the others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.groups import select_items
from protocols.registry import PROTOCOLS
from protocols.tasks import make_task
from protocols.trial import SURFACE, Item
from stimuli.recipe import NO_REFERENCE
from study.observer.raters import ObserverModel
from study.settings.designs import make_design

if TYPE_CHECKING:
    from collections.abc import Iterator

    from protocols.protocol import Task
    from study.settings.tables import Settings


def find_conflicts(settings: Settings) -> list[str]:
    """Find settings that do not go together.

    Parameters
    ----------
    settings : Settings
        Settings each of which is allowed.

    Returns
    -------
    list of str
        Every conflict in one line; empty if there is none.
    """
    # What is wrong here would only be said again, and less clearly, by what follows from it.
    if found := [*_check_tasks(settings), *_check_between(settings), *_check_observer(settings)]:
        return found
    tasks = make_design(settings).tasks
    return [*_check_samples(settings, tasks), *_check_comparisons(settings, tasks)]


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
    for level in settings.between.get("level", (None,)):
        items = select_items(_list_items(settings), {} if level is None else {"level": level})
        for task in tasks:
            try:
                PROTOCOLS[task.protocol].compare(items, task)
            except ValueError as error:
                yield f"tasks.{task.protocol}: {error}"


def _list_items(settings: Settings) -> list[Item]:
    """List what will be built from the first recording, as protocols see it; the others fare alike."""
    from stimuli.anchors import ANCHORS

    stimuli, recording = settings.stimuli, settings.recordings[0].title
    made = [(name, "test") for name in stimuli.reducers]
    made += [(stimuli.reference, "reference")] * (stimuli.reference != NO_REFERENCE)
    made += [(name, "anchor") for name in ANCHORS] * stimuli.anchors
    return [
        Item(f"{recording}-{role}-{reducer}-{level}", recording, reducer, level, role)
        for level in stimuli.levels
        for reducer, role in made
    ]
