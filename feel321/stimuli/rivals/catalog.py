"""RIVALS: every rival metric, measured on pairs or batches of them, and why it may be NaN."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from numpy.typing import ArrayLike

from feel321.doors import Registry
from feel321.stimuli.rivals import codecs, envelope, spectra
from feel321.stimuli.rivals.pairs import Pair, make_pairs
from feel321.types import Samples

SILENT = "the recording has no energy from 20 to 1000 Hz, or is too short for any frequency there"
SHORT = f"{SILENT}, or is shorter than a block of 64 ms"


class Rival(NamedTuple):
    """A rival metric of pairs, and the reason where it is NaN."""

    measure: Callable[[Pair], Samples]
    reason: str = SILENT


_ALL = (
    Rival(spectra.level_difference),
    Rival(spectra.log_spectral_distance),
    Rival(spectra.itakura_saito_distance),
    Rival(spectra.balance_difference, f"{SILENT}, or none on one side of 141 Hz"),
    Rival(spectra.pacinian_power_difference),
    Rival(spectra.spectral_intensity_distance),
    Rival(envelope.segment_intensity_difference),
    Rival(envelope.envelope_correlation, f"{SILENT}, or its envelope does not vary at up to 50 Hz"),
    Rival(envelope.modulation_distance, f"{SILENT}, or is shorter than 20 ms"),
    Rival(codecs.st_sim, f"{SHORT}, or cannot be felt (samples in m/s^2?)"),
    Rival(codecs.spqi, SHORT),
)

RIVALS: Registry[Rival] = Registry("rival metric", {one.measure.__name__: one for one in _ALL})
"""Name -> rival metric, the baseline first."""


def measure_batch(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float
) -> Mapping[str, Samples]:
    """Measure every rival of recordings, (..., 3, n), and as many reduced signals, (..., n): by name, (...)."""
    pair = make_pairs(acceleration, reduced, rate_hz)
    return {name: rival.measure(pair) for name, rival in RIVALS.items()}
