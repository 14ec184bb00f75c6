"""What each table of `study.toml` may say by itself, but not together with the others."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from protocols.groups import CHOOSING, select_items, select_tasks
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


MOST_TRIALS = 10_000
"""Trials in a session; people do a few hundred, simulated ones somewhat more."""


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
    trials = max(each * sum(len(PROTOCOLS[t.protocol].compare(items, t)) for t in own) for items, own in groups)
    if trials > MOST_TRIALS:
        yield (
            f"session.repeats: got {settings.session.repeats}, which makes {trials} trials in a session, allowed are "
            f"at most {MOST_TRIALS}; ask for fewer repeats, reducers or recordings"
        )


def _list_groups(settings: Settings, tasks: tuple[Task, ...]) -> Iterator[tuple[tuple[Item, ...], tuple[Task, ...]]]:
    """List what is felt and done in the groups that differ in that."""
    factors = {name: settings.between[name] for name in CHOOSING if name in settings.between}
    for levels in product(*factors.values()):
        groups = dict(zip(factors, levels, strict=True))
        yield select_items(_list_items(settings), groups), select_tasks(tasks, groups)


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
