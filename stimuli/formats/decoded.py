"""What goes into a format's reader and what comes out, before units and sampling are settled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.recording import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Request:
    """What the caller says about the file.

    Parameters
    ----------
    rate_hz : float, optional
        Sampling rate in Hz.
    unit : str, optional
        Unit of the samples, a key of `stimuli.recording.UNITS`.
    columns : sequence of str or int, optional
        (x, y, z) or (time, x, y, z): names, or numbers from 0.
    full_scale : float, optional
        What full scale of an integer WAV means, in the unit.
    resample : bool
        Whether irregular sampling is made regular instead of refused.
    """

    rate_hz: float | None = None
    unit: str | None = None
    columns: Sequence[str | int] | None = None
    full_scale: float | None = None
    resample: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """What a file says of itself.

    Parameters
    ----------
    acceleration : ndarray of float64, shape (3, n_samples)
        Samples in the file's unit.
    unit : str, optional
        The unit that the file names, a key of `stimuli.recording.UNITS`.
    rate_hz : float, optional
        The rate that the file names, in Hz.
    time_s : ndarray of float64, shape (n_samples,), optional
        Time stamps in s.
    time_step_s : float
        The smallest step in s that the stamps can show.
    first_line : int, optional
        The line of a text file that holds the first sample, from 1.
    notes : tuple of str
        What the reader had to assume.
    sources : tuple of Path
        The files that were read, in the order in which they are hashed; empty means the one file.
    name : str
        What to call the recording; empty means the file's stem.
    """

    acceleration: NDArray[np.float64]
    unit: str | None = None
    rate_hz: float | None = None
    time_s: NDArray[np.float64] | None = None
    time_step_s: float = 0.0
    first_line: int | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[Path, ...] = ()
    name: str = ""


def stack_axes(axes: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Stack three axes of equal length; never shorten one to fit.

    Parameters
    ----------
    axes : mapping of str to ndarray, shape (n_samples,)
        The samples of each axis, by "x", "y", "z".

    Returns
    -------
    ndarray of float64, shape (3, n_samples)
        In the order x, y, z.

    Raises
    ------
    ValueError
        If an axis is missing, or the lengths differ.
    """
    if len(axes) < AXES:
        got = f"only the axes {', '.join(sorted(axes))}" if axes else "no axes"
        raise ValueError(f"got {got}, allowed is three axes x, y, z; a reduction needs all three")
    lengths = {axis: axes[axis].size for axis in "xyz"}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{axis} {n}" for axis, n in lengths.items())
        raise ValueError(f"got axes of unequal length ({counts} samples), allowed is one length; cut them alike")
    return np.stack([axes[axis] for axis in "xyz"])


def as_three_axes(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn an array to (3, n_samples), or say why it is not three axes.

    Parameters
    ----------
    values : ndarray of float64
        Shape (3, n_samples), or (n_samples, 3) with more than three samples.

    Returns
    -------
    ndarray of float64, shape (3, n_samples)
        The same samples.

    Raises
    ------
    ValueError
        If one axis (already reduced), two, or more than three are there.
    """
    if values.size == 0:
        raise ValueError(f"got an empty array of shape {values.shape}, allowed is (3, n) or (n, 3)")
    if values.ndim == 2 and values.shape[0] == AXES:  # noqa: PLR2004 - axes x samples
        return values
    if values.ndim < 2 or (values.ndim == 2 and 1 in values.shape):  # noqa: PLR2004 - axes x samples
        raise already_reduced(f"an array of shape {values.shape}")
    if values.ndim == 2 and values.shape[1] == AXES:  # noqa: PLR2004 - axes x samples
        return values.T
    raise ValueError(f"got an array of shape {values.shape}, allowed is (3, n) or (n, 3): exactly three axes")


def already_reduced(got: str) -> ValueError:
    """Return the refusal of a signal with one axis.

    Parameters
    ----------
    got : str
        What was found.

    Returns
    -------
    ValueError
        To be raised.
    """
    return ValueError(
        f"got {got}: one channel, so already reduced to one axis; allowed is the raw three-axis recording"
    )
