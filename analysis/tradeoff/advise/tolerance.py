"""How far from the best is still as good: every tolerance follows from one Weber fraction, 22 %.

People notice a change of vibration intensity of about a fifth; below that, two vibrations are equally strong to them.
Published fractions lie between 0.4 and 2.3 dB. The 22 % are taken here as a share of *energy* (0.86 dB), the cautious
end of that range: "sufficient" is a claim that nothing is felt to be missing, and faults of several bands add up.
Energy is also what the metrics compare, so one number serves all of them:

- *Level* (felt level of the output against the recording's, in dB): ``10 log10(1 + w)``, weaker or stronger.
- *Spectrum* (`spectral_match_energy_weighted`, the share of energy common to both spectra, in bands as wide as people
  confuse frequencies): ``w``. A match that is lower by w means that a further share w of the energy is missing or
  misplaced.
- *Time* (`temporal_match_invariant`; its square is the share of the motion's energy that goes along with the output):
  that share may fall by ``w`` of the best's. The best is the projection on the first principal axis, by theorem.
- *Steadiness* (change of the output, up to its sign, under sensor noise of -60 dB): ``sqrt(1 + w) - 1``, the amplitude
  which in phase with the output changes its energy by w. An output that depends on noise more than that is not
  determined by the scene.

The paper's own metrics are reported, but do not count. Its spectral match weighs a band without energy like any other:
on a shaker with 99.9 % of its energy on one axis, that axis alone scores 0.61, for the sensor noise of the two others.
Its temporal match rewards the sensor's own diagonal and changes with the mounting. Their means over random mountings do
not count either: a scene comes with the mounting it was recorded with, and an axis that carries everything *there* is
enough there. For a reducer whose output turns with the sensor the invariant counterparts are their own rotation means.

References
----------
.. [1] N. Landin et al., EuroHaptics 2010, section 3. doi:10.1007/978-3-642-14075-4_12
.. [2] J. C. Craig, "Difference threshold for intensity of tactile stimuli", Perception & Psychophysics 11, 1972.
   doi:10.3758/BF03210362
.. [3] G. A. Gescheider, S. J. Bolanowski, R. T. Verrillo, D. J. Arpajian, T. F. Ryan, "Vibrotactile intensity
   discrimination measured by three methods", JASA 87(1), 1990. doi:10.1121/1.399300
"""

from __future__ import annotations

import math
from dataclasses import dataclass

WEBER_FRACTION = 0.22


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What follows from a Weber fraction of intensity.

    Parameters
    ----------
    weber : float
        Smallest relative change of a vibration's energy that counts as felt.

    Raises
    ------
    ValueError
        If it is not above 0 and below 1.

    Examples
    --------
    >>> round(Tolerance().level_db, 2), round(Tolerance().change, 3)
    (0.86, 0.105)
    """

    weber: float = WEBER_FRACTION

    def __post_init__(self) -> None:
        """Refuse what is no fraction."""
        if not 0 < self.weber < 1:
            raise ValueError(f"tolerance: got {self.weber:g}, allowed is above 0 and below 1; 0.22 is people's own")

    @property
    def level_db(self) -> float:
        """Deviation of the felt level in dB."""
        return 10 * math.log10(1 + self.weber)

    @property
    def spectrum(self) -> float:
        """Difference of the spectral match (invariant form)."""
        return self.weber

    @property
    def time(self) -> float:
        """Relative loss of the motion's energy that goes along with the output: of the squared temporal match."""
        return self.weber

    @property
    def change(self) -> float:
        """Relative change of the output under sensor noise."""
        return math.sqrt(1 + self.weber) - 1
