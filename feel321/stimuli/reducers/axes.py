r"""Reducers to one axis, fixed or principal, as it is or with one gain; and the frames of windowed reducers.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never
modified. Fixed axes do not need the sampling rate; they take it so that every reducer is called alike. A window of
`window_s` is the nearest even number of samples, at least 2.

A signal of n samples is cut into blocks of one hop; a frame is two neighbouring blocks, so every sample lies in exactly
two frames. A silent block before the first and after the last gives both ends their second frame. A *block
processor* is fed blocks in time order and answers with finished blocks, one hop late; the offline form feeds it a few
hundred blocks at a time (so that its work stays in the processor's cache), the streaming form as they come. Both
therefore compute the same thing.

An axis has no sign of its own. That of a whole signal is chosen so that the output does not correlate negatively with
the sum of the components; that of a segment so that it agrees with the segments before it.

Matched reducers give one axis one gain, so that it is as strong as the vibration of all three axes. The whole-signal
forms use one gain for the whole recording. The causal forms estimate the same gain from the past, which they forget
with a time constant of `FORGETTING_S`: `*_running` sample by sample without any delay, `pca321_matched_windowed`
frame by frame. An offset counts as energy of a sensor axis: remove it first.

Notes
-----
With :math:`e_i` the energy of axis i, a the axis that is kept and :math:`e_a` its energy, the gain is

.. math:: g = \sqrt{\min\left(\textstyle\sum_i e_i / e_a, \; g_{max}^2\right)}, \qquad g_{max} = 10

so the output has the energy of the recording, whatever the mounting, as `dft321`'s has; but a single gain leaves the
waveform alone: no phase is undetermined, and weak noise stays weak. What one axis cannot do is to show frequencies
that are strong on another one only. An axis with less than 1 % of the energy does not carry the motion, and more gain
would play its noise: hence the limit. A silent axis stays silent. On a principal axis g is at most :math:`\sqrt 3`.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 4. doi:10.1007/978-3-642-14075-4_12
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feel321.arguments import check_rate
from feel321.stimuli.recording import add_squares, admit
from feel321.types import Samples

_OneAxis: TypeAlias = Callable[[ArrayLike, float], Samples]

DEFAULT_WINDOW_S = 0.035
"""Window of 35 ms: the paper's value, 10 ms below the shortest delay noticed between sight and touch."""

# Three axes, two-fold overlap, float64 in and complex out: about 1 MiB of work at a time.
_SAMPLES_AT_A_TIME = 16384


class BlockProcessor(Protocol):
    """Turns blocks of three axes, `hop` samples long, into finished blocks of one axis, one hop late."""

    hop: int

    def push(self, blocks: Samples, valid: NDArray[np.bool_]) -> Samples:
        """Take the next blocks, (..., 3, m, hop), and which of their samples, (m, hop), belong to the signal.

        Returns as many finished blocks, (..., m, hop); the first is the one before the first that is pushed.
        """


def window_samples(window_s: float, rate_hz: float) -> int:
    """Length of the window in samples: even, because frames overlap by half, and at least 2."""
    rate = check_rate(rate_hz)
    if not (math.isfinite(window_s) and window_s > 0):
        raise ValueError(f"window_s must be a finite time in s above 0, got {window_s!r}")
    return max(2, 2 * math.floor(window_s * rate / 2 + 0.5))


def sqrt_hann(length: int) -> Samples:
    """Square root of the periodic Hann window: at half overlap its squares add up to 1."""
    return np.sin(np.pi * np.arange(length) / length)


def reduce_in_frames(
    processor_for: Callable[[tuple[int, ...], int], BlockProcessor], acceleration: ArrayLike,
    *, rate_hz: float, window_s: float,
) -> Samples:  # fmt: skip
    """Check a recording and feed it through a block processor."""
    samples, _ = admit(acceleration, rate_hz)
    hop = window_samples(window_s, rate_hz) // 2
    *batch, _, n = samples.shape
    if not samples.size:
        return np.zeros((*batch, n))
    processor = processor_for(tuple(batch), hop)
    reduced = np.empty((*batch, n))
    written = -hop  # the first finished block is the silent one before the signal
    blocks_left = math.ceil(n / hop) + 1
    per_push = max(1, _SAMPLES_AT_A_TIME // (hop * math.prod(batch)))
    for first in range(0, blocks_left, per_push):
        n_blocks = min(per_push, blocks_left - first)
        piece = samples[..., first * hop : (first + n_blocks) * hop]
        finished = processor.push(*cut_blocks(piece, hop, n_blocks)).reshape(*batch, -1)
        skipped = max(0, -written)
        end = min(n, written + finished.shape[-1])
        reduced[..., written + skipped : end] = finished[..., skipped : end - written]
        written = end
    return reduced


def cut_blocks(samples: Samples, hop: int, n_blocks: int) -> tuple[Samples, NDArray[np.bool_]]:
    """Cut samples (..., 3, k) into blocks (..., 3, n_blocks, hop), silent where they end early; and say where."""
    k = samples.shape[-1]
    valid = (np.arange(n_blocks * hop) < k).reshape(n_blocks, hop)
    if k < n_blocks * hop:
        padded = np.zeros((*samples.shape[:-1], n_blocks * hop))
        padded[..., :k] = samples
        samples = padded
    return samples.reshape(*samples.shape[:-1], n_blocks, hop), valid


def soc321(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Add the three axes.

    Axes in phase interfere constructively (three equal axes: three times the energy), axes in anti-phase cancel.
    """
    samples, _ = admit(acceleration, rate_hz)
    return np.asarray(samples.sum(axis=-2))


def mag321(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Take the length of the acceleration vector.

    Never negative, so it has an offset that the vibration did not have, and frequencies are doubled and mixed.
    """
    samples, _ = admit(acceleration, rate_hz)
    return np.asarray(np.sqrt(np.einsum("...in,...in->...n", samples, samples)))


# Below this the sum of an axis's components is rounding, and cannot choose its sign.
NO_SIGN = 1e-9
# A segment whose variation is below this share of its second moment is constant but for rounding.
_CONSTANT = 1e-20
# Two axes that do not point against each other mix to at least this length.
_SHORTEST_MIX = np.sqrt(0.5)


def pca321(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Project on the principal axis of the whole signal, its mean removed.

    Notes
    -----
    The sign is the one whose correlation with x + y + z is not negative. Where it is 0 (an axis perpendicular to the
    sensor's diagonal, as for anti-phase axes), the axis's largest component is positive, the first among equals.
    """
    samples, _ = admit(acceleration, rate_hz)
    return _project(samples)[0]


def _project(samples: Samples) -> tuple[Samples, Samples]:
    """Project on the principal axis, (..., n); and all axes about their means, (..., 3, n)."""
    if samples.shape[-1] == 0:
        return samples[..., 0, :], samples
    centred = samples - samples.mean(axis=-1, keepdims=True)
    # einsum, not matmul: its result does not depend on how many threads a BLAS library happens to use.
    axes = with_sign(leading_axis(np.einsum("...in,...jn->...ij", centred, centred)))
    return np.einsum("...i,...in->...n", axes, centred), centred


def pca321_adaptive(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> Samples:
    r"""Project on a principal axis that is estimated anew in short overlapping segments.

    Notes
    -----
    Segments overlap by half. Each has the leading eigenvector u of its Hann-weighted covariance, whose trace is its
    energy e. Its sign s agrees with a memory of the axes before it, each as strong as its segment,

    .. math:: s_k = \mathrm{sign}(u_k \cdot m_{k-1}), \qquad m_k = e^{-h / 1\,\mathrm{s}} m_{k-1} + e_k s_k u_k,

    with h half a window; the first points along the sensor's diagonal. As :math:`u_k` times the eigenvalue is the
    correlation of a segment's output with the three components, m is about the correlation of the whole output so far:
    equation 2's numerator grows with every segment. Noise in a pause has no energy and so no say. In a segment without
    a leading direction noise chooses the axis, and with it the sign; and an axis that turns by half within about a
    second meets its own past and changes its sign there.

    At every sample the axes of its two segments are mixed with their weights and brought to unit length; where they
    point against each other the output fades through zero. A constant segment keeps the axis before it. Only the past
    is used, so the method streams.
    """
    frames = partial(PrincipalFrames, rate_hz=rate_hz)
    return reduce_in_frames(frames, acceleration, rate_hz=rate_hz, window_s=window_s)


def leading_axis(covariance: Samples) -> Samples:
    """Return the unit eigenvector of the largest eigenvalue of (..., 3, 3), its sign left open."""
    return np.asarray(np.linalg.eigh(covariance)[1][..., -1])


def with_sign(axes: Samples) -> Samples:
    """Turn axes (..., 3) along the sensor's diagonal, or by their largest component where they cannot."""
    along = axes.sum(axis=-1, keepdims=True)
    strength = np.abs(axes)
    first = np.argmax(strength >= (1 - NO_SIGN) * strength.max(axis=-1, keepdims=True), axis=-1)
    largest = np.take_along_axis(axes, first[..., None], axis=-1)
    chosen = np.where(np.abs(along) > NO_SIGN, along, largest)
    return np.asarray(axes * np.where(chosen < 0, -1.0, 1.0))


class PrincipalFrames:
    """The block processor of `pca321_adaptive`: see `BlockProcessor`."""

    def __init__(self, batch: tuple[int, ...], hop: int, rate_hz: float) -> None:
        self.hop = hop
        self._forgetting = _forget(hop / rate_hz)
        self._rise, self._fall = np.split(sqrt_hann(2 * hop) ** 2, 2)
        self._previous = np.zeros((*batch, 3, 1, hop))
        self._valid = np.zeros((1, hop), dtype=bool)
        self._axis = np.full((*batch, 1, 3), 1 / np.sqrt(3))
        self._memory = np.zeros((*batch, 3))

    def push(self, blocks: Samples, valid: NDArray[np.bool_]) -> Samples:
        """Take blocks (..., 3, m, hop), return as many finished ones (..., m, hop), one hop late."""
        blocks = np.concatenate([self._previous, blocks], axis=-2)
        valid = np.concatenate([self._valid, valid])
        frames = np.concatenate([blocks[..., :-1, :], blocks[..., 1:, :]], axis=-1)
        weights = np.concatenate([valid[:-1] * self._rise, valid[1:] * self._fall], axis=-1)
        axes = np.concatenate([self._axis, self._turned(*_segment_axes(frames, weights))], axis=-2)
        self._previous, self._valid = blocks[..., -1:, :].copy(), valid[-1:]
        self._axis = axes[..., -1:, :]
        mixed = axes[..., :-1, :, None] * self._fall
        mixed += axes[..., 1:, :, None] * self._rise
        mixed /= np.maximum(np.linalg.norm(mixed, axis=-2, keepdims=True), _SHORTEST_MIX)
        return np.asarray(np.einsum("...mih,...imh->...mh", mixed, blocks[..., :-1, :]))

    def _turned(self, axes: Samples, energies: Samples, constant: NDArray[np.bool_]) -> Samples:
        """Give every axis its sign; constant segments keep the axis before them."""
        axes = np.concatenate([self._axis, with_sign(axes)], axis=-2)
        own = np.where(constant, 0, np.arange(1, axes.shape[-2]))
        own = np.maximum.accumulate(own, axis=-1)
        own = np.concatenate([np.zeros_like(own[..., :1]), own], axis=-1)
        axes = np.take_along_axis(axes, own[..., 1:, None], axis=-2)
        signs = np.ones(energies.shape)
        for place in range(energies.shape[-1]):
            along = np.einsum("...i,...i->...", axes[..., place, :], self._memory)
            # An axis across the memory keeps the sign that it has by itself: rounding must not choose.
            across = NO_SIGN * np.abs(self._memory).sum(axis=-1)
            signs[..., place] = np.where(along < -across, -1.0, 1.0)
            strength = (signs[..., place] * energies[..., place])[..., None]
            self._memory = self._forgetting * self._memory + strength * axes[..., place, :]
        return np.asarray(axes * signs[..., None])


def _segment_axes(frames: Samples, weights: Samples) -> tuple[Samples, Samples, NDArray[np.bool_]]:
    """Leading axes (..., m, 3) of frames (..., 3, m, length), their energies, and which are constant: (..., m)."""
    total = np.maximum(weights.sum(axis=-1), np.finfo(np.float64).tiny)
    mean = np.einsum("...imt,mt->...im", frames, weights) / total
    centred = frames - mean[..., None]
    centred *= np.sqrt(weights)
    covariance = np.einsum("...imt,...jmt->...mij", centred, centred)
    variation = np.trace(covariance, axis1=-2, axis2=-1)
    constant = variation <= _CONSTANT * np.einsum("...im,m->...m", mean**2, total)
    return leading_axis(covariance), np.where(constant, 0.0, variation), np.asarray(constant)


MOST_GAIN = 10.0  # Largest gain of a single axis: 20 dB
FORGETTING_S = 1.0  # Time constant with which the causal forms forget energies

HOLD = 0.3
"""How much a running principal axis is held where it was, as a share of the motion's energy: another direction must
hold noticeably more before the axis turns. Without it the axis of isotropic motion wanders, which smears the output."""


def match_energy(total: Samples, kept: Samples) -> Samples:
    """Compute the gain that gives the kept signal the energy of all axes; at most `MOST_GAIN`, and 0 for silence."""
    limited = np.maximum(kept, total / MOST_GAIN**2)
    ratio = np.divide(total, limited, out=np.zeros_like(total), where=limited > 0)
    return np.asarray(np.sqrt(ratio))


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
        squares = np.einsum("...in,...in->...n", samples, samples)
        powers, poles = np.stack([squares, np.square(kept)], axis=-2), [1.0, -self._memory]
        energies, self._energies = lfilter([1.0], poles, powers, zi=self._energies)
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
        poles = [1.0, -self._memory]
        moments, self._moment = lfilter([1.0], poles, own, axis=-3, zi=self._moment)
        first = self._axis
        axes = self._follow(moments, own)
        kept = np.einsum("...mi,...mij,...mj->...m", axes, moments, axes)
        gains = match_energy(np.trace(moments, axis1=-2, axis2=-1), kept)
        gains = np.concatenate([self._gain, gains], axis=-1)
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
            held = hold[..., place, :, :] * before[..., :, None] * before[..., None, :]
            leading = leading_axis(shares[..., place, :, :] + held)
            axes[..., place + 1, :] = np.where(energy[..., place, :, 0] > 0, leading, before)
        axes[..., 1:, :] = with_sign(axes[..., 1:, :])
        along = np.einsum("...mi,...mi->...m", axes[..., 1:, :], axes[..., :-1, :])
        # An axis across the one before it keeps the sign that it has by itself: rounding must not choose.
        signs = np.cumprod(np.where(along < -NO_SIGN, -1.0, 1.0), axis=-1)
        axes = axes[..., 1:, :] * signs[..., None]
        self._axis = axes[..., -1, :]
        return axes


def _forget(duration_s: float) -> float:
    """Share of an energy that still counts after some time: exp(-duration / `FORGETTING_S`)."""
    return math.exp(-duration_s / FORGETTING_S)


def _name(reducer: _OneAxis, name: str, does: str) -> _OneAxis:
    """Name a reducer that was made, as if it had been written out."""
    reducer.__name__ = reducer.__qualname__ = name
    reducer.__doc__ = does
    return reducer


def _match(keep: Callable[[Samples], tuple[Samples, Samples]]) -> _OneAxis:
    """Give what is kept of the samples one gain that makes it as strong as all axes; keep: (kept, all axes)."""

    def match(acceleration: ArrayLike, rate_hz: float) -> Samples:
        samples, _ = admit(acceleration, rate_hz)
        kept, samples = keep(samples)
        return match_energy(add_squares(samples, 2), add_squares(kept))[..., None] * kept

    return match


def _make_axis(axis: int) -> tuple[_OneAxis, _OneAxis, _OneAxis]:
    """Make the reducers to one sensor axis: as it is, with one gain, and with the gain of the recent past."""

    def keep(acceleration: ArrayLike, rate_hz: float) -> Samples:
        samples, _ = admit(acceleration, rate_hz)
        return samples[..., axis, :].copy()

    def run(acceleration: ArrayLike, rate_hz: float) -> Samples:
        samples, _ = admit(acceleration, rate_hz)
        return RunningAxis(samples.shape[:-2], axis, rate_hz).push(samples)

    match = _match(lambda samples: (samples[..., axis, :], samples))
    name, does = f"sa{'xyz'[axis]}321", f"Keep the sensor's {'xyz'[axis]} axis"
    limited = f"{does}, with one gain, at most {MOST_GAIN:g}, that gives it the energy of all"
    return (
        _name(keep, name, f"{does}."),
        _name(match, f"{name}_matched", f"{limited} three axes."),
        _name(run, f"{name}_matched_running", f"{limited} axes in the recent past."),
    )


sax321, sax321_matched, sax321_matched_running = _make_axis(0)
say321, say321_matched, say321_matched_running = _make_axis(1)
saz321, saz321_matched, saz321_matched_running = _make_axis(2)
pca321_matched = _name(
    _match(_project),
    "pca321_matched",
    "Project on the principal axis of the whole signal, with one gain that gives it the energy of all three axes.",
)
