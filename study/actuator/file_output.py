"""Actuators for machines without any: each playback becomes a WAV file, in the time that it would take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from study.actuator.delivered import write_delivered
from study.actuator.mixer import Mixer
from study.actuator.output import Delivery
from study.actuator.rig import FILE_DEVICE, identify

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.manifest import Stimulus
    from study.actuator.mixer import Cue
    from study.actuator.output import Clock
    from study.actuator.rig import Rig

BLOCK_FRAMES = 512
"""What a stop waits for at most, as with a device."""


@dataclass(frozen=True, slots=True)
class _Playback:
    """What is to be rendered once it is known how long it was let play."""

    cue: Cue
    begin_s: float
    first_frame: int
    gap_s: float


class FileOutput:
    """Renders each playback to a numbered WAV file; the journal's `file_number` tells which.

    Numbers, not names: the experimenter is not to read off the files what was played.

    Parameters
    ----------
    rig : Rig
        The rig.
    sounds : mapping of str to ndarray of float32, shape (n_samples, channels)
        Rendered stimuli, by their ids.
    rate_hz : float
        Sampling rate in Hz.
    folder : Path
        Where to write; made if missing. Files that are there are kept.
    clock : callable
        The session's clock.
    """

    def __init__(
        self,
        rig: Rig,
        sounds: Mapping[str, NDArray[np.float32]],
        *,
        rate_hz: float,
        folder: Path,
        clock: Clock,
    ) -> None:
        self._rig = rig
        self._rate_hz = rate_hz
        self._folder = folder
        self._clock = clock
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=0.0)
        self._block = np.zeros((BLOCK_FRAMES, rig.n_channels), dtype=np.float32)
        self._blocks: list[NDArray[np.float32]] = []
        self._playback: _Playback | None = None

    @property
    def identity(self) -> Mapping[str, Any]:
        """What plays: the rig, as a file."""
        return {
            "rig": identify(self._rig),
            "device": FILE_DEVICE,
            "rate_hz": self._rate_hz,
            "channels": self._rig.n_channels,
        }

    def start(self, stimulus: Stimulus, *, gap_s: float) -> None:
        """Begin a playback.

        Parameters
        ----------
        stimulus : Stimulus
            What to play.
        gap_s : float
            Silence before it, in s; longer where masking has to come first.
        """
        cue = self._mixer.start(stimulus.stimulus_id, gap_s=gap_s)
        self._blocks = []
        self._playback = _Playback(cue, self._clock(), self._mixer.frame, gap_s)

    @property
    def is_playing(self) -> bool:
        """Whether the playback is not over yet; time passes, blocks come to be."""
        self._catch_up()
        return self._mixer.is_playing

    def stop(self) -> None:
        """End the playback with the next block."""
        self._catch_up()
        self._mixer.stop()
        if self._mixer.is_playing:
            self._fill()

    def collect(self) -> Delivery:
        """Write the file of the playback, and tell what became of it.

        Returns
        -------
        Delivery
            What became of it; where the file could not be written, `error` says why.

        Raises
        ------
        ValueError
            If nothing was started, or it still plays.
        """
        playback = self._playback
        if playback is None or not playback.cue.is_over:
            raise ValueError("got no playback that is over; start one and wait until is_playing is False")
        cue = playback.cue
        onset_s = playback.begin_s + (cue.onset_frame - playback.first_frame) / self._rate_hz
        error, measured = "", {"n_samples": float(cue.n_played)}
        try:
            samples = np.concatenate(self._blocks).T
            measured["file_number"] = float(write_delivered(self._folder, samples, rate_hz=self._rate_hz))
        except OSError as problem:
            error = str(problem)
        return Delivery(
            requested_s=playback.begin_s + playback.gap_s,
            onset_s=onset_s if cue.n_played else None,
            clipped=cue.clipped,
            completed=cue.is_complete,
            error=error,
            measured=measured,
        )

    def _catch_up(self) -> None:
        """Fill the blocks that a device would have played by now."""
        while self._mixer.is_playing and self._playback and self._elapsed_frames(self._playback) >= BLOCK_FRAMES:
            self._fill()

    def _elapsed_frames(self, playback: _Playback) -> float:
        filled = self._mixer.frame - playback.first_frame
        return (self._clock() - playback.begin_s) * self._rate_hz - filled

    def _fill(self) -> None:
        self._mixer.fill(self._block)
        self._blocks.append(self._block.copy())
