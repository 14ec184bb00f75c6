"""Pink noise on headphones, so that a vibration is felt and not heard: it begins before and ends after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

LOOP_S = 20.0
"""How long the noise is before it repeats: too long for a repetition to be heard."""

LOWEST_HZ = 20.0
"""Below this nothing is heard."""

NEVER = 2**62
"""A frame that no stream reaches."""


def make_pink(rng: np.random.Generator, *, n_samples: int, rate_hz: float) -> NDArray[np.float64]:
    """Make Gaussian noise whose power falls by 10 dB per decade, from 20 Hz to half the rate.

    It is made of whole periods, so that it can be repeated without a click.

    Parameters
    ----------
    rng : Generator
        Source of its phases and amplitudes.
    n_samples : int
        How long it is to be.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        Noise with a root mean square of 1.

    References
    ----------
    .. [1] Timmer, J. and König, M. (1995). On generating power law noise. Astronomy and Astrophysics 300, 707-710.
    """
    frequencies = np.fft.rfftfreq(n_samples, 1 / rate_hz)
    audible = frequencies >= LOWEST_HZ
    spectrum = np.zeros(len(frequencies), dtype=np.complex128)
    parts = rng.standard_normal((2, int(audible.sum())))
    spectrum[audible] = (parts[0] + 1j * parts[1]) / np.sqrt(frequencies[audible])
    noise = np.fft.irfft(spectrum, n_samples)
    return np.asarray(noise / np.sqrt(np.mean(noise**2)))


class Masker:
    """Noise that comes and goes in ramps, at frames of the stream.

    Parameters
    ----------
    noise : ndarray of float32, shape (n_samples,)
        What is repeated; longer than a block.
    columns : list of int
        The headphones' channels, from 0.
    ramp_frames : int
        How long it takes to come and to go.
    lead_frames : int
        From the begin of its coming to the onset, and from the end of a vibration to the end of its going.
    max_frames : int
        Longest block.
    """

    def __init__(
        self,
        noise: NDArray[np.float32],
        *,
        columns: list[int],
        ramp_frames: int,
        lead_frames: int,
        max_frames: int,
    ) -> None:
        self._noise = noise
        self._columns = columns
        self._lead = lead_frames
        # Half a cosine has no edge that could be heard; it ends at exactly 1.
        top = max(ramp_frames, 1)
        self._ramp = (0.5 - 0.5 * np.cos(np.pi * np.arange(top + 1) / top)).astype(np.float32)
        self._block = np.zeros(max_frames, dtype=np.float32)
        self._gain = np.zeros(max_frames, dtype=np.float32)
        self._top = top
        self._step = 0  # how far up the ramp
        self._is_up = False  # where it is going
        self._up_at, self._down_at = NEVER, NEVER

    def cover(self, frame: int, gap_frames: int) -> int:
        """Find the onset of a vibration that is asked for, and be there in time.

        Parameters
        ----------
        frame : int
            Where the stream is.
        gap_frames : int
            From there to the onset, at least.

        Returns
        -------
        int
            The frame of the onset: later than asked for where the noise has to come first.
        """
        is_heard = self._is_up and self._step == self._top and self._down_at > frame
        onset = frame + (gap_frames if is_heard else max(gap_frames, self._lead))
        begin = onset - self._lead
        if self._is_up and begin <= self._down_at:
            self._down_at = NEVER
        else:
            self._up_at = begin
        return onset

    def release(self, end: int) -> None:
        """Go after a vibration.

        Parameters
        ----------
        end : int
            The frame after its last one.
        """
        if self._up_at >= end:  # it never began, and leaves no noise to come
            self._up_at = NEVER
        is_heard = self._is_up or self._up_at < NEVER
        self._down_at = max(end + self._lead - self._top, end) if is_heard else NEVER

    def silence(self) -> None:
        """Be silent at once, for a stream that begins anew; what was to come does not."""
        self._step, self._is_up = 0, False
        self._up_at, self._down_at = NEVER, NEVER

    def fill(self, block: NDArray[np.float32], frame: int) -> None:
        """Write the noise into the headphones' channels of the next block.

        Parameters
        ----------
        block : ndarray of float32, shape (n, channels)
            The block.
        frame : int
            The frame of its first sample.
        """
        n = len(block)
        if not self._is_up and self._step == 0 and self._up_at >= frame + n:
            return
        self._shape(self._gain[:n], frame)
        noise, start = self._block[:n], frame % len(self._noise)
        whole = min(n, len(self._noise) - start)
        noise[:whole] = self._noise[start : start + whole]
        noise[whole:] = self._noise[: n - whole]
        np.multiply(noise, self._gain[:n], out=noise)
        for column in self._columns:
            block[:, column] = noise

    def _shape(self, gain: NDArray[np.float32], frame: int) -> None:
        place = 0
        while place < len(gain):
            now = frame + place
            if now >= self._up_at:
                self._is_up, self._up_at = True, NEVER
            if now >= self._down_at:
                self._is_up, self._down_at = False, NEVER
            piece = gain[place : place + min(self._up_at, self._down_at) - now]
            self._climb(piece)
            place += len(piece)

    def _climb(self, gain: NDArray[np.float32]) -> None:
        if self._is_up:
            n_steps = min(self._top - self._step, len(gain))
            gain[:n_steps] = self._ramp[self._step + 1 : self._step + 1 + n_steps]
            gain[n_steps:] = 1
            self._step += n_steps
        else:
            n_steps = min(self._step, len(gain))
            gain[:n_steps] = self._ramp[self._step - n_steps : self._step][::-1]
            gain[n_steps:] = 0
            self._step -= n_steps
