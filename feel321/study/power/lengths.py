"""How long a session takes with other numbers of recordings, reducers and repeats."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.protocols import trial
from feel321.study import minutes
from feel321.study.session import plan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.analysis.power.design import PowerDesign
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.minutes import Length, Pace
    from feel321.study.session.plan import Design


def measure_sessions(
    design: Design, stimuli: StimulusSet, sizes: PowerDesign, *, groups: int, pace: Pace
) -> Length:
    """Work through sessions of these sizes, with the study's own stimuli and copies of them, in every group."""
    choosing = {name: own for name, own in design.between.items() if name in trial.CHOOSING}
    design = replace(design, repeats=sizes.repeats, between=choosing)
    items, durations = _resize(stimuli, sizes.recordings, sizes.reducers)
    courses = [plan.make_trials(design, items, number=number + 1) for number in range(groups)]
    sittings = [minutes.Sitting.plan(course, design.flow, durations) for course in courses]
    return minutes.measure_length(sittings, pace)


def _resize(
    stimuli: StimulusSet, recordings: int, reducers: int
) -> tuple[list[trial.Item], dict[str, float]]:
    """List the stimuli of so many recordings and reducers, the set's own first and then copies of them."""
    known, durations = minutes.find_durations(stimuli), {}
    own = list(dict.fromkeys(one.reducer for one in stimuli if one.role == "test"))
    kept = _number_copies(own, reducers)
    items = []
    for name, scene in _number_copies(list(known), recordings):
        durations[name] = known[scene]
        for one in (one for one in stimuli if one.recording == scene):
            made = (
                [new for new, of in kept if of == one.reducer]
                if one.role == "test"
                else [one.reducer]
            )
            items += [
                trial.Item(f"{name}__{reducer}__{one.level}", name, reducer, one.level, one.role)
                for reducer in made
            ]
    return items, durations


def _number_copies(names: Sequence[str], wanted: int) -> list[tuple[str, str]]:
    """List so many names, each with the one it is a copy of.

    Examples
    --------
    >>> _number_copies(["a", "b"], 3)
    [('a', 'a'), ('b', 'b'), ('a (2)', 'a')]
    """
    found = [(name, turn) for turn in range(1, wanted // len(names) + 2) for name in names][:wanted]
    return [(name if turn == 1 else f"{name} ({turn})", name) for name, turn in found]
