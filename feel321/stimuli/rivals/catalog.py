"""RIVALS: every rival metric, how batches are measured, and why it may be NaN."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from numpy.typing import ArrayLike

from feel321.doors import Registry
from feel321.stimuli.rivals import (
    balance,
    codecs,
    envelope,
    level,
    log_spectral,
    pacinian,
    segments,
)
from feel321.stimuli.rivals.pairs import Pair, make_pairs
from feel321.types import Metric, Samples

SILENT = "the recording has no energy from 20 to 1000 Hz, or is too short for any frequency there"


class Rival(NamedTuple):
    """A rival metric: as any metric is called, over batches, and the reason where it is NaN."""

    metric: Metric
    measure: Callable[[Pair], Samples]
    reason: str = SILENT


SHORT = f"{SILENT}, or is shorter than a block of 64 ms"

_ALL = (
    Rival(level.level_difference, level.measure_level),
    Rival(log_spectral.log_spectral_distance, log_spectral.measure_log_spectral),
    Rival(log_spectral.itakura_saito_distance, log_spectral.measure_itakura_saito),
    Rival(balance.balance_difference, balance.measure_balance,
          f"{SILENT}, or none on one side of 141 Hz"),
    Rival(pacinian.pacinian_power_difference, pacinian.measure_power),
    Rival(pacinian.spectral_intensity_distance, pacinian.measure_intensity),
    Rival(segments.segment_intensity_difference, segments.measure_segments),
    Rival(envelope.envelope_correlation, envelope.measure_correlation,
          f"{SILENT}, or its envelope does not vary at up to 50 Hz"),
    Rival(envelope.modulation_distance, envelope.measure_modulation,
          f"{SILENT}, or is shorter than 20 ms"),
    Rival(codecs.st_sim, codecs.measure_st_sim, f"{SHORT}, or cannot be felt (samples in m/s^2?)"),
    Rival(codecs.spqi, codecs.measure_spqi, SHORT),
)  # fmt: skip

RIVALS: Registry[Rival] = Registry("rival metric", {rival.metric.__name__: rival for rival in _ALL})  # type: ignore[attr-defined]  # functions, all of them
"""Name -> rival metric, the baseline first."""


def measure_batch(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float
) -> Mapping[str, Samples]:
    """Measure every rival of recordings, (..., 3, n), and as many reduced signals, (..., n): by name, (...)."""
    pair = make_pairs(acceleration, reduced, rate_hz)
    return {name: rival.measure(pair) for name, rival in RIVALS.items()}
