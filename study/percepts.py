"""How far every stimulus of a set is from its recording's original, for the sense of touch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Percept:
    """What the hand tells a stimulus from its recording's original by.

    Parameters
    ----------
    spectral_db : float
        Distance of the spectra above threshold in dB, whatever the levels; 0 for the original.
    envelope : float
        Distance of the envelopes, whatever the levels; 0 for the original, 1 for nothing in common.
    level_db : float
        Felt level above that of the original in dB.
    """

    spectral_db: float
    envelope: float
    level_db: float
