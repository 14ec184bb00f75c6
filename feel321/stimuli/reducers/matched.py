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
    leading_axis,
    pca321,
    reduce_in_frames,
    turn_alike,
    with_sign,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from feel321.types import Samples

MOST_GAIN = 10.0
"""Largest gain of a single axis: 20 dB."""

FORGETTING_S = 1.0
"""Time constant with which the causal forms forget energies."""

HOLD = 0.3
"""How much a running principal axis is held where it was, as a share of the motion's energy: another direction must
hold noticeably more before the axis turns. Without it the axis of isotropic motion wanders, which smears the output."""


def match_energy(total: Samples, kept: Samples) -> Samples:
    """Compute the gain that gives the kept signal the energy of all axes; at most `MOST_GAIN`, and 0 for silence."""
    limited = np.maximum(kept, total / MOST_GAIN**2)
    return np.asarray(
        np.sqrt(np.divide(total, limited, out=np.zeros_like(total), where=limited > 0))
    )


def sax321_matched(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's x axis, with one gain that gives it the energy of all three axes."""
    return _match_axis(acceleration, rate_hz, 0)


def say321_matched(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's y axis, with one gain that gives it the energy of all three axes."""
    return _match_axis(acceleration, rate_hz, 1)


def saz321_matched(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's z axis, with one gain that gives it the energy of all three axes."""
    return _match_axis(acceleration, rate_hz, 2)


def pca321_matched(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Project on the principal axis of the whole signal, with one gain that gives it the energy of all three axes.

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


def sax321_matched_running(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's x axis, with a gain that gives it the energy of all three axes in the recent past."""
    return _run_axis(acceleration, rate_hz, 0)


def say321_matched_running(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's y axis, with a gain that gives it the energy of all three axes in the recent past."""
    return _run_axis(acceleration, rate_hz, 1)


def saz321_matched_running(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Keep the sensor's z axis, with a gain that gives it the energy of all three axes in the recent past."""
    return _run_axis(acceleration, rate_hz, 2)


def pca321_matched_windowed(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> Samples:
    """Project on the principal axis of the recent past, as strong as all three axes were there.

    Notes
    -----
    The mean products of the axes are updated every half window and forgotten with a time constant of 1 s: 35 ms are
    too short to have an axis of their own. The axis is the leading one, held a little where it was, and points along
    the one before it; within half a window axis and gain fade from one estimate to the next. Only the past is used, so
    the method streams.
    """
    frames = partial(MatchedFrames, rate_hz=rate_hz)
    return reduce_in_frames(frames, acceleration, rate_hz=rate_hz, window_s=window_s)


class RunningAxis:
    r"""One sensor axis with the gain of `match_energy`, from energies remembered from call to call.

    In place of energies stand :math:`e_i(k) = m \, e_i(k-1) + a_i(k)^2`, :math:`m = \exp(-1 / (1\,\mathrm{s} \cdot
    rate))`. Nothing waits: the gain of a sample rests on it and those before it.
    """

    def __init__(self, batch: tuple[int, ...], axis: int, rate_hz: float) -> None:
        self._axis = axis
        self._memory = _forget(1 / rate_hz)
        self._energies = np.zeros((*batch, 2, 1))

    def push(self, samples: Samples) -> Samples:
        """Reduce the next samples, (..., 3, k), to as many of the output, (..., k), without delay."""
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
    """The block processor of `pca321_matched_windowed`: see `BlockProcessor`."""

    def __init__(self, batch: tuple[int, ...], hop: int, rate_hz: float) -> None:
        self.hop = hop
        self._fading_in = np.arange(hop) / hop
        self._memory = _forget(hop / rate_hz)
        self._previous = np.zeros((*batch, 3, 1, hop))
        self._moment = np.zeros((*batch, 1, 3, 3))
        self._axis = np.zeros((*batch, 3))
        self._gain = np.zeros((*batch, 1))

    def push(self, blocks: Samples, valid: NDArray[np.bool_]) -> Samples:
        """Take blocks (..., 3, m, hop), return as many finished ones (..., m, hop), one hop late."""
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

    def _fade(self, values: Samples) -> Samples:
        """Fade from one value to the next: (..., m + 1) in, (..., m, hop) out."""
        return np.asarray(values[..., :-1, None] + np.diff(values)[..., None] * self._fading_in)

    def _follow(self, moments: Samples, own: Samples) -> Samples:
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
        axes = turn_alike(axes)
        self._axis = axes[..., -1, :]
        return axes


def _forget(duration_s: float) -> float:
    """Share of an energy that still counts after some time: exp(-duration / `FORGETTING_S`)."""
    return math.exp(-duration_s / FORGETTING_S)


def _match_axis(acceleration: ArrayLike, rate_hz: float, axis: int) -> Samples:
    admitted = admit(acceleration, rate_hz)
    kept = admitted.samples[..., axis, :]
    gain = match_energy(admitted.energy, np.einsum("...n,...n->...", kept, kept)[..., None])
    return admitted.restore(gain * kept)


def _run_axis(acceleration: ArrayLike, rate_hz: float, axis: int) -> Samples:
    admitted = admit(acceleration, rate_hz)
    running = RunningAxis(admitted.samples.shape[:-2], axis, rate_hz)
    return admitted.restore(running.push(admitted.samples))
