"""Signals cut into half-overlapping frames: the shared frame of every windowed reducer.

A signal of n samples is cut into blocks of one hop; a frame is two neighbouring blocks, so every sample lies in exactly
two frames. A silent block before the first and after the last gives both ends their second frame. A *block
processor* is fed blocks in time order and answers with finished blocks, one hop late; the offline form feeds it a few
hundred blocks at a time (so that its work stays in the processor's cache), the streaming form as they come. Both
therefore compute the same thing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from stimuli.recording import check_rate

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

DEFAULT_WINDOW_S = 0.035
"""Window of 35 ms: the paper's value, 10 ms below the shortest delay noticed between sight and touch."""

# Three axes, two-fold overlap, float64 in and complex out: about 1 MiB of work at a time.
_SAMPLES_AT_A_TIME = 16384


class BlockProcessor(Protocol):
    """What turns blocks of three axes into finished blocks of one, one hop late.

    Attributes
    ----------
    hop : int
        Length of a block in samples.
    """

    hop: int

    def push(self, blocks: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Take the next blocks and give as many finished ones; the first is the one before the first that is pushed.

        Parameters
        ----------
        blocks : ndarray, shape (..., 3, m, hop)
            The next blocks of the signal.
        valid : ndarray of bool, shape (m, hop)
            False where a block was filled up with silence.

        Returns
        -------
        ndarray of float64, shape (..., m, hop)
            Finished blocks.
        """


def window_samples(window_s: float, rate_hz: float) -> int:
    """Length of the window in samples: even, because frames overlap by half, and at least 2.

    Parameters
    ----------
    window_s : float
        Wanted length of the window in s.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    int
        The nearest even number of samples (ties go up).

    Raises
    ------
    ValueError
        If the window is not a finite time above 0.

    Examples
    --------
    >>> window_samples(0.035, 10000), window_samples(0.035, 1000), window_samples(1e-9, 1000)
    (350, 36, 2)
    """
    rate = check_rate(rate_hz)
    if not (math.isfinite(window_s) and window_s > 0):
        raise ValueError(f"window_s: got {window_s!r}, allowed is a finite time in s above 0")
    return max(2, 2 * math.floor(window_s * rate / 2 + 0.5))


def sqrt_hann(length: int) -> NDArray[np.float64]:
    """Square root of the periodic Hann window; its squares at half overlap add up to 1.

    Parameters
    ----------
    length : int
        Even number of samples.

    Returns
    -------
    ndarray of float64, shape (length,)
        sin(pi k / length).
    """
    return np.sin(np.pi * np.arange(length) / length)


def run_offline(
    processor_for: Callable[[tuple[int, ...], int], BlockProcessor], samples: NDArray[np.float64], hop: int
) -> NDArray[np.float64]:
    """Feed a whole signal through a block processor.

    Parameters
    ----------
    processor_for : callable
        Makes a fresh block processor for a batch shape and a hop.
    samples : ndarray, shape (..., 3, n)
        The whole signal.
    hop : int
        Block length in samples.

    Returns
    -------
    ndarray of float64, shape (..., n)
        The reduced signal.
    """
    *batch, _, n = samples.shape
    if not samples.size:
        return np.zeros((*batch, n))
    processor = processor_for(tuple(batch), hop)
    reduced = np.empty((*batch, n))
    written = -hop  # the first finished block is the silent one before the signal
    blocks_left = math.ceil(n / hop) + 1
    per_push = max(1, _SAMPLES_AT_A_TIME // hop)
    for first in range(0, blocks_left, per_push):
        n_blocks = min(per_push, blocks_left - first)
        piece = samples[..., first * hop : (first + n_blocks) * hop]
        finished = processor.push(*cut_blocks(piece, hop, n_blocks)).reshape(*batch, -1)
        skipped = max(0, -written)
        end = min(n, written + finished.shape[-1])
        reduced[..., written + skipped : end] = finished[..., skipped : end - written]
        written = end
    return reduced


def cut_blocks(samples: NDArray[np.float64], hop: int, n_blocks: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Cut samples into blocks, filling up with silence where they end early.

    Parameters
    ----------
    samples : ndarray, shape (..., 3, k)
        The next samples of the signal, k <= n_blocks * hop.
    hop : int
        Block length in samples.
    n_blocks : int
        Number of blocks.

    Returns
    -------
    blocks : ndarray, shape (..., 3, n_blocks, hop)
        The samples in blocks.
    valid : ndarray of bool, shape (n_blocks, hop)
        False where a block was filled with silence.
    """
    k = samples.shape[-1]
    valid = (np.arange(n_blocks * hop) < k).reshape(n_blocks, hop)
    if k < n_blocks * hop:
        padded = np.zeros((*samples.shape[:-1], n_blocks * hop))
        padded[..., :k] = samples
        samples = padded
    return samples.reshape(*samples.shape[:-1], n_blocks, hop), valid
