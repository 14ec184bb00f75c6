"""Options of any task: several scales in each trial, and the pace of its trials."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.protocols.detection import THRESHOLD
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import FREE, MATCHING, SURFACE, Task

if TYPE_CHECKING:
    from collections.abc import Sequence

MOST_SCALES = 4
"""Scales of a trial: more do not fit on one screen."""


def refine_task(
    task: Task,
    *,
    scales: Sequence[str] = (),
    gap_s: float | None = None,
    answer_timeout_s: float | None = None,
    onset_s: float | None = None,
) -> Task:
    """Give a task several scales, or a pace of its own.

    Parameters
    ----------
    task : Task
        The task.
    scales : sequence of str
        The scales of each trial, in order: the protocol's own and others; its own alone by default.
    gap_s : float or None
        Silence in s before each part; None for the session's.
    answer_timeout_s : float or None
        Time for an answer, in s, from when it can be given; None for any.
    onset_s : float or None
        Time in s from the onset of a trial to that of the next; None to begin when the participant is ready.

    Returns
    -------
    Task
        The task with these options.

    Raises
    ------
    ValueError
        If its protocol does not have an option.

    Examples
    --------
    >>> from feel321 import protocols
    >>> task = protocols.refine_task(protocols.make_task("realism"), scales=["realism", "roughness"])
    >>> task.scales
    ('realism', 'roughness')
    """
    for key, value in zip(TIMES, (gap_s, answer_timeout_s, onset_s), strict=True):
        if value is not None:
            _check_time(task, key, value)
    if onset_s is not None and (task.surface or task.reference == SURFACE):
        raise ValueError(
            f"tasks.{task.protocol}.onset_s must not be set where the real surface is touched, which takes its own "
            "time; leave it out"
        )
    return replace(
        task,
        scales=_check_scales(task, tuple(scales)),
        gap_s=gap_s,
        answer_timeout_s=answer_timeout_s,
        onset_s=onset_s,
    )


TIMES = {"gap_s": (0.0, 30.0), "answer_timeout_s": (0.5, 600.0), "onset_s": (0.5, 600.0)}
"""The shortest and the longest time of each option, in s."""


def _check_time(task: Task, key: str, value: float) -> None:
    place, (low, high) = f"tasks.{task.protocol}.{key}", TIMES[key]
    if not low <= value <= high:
        raise ValueError(f"{place} must be {low:g} to {high:g}, got {value:g}")
    if task.timing == FREE:
        raise ValueError(
            f"{place} must not be set: parts are felt at will, in the participant's own time; leave it out"
        )


def _check_scales(task: Task, scales: tuple[str, ...]) -> tuple[str, ...]:
    """Check the scales of a task; none where there is only the protocol's own."""
    key, protocol = f"tasks.{task.protocol}.scales", PROTOCOLS[task.protocol]
    if scales in {(), (protocol.scale,)}:
        return ()
    if not protocol.has_slider:
        able = ", ".join(name for name, other in PROTOCOLS.items() if other.has_slider)
        raise ValueError(
            f"{key} must be left out, got {list(scales)}: several scales are for tasks with one slider ({able})"
        )
    if protocol.scale not in scales:
        raise ValueError(
            f"{key} must hold {protocol.scale!r}, the protocol's own, got {list(scales)}; add it"
        )
    if len(set(scales)) < len(scales) or len(scales) > MOST_SCALES:
        raise ValueError(
            f"{key} must be at most {MOST_SCALES} names, each once, got {list(scales)}; ask on fewer scales"
        )
    ours = (other.scale for other in PROTOCOLS.values() if not other.sha256)
    taken = {*ours, THRESHOLD, MATCHING}
    if foreign := sorted(taken.intersection(scales) - {protocol.scale}):
        raise ValueError(
            f"{key} must not hold the scale of another task, got {', '.join(map(repr, foreign))}; name one of your own"
        )
    return scales
