r"""One axis with one gain: a sensor axis or the principal axis, as strong as the vibration of all three axes.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never modified.
The whole-signal forms use one gain for the whole recording. The causal forms estimate the same gain from the past,
which they forget with a time constant of `FORGETTING_S`: `*_running` sample by sample without any delay,
`pca321_matched_windowed` frame by frame. An offset counts as energy of a sensor axis: remove it first.

Notes
-----
With :math:`e_i` the energy of axis i, a the axis that is kept and :math:`e_a` its energy, the gain is

.. math:: g = \sqrt{\min\left(\textstyle\sum_i e_i / e_a, \; g_{max}^2\right)}, \qquad g_{max} = 10

so the output has the energy of the recording, whatever the mounting, as `dft321`'s has; but a single gain leaves the
waveform alone: no phase is undetermined, and weak noise stays weak. What one axis cannot do is to show frequencies
that are strong on another one only. An axis with less than 1 % of the energy does not carry the motion, and more gain
would play its noise: hence the limit. A silent axis stays silent. On a principal axis g is at most :math:`\sqrt 3`.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.recording import admit
from feel321.stimuli.reducers.axes import (
    DEFAULT_WINDOW_S,
    NO_SIGN,
    leading_axis,
    pca321,
    run_offline,
    window_samples,
    with_sign,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

MOST_GAIN = 10.0
"""Largest gain of a single axis: 20 dB."""

FORGETTING_S = 1.0
"""Time constant with which the causal forms forget energies."""

HOLD = 0.3
"""How much a running principal axis is held where it was, as a share of the motion's energy: another direction must
hold noticeably more before the axis turns. Without it the axis of isotropic motion wanders, which smears the output."""


def match_energy(total: NDArray[np.float64], kept: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the gain that gives what is kept the energy of all; at most `MOST_GAIN`, and 0 for silence."""
    limited = np.maximum(kept, total / MOST_GAIN**2)
    return np.asarray(
        np.sqrt(np.divide(total, limited, out=np.zeros_like(total), where=limited > 0))
    )


def sax321_matched(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's x axis, with one gain that gives it the energy of all three axes.

    acceleration: (..., 3, n_samples); returns (..., n_samples), the x axis times sqrt(energy of all
    axes / energy of x), at most times 10.

    Examples
    --------
    >>> sax321_matched([[3, -3], [4, 0], [0, 4]], 1000)
    array([ 5., -5.])
    """
    return _match_axis(acceleration, rate_hz, 0)


def say321_matched(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's y axis, with one gain that gives it the energy of all three axes.

    acceleration: (..., 3, n_samples); returns (..., n_samples).
    """
    return _match_axis(acceleration, rate_hz, 1)


def saz321_matched(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's z axis, with one gain that gives it the energy of all three axes.

    acceleration: (..., 3, n_samples); returns (..., n_samples).
    """
    return _match_axis(acceleration, rate_hz, 2)


def pca321_matched(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Project on the principal axis of the whole signal, with one gain that gives it the energy of all three axes.

    acceleration: (..., 3, n_samples); returns (..., n_samples).

    Examples
    --------
    >>> np.round(pca321_matched([[3, -3, 3, -3], [4, -4, 4, -4], [3.75, 3.75, -3.75, -3.75]], 1000), 9)
    array([ 6.25, -6.25,  6.25, -6.25])
    """
    admitted = admit(acceleration, rate_hz)
    samples = admitted.samples
    if samples.shape[-1] == 0:
        return np.zeros((*samples.shape[:-2], 0))
    kept = pca321(samples, rate_hz)
    centred = samples - samples.mean(axis=-1, keepdims=True)
    total = np.einsum("...in,...in->...", centred, centred)
    gain = match_energy(total, np.einsum("...n,...n->...", kept, kept))
    return admitted.restore(gain[..., None] * kept)


def sax321_matched_running(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    r"""Keep the sensor's x axis, with a gain that gives it the energy of all three axes in the recent past.

    acceleration: (..., 3, n_samples); returns (..., n_samples).

    Notes
    -----
    With :math:`e_i(k) = m \, e_i(k-1) + a_i(k)^2` and :math:`m = \exp(-1 / (1\,\mathrm{s} \cdot rate))` in place of
    the energies. Nothing waits: the gain of a sample rests on it and those before it.
    """
    return _run_axis(acceleration, rate_hz, 0)


def say321_matched_running(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's y axis, with a gain that gives it the energy of all three axes in the recent past.

    acceleration: (..., 3, n_samples); returns (..., n_samples).
    """
    return _run_axis(acceleration, rate_hz, 1)


def saz321_matched_running(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's z axis, with a gain that gives it the energy of all three axes in the recent past.

    acceleration: (..., 3, n_samples); returns (..., n_samples).
    """
    return _run_axis(acceleration, rate_hz, 2)


def pca321_matched_windowed(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> NDArray[np.float64]:
    """Project on the principal axis of the recent past, as strong as all three axes were there.

    acceleration: (..., 3, n_samples); window_s: the nearest even number of samples, at least 2, is
    used; returns (..., n_samples).

    Notes
    -----
    The mean products of the axes are updated every half window and forgotten with a time constant of 1 s: 35 ms are
    too short to have an axis of their own. The axis is the leading one, held a little where it was, and points along
    the one before it; within half a window axis and gain fade from one estimate to the next. Only the past is used, so
    the method streams.
    """
    admitted = admit(acceleration, rate_hz)
    hop = window_samples(window_s, rate_hz) // 2
    return admitted.restore(run_offline(frames_at(rate_hz), admitted.samples, hop))


class RunningAxis:
    """One sensor axis with the gain of `match_energy`, from energies remembered from call to call."""

    def __init__(self, batch: tuple[int, ...], axis: int, rate_hz: float) -> None:
        self._axis = axis
        self._memory = _forget(1 / rate_hz)
        self._energies = np.zeros((*batch, 2, 1))

    def push(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take samples (..., 3, k), give as many of the output (..., k), without delay.

        samples: (..., 3, k); returns (..., k).
        """
        from scipy.signal import lfilter

        kept = samples[..., self._axis, :]
        if not kept.size:
            return np.zeros(kept.shape)
        powers = np.stack(
            [np.einsum("...in,...in->...n", samples, samples), np.square(kept)], axis=-2
        )
        energies, self._energies = lfilter(
            np.ones(1), np.array([1.0, -self._memory]), powers, zi=self._energies
        )
        return np.asarray(kept * match_energy(energies[..., 0, :], energies[..., 1, :]))


class MatchedFrames:
    """The block processor of `pca321_matched_windowed`: see `frames.BlockProcessor`.

    hop: half a window, in samples.
    """

    def __init__(self, batch: tuple[int, ...], hop: int, rate_hz: float) -> None:
        self.hop = hop
        self._fading_in = np.arange(hop) / hop
        self._memory = _forget(hop / rate_hz)
        self._previous = np.zeros((*batch, 3, 1, hop))
        self._moment = np.zeros((*batch, 1, 3, 3))
        self._axis = np.zeros((*batch, 3))
        self._gain = np.zeros((*batch, 1))

    def push(self, blocks: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Take blocks (..., 3, m, hop), give as many finished ones (..., m, hop), one hop late.

        blocks: (..., 3, m, hop); valid: (m, hop); returns (..., m, hop).
        """
        from scipy.signal import lfilter

        del valid
        own = np.einsum("...imt,...jmt->...mij", blocks, blocks)
        moments, self._moment = lfilter(
            np.ones(1), np.array([1.0, -self._memory]), own, axis=-3, zi=self._moment
        )
        first = self._axis
        axes = self._follow(moments, own)
        kept = np.einsum("...mi,...mij,...mj->...m", axes, moments, axes)
        gains = np.concatenate(
            [self._gain, match_energy(np.trace(moments, axis1=-2, axis2=-1), kept)], axis=-1
        )
        axes = np.concatenate([first[..., None, :], axes], axis=-2)
        blocks = np.concatenate([self._previous, blocks], axis=-2)
        self._previous, self._gain = blocks[..., -1:, :].copy(), gains[..., -1:]
        mixed = self._fade(np.swapaxes(axes, -1, -2))
        size = np.linalg.norm(mixed, axis=-3)
        scale = np.divide(self._fade(gains), size, out=np.zeros_like(size), where=size > 0)
        return np.asarray(scale * np.einsum("...imh,...imh->...mh", mixed, blocks[..., :-1, :]))

    def _fade(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fade from one value to the next: (..., m + 1) in, (..., m, hop) out."""
        return np.asarray(values[..., :-1, None] + np.diff(values)[..., None] * self._fading_in)

    def _follow(
        self, moments: NDArray[np.float64], own: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Leading axes (..., m, 3) of moments (..., m, 3, 3), each leaning and pointing towards the one before it.

        An axis is held by the share of the energy that it rests on: noise before the first tap has no say.
        """
        axes = np.zeros((*moments.shape[:-3], moments.shape[-3] + 1, 3))
        axes[..., 0, :] = self._axis
        energy = np.trace(moments, axis1=-2, axis2=-1)[..., None, None]
        shares = np.divide(moments, energy, out=np.zeros_like(moments), where=energy > 0)
        past = energy - np.trace(own, axis1=-2, axis2=-1)[..., None, None]
        hold = HOLD * np.divide(past, energy, out=np.zeros_like(energy), where=energy > 0)
        for place in range(moments.shape[-3]):
            before = axes[..., place, :]
            leaning = (
                shares[..., place, :, :]
                + hold[..., place, :, :] * before[..., :, None] * before[..., None, :]
            )
            axes[..., place + 1, :] = np.where(
                energy[..., place, :, 0] > 0, leading_axis(leaning), before
            )
        axes[..., 1:, :] = with_sign(axes[..., 1:, :])
        along = np.einsum("...mi,...mi->...m", axes[..., 1:, :], axes[..., :-1, :])
        axes = (
            axes[..., 1:, :] * np.cumprod(np.where(along < -NO_SIGN, -1.0, 1.0), axis=-1)[..., None]
        )
        self._axis = axes[..., -1, :]
        return np.asarray(axes)


def frames_at(rate_hz: float) -> Callable[[tuple[int, ...], int], MatchedFrames]:
    """Make the block processor of `pca321_matched_windowed` for a sampling rate.

    Returns batch shape, hop -> a fresh block processor.
    """
    return partial(MatchedFrames, rate_hz=rate_hz)


def _forget(duration_s: float) -> float:
    """Share of an energy that still counts after some time: exp(-duration / `FORGETTING_S`)."""
    return math.exp(-duration_s / FORGETTING_S)


def _match_axis(acceleration: ArrayLike, rate_hz: float, axis: int) -> NDArray[np.float64]:
    admitted = admit(acceleration, rate_hz)
    kept = admitted.samples[..., axis, :]
    gain = match_energy(admitted.energy, np.einsum("...n,...n->...", kept, kept)[..., None])
    return admitted.restore(gain * kept)


def _run_axis(acceleration: ArrayLike, rate_hz: float, axis: int) -> NDArray[np.float64]:
    admitted = admit(acceleration, rate_hz)
    running = RunningAxis(admitted.samples.shape[:-2], axis, rate_hz)
    return admitted.restore(running.push(admitted.samples))
