"""What a stream notices about one playback, block by block: when it really began and ended, and what went wrong.

All times are the device's own, in s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from study.actuator.mixer import Cue

SENSOR_TAIL_S = 0.05
"""So long after the vibration the sensor is listened to: what hangs on an actuator rings on."""


@dataclass(frozen=True, slots=True)
class Block:
    """What a stream says of itself as it asks for a block.

    Parameters
    ----------
    now_s : float
        When it was asked for.
    dac_s : float
        When its first frame will leave the converter.
    adc_s : float
        When the first frame that came in with it entered the converter; 0 where nothing does.
    has_run_dry : bool
        Whether the output stood still before it.
    has_lost_input : bool
        Whether input was lost before it.
    """

    now_s: float
    dac_s: float
    adc_s: float = 0.0
    has_run_dry: bool = False
    has_lost_input: bool = False


class Take:
    """The record of one playback; the callback writes it, the session reads it once it is out.

    Parameters
    ----------
    rate_hz : float
        Sampling rate in Hz.
    latency_s : float
        What the device says it takes from a block to its sound, and from the sensor back if there is one, in s.
    sensor : ndarray of float32, shape (n,), optional
        Where what the sensor measures goes; None without a sensor.

    Attributes
    ----------
    cue : Cue or None
        What is played; None until the mixer was asked.
    onset_s, end_s : float or None
        When the first sample left the converter, and when the one after the last did.
    is_out : bool
        Whether everything has left the converter.
    n_blocks, n_underruns, n_sensor_gaps : int
        How many blocks there were, and how many of them after a fault.
    longest_s : float
        The longest that the callback took.
    sensor_latency_s : float
        From the block of the onset to the block in which it should come back, as the device tells its times.
    n_sensed : int
        How many samples of the sensor are there, from the block of the onset on.
    """

    def __init__(self, rate_hz: float, latency_s: float, *, sensor: NDArray[np.float32] | None = None) -> None:
        self.cue: Cue | None = None
        self.onset_s: float | None = None
        self.end_s: float | None = None
        self.is_out = False
        self.n_blocks = 0
        self.n_underruns = 0
        self.n_sensor_gaps = 0
        self.longest_s = 0.0
        self.sensor_latency_s = 0.0
        self.n_sensed = 0
        self._rate_hz = rate_hz
        self._sensor = sensor
        # Some host interfaces tell no times: then what the device says of itself counts, twice to be safe.
        self._late_frames = round(2 * latency_s * rate_hz)
        # Times that are told of inputs are less true than those of outputs, so the sensor is listened to by frames.
        self._sensed_frames = round((latency_s + SENSOR_TAIL_S) * rate_hz)
        self._end_frame = 0

    def note(self, block: Block, *, frame: int) -> None:
        """Note a block that the mixer has filled.

        Parameters
        ----------
        block : Block
            What the stream said of it.
        frame : int
            Its first frame, counted since the stream's begin.
        """
        self.n_blocks += 1
        self.n_underruns += block.has_run_dry
        self.n_sensor_gaps += block.has_lost_input
        if self.cue is None:
            return
        if self.end_s is not None:
            n_since = frame - self._end_frame
            is_heard = block.now_s >= self.end_s or n_since >= self._late_frames
            self.is_out = is_heard and (self._sensor is None or n_since >= self._sensed_frames)
            return
        if self.onset_s is None and self.cue.n_played:
            self.onset_s = block.dac_s + (self.cue.onset_frame - frame) / self._rate_hz
            self.sensor_latency_s = block.dac_s - block.adc_s
        if self.cue.is_over:
            self._end_frame = self.cue.onset_frame + self.cue.n_played if self.cue.n_played else frame
            self.end_s = block.dac_s + (self._end_frame - frame) / self._rate_hz

    def sense(self, samples: NDArray[np.float32], *, frame: int) -> None:
        """Keep what the sensor measured since the frame of the onset went out; it comes back later.

        Parameters
        ----------
        samples : ndarray of float32, shape (n,)
            What the sensor's channel brought with a block.
        frame : int
            The block's first frame.
        """
        if self._sensor is None or self.cue is None or self.onset_s is None:
            return
        first = max(self.cue.onset_frame - frame, 0)
        piece = samples[first : first + len(self._sensor) - self.n_sensed]
        self._sensor[self.n_sensed : self.n_sensed + len(piece)] = piece
        self.n_sensed += len(piece)

    @property
    def sensed(self) -> NDArray[np.float32]:
        """What the sensor measured, in fractions of its full scale."""
        return np.zeros(0, dtype=np.float32) if self._sensor is None else self._sensor[: self.n_sensed]
