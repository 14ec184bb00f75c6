"""Types that signatures name, for annotations in a lab's own code; and the names of reducers and metrics.

What each metric declares is data here, for what reads tables and needs no signals.
"""

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from feel321.arguments import Registry

__all__ = [
    "Direction", "Level", "Method", "Metric", "MetricInfo", "PathLike", "Progress", "Reducer", "Rng", "Samples",
]  # fmt: skip

Samples: TypeAlias = NDArray[np.float64]
"""Real numbers; the docstring that names it gives their shape and unit."""
PathLike: TypeAlias = str | os.PathLike[str]
"""A path to a file or folder."""
Rng: TypeAlias = int | np.random.Generator
"""A seed, or a generator that is used up as it is drawn from."""
Progress: TypeAlias = bool | Callable[[int, int], None]
"""Whether to show a progress bar; or a function called with the numbers of steps done and to do."""
Level: TypeAlias = Literal["as_is", "equal_intensity"]
"""How the gain of stimuli is chosen: see `feel321.stimuli.LEVELS`."""
Method: TypeAlias = Literal["pearson", "spearman", "kendall"]
"""A kind of correlation."""
Direction: TypeAlias = Literal["better", "worse"]
"""Which way a metric points: whether a larger value means a better match or a worse one."""


class Reducer(Protocol):
    """A 321 transform."""

    def __call__(self, acceleration: Samples, rate_hz: float, /) -> Samples:
        """Reduce three axes, shape (..., 3, n), to one, shape (..., n)."""


class Metric(Protocol):
    """A measure of how well a reduced signal matches its recording."""

    def __call__(self, acceleration: Samples, reduced: Samples, rate_hz: float, /) -> float:
        """Compare three axes, shape (3, n), with one, shape (n,)."""


@dataclass(frozen=True, slots=True)
class MetricInfo:
    """What a metric declares of itself: which way it points, the ends of its range, and how it is named on a page.

    higher: whether a larger value means a better match or a worse one. low, high: its bounds, infinite where it has
    none. unit: as a reader sees it, empty for a pure number.
    """

    label: str
    higher: Direction = "better"
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse a direction that is none, and bounds out of order."""
        if self.higher not in get_args(Direction):
            raise ValueError(f"higher must be 'better' or 'worse', got {self.higher!r}")
        if not self.low < self.high:
            raise ValueError(f"low must be below high, got {self.low} and {self.high}")


MOST_DB = 60.0  # levels further apart count as this far apart: people feel some 55 dB

REDUCER_NAMES = (
    "sax321", "say321", "saz321", "soc321", "mag321", "pca321", "pca321_adaptive", "dft321", "dft321_windowed",
    "dft321_principal", "dft321_principal_windowed", "sax321_matched", "say321_matched", "saz321_matched",
    "pca321_matched", "sax321_matched_running", "say321_matched_running", "saz321_matched_running",
    "pca321_matched_windowed", "dft321_bands", "dft321_filtered",
)  # fmt: skip
"""In the order of the paper, simplest first; later ones follow. The only list of names."""

_WORSE_DB: tuple[Direction, float, float, str] = ("worse", 0.0, MOST_DB, "dB")
METRIC_INFO: Mapping[str, MetricInfo] = Registry("metric", {
    "spectral_match": MetricInfo("spectral match", high=1.0),
    "temporal_match": MetricInfo("temporal match", low=0.0, high=1.0),
    "spectral_match_bounded": MetricInfo("bounded spectral match", low=0.0, high=1.0),
    "temporal_match_windowed": MetricInfo("temporal match in windows", low=0.0, high=1.0),
    "level_difference": MetricInfo("level difference", *_WORSE_DB),
    "log_spectral_distance": MetricInfo("log-spectral distance", *_WORSE_DB),
    "pacinian_power_difference": MetricInfo("Pacinian power difference", *_WORSE_DB),
    "envelope_correlation": MetricInfo("envelope correlation", "better", -1.0, 1.0),
    "modulation_distance": MetricInfo("modulation spectrum distance", "worse", 0.0),
    "st_sim": MetricInfo("ST-SIM", "better", 0.0, 1.0),
    "spqi": MetricInfo("SPQI", "better", 0.0, 1.0),
})  # fmt: skip
"""Name of a metric, the match metrics first -> which way it points, its bounds, and how it is called on a page."""

MATCHES = ("spectral_match", "temporal_match", "spectral_match_bounded")
"""The match metrics: what is compared with delivered signals and over orientations, too."""

WRITTEN = (*MATCHES, "temporal_match_windowed")  # the metrics that `build` writes
ANCHOR = "anchor"  # the role of anchors in the manifest
ANCHOR_NAMES = ("anchor_low", "anchor_mid")
