"""The last line of defence for skin and coil: peak, RMS of any second, and duration, across successive stimuli.

What is within the limits passes bit for bit. What is not is changed sample by sample, so that the outcome does not
depend on how the stream is cut into blocks; what is no number becomes silence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

WINDOW_S = 1.0
"""Over how long the RMS is taken."""

PAUSE_S = 0.1
"""So long an actuator is at rest before the duration of what it does begins anew."""

ROUNDING = 1e-9
"""Share by which a window may exceed its energy: what the rounding of sums of squares adds up to."""


class Limiter:
    """Watches over one actuator.

    Parameters
    ----------
    rate_hz : float
        Sampling rate in Hz.
    peak : float
        Largest magnitude, as a part of the actuator's full scale.
    rms : float
        Largest root mean square over any second, as a part of the same.
    duration_s : float
        Longest vibration without a pause.
    max_frames : int
        Longest block; shorter than a pause.
    """

    def __init__(self, rate_hz: float, *, peak: float, rms: float, duration_s: float, max_frames: int) -> None:
        self._window = round(WINDOW_S * rate_hz)
        self._pause = round(PAUSE_S * rate_hz)
        if max_frames > self._pause:
            raise ValueError(f"got blocks of {max_frames} frames, allowed are {self._pause}: a pause spans blocks")
        self._peak = np.float32(min(peak, 1.0))
        self._energy_limit = float(rms) ** 2 * self._window * (1 + ROUNDING)
        self._longest = round(duration_s * rate_hz)
        self._squares = np.zeros(self._window)  # of the last second, a ring
        self._place = 0
        self._walk = 0.0  # energy of the last second, had nothing been limited since the ring began anew
        self._excess = 0.0  # what was taken from it since
        self._rest = self._pause  # frames since the last one that was not 0
        self._run = 0  # frames since the last pause
        self._new = np.empty(max_frames)
        self._sums = np.empty(max_frames)
        self._rises = np.empty(max_frames)
        self._limited = np.empty(max_frames, dtype=np.float32)
        self._given = np.empty(max_frames, dtype=np.float32)
        self._differs = np.empty(max_frames, dtype=np.bool_)

    def limit(self, samples: NDArray[np.float32]) -> int:
        """Limit the next block in place.

        Parameters
        ----------
        samples : ndarray of float32, shape (n,)
            What the actuator is about to get, in parts of its full scale.

        Returns
        -------
        int
            How many samples were changed.
        """
        given, differs = self._given[: len(samples)], self._differs[: len(samples)]
        np.copyto(given, samples)
        # What is no number passes every comparison, and one of them blinds the sum of squares to all that follows.
        np.isnan(samples, out=differs)
        np.copyto(samples, 0, where=differs)
        self._limit_duration(samples)
        np.clip(samples, -self._peak, self._peak, out=samples)
        start = 0
        while start < len(samples):  # the ring is met in pieces that do not wrap
            piece = samples[start : start + self._window - self._place]
            self._limit_energy(piece)
            start += len(piece)
        np.not_equal(samples, given, out=differs)
        return int(np.count_nonzero(differs))

    def _limit_duration(self, samples: NDArray[np.float32]) -> None:
        n = len(samples)
        moving = self._differs[:n]
        np.not_equal(samples, 0, out=moving)
        first = int(moving.argmax()) if n else 0
        if n == 0 or not moving[first]:
            self._rest += n
            self._run += n
            return
        if self._rest + first >= self._pause:
            self._run = -first
        self._rest = int(moving[::-1].argmax())
        allowed = max(self._longest - self._run, 0)
        self._run += n
        samples[allowed:] = 0

    def _limit_energy(self, samples: NDArray[np.float32]) -> None:
        """Give each sample what the last second leaves of the energy.

        The energy of the last second is a walk E(i) = min(E(i-1) + d(i), limit), d being what is new less what is a
        second old. That is the free walk S less the running maximum of what S exceeds the limit by [1]_; each rise of
        the maximum is taken from the sample where it happens.

        References
        ----------
        .. [1] Lindley, D. V. (1952). The theory of queues with a single server. doi:10.1017/S0305004100027638
        """
        n = len(samples)
        new, sums, old = self._new[:n], self._sums[:n], self._squares[self._place : self._place + n]
        np.copyto(new, samples)  # first, or the product would be made by way of a buffer
        np.multiply(new, new, out=new)
        np.subtract(new, old, out=sums)
        sums[0] += self._walk
        np.cumsum(sums, out=sums)
        self._walk = float(sums[-1])
        if sums.max() - self._energy_limit > self._excess:
            self._take_excess(samples, new=new, sums=sums)
        np.copyto(old, new)
        self._place += n
        if self._place == self._window:  # once per round the sum is taken afresh, or its rounding would grow for hours
            self._place, self._walk, self._excess = 0, float(self._squares.sum()), 0.0

    def _take_excess(
        self, samples: NDArray[np.float32], *, new: NDArray[np.float64], sums: NDArray[np.float64]
    ) -> None:
        n = len(samples)
        excess, rises, limited, rising = sums, self._rises[:n], self._limited[:n], self._differs[:n]
        np.subtract(sums, self._energy_limit, out=excess)
        excess[0] = max(excess[0], self._excess)
        np.maximum.accumulate(excess, out=excess)
        np.subtract(excess[1:], excess[:-1], out=rises[1:])
        rises[0] = excess[0] - self._excess
        self._excess = float(excess[-1])
        np.subtract(new, rises, out=new)
        np.maximum(new, 0, out=new)
        np.greater(rises, 0, out=rising)
        np.sqrt(new, out=rises)
        np.copyto(limited, rises, casting="same_kind")
        np.copysign(limited, samples, out=limited)
        np.copyto(samples, limited, where=rising)
