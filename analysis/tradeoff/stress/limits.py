"""MEASURES: what is measured per reducer and scene, from where on it counts as a failure, and why from there.

Every limit is argued from one figure, in `why`: the paper's Weber fraction of vibration, 22 %, taken of the amplitude
(1.7 dB). A caution is about half way to a failure.

References
----------
.. [1] N. Landin et al., EuroHaptics 2010, section 3 (22 % Weber fraction) and Table 1.
   doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

    Grade = Literal["good", "caution", "fails", "undefined"]


@dataclass(frozen=True, slots=True)
class Measure:
    """A figure per reducer and scene, and its limits.

    Parameters
    ----------
    name : str
        Key in `MEASURES`.
    letter : str
        For the heat map.
    title : str
        For tables.
    brief : str
        For the heat map's key.
    unit : str
        Of the figure; empty for a ratio.
    caution, fails : float
        From where on; the sign of the figure does not count.
    what : str
        What the figure says, in one sentence.
    why : str
        Why it fails from there on.
    """

    name: str
    letter: str
    title: str
    brief: str
    unit: str
    caution: float
    fails: float
    what: str
    why: str

    def grade(self, value: float) -> Grade:
        """Judge a figure.

        Parameters
        ----------
        value : float
            The figure; NaN where it is not defined.

        Returns
        -------
        {"good", "caution", "fails", "undefined"}
            A figure on a limit is beyond it.

        Examples
        --------
        >>> [MEASURES["gain"].grade(value) for value in (1.0, 3.0, 1230.0)]
        ['good', 'caution', 'fails']
        """
        if math.isnan(value):
            return "undefined"
        return "fails" if abs(value) >= self.fails else "caution" if abs(value) >= self.caution else "good"


_WEBER = "a change of 22 % of the waveform is the paper's Weber fraction of vibration"
_MEASURES = (
    Measure("gain", "G", "Perturbation gain", "gain", "", 3.0, 10.0,
            "How many times more the output changes than the input, under sensor noise 60 dB below the recording.",
            "sensor noise of 10 mg on a drag of 5 m/s² (2 %) then changes 20 % of the output, a Weber fraction; "
            "from 3 on it changes 6 %."),
    Measure("rotation", "R", "Change under rotation", "output changes under rotation", "", 0.1, 0.22,
            "How much the output itself changes if the sensor is glued on in a random other orientation.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("flip", "F", "Change under a flipped axis", "under a flipped axis", "", 0.1, 0.22,
            "How much the output changes if one axis has the other sign (the worst of the three).",
            f"{_WEBER}; the caution is about half of it."),
    Measure("shift", "S", "Change under a shift", "under a shift in time", "", 0.1, 0.22,
            "How much the output changes if the same motion begins up to one window later.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("edge", "W", "Window-edge error", "energy moved across window edges", "", 0.1, 0.2,
            "Which share of the energy the output puts into another half window than the recording has it in.",
            "0.2 is a mean change of the half windows' energy by 40 % (1.5 dB), about a Weber fraction of the "
            "amplitude (1.7 dB)."),
    Measure("energy", "E", "Energy error", "energy error", "dB", 1.5, 3.0,
            "How much stronger or weaker the output vibrates than the recording.",
            "from 1.5 dB on it nears a Weber fraction of the amplitude (1.7 dB); 3 dB is nearly two: half or double "
            "the energy."),
    Measure("spread", "M", "Spread of the metrics", "SD of a metric over rotations", "", 0.05, 0.1,
            "Standard deviation of the match metrics over random orientations of the sensor, the larger of the two.",
            "in the paper's Table 1 the better methods lie 0.1 apart in temporal match (0.40, 0.46, 0.51): "
            "the mounting then decides as much as the method."),
    Measure("fault", "D", "Damage by the fault", "fault amplified", "", 1.5, 2.0,
            "How many times more the output changes than the input, by the fault of the scene (clipping, steps, gaps, "
            "clocks).",
            "at 2 the method does as much harm as the sensor did."),
)  # fmt: skip

MEASURES: Mapping[str, Measure] = MappingProxyType({measure.name: measure for measure in _MEASURES})
"""Name -> measure, the heat map's own first."""
