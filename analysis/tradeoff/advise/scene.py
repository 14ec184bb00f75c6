"""A scene: a recording or a segment of one, and the context in which it is to be felt."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING

from analysis.tradeoff.advise.tolerance import Tolerance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from stimuli.recording import Recording

LATENCY_MS = 45.0
"""Shortest delay between sight and touch that people notice, by the paper: the budget where none is named."""

BLOCK_MS = 1000 * 64 / 48_000
"""Time that a block of 64 samples at 48 kHz takes to come together."""

DEVICE_MS = 5.0
"""Assumed delay of converters and drivers where nobody has measured it; a sound card may need ten times as much."""

ANY, RECORDED = "any", "recorded"
"""Mountings of the sensor that advice must hold for: all of them, or the one that was recorded."""

SHORTEST_S = 0.1
"""Shortest segment: two periods of the lowest frequency that the metrics compare."""

ALL_AXES = 3


@dataclass(frozen=True, slots=True)
class Context:
    """Where a reducer is to run.

    Parameters
    ----------
    online : bool
        Whether it runs while the vibration is being made.
    latency_ms : float, optional
        The longest delay online in ms; 45 ms if left out.
    axes : int
        Axes that the actuator can move, 1 to 3.
    tolerance : Tolerance
        What is as good as the best.
    mounting : {"any", "recorded"}
        Whether advice must hold however the sensor is mounted, or for the mounting that was recorded.
    block_ms, device_ms : float
        What a block of samples and the device take of the longest delay.

    Raises
    ------
    ValueError
        If there are other axes or mountings, or a budget that is no time, leaves none or belongs to no online context.

    Examples
    --------
    >>> Context(online=True).budget_ms
    45.0
    """

    online: bool = False
    latency_ms: float | None = None
    axes: int = 1
    tolerance: Tolerance = field(default_factory=Tolerance)
    mounting: str = ANY
    block_ms: float = BLOCK_MS
    device_ms: float = DEVICE_MS

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.mounting not in {ANY, RECORDED}:
            raise ValueError(f"mounting: got {self.mounting!r}, allowed is {ANY} or {RECORDED}")
        if self.axes not in range(1, ALL_AXES + 1):
            raise ValueError(f"axes: got {self.axes}, allowed is 1, 2 or 3: what the actuator can move")
        times = {"latency-ms": self.latency_ms, "block-ms": self.block_ms, "device-ms": self.device_ms}
        for name, value in times.items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name}: got {value:g}, allowed is a finite time of 0 ms or more")
        if self.latency_ms is not None and not self.online:
            raise ValueError(f"latency-ms: got {self.latency_ms:g} offline, where nobody waits; add --online")
        if self.online and self.room_ms < 0:
            raise ValueError(
                f"latency-ms: got {self.budget_ms:g}, but block ({self.block_ms:.3g} ms) and device "
                f"({self.device_ms:.3g} ms) alone take {self.overhead_ms:.3g} ms; allow more, or lower --block-ms or "
                "--device-ms"
            )

    @property
    def overhead_ms(self) -> float:
        """What block and device take, in ms."""
        return self.block_ms + self.device_ms

    @property
    def room_ms(self) -> float:
        """What is left for the reducer, in ms; infinite offline."""
        return self.budget_ms - self.overhead_ms

    @property
    def budget_ms(self) -> float:
        """The longest delay in ms, of reducer, block and device together; infinite offline."""
        if not self.online:
            return float("inf")
        return LATENCY_MS if self.latency_ms is None else self.latency_ms


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording, or a segment of one.

    Parameters
    ----------
    recording : Recording
        The samples of the scene.
    source : str
        Name of the recording that it is, or is a part of.
    start_s, stop_s : float
        Where it lies in that.
    is_segment : bool
        Whether it is only a part.
    """

    recording: Recording
    source: str
    start_s: float
    stop_s: float
    is_segment: bool

    @property
    def name(self) -> str:
        """How to call it."""
        return f"{self.source} {self.start_s:.2f}-{self.stop_s:.2f} s" if self.is_segment else self.source


def check_segment(segment_s: float) -> float:
    """Refuse segments in which the lowest frequency has no room.

    Parameters
    ----------
    segment_s : float
        Length in s.

    Returns
    -------
    float
        The same.

    Raises
    ------
    ValueError
        If it is below 0.1 s.
    """
    if not (isfinite(segment_s) and segment_s >= SHORTEST_S):
        raise ValueError(f"segment: got {segment_s:g} s, allowed is {SHORTEST_S} s or more")
    return segment_s


def split_recording(recording: Recording, segment_s: float | None = None) -> Iterator[Scene]:
    """Make one scene of a recording, or one of every segment.

    Parameters
    ----------
    recording : Recording
        The recording.
    segment_s : float, optional
        Length of a segment in s. What is left at the end is a segment of its own if it is at least half as long, and
        belongs to the one before it otherwise.

    Yields
    ------
    Scene
        In time order; together they hold every sample once.

    Raises
    ------
    ValueError
        If segments are shorter than 0.1 s.
    """
    if segment_s is None:
        yield Scene(recording, recording.name, 0.0, recording.duration_s, is_segment=False)
        return
    length = round(check_segment(segment_s) * recording.rate_hz)
    pieces = max(1, int(recording.n_samples / length + 0.5))
    edges = [*(piece * length for piece in range(pieces)), recording.n_samples]
    for start, stop in pairwise(edges):
        part = replace(recording, acceleration=recording.acceleration[:, start:stop], sha256="")
        seconds = start / recording.rate_hz, stop / recording.rate_hz
        yield Scene(part, recording.name, *seconds, is_segment=pieces > 1)
