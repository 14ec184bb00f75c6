"""The last line of defence for skin and coil: peak, RMS of any second, and duration, across successive stimuli.

What is within the limits passes bit for bit. What is not is changed sample by sample, so that the outcome does not
depend on how the stream is cut into blocks.
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
        self._energy = 0.0
        self._rest = self._pause  # frames since the last one that was not 0
        self._run = 0  # frames since the last pause
        self._new = np.empty(max_frames)
        self._sums = np.empty(max_frames)
        self._limited = np.empty(max_frames, dtype=np.float32)
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
        n_changed = self._limit_duration(samples)
        n_changed += self._limit_peak(samples)
        start = 0
        while start < len(samples):  # the ring is met in pieces that do not wrap
            piece = samples[start : start + self._window - self._place]
            n_changed += self._limit_energy(piece)
            start += len(piece)
        return n_changed

    def _limit_duration(self, samples: NDArray[np.float32]) -> int:
        n = len(samples)
        moving = self._differs[:n]
        np.not_equal(samples, 0, out=moving)
        first = int(moving.argmax()) if n else 0
        if n == 0 or not moving[first]:
            self._rest += n
            self._run += n
            return 0
        if self._rest + first >= self._pause:
            self._run = -first
        self._rest = int(moving[::-1].argmax())
        allowed = max(self._longest - self._run, 0)
        self._run += n
        if allowed >= n:
            return 0
        samples[allowed:] = 0
        return int(np.count_nonzero(moving[allowed:]))

    def _limit_peak(self, samples: NDArray[np.float32]) -> int:
        limited, differs = self._limited[: len(samples)], self._differs[: len(samples)]
        np.clip(samples, -self._peak, self._peak, out=limited)
        np.not_equal(samples, limited, out=differs)
        n_changed = int(np.count_nonzero(differs))
        if n_changed:
            np.copyto(samples, limited)
        return n_changed

    def _limit_energy(self, samples: NDArray[np.float32]) -> int:
        n = len(samples)
        new, sums, old = self._new[:n], self._sums[:n], self._squares[self._place : self._place + n]
        np.multiply(samples, samples, out=new, dtype=np.float64)
        np.subtract(new, old, out=sums)
        sums[0] += self._energy
        np.cumsum(sums, out=sums)
        n_changed = 0
        if sums.max() > self._energy_limit:
            n_changed = self._limit_each(samples, new=new, old=old)
        else:
            self._energy = float(sums[-1])
        np.copyto(old, new)
        self._place += n
        if self._place == self._window:  # once per round the sum is taken afresh, or its rounding would grow for hours
            self._place, self._energy = 0, float(self._squares.sum())
        return n_changed

    def _limit_each(self, samples: NDArray[np.float32], *, new: NDArray[np.float64], old: NDArray[np.float64]) -> int:
        """Give each sample what the last second leaves of the energy; `new` becomes the squares of what is left."""
        n_changed, energy = 0, self._energy
        for place in range(len(samples)):
            left = max(self._energy_limit - (energy - old[place]), 0.0)
            if new[place] > left:
                # Towards zero, or rounding to float32 could exceed what is left.
                samples[place] = np.nextafter(np.copysign(np.float32(left**0.5), samples[place]), np.float32(0))
                new[place] = float(samples[place]) ** 2
                n_changed += 1
            energy += new[place] - old[place]
        self._energy = float(energy)
        return n_changed
