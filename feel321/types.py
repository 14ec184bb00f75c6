"""Types that signatures name: for annotations in a lab's own code."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

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
