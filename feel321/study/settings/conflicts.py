"""Settings that do not go together, though each is allowed by itself."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from itertools import product
from typing import Any

from feel321.doors import name_of, refuse_name
from feel321.extensions import is_given
from feel321.names import ANCHOR_NAMES, METRIC_INFO, WRITTEN
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import read_texts
from feel321.protocols.trial import CHOOSING, SURFACE, Item, Task, select_group
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.recipe import NO_REFERENCE, ORIGINAL
from feel321.study.settings.schema import LANGUAGE_FILE, Settings, TaskTable

MOST_TRIALS = 10_000
"""Trials in a session; people do a few hundred, simulated participants somewhat more."""

Group = tuple[tuple[Item, ...], tuple[Task, ...]]  # what its participants feel, and do


def find_conflicts(settings: Settings) -> list[str]:
    """Find settings that do not go together."""
    # A mistake is reported where it is made, not again, and less clearly, in what follows from it.
    checks = (_check_methods, _check_stimuli, _check_tasks)
    if found := [line for check in checks for line in check(settings)]:
        return found
    groups = list(_list_groups(settings))
    found = list(dict.fromkeys(_check_comparisons(settings, groups)))
    return found or list(_check_length(settings, groups))


def _check_methods(settings: Settings) -> Iterator[str]:
    """Refuse unknown metrics, and tables that would replace a method of feel321's: they would be left unread."""
    coded = [name for name, one in settings.metrics.items() if one.use or one.command]
    taken = {"reducers": (*REDUCERS, ORIGINAL, NO_REFERENCE), "metrics": METRICS}
    for kind, names in (("reducers", settings.reducers), ("metrics", coded)):
        for name in (one for one in names if one in taken[kind]):
            yield f"{kind}.{name}: the name is taken by one of feel321's own; give yours another"
    for name, table in settings.metrics.items():
        if name in METRIC_INFO and table.higher not in {None, (right := METRIC_INFO[name].higher)}:
            yield f"metrics.{name}.higher must be {right!r} for this metric, got {table.higher!r}; remove it"
    # A lab's own is not imported yet.
    further = [name for name in METRICS if name not in WRITTEN]
    for number, name in enumerate(settings.stimuli.metrics, start=1):
        if name in WRITTEN:
            yield f"stimuli.metrics[{number}] must be a further metric, got {name!r}, which every set has; remove it"
        elif name not in METRICS and not is_given("metric", name, settings.metrics):
            yield refuse_name(name, further, f"stimuli.metrics[{number}]")


def _check_stimuli(settings: Settings) -> Iterator[str]:
    """Check that there is what is to be compared or matched."""
    stimuli, matching = settings.stimuli, settings.session.matching
    if (reference := stimuli.reference) in stimuli.reducers:
        rule = "must not be one of stimuli.reducers too"
        yield f"stimuli.reference {rule}, got {reference!r}; take it out of the reducers"
    if matching and matching.level not in {None, *stimuli.levels}:
        rule = f"must be one of stimuli.levels, got {matching.level!r}"
        yield f"session.matching.level {rule}; add it there"
    if matching and reference == NO_REFERENCE:
        yield f"session.matching needs a reference, got stimuli.reference = {reference!r}; set another one"


def _check_tasks(settings: Settings) -> Iterator[str]:
    """Try each setting of a task by itself, so that every mistake is found; then all together."""
    for name, table in settings.tasks.items():
        alone = [TaskTable(**{key: value}) for key, value in table if key in table.model_fields_set]
        faults = []
        for one in (*alone, table):
            try:
                one.make_task(name)
            except ValueError as error:
                faults.append(str(error))
        yield from dict.fromkeys(faults[:-1] or faults)
    # Words in a file of the lab's own are found when it is read.
    if not settings.session.language.endswith(LANGUAGE_FILE):
        yield from find_mute_scales(settings, read_texts(settings.session.language)["scales"])
    places = {
        "level": ("stimuli.levels", settings.stimuli.levels),
        "protocol": ("session.protocols", settings.session.protocols),
    }
    for factor, (place, allowed) in places.items():
        for name in settings.between.get(factor, ()):
            if name not in allowed:
                rule = f"must be one of {', '.join(allowed)}, got {name!r}"
                yield f"between.{factor} {rule}; or add it to {place}"


def find_mute_scales(settings: Settings, texts: Mapping[str, Any]) -> Iterator[str]:
    """Find scales that are asked and have no words, and words for scales that are no sliders."""
    for name in settings.scales:
        if texts.get(name, {}).get("choices"):
            yield f"scales.{name}: must not be set, the answer to {name} is a choice; remove it"
    known = {*texts, *settings.scales}
    asked = [(task, name) for task, table in settings.tasks.items() for name in table.scales]
    for task, name in (one for one in asked if one[1] not in known):
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? Or " if near else ""
        remedy = f"{hint}add [scales.{name}] with question, low and high"
        yield f"tasks.{task}.scales: {name!r} has no words; {remedy}"


def _list_groups(settings: Settings) -> Iterator[Group]:
    """List the stimuli, as built from the first recording, and the tasks of the groups that differ in them."""
    stimuli, recording = settings.stimuli, settings.recordings[0].title
    made = [(name_of(name), "test") for name in stimuli.reducers]
    made += [(name_of(stimuli.reference), "reference")] * (stimuli.reference != NO_REFERENCE)
    made += [(name, "anchor") for name in ANCHOR_NAMES] * stimuli.anchors
    items = [
        Item(f"{recording}-{role}-{reducer}-{level}", recording, reducer, level, role)
        for level in stimuli.levels
        for reducer, role in made
    ]
    factors = {name: settings.between[name] for name in CHOOSING if name in settings.between}
    for levels in product(*factors.values()):
        yield select_group(items, settings.list_tasks(), dict(zip(factors, levels, strict=True)))


def _check_comparisons(settings: Settings, groups: list[Group]) -> Iterator[str]:
    """Check that surfaces have names, and that the stimuli to be built are what the tasks need."""
    tasks = dict.fromkeys(task for _, own in groups for task in own)
    on_surfaces = [task.protocol for task in tasks if task.surface or task.reference == SURFACE]
    for number, recording in enumerate(settings.recordings, start=1):
        if on_surfaces and not recording.sample:
            yield (
                f"recordings[{number}].sample: missing, but participants touch the real surface in "
                f"{' and '.join(on_surfaces)}; add the name that it has in the lab"
            )
    for items, own in groups:
        for task in own:
            try:
                PROTOCOLS[task.protocol].make_lessons(items, task)
                PROTOCOLS[task.protocol].compare(items, task)
            except (TypeError, ValueError) as error:
                yield f"tasks.{task.protocol}: {error}"


def _check_length(settings: Settings, groups: list[Group]) -> Iterator[str]:
    """Count the trials of each group, which are as many for each recording."""
    everything, share = len(settings.recordings), settings.session.recordings_per_participant
    if share and share > everything:
        yield (
            f"session.recordings_per_participant must be at most the {everything} recordings of the study, "
            f"got {share}; leave it out, and everybody feels them all"
        )
    counts = [
        sum(len(PROTOCOLS[task.protocol].compare(items, task)) for task in own)
        for items, own in groups
    ]
    repeats = settings.session.repeats
    if (trials := max(counts) * repeats * (share or everything)) > MOST_TRIALS:
        yield (
            f"a session must have at most {MOST_TRIALS} trials, got {trials} with session.repeats = {repeats}; use "
            "fewer repeats, reducers or recordings, or let each participant feel a share of them: "
            "session.recordings_per_participant"
        )
