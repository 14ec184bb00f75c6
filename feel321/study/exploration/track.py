"""What is kept of an exploration: the hand's track in a file beside the journal, its digest, and a summary."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.files import make_folder, write_text
from feel321.study.exploration.explorer import Explorer, make_explorer
from feel321.study.exploration.motion import MotionSource, check_track
from feel321.types import Samples

if TYPE_CHECKING:
    from feel321.study.session.ports import Playback

MOTION = "motion"
"""Folder of the tracks, beside the journal."""

HEAD = "time_s,x_m,y_m,speed_m_s"


def name_track(number: int) -> str:
    """Name the file of a track.

    Examples
    --------
    >>> name_track(12)
    '00012.csv'
    """
    return f"{number:05d}.csv"


def write_track(folder: Path, track: Samples) -> tuple[int, str]:
    """Write a track, (k, 4), with the next free number, and return that and the file's digest."""
    make_folder(folder, private=True)
    numbers = [int(path.stem) for path in folder.glob("*.csv") if path.stem.isdecimal()]
    path = folder / name_track(number := max(numbers, default=0) + 1)
    rows = (",".join(f"{value:.6f}" for value in row) for row in track.tolist())
    write_text(path, "\n".join([HEAD, *rows]) + "\n", private=True)
    return number, hashlib.sha256(path.read_bytes()).hexdigest()


def describe_track(track: Samples, *, duration_s: float) -> dict[str, float]:
    """Describe a track, (k, 4): its length in m, the mean speed over the playback, reports per s."""
    distance_m = float(np.hypot(*np.diff(track[:, 1:3], axis=0).T).sum()) if len(track) > 1 else 0.0
    lasted_s = max(duration_s, 1e-9)
    return {
        "distance_m": distance_m, "mean_speed_m_s": distance_m / lasted_s,
        "duration_s": duration_s, "reports_per_s": len(track) / lasted_s,
    }  # fmt: skip


def find_latencies(explorer: Explorer, *, first_s: float, rate_hz: float) -> dict[str, float]:
    """Find the latency from motion report to output, in ms; first_s: when the first sample leaves the converter."""
    uses = explorer.uses[: explorer.n_uses]
    late_ms = 1e3 * (first_s + uses[:, 1] / rate_hz - uses[:, 0])
    # What was reported before the playback began was not waiting to be felt.
    late_ms = late_ms[uses[:, 1] > 0]
    if not late_ms.size:
        return {}
    median, most = np.quantile(late_ms, (0.5, 1.0)).tolist()
    return {"motion_latency_ms": median, "motion_latency_ms_max": most}


@dataclass(frozen=True, slots=True)
class Exploration:
    """The exploration of a session: what drives what, and where tracks go.

    modes: protocol -> what the motion drives; folder: of the tracks.
    """

    source: MotionSource
    modes: Mapping[str, str]
    reference_m_s: float
    rate_hz: float
    folder: Path

    def begin(self, protocol: str) -> Explorer | None:
        """Make the explorer of a playback, if its protocol explores."""
        if (mode := self.modes.get(protocol)) is None:
            return None
        return make_explorer(
            mode, self.source, reference_m_s=self.reference_m_s, rate_hz=self.rate_hz
        )

    def finish(self, playback: Playback) -> Playback:
        """Write the track of a playback, and add it; a track that cannot be kept is the playback's error."""
        lasted_s = playback.measured.get("n_samples", 0.0) / self.rate_hz
        try:
            track = check_track(self.source.take())
            number, sha256 = write_track(self.folder, track)
        except (OSError, ValueError) as error:
            return replace(playback, error=playback.error or f"motion: {error}")
        motion = {"file_number": float(number), **describe_track(track, duration_s=lasted_s)}
        return replace(playback, motion=motion, motion_sha256=sha256)
