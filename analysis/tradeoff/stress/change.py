"""How far two outputs lie apart, as far as it can be felt.

The relative change from an output r to another r' is *sign-free*, because the skin does not feel the sign of a
vibration:

    δ(r', r) = min(‖r' - r‖, ‖r' + r‖) / ‖r‖, at most sqrt(2)

sqrt(2) is what lies between two unrelated signals of equal energy: more is not less stable. An output that is silent
and stays silent has changed by 0, one that is silent and becomes anything by sqrt(2).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from stimuli.recording import Recording

    Samples = NDArray[np.float64]
    Free = Literal["sign", "phase"]

UNRELATED = float(np.sqrt(2))
"""Largest relative change: between two unrelated signals of equal energy."""


class Change(NamedTuple):
    """A change over many draws.

    Parameters
    ----------
    median, worst, p90 : float
        Over the draws; nine of ten are not above `p90`, which is NaN where nothing is drawn.
    """

    median: float
    worst: float
    p90: float = math.nan


def relative_change(changed: Samples, output: Samples, *, free: Free = "sign") -> Samples:
    r"""Tell how much outputs differ from another one, but for its sign or for a constant phase.

    Parameters
    ----------
    changed : ndarray, shape (..., n)
        Outputs.
    output : ndarray, shape (..., n)
        What they are compared with.
    free : {"sign", "phase"}
        What does not count: the sign, or any constant phase (the same turn of all frequencies).

    Returns
    -------
    ndarray of float64, shape (...)
        0 to sqrt(2).

    Raises
    ------
    ValueError
        If `free` is neither.

    Notes
    -----
    With H the Hilbert transform, the smallest distance over all phases is

    .. math:: \min_\varphi \|r' - \cos\varphi\, r - \sin\varphi\, Hr\|^2
        = \|r'\|^2 + \|r\|^2 - 2 \sqrt{(r' \cdot r)^2 + (r' \cdot Hr)^2}

    for outputs without offset, whose r and Hr are orthogonal and equally strong.

    Examples
    --------
    >>> u = np.sin(2 * np.pi * np.arange(100) / 10)
    >>> float(relative_change(-u, u)), float(relative_change(1.25 * u, u)), float(relative_change(np.roll(u, 3), u)) > 1
    (0.0, 0.25, True)
    >>> float(relative_change(np.roll(u, 3), u, free="phase").round(6))
    0.0
    """
    if free not in {"sign", "phase"}:
        raise ValueError(f"free: got {free!r}, allowed is 'sign' or 'phase'")
    distance = _phase_free(changed, output) if free == "phase" else _sign_free(changed, output)
    strength = np.linalg.norm(output, axis=-1)
    silent = np.where(distance > 0, UNRELATED, 0.0)
    known = np.broadcast_to(strength > 0, distance.shape)
    relative = np.divide(distance, strength, out=np.array(silent), where=known)
    return np.asarray(np.minimum(relative, UNRELATED))


def admit_moving(recording: Recording, draws: int) -> tuple[Samples, float]:
    """Check what a change is measured on.

    Parameters
    ----------
    recording : Recording
        To be no silence.
    draws : int
        To be at least 1.

    Returns
    -------
    samples : ndarray, shape (3, n)
        The recording's.
    strength : float
        Root of its energy.

    Raises
    ------
    ValueError
        If the recording is silent or there are no draws.
    """
    samples = recording.acceleration
    strength = float(np.linalg.norm(samples))
    if strength == 0:
        raise ValueError(f"recording {recording.name!r}: is silent, so no change can be related to it; leave it out")
    if draws < 1:
        raise ValueError(f"draws: got {draws}, allowed is 1 or more")
    return samples, strength


def summarise(changes: Samples) -> Change:
    """Summarise changes over draws.

    Parameters
    ----------
    changes : ndarray, shape (draws,)
        One per draw.

    Returns
    -------
    Change
        Median, worst and 90th percentile.
    """
    return Change(float(np.median(changes)), float(changes.max()), float(np.quantile(changes, 0.9)))


def _sign_free(changed: Samples, output: Samples) -> Samples:
    apart = np.linalg.norm(changed - output, axis=-1)
    return np.asarray(np.minimum(apart, np.linalg.norm(changed + output, axis=-1)))


def _phase_free(changed: Samples, output: Samples) -> Samples:
    from scipy.signal import hilbert

    analytic = hilbert(output)
    along = np.abs(np.einsum("...n,...n->...", changed, analytic))
    energies = np.square(changed).sum(axis=-1) + np.square(output).sum(axis=-1)
    return np.asarray(np.sqrt(np.maximum(energies - 2 * along, 0.0)))
