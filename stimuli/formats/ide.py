"""enDAQ recordings (.IDE), read by the optional package idelib."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from stimuli.formats.decoded import Decoded
from stimuli.formats.errors import foreign_errors
from stimuli.formats.units import ACCELERATION_SPELLINGS, normalise
from stimuli.recording import AXES

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

LOST_SAMPLE = 1.5
"""An interval of so many periods means that samples were lost; less is the coarse clock of the blocks."""


def read_ide(path: Path, _: Request) -> Decoded:
    """Read the triaxial accelerometer with the highest rate.

    Parameters
    ----------
    path : Path
        The recording.

    Returns
    -------
    Decoded
        Calibrated samples at the mean rate, because the recorder stamps blocks of samples on a coarse clock.
        Only where samples were lost are the time stamps kept, to be refused or resampled.

    Raises
    ------
    ValueError
        If idelib is not installed, the file is damaged, or no accelerometer has three axes.
    """
    try:
        from idelib import importer
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[ide]'"
        raise ValueError(f"got an enDAQ recording, which idelib reads; {how}") from None
    # Opened here, because idelib leaves a file that it cannot read open.
    with foreign_errors("an enDAQ recording"), path.open("rb") as stream:
        dataset = importer.openFile(stream, quiet=True)
        importer.readData(dataset)
        triaxial = [c for c in dataset.channels.values() if c.sessions and len(_axes(c)) == AXES]
        found = [_read_channel(channel) for channel in triaxial]
    measured = [(samples, unit) for samples, unit in found if samples.shape[1] > 1]
    if not measured:
        raise ValueError("got no accelerometer with three axes and samples, allowed is a triaxial recording")
    samples, unit = max(measured, key=lambda pair: _rate_hz(pair[0][0]))
    time_s = samples[0] - samples[0, 0]
    even = bool(np.diff(time_s).max() * _rate_hz(time_s) < LOST_SAMPLE)
    return Decoded(samples[1:], unit, _rate_hz(time_s)) if even else Decoded(samples[1:], unit, time_s=time_s)


def _axes(channel: Any) -> dict[str, int]:  # noqa: ANN401 - idelib is not typed
    """Return the row of each axis: the recorder's order is not always x, y, z."""
    rows: dict[str, int] = {}
    for row, subchannel in enumerate(channel.subchannels or ()):
        match = re.search(r"\b([xyz])\b", str(subchannel.name), re.IGNORECASE)
        if match and _unit(subchannel):
            rows[match[1].lower()] = row
    return rows


def _unit(subchannel: Any) -> str | None:  # noqa: ANN401 - idelib is not typed
    """Return the unit of acceleration, or None for what is no acceleration."""
    label_and_unit = subchannel.units or ("", "")
    return ACCELERATION_SPELLINGS.get(normalise(str(label_and_unit[1])))


def _read_channel(channel: Any) -> tuple[NDArray[np.float64], str | None]:  # noqa: ANN401 - idelib is not typed
    """Return time in s and the three axes, shape (4, n_samples), and their unit."""
    rows = _axes(channel)
    values = np.asarray(channel.getSession().arraySlice(), dtype=np.float64)
    stacked = np.stack([values[0] * 1e-6, *(values[1 + rows[axis]] for axis in "xyz")])
    return stacked, _unit(channel.subchannels[rows["x"]])


def _rate_hz(time_s: NDArray[np.float64]) -> float:
    return float((time_s.size - 1) / (time_s[-1] - time_s[0]))
