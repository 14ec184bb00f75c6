"""Skeleton: see the docstrings; being filled in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from study.actuator.rig import Rig


@dataclass(slots=True)
class Cue:
    """One playback, from its request to its end. Frames are counted since the stream began.

    onset_frame is -1 until the first `fill` after `start` has scheduled it.
    """

    gap_frames: int
    n_samples: int
    onset_frame: int = -1
    n_played: int = 0
    clipped: int = 0
    is_stopping: bool = False
    is_over: bool = False


class Mixer:
    """What the callback does, without a device.

    Mixer(rig, sounds, rate_hz=48000); sounds: stimulus_id -> (n, rig.n_channels) float32 (render.render_set).
    """

    frame: int  # frames filled since the stream began

    def __init__(self, rig: Rig, sounds: Mapping[str, NDArray[np.float32]], *, rate_hz: float) -> None: ...

    def start(self, stimulus_id: str, *, gap_s: float) -> Cue: ...  # type: ignore[empty-body]

    @property
    def is_playing(self) -> bool: ...  # type: ignore[empty-body]

    def stop(self) -> None: ...

    def fill(self, out: NDArray[np.float32]) -> None: ...
