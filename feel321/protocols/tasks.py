"""PROTOCOLS, the one list of rating tasks, and what is made from it: tasks and scores."""

from __future__ import annotations

from math import prod
from types import MappingProxyType
from typing import TYPE_CHECKING

from feel321.protocols.abx import ABX
from feel321.protocols.dissimilarity import DISSIMILARITY
from feel321.protocols.mushra import MUSHRA
from feel321.protocols.realism import REALISM
from feel321.protocols.similarity import SIMILARITY
from feel321.protocols.trial import ORIGINAL, RATING_RANGE, SURFACE, Task

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.protocols.trial import Protocol, Trial

# The one list of protocols: settings, messages and tests iterate it.

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType({
    protocol.name: protocol for protocol in (REALISM, SIMILARITY, DISSIMILARITY, MUSHRA, ABX)
})
"""Name -> protocol. Later ones are added, none renamed."""


# Tasks: what a study makes of a protocol, refused where the protocol does not have it.


def make_task(
    name: str,
    *,
    timing: str | None = None,
    reference: str | None = None,
    surface: bool = False,
    training: int = 0,
    practice: int = 0,
) -> Task:
    """Make a task of a protocol.

    Parameters
    ----------
    name : str
        Name in `PROTOCOLS`.
    timing : str or None
        One of the protocol's timings; None for its first.
    reference : str or None
        What is judged against: `original`, `surface` or the name of a reducer; None for the protocol's first.
    surface : bool
        Whether the real surface is felt first.
    training, practice : int
        Trials with feedback, and trials without that do not count, before the first that does.

    Returns
    -------
    Task
        The task.

    Raises
    ------
    ValueError
        If there is no such protocol, or it does not have what is asked for.

    Examples
    --------
    >>> make_task("similarity", reference="dft321").timing
    'replay'
    """
    if name not in PROTOCOLS:
        raise ValueError(f"protocol: got {name!r}, allowed: {', '.join(PROTOCOLS)}")
    protocol = PROTOCOLS[name]
    timing = protocol.timings[0] if timing is None else timing
    if timing not in protocol.timings:
        raise ValueError(
            f"tasks.{name}.timing: got {timing!r}, allowed: {', '.join(protocol.timings)}"
        )
    if reference is not None:
        _check_reference(protocol, reference)
    if surface and protocol.references:
        raise ValueError(
            f"tasks.{name}.surface: got true, allowed is false: nothing is judged by itself here; leave it out"
            + (f", or set reference = {SURFACE!r}" if SURFACE in protocol.references else "")
        )
    for key, count in {"training": training, "practice": practice}.items():
        if count < 0:
            raise ValueError(
                f"tasks.{name}.{key}: got {count}, allowed is a whole number of at least 0"
            )
    if reference is None:
        reference = next(iter(protocol.references), ORIGINAL)
    return Task(name, timing, reference, surface, training, practice)


def _check_reference(protocol: Protocol, reference: str) -> None:
    key = f"tasks.{protocol.name}.reference"
    if not protocol.references:
        raise ValueError(
            f"{key}: got {reference!r}, allowed is none: each stimulus is judged by itself; leave it out"
        )
    kind = reference if reference in {ORIGINAL, SURFACE} else "reducer"
    if not reference or kind not in protocol.references:
        allowed = [
            "the name of a reducer" if kind == "reducer" else kind for kind in protocol.references
        ]
        raise ValueError(f"{key}: got {reference!r}, allowed: {', '.join(allowed)}")


# What the answers to a trial are worth, and whether they are those of someone who has understood.


def score_trial(trial: Trial, values: Mapping[str, float | str]) -> dict[str, float]:
    """Turn the answers to a trial into points.

    Parameters
    ----------
    trial : Trial
        The trial.
    values : mapping of str to float or str
        The answer to each of its judgements, by the part that is judged.

    Returns
    -------
    dict of str to float
        Points, 0 to 100, by the part that is judged, in the trial's order.

    Raises
    ------
    KeyError
        If a judgement has no answer.
    """
    protocol = PROTOCOLS[trial.protocol]
    parts = {part.name: part.stimulus_id for part in trial.parts}
    return {
        judgement.part: protocol.score(judgement, values[judgement.part], parts)
        for judgement in trial.judgements
    }


def is_as_expected(trial: Trial, values: Mapping[str, float | str]) -> bool | None:
    """Tell whether the answers lie where those of someone who has understood do.

    Parameters
    ----------
    trial : Trial
        The trial.
    values : mapping of str to float or str
        The answer to each of its judgements, by the part that is judged.

    Returns
    -------
    bool or None
        Whether all do; None where nothing is expected.
    """
    points = score_trial(trial, values)
    met = [
        judgement.expected[0] <= points[judgement.part] <= judgement.expected[1]
        for judgement in trial.judgements
        if judgement.expected is not None
    ]
    return all(met) if met else None


def measure_chance(trial: Trial) -> float:
    """Tell how often someone who guesses answers as expected."""
    if choices := PROTOCOLS[trial.protocol].choices:
        return 1 / len(choices)
    low, high = RATING_RANGE
    known = [judgement.expected for judgement in trial.judgements if judgement.expected]
    return prod((most - least) / (high - low) for least, most in known)
