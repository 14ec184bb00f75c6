"""Outputs: play a stimulus, stop it, report what was delivered; and the output into numbered WAV files.

A stream to a device and a rendering to files are both outputs. All times are in s on the session's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from feel321.stimuli.wav import write_wav
from feel321.study.actuator.mixer import Mixer
from feel321.study.actuator.rig import FILE_DEVICE, identify
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.actuator.mixer import Cue
    from feel321.study.actuator.rig import Rig

    Sounds = Mapping[str, NDArray[np.float32]]

Clock = Callable[[], float]
"""Gives the time in s since the session began; time between its openings does not count."""


class Output(Protocol):
    """Plays stimuli, one at a time."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """Rig, device, rate and channels, for the journal's header; compared when a session is resumed."""

    def start(self, stimulus: Stimulus, *, gap_s: float) -> None:
        """Schedule silence, then a stimulus, and return at once."""

    @property
    def is_playing(self) -> bool:
        """Whether the stimulus that was started last is not over yet, its silence included."""

    def stop(self) -> None:
        """Fall silent within one block; the stimulus is then not completed."""

    def collect(self) -> Playback:
        """Report what became of the stimulus that was started last, once it no longer plays."""


def write_delivered(folder: Path, samples: ArrayLike, *, rate_hz: float) -> int:
    """Write samples to a WAV file with the next free number; a name would tell the experimenter what was played."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [int(path.stem) for path in folder.glob("*.wav") if path.stem.isdecimal()]
    number = max(numbers, default=0) + 1
    write_wav(folder / f"{number:04}.wav", samples, rate_hz)
    return number


BLOCK_FRAMES = 512  # longest delay of a stop, as with a device


class FileOutput:
    """For machines without actuators: each playback becomes a WAV file, in the time that it would take.

    The journal's `file_number` says which file; sounds: (n_samples, channels).
    """

    def __init__(
        self, rig: Rig, sounds: Sounds, *, rate_hz: float, folder: Path, clock: Clock
    ) -> None:
        self._rig, self._rate_hz, self._folder, self._clock = rig, rate_hz, folder, clock
        self._mixer = Mixer(rig, sounds, rate_hz=rate_hz, preroll_s=0.0)
        self._block = np.zeros((BLOCK_FRAMES, rig.n_channels), dtype=np.float32)
        self._blocks: list[NDArray[np.float32]] = []
        self._cue: Cue | None = None
        self._begin_s = self._requested_s = 0.0
        self._first_frame = 0

    @property
    def identity(self) -> Mapping[str, Any]:
        """The rig, with files in place of its device."""
        return {
            "rig": identify(self._rig),
            "device": FILE_DEVICE,
            "rate_hz": self._rate_hz,
            "channels": self._rig.n_channels,
        }

    def start(self, stimulus: Stimulus, *, gap_s: float) -> None:
        """Begin a playback."""
        self._cue = self._mixer.start(stimulus.stimulus_id, gap_s=gap_s)
        self._blocks = []
        self._begin_s, self._first_frame = self._clock(), self._mixer.frame
        self._requested_s = self._begin_s + gap_s

    @property
    def is_playing(self) -> bool:
        """Whether the playback is not over yet; fills the blocks that a device would have played by now."""
        while self._mixer.is_playing:
            filled = self._mixer.frame - self._first_frame
            if (self._clock() - self._begin_s) * self._rate_hz - filled < BLOCK_FRAMES:
                return True
            self._fill()
        return False

    def stop(self) -> None:
        """End the playback with the next block."""
        if self.is_playing:
            self._mixer.stop()
            self._fill()

    def collect(self) -> Playback:
        """Write the file of the playback, and report what became of it."""
        cue = self._cue
        if cue is None or not cue.is_over:
            raise ValueError("no playback is over; start one and wait until is_playing is False")
        onset_s = self._begin_s + (cue.onset_frame - self._first_frame) / self._rate_hz
        error, measured = "", {"n_samples": float(cue.n_played)}
        try:
            samples = np.concatenate(self._blocks).T
            number = write_delivered(self._folder, samples, rate_hz=self._rate_hz)
            measured["file_number"] = float(number)
        except OSError as problem:
            error = str(problem)
        return Playback(
            requested_s=self._requested_s,
            onset_s=onset_s if cue.n_played else None,
            clipped=cue.clipped,
            completed=cue.is_complete,
            error=error,
            measured=measured,
        )

    def _fill(self) -> None:
        self._mixer.fill(self._block)
        self._blocks.append(self._block.copy())
