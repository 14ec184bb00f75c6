"""What a sensor measured of each playback, written to numbered WAV files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.actuator.delivered import write_delivered

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from study.actuator.rig import Rig
    from study.actuator.take import Take

    Samples = NDArray[np.float32]

BEYOND_S = 5.0
"""Longest recording beyond the stimulus; two latencies of 2 s fit in."""


class Recorder:
    """Room for what a sensor measures, and where it goes; without a sensor there is neither.

    Parameters
    ----------
    rig : Rig
        The rig.
    sounds : mapping of str to ndarray of float32, shape (n_samples, channels)
        What will be played.
    rate_hz : float
        Sampling rate in Hz.
    folder : Path
        Where recordings go.

    Attributes
    ----------
    room : ndarray of float32, shape (n,), or None
        As long as the longest recording.
    """

    def __init__(self, rig: Rig, sounds: Mapping[str, Samples], *, rate_hz: float, folder: Path) -> None:
        self._sensor = rig.sensor
        self._rate_hz = rate_hz
        self._folder = folder
        longest = max((len(sound) for sound in sounds.values()), default=0)
        n = longest + round(BEYOND_S * rate_hz)
        self.room: Samples | None = None if rig.sensor is None else np.zeros(n, dtype=np.float32)

    def keep(self, take: Take) -> dict[str, float]:
        """Write what was measured, in m/s^2, from the frame on in which the onset was sent.

        So recordings of one session are aligned to the sample: the onset stands at the same sample in all of them,
        which is the way there and back and is measured by doctor. They are not cut there by the times that the device
        tells of its input, which can be wrong by much more (10 ms and, at a stream's begin, 0.4 s were seen).

        Parameters
        ----------
        take : Take
            The playback; it is over.

        Returns
        -------
        dict of str to float
            `file_number`; `sensor_onset_sample`, where the onset stands in the file if what the device says of its
            times is true; `sensor_gaps`, how often input was lost. Empty if there is nothing.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        if self._sensor is None or not len(take.sensed):
            return {}
        samples = take.sensed * np.float32(self._sensor.full_scale_m_s2)
        return {
            "file_number": float(write_delivered(self._folder, samples, rate_hz=self._rate_hz)),
            "sensor_onset_sample": float(round(take.sensor_latency_s * self._rate_hz)),
            "sensor_gaps": float(take.n_sensor_gaps),
        }
