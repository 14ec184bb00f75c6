"""Outputs: play a stimulus, stop it, report what was delivered; and the output into files.

A stream to a device and a rendering to files are both outputs. All times are in s on the session's clock.

Numbers, not names: the experimenter is not to read off the files what was played.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from feel321.stimuli.wav import write_wav
from feel321.study.actuator.mixer import Mixer
from feel321.study.actuator.rig import FILE_DEVICE, identify

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.actuator.mixer import Cue
    from feel321.study.actuator.rig import Rig

# What a screen needs of the actuators: play a stimulus, stop it, say what became of it.

Clock = Callable[[], float]
"""Tells the time in s since the session began, with what earlier openings of it took."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """What became of one stimulus."""

    requested_s: float
    onset_s: float | None
    underruns: int = 0
    clipped: int = 0
    completed: bool = True
    error: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)


class Output(Protocol):
    """Whatever plays stimuli, one at a time."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """What plays: rig, device, rate, channels; stands in the journal's header and is compared on resume."""

    def start(self, stimulus: Stimulus, *, gap_s: float) -> None:
        """Schedule silence, then a stimulus, and return at once."""

    @property
    def is_playing(self) -> bool:
        """Whether the stimulus that was started last is not over yet, its silence included."""

    def stop(self) -> None:
        """Fall silent within one block; what was playing was then not completed."""

    def collect(self) -> Delivery:
        """Tell what became of the stimulus that was started last, once it no longer plays."""


# Numbered WAV files of what was delivered.


def write_delivered(folder: Path, samples: ArrayLike, *, rate_hz: float) -> int:
    """Write samples under the next free number.

    samples: (n,).
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [int(path.stem) for path in folder.glob("*.wav") if path.stem.isdecimal()]
    number = max(numbers, default=0) + 1
    write_wav(folder / f"{number:04}.wav", samples, rate_hz)
    return number


# Actuators for machines without any: each playback becomes a WAV file, in the time that it would take.

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

    sounds: (n_samples, channels).
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
        """Begin a playback."""
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
        """Write the file of the playback, and tell what became of it."""
        playback = self._playback
        if playback is None or not playback.cue.is_over:
            raise ValueError(
                "got no playback that is over; start one and wait until is_playing is False"
            )
        cue = playback.cue
        onset_s = playback.begin_s + (cue.onset_frame - playback.first_frame) / self._rate_hz
        error, measured = "", {"n_samples": float(cue.n_played)}
        try:
            samples = np.concatenate(self._blocks).T
            measured["file_number"] = float(
                write_delivered(self._folder, samples, rate_hz=self._rate_hz)
            )
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
        while (
            self._mixer.is_playing
            and self._playback
            and self._elapsed_frames(self._playback) >= BLOCK_FRAMES
        ):
            self._fill()

    def _elapsed_frames(self, playback: _Playback) -> float:
        filled = self._mixer.frame - playback.first_frame
        return (self._clock() - playback.begin_s) * self._rate_hz - filled

    def _fill(self) -> None:
        self._mixer.fill(self._block)
        self._blocks.append(self._block.copy())
