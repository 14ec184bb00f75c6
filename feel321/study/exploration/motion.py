"""The port between a hand and a playback: a motion source, which gives position and speed at a rate of its own.

The pointer of the screen is one on every machine: a mouse, or a tablet. A tracker is another, by its dotted name. A
source is written by its own thread and read by the audio device's: `latest` is one reference that is replaced as a
whole, so that neither waits for the other.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import hypot
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from feel321.types import Samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTER = "mouse"
SPAN_S = 0.03
"""Time over which the pointer's speed is taken: some events of a slow mouse, short for a hand."""

STILL_S = 0.05
"""A pointer that reports nothing for so long is at rest."""


class Motion(NamedTuple):
    """Where the hand is and how fast it moves, at a time on the session's clock; x to the right, y down."""

    time_s: float
    x_m: float
    y_m: float
    speed_m_s: float
    x_m_s: float


REST = Motion(0.0, 0.0, 0.0, 0.0, 0.0)


class MotionSource(Protocol):
    """Gives the hand's motion; a tracker of a lab's own is a class with these, made without arguments."""

    def read(self) -> Motion:
        """Return the latest motion, at once: the audio device's thread asks, block by block."""

    def begin(self) -> None:
        """Begin to keep what is measured, for a playback."""

    def take(self) -> Samples:
        """Return what was measured since `begin`, (k, 4): time in s, x and y in m, speed in m/s."""

    def close(self) -> None:
        """Let the device go."""


class Pointer:
    """The pointer of a window: `move` is called with every event, at the rate of the device."""

    def __init__(self, clock: Callable[[], float], *, m_per_pixel: float) -> None:
        self._clock, self._m_per_pixel = clock, m_per_pixel
        self._latest = REST
        self._track: list[Motion] = []

    def move(self, x_px: float, y_px: float) -> None:
        """Take account of a place of the pointer, in pixels."""
        now_s, x_m, y_m = self._clock(), x_px * self._m_per_pixel, y_px * self._m_per_pixel
        past = next((m for m in self._track if now_s - m.time_s <= SPAN_S), None)
        if past is None or now_s <= past.time_s:
            found = Motion(now_s, x_m, y_m, 0.0, 0.0)
        else:
            lasted_s = now_s - past.time_s
            across, down = (x_m - past.x_m) / lasted_s, (y_m - past.y_m) / lasted_s
            found = Motion(now_s, x_m, y_m, hypot(across, down), across)
        self._latest = found
        self._track.append(found)

    def read(self) -> Motion:
        """Return the latest motion; a pointer that reports nothing rests where it was."""
        latest, now_s = self._latest, self._clock()
        if now_s - latest.time_s > STILL_S and latest.speed_m_s:
            return latest._replace(time_s=latest.time_s + STILL_S, speed_m_s=0.0, x_m_s=0.0)
        return latest

    def begin(self) -> None:
        """Forget what was before, but for what the speed rests on."""
        self._track = [m for m in self._track if self._clock() - m.time_s <= SPAN_S]

    def take(self) -> Samples:
        """Return what was reported since `begin`."""
        return np.array([motion[:4] for motion in self._track], dtype=np.float64).reshape(-1, 4)

    def close(self) -> None:
        """Do nothing: the window is closed by who opened it."""


class Strokes:
    """The hand of a simulated participant: strokes to and fro, reported 125 times per s as a mouse reports.

    The same seed strokes alike. Speed is that of a sine: it rests where it turns.
    """

    RATE_HZ = 125.0

    def __init__(
        self, clock: Callable[[], float], rng: np.random.Generator, *, speed_m_s: float
    ) -> None:
        self._clock = clock
        self._strokes_hz = float(rng.uniform(0.6, 1.4))
        self._phase = float(rng.uniform(0, 2 * np.pi))
        self._peak_m_s = float(speed_m_s * rng.uniform(0.8, 1.6))
        self._begin_s = clock()

    def read(self) -> Motion:
        """Return the motion of the latest report."""
        return self._at(np.floor(self._clock() * self.RATE_HZ) / self.RATE_HZ)

    def begin(self) -> None:
        """Begin a playback."""
        self._begin_s = self._clock()

    def take(self) -> Samples:
        """Return the reports since `begin`."""
        first, last = (np.ceil(t * self.RATE_HZ) for t in (self._begin_s, self._clock()))
        times = np.arange(first, last + 1) / self.RATE_HZ
        return np.array([self._at(time_s)[:4] for time_s in times]).reshape(-1, 4)

    def close(self) -> None:
        """Do nothing."""

    def _at(self, time_s: float) -> Motion:
        turn = 2 * np.pi * self._strokes_hz
        velocity = self._peak_m_s * float(np.cos(turn * time_s + self._phase))
        x_m = self._peak_m_s / turn * float(np.sin(turn * time_s + self._phase))
        return Motion(time_s, x_m, 0.0, abs(velocity), velocity)


def find_tracker(name: str) -> Callable[[], MotionSource]:
    """Find what makes a tracker, by its dotted name ("mylab.tracking:tracker")."""
    module, _, attribute = name.partition(":")
    try:
        found: Callable[[], MotionSource] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"session.exploration.source {name!r} cannot be imported: {error}"
        ) from None
    return found


@contextmanager
def open_tracker(name: str) -> Iterator[MotionSource]:
    """Open a lab's own tracker, and close it whatever happens."""
    try:
        source = find_tracker(name)()
        missing = [one for one in ("read", "begin", "take", "close") if not hasattr(source, one)]
        motion = None if missing else Motion(*source.read())
    except (TypeError, OSError) as error:
        raise ValueError(f"session.exploration.source {name!r} does not open: {error}") from error
    if missing or motion is None:
        raise ValueError(
            f"session.exploration.source {name!r} must have read, begin, take and close; it lacks {', '.join(missing)}"
        )
    try:
        yield source
    finally:
        source.close()


def check_track(track: object) -> Samples:
    """Refuse what a source gives as its track unless it is finite, (k, 4), in order of time."""
    found: NDArray[np.float64] = np.asarray(track, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 4 or not np.all(np.isfinite(found)):  # noqa: PLR2004 - time, x, y, speed
        raise ValueError(
            f"a motion source must give finite values of shape (k, 4), got {found.shape}"
        )
    if np.any(np.diff(found[:, 0]) < 0):
        raise ValueError("a motion source must give times in order")
    return found
