"""Tasks: what a study makes of a protocol, refused where the protocol does not have it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.protocol import ORIGINAL, Task
from protocols.registry import PROTOCOLS
from protocols.trial import SURFACE

if TYPE_CHECKING:
    from protocols.protocol import Protocol


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
        raise ValueError(f"tasks.{name}.timing: got {timing!r}, allowed: {', '.join(protocol.timings)}")
    if reference is not None:
        _check_reference(protocol, reference)
    if surface and protocol.references:
        raise ValueError(
            f"tasks.{name}.surface: got true, allowed is false: nothing is judged by itself here; leave it out"
            + (f", or set reference = {SURFACE!r}" if SURFACE in protocol.references else "")
        )
    for key, count in {"training": training, "practice": practice}.items():
        if count < 0:
            raise ValueError(f"tasks.{name}.{key}: got {count}, allowed is a whole number of at least 0")
    if reference is None:
        reference = next(iter(protocol.references), ORIGINAL)
    return Task(name, timing, reference, surface, training, practice)


def _check_reference(protocol: Protocol, reference: str) -> None:
    key = f"tasks.{protocol.name}.reference"
    if not protocol.references:
        raise ValueError(f"{key}: got {reference!r}, allowed is none: each stimulus is judged by itself; leave it out")
    kind = reference if reference in {ORIGINAL, SURFACE} else "reducer"
    if not reference or kind not in protocol.references:
        allowed = ["the name of a reducer" if kind == "reducer" else kind for kind in protocol.references]
        raise ValueError(f"{key}: got {reference!r}, allowed: {', '.join(allowed)}")
