"""Explorers: what the hand's motion makes of a stimulus, block by block, for the stream's callback.

With the hand at the reference speed every sample of the stimulus is played as it is, bit for bit. At rest there is
silence. Between them:

- *gain*: the stimulus goes on in time, the louder the faster the hand, up to twice, never beyond full scale.
- *speed*: the hand runs through the stimulus as over a texture; half as fast is an octave lower. At its end it begins
  again.
- *window*: short windows of the stimulus, taken where the hand is; slower or faster, to and fro, at the same pitch.

Gains and rates follow the motion along straight lines, the whole range of 1 in `RAMP_S`, so that nothing jumps whenever
reports arrive. An output lasts as long as its stimulus. Rendering allocates nothing that lasts.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from feel321.doors import check_name
from feel321.study.exploration.motion import REST, Motion, MotionSource
from feel321.types import Samples

Frames = NDArray[np.float32]  # (n, channels), as the mixer's

RAMP_S = 0.02
"""Time in which a gain or a rate changes by 1: short for a hand, long for a click."""

MOST_GAIN, MOST_RATE = 2.0, 4.0
QUIET = 0.05
"""Share of the reference speed below which the output fades into the silence of rest."""

GRAIN_S = 0.05
"""Length of a window, of which two overlap at any time: 20 Hz and more are kept."""

MOST_USES = 2**14
"""Reports of a playback whose latency is measured: two minutes of a mouse."""


class Ramp:
    """A value that follows its target along straight lines, and meets it exactly."""

    def __init__(self, value: float, *, frames: float, max_frames: int) -> None:
        self.value, self._step = value, 1 / max(frames, 1.0)
        self._counts = np.arange(1, max_frames + 1, dtype=np.float64)
        self._values = np.empty(max_frames)

    def follow(self, target: float, n: int) -> Samples:
        """Give the next n values, valid until the next call."""
        values, away = self._values[:n], target - self.value
        np.multiply(self._counts[:n], self._step if away > 0 else -self._step, out=values)
        np.add(values, self.value, out=values)
        (np.minimum if away > 0 else np.maximum)(values, target, out=values)
        self.value = float(values[-1]) if n else self.value
        return values


class Explorer:
    """Plays one stimulus as the hand moves; `render` is called by the mixer, in the device's thread."""

    def __init__(
        self, source: MotionSource, *, reference_m_s: float, rate_hz: float, max_frames: int = 1024
    ) -> None:
        self._source, self._reference, self._rate_hz = source, reference_m_s, rate_hz
        self._ramp_frames, self._max_frames = RAMP_S * rate_hz, max_frames
        self._motion: Motion = REST
        self._gain: Ramp | None = None
        self._most = 1.0
        self.n_uses = 0
        self.uses = np.zeros((MOST_USES, 2))

    def prepare(self, sound: Frames) -> None:
        """Make ready for a stimulus, (n, channels), before the device asks for it."""
        peak = float(np.abs(sound).max(initial=0.0))
        self._most = min(MOST_GAIN, 1 / peak) if peak > 0 else 1.0
        self._source.begin()

    def render(self, piece: Frames, sound: Frames, place: int) -> None:
        """Write the next frames of the output, (k, channels); place: how many came before."""
        done = 0
        while done < len(piece):
            end = self._find_cut(place + done, len(sound))
            part = piece[done : min(done + self._max_frames, len(piece), done + end)]
            self._look(place + done)
            self._write(part, sound, place + done)
            done += len(part)

    def _find_cut(self, place: int, n: int) -> int:
        """Find how many frames may be written at once from here on."""
        return n - place

    def _write(self, part: Frames, sound: Frames, place: int) -> None:
        raise NotImplementedError

    def _look(self, place: int) -> None:
        """Read the hand's motion, and note when a report is first used."""
        motion = self._source.read()
        if motion.time_s != self._motion.time_s and self.n_uses < MOST_USES:
            self.uses[self.n_uses] = motion.time_s, place
            self.n_uses += 1
        self._motion = motion

    @property
    def _ratio(self) -> float:
        """Speed relative to the reference; 0 where a source gives none."""
        ratio = self._motion.speed_m_s / self._reference
        return min(ratio, MOST_RATE) if ratio > 0 else 0.0

    def _play_louder(self, part: Frames, target: float) -> None:
        """Multiply by the gain on its way to a target; begin there."""
        if self._gain is None:
            self._gain = Ramp(target, frames=self._ramp_frames, max_frames=self._max_frames)
        gains = self._gain.follow(target, len(part))
        for column in range(part.shape[1]):
            np.multiply(part[:, column], gains, out=part[:, column], casting="same_kind")


class GainExplorer(Explorer):
    """The louder the faster."""

    def _write(self, part: Frames, sound: Frames, place: int) -> None:
        np.copyto(part, sound[place : place + len(part)])
        self._play_louder(part, min(self._ratio, self._most))


class _Wandering(Explorer):
    """An explorer that leaves the stimulus's own time, and must fade at its end where it is not there."""

    def prepare(self, sound: Frames) -> None:
        super().prepare(sound)
        self._fade_at = len(sound) - int(np.ceil(self._ramp_frames))

    def _find_cut(self, place: int, n: int) -> int:
        return self._fade_at - place if place < self._fade_at else n - place

    def _find_gain(self, place: int, *, in_time: bool) -> float:
        if place >= self._fade_at and not in_time:
            return 0.0
        return min(self._ratio / QUIET, 1.0)


class SpeedExplorer(_Wandering):
    """The hand runs through the stimulus: sample by sample at its speed, interpolated by cubic Hermite splines."""

    def prepare(self, sound: Frames) -> None:
        """Make room for positions, indices and neighbours."""
        super().prepare(sound)
        n, channels = self._max_frames, sound.shape[1]
        self._position = 0.0
        self._rate: Ramp | None = None
        self._places, self._shares = np.empty((2, n))
        self._indices: NDArray[np.intp] = np.empty(n, dtype=np.intp)
        self._near = np.empty((4, n, channels), dtype=np.float32)

    def _write(self, part: Frames, sound: Frames, place: int) -> None:
        n, ratio = len(part), self._ratio
        if self._rate is None:
            self._rate = Ramp(ratio, frames=self._ramp_frames, max_frames=self._max_frames)
        in_time = self._position == place % len(sound) and self._rate.value == ratio == 1
        rates, places, shares = self._rate.follow(ratio, n), self._places[:n], self._shares[:n]
        np.cumsum(rates, out=places)
        end = self._position + float(places[-1])
        np.add(places, self._position, out=places)
        np.subtract(places, rates, out=places)  # the first one is where the last block ended
        self._position = end % len(sound)
        np.floor(places, out=shares)
        np.copyto(self._indices[:n], shares, casting="unsafe")
        np.subtract(places, shares, out=shares)
        self._interpolate(part, sound, n)
        self._play_louder(part, self._find_gain(place, in_time=in_time))

    def _interpolate(self, part: Frames, sound: Frames, n: int) -> None:
        """Write what lies between the samples; on a sample exactly that."""
        indices, near = self._indices[:n], self._near[:, :n]
        np.subtract(indices, 1, out=indices)
        for one in near:
            np.take(sound, indices, axis=0, out=one, mode="wrap")
            np.add(indices, 1, out=indices)
        before, here, after, beyond = near
        share = self._shares[:n, None].astype(np.float32)
        slope, bend = 0.5 * (after - before), before - 2.5 * here + 2 * after - 0.5 * beyond
        np.multiply(0.5 * (beyond - before) + 1.5 * (here - after), share, out=part)
        np.add(part, bend, out=part)
        np.multiply(part, share, out=part)
        np.add(part, slope, out=part)
        np.multiply(part, share, out=part)
        np.add(part, here, out=part)


class WindowExplorer(_Wandering):
    """Windows of the stimulus, each taken where the hand is as it begins; two overlap, and fade into each other."""

    def prepare(self, sound: Frames) -> None:
        """Make the fade, and room for two windows."""
        super().prepare(sound)
        self._hop = max(round(GRAIN_S * self._rate_hz / 2), 1)
        self._fade_in = np.sin(0.5 * np.pi * np.arange(self._hop) / self._hop) ** 2
        self._old = -self._hop  # where the windows begin in the stimulus
        self._new, self._begun = 0, 0
        self._rest = 0.0
        self._indices: NDArray[np.intp] = np.empty(self._max_frames, dtype=np.intp)
        self._near = np.empty((2, self._max_frames, sound.shape[1]), dtype=np.float32)

    def _find_cut(self, place: int, n: int) -> int:
        return min(super()._find_cut(place, n), self._hop - place % self._hop)

    def _write(self, part: Frames, sound: Frames, place: int) -> None:
        n, phase = len(part), place % self._hop
        if phase == 0 and place:
            self._begin_window()
        indices, (old, new) = self._indices[:n], self._near[:, :n]
        for first, out in ((self._old + self._hop + phase, old), (self._new + phase, new)):
            np.add(np.arange(n), first, out=indices)
            np.take(sound, indices, axis=0, out=out, mode="wrap")
        np.subtract(new, old, out=new)
        share = self._fade_in[phase : phase + n, None]
        np.multiply(new, share, out=new, casting="same_kind")
        np.add(old, new, out=part)
        in_time = (
            (self._new + phase - place) % len(sound) == 0 == (self._old + self._hop - self._new)
        )
        self._play_louder(part, self._find_gain(place, in_time=in_time))

    def _begin_window(self) -> None:
        """Begin the next window where the hand is by now."""
        across = self._motion.x_m_s / self._reference
        ratio = max(min(across, MOST_RATE), -MOST_RATE) if isfinite(across) else 0.0
        moved = self._hop * ratio + self._rest
        whole = round(moved)
        self._rest = moved - whole
        self._old, self._new = self._new, self._new + whole


EXPLORERS: Mapping[str, type[Explorer]] = MappingProxyType({
    "gain": GainExplorer, "speed": SpeedExplorer, "window": WindowExplorer,
})  # fmt: skip
"""Name -> what the motion drives; the only list of names."""


def make_explorer(
    mode: str, source: MotionSource, *, reference_m_s: float, rate_hz: float
) -> Explorer:
    """Make the explorer of a playback."""
    kind = EXPLORERS[check_name(mode, EXPLORERS, "explore")]
    return kind(source, reference_m_s=reference_m_s, rate_hz=rate_hz)
