"""Everything that a stream's callback does, without a stream: each block of samples, from buffers that are there.

Frames are counted from the stream's begin. A stimulus that was asked for is scheduled when the next block is filled,
so its onset is known to the sample. What is filled allocates nothing that lasts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.actuator.limiter import PAUSE_S, Limiter
from study.actuator.masking import LOOP_S, Masker, make_pink

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from study.actuator.rig import Rig

BLOCK_FRAMES = 1024
"""Longer blocks are filled in pieces of this many frames."""

PREROLL_S = 0.25
"""So long a stream is silent before anything is scheduled: devices swallow what comes first."""

STOP_S = 0.005
"""How long a vibration takes to end that is stopped, but no longer than a block: cut off at once it would knock."""

NOT_SCHEDULED = -1


@dataclass(slots=True)
class Cue:
    """One playback, from its request to its end; the callback writes it, everybody may read it.

    Parameters
    ----------
    sound : ndarray of float32, shape (n_samples, channels)
        What is played.
    gap_frames : int
        Silence before it, at least.
    onset_frame : int
        Frame of the first sample; `NOT_SCHEDULED` until a block was filled.
    n_played : int
        How many samples were played, those of a stop included.
    clipped : int
        How many samples the limiter changed.
    is_stopping : bool
        Whether it was stopped.
    is_over : bool
        Whether nothing more will come of it.
    """

    sound: NDArray[np.float32]
    gap_frames: int
    onset_frame: int = NOT_SCHEDULED
    n_played: int = 0
    clipped: int = 0
    is_stopping: bool = False
    is_over: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether every sample was played as it is."""
        return self.n_played == len(self.sound)


class Mixer:
    """Mixes what goes to a rig's channels.

    Parameters
    ----------
    rig : Rig
        The rig.
    sounds : mapping of str to ndarray of float32, shape (n_samples, channels)
        What can be played: rendered stimuli, by their ids.
    rate_hz : float
        Sampling rate in Hz.
    preroll_s : float
        Silence at the begin of the stream, in s.

    Attributes
    ----------
    frame : int
        How many frames were filled.
    """

    def __init__(
        self, rig: Rig, sounds: Mapping[str, NDArray[np.float32]], *, rate_hz: float, preroll_s: float = PREROLL_S
    ) -> None:
        self.frame = 0
        self._rate_hz = rate_hz
        self._sounds = sounds
        self._preroll = round(preroll_s * rate_hz)
        self._block = min(BLOCK_FRAMES, round(PAUSE_S * rate_hz))
        self._limiters = _make_limiters(rig, rate_hz=rate_hz, max_frames=self._block)
        self._masker = _make_masker(rig, rate_hz=rate_hz, max_frames=self._block)
        self._sync = rig.sync
        self._sync_frames = max(round(rig.sync.duration_s * rate_hz), 1) if rig.sync else 0
        self._fade = _Fade(max(round(STOP_S * rate_hz), 1), columns=[column for column, _ in self._limiters])
        self._waiting: deque[Cue] = deque()  # its ends are safe to use from two threads
        self._latest: Cue | None = None
        self._cue: Cue | None = None

    def start(self, stimulus_id: str, *, gap_s: float) -> Cue:
        """Ask for a stimulus; what plays is stopped.

        Parameters
        ----------
        stimulus_id : str
            Which.
        gap_s : float
            Silence before it, in s; longer where masking has to come first.

        Returns
        -------
        Cue
            What becomes of it.

        Raises
        ------
        ValueError
            If it was not loaded.
        """
        if stimulus_id not in self._sounds:
            raise ValueError(f"got stimulus {stimulus_id!r}, allowed are the {len(self._sounds)} that were loaded")
        self.stop()
        self._latest = Cue(self._sounds[stimulus_id], gap_frames=round(gap_s * self._rate_hz))
        self._waiting.append(self._latest)
        return self._latest

    @property
    def is_playing(self) -> bool:
        """Whether samples of the stimulus that was started last, or of its gap, are still to be filled."""
        return self._latest is not None and not self._latest.is_over

    def stop(self) -> None:
        """Let what plays fall silent within the next block."""
        if self._latest is not None:
            self._latest.is_stopping = True

    def reset(self) -> None:
        """Forget what plays and what waits, for a device that begins anew; not to be called while one runs.

        What was cut off with the old device is not to fade out on the new one. The limiters keep what they know: skin
        and coil do not begin anew.
        """
        for cue in (self._cue, *self._waiting):
            if cue is not None:
                cue.is_over = True
        self._waiting.clear()
        if self._masker:
            self._masker.silence()

    def fill(self, out: NDArray[np.float32]) -> None:
        """Fill the stream's next block.

        Parameters
        ----------
        out : ndarray of float32, shape (n, channels)
            The block; whatever stands in it is overwritten.
        """
        for start in range(0, len(out), self._block):
            self._fill(out[start : start + self._block])

    def _fill(self, block: NDArray[np.float32]) -> None:
        block.fill(0)
        cue = self._take()
        end = self._play(cue, block) if cue else None
        if self._masker:
            if end is not None:
                self._masker.release(end)
            self._masker.fill(block, self.frame)
        n_changed = 0
        for column, limiter in self._limiters:  # after all that is written, so that nothing comes past them
            n_changed += limiter.limit(block[:, column])
        self.frame += len(block)
        if cue:
            cue.clipped += n_changed
            cue.is_over = end is not None  # last of all: whoever reads it reads the rest

    def _take(self) -> Cue | None:
        """Find what plays now; take up what waits if nothing does."""
        if self._cue is not None and not self._cue.is_over:
            return self._cue
        self._cue = None
        while self._cue is None and self._waiting and self.frame >= self._preroll:
            cue = self._waiting.popleft()
            if cue.is_stopping:
                cue.is_over = True
            else:
                cue.onset_frame = self._schedule(cue.gap_frames)
                self._cue = cue
        return self._cue

    def _schedule(self, gap_frames: int) -> int:
        return self._masker.cover(self.frame, gap_frames) if self._masker else self.frame + gap_frames

    def _play(self, cue: Cue, block: NDArray[np.float32]) -> int | None:
        """Write what this block has of a stimulus and its sync pulse; return the frame after its end if it ends."""
        is_stopping = cue.is_stopping  # once: another thread sets it
        first = max(cue.onset_frame - self.frame, 0)
        if is_stopping and not cue.n_played:
            cue.onset_frame = NOT_SCHEDULED
            return self.frame
        piece = block[first:]
        piece = piece[: len(cue.sound) - cue.n_played]
        np.copyto(piece, cue.sound[cue.n_played : cue.n_played + len(piece)])
        if self._sync:
            pulse = block[first : max(cue.onset_frame + self._sync_frames - self.frame, 0)]
            pulse[:, self._sync.channel - 1] = self._sync.level
        cue.n_played += self._fade.end(piece) if is_stopping else len(piece)
        is_over = is_stopping or cue.is_complete
        return self.frame + first + len(piece) if is_over else None


class _Fade:
    """How a vibration ends that is stopped."""

    def __init__(self, n_frames: int, *, columns: list[int]) -> None:
        self._steps = np.arange(1, n_frames + 1, dtype=np.float32)
        self._gain = np.empty(n_frames, dtype=np.float32)
        self._columns = columns

    def end(self, piece: NDArray[np.float32]) -> int:
        """Let it end in this piece; give how many samples are left, the last of the fade being 0."""
        n = min(len(piece), len(self._steps))
        gain = self._gain[:n]
        np.multiply(self._steps[:n], np.float32(-1 / n), out=gain)
        np.add(gain, np.float32(1), out=gain)
        gain[-1:] = 0
        for column in self._columns:
            np.multiply(piece[:n, column], gain, out=piece[:n, column])
            piece[n:, column] = 0
        return n - 1


def _make_limiters(rig: Rig, *, rate_hz: float, max_frames: int) -> list[tuple[int, Limiter]]:
    limits = rig.limits
    return [
        (
            actuator.channel - 1,
            Limiter(
                rate_hz,
                peak=limits.peak_m_s2 / actuator.full_scale_m_s2,
                rms=limits.rms_m_s2 / actuator.full_scale_m_s2,
                duration_s=limits.duration_s,
                max_frames=max_frames,
            ),
        )
        for actuator in rig.actuators
    ]


def _make_masker(rig: Rig, *, rate_hz: float, max_frames: int) -> Masker | None:
    masking = rig.masking
    if masking is None:
        return None
    noise = make_pink(np.random.default_rng(masking.seed), n_samples=round(LOOP_S * rate_hz), rate_hz=rate_hz)
    return Masker(
        (masking.rms * noise).astype(np.float32),
        columns=[channel - 1 for channel in masking.channels],
        ramp_frames=round(masking.ramp_s * rate_hz),
        lead_frames=round(masking.lead_s * rate_hz),
        max_frames=max_frames,
    )
