"""Which raters may not have done what they were asked? Rules with limits, and lists of whom they hit.

judgements (a tidy table, prepared), anchors (ITU-R BS.1534-3), habits (one participant at a time), fences (against
the others), gauge (expertise against a permutation null), rules (the one list), screen (`screen_raters`, from end to
end). Nothing here removes anybody: a hit is a reason to look, and a deletion needs a documented error.
"""

from analysis.screening.fences import multimodality, tukey_fences, tukey_hinges
from analysis.screening.rules import RULES, Rule
from analysis.screening.screen import Screening, screen_raters

__all__ = ["RULES", "Rule", "Screening", "multimodality", "screen_raters", "tukey_fences", "tukey_hinges"]
