"""Numbered WAV files of what was delivered.

Numbers, not names: the experimenter is not to read off the files what was played.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.wav import write_wav

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike


def write_delivered(folder: Path, samples: ArrayLike, *, rate_hz: float) -> int:
    """Write samples under the next free number.

    Parameters
    ----------
    folder : Path
        Where; made if missing. Files that are there are kept.
    samples : array_like, shape (n,) or (channels, n)
        What to write.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    int
        The number.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [int(path.stem) for path in folder.glob("*.wav") if path.stem.isdecimal()]
    number = max(numbers, default=0) + 1
    write_wav(folder / f"{number:04}.wav", samples, rate_hz)
    return number
