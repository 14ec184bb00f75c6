"""What a power analysis is about: the truth planted in a study, its design, and the stimuli that it draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.primary.plan import ITEM, REDUCER, SCENE, SOURCE

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Samples

    Codes = NDArray[np.intp]

LEVEL = 0.05  # Of all tests of a study together, by Holm's method
ENOUGH = 0.8  # Power that is asked for

LEAST = {"participants": 6, "recordings": 4, "reducers": 3}
"""No smaller study is advised, however large the slope: intervals over fewer are too unsure of themselves."""

SIZES = ("participants", "recordings", "reducers", "repeats")  # What a plan varies

GROUPS = {
    "person_sd": "participant", "recording_sd": SCENE, "item_sd": ITEM, "reducer_sd": REDUCER,
    "person_recording_sd": f"participant:{SCENE}", "person_reducer_sd": f"participant:{REDUCER}",
}  # fmt: skip
"""Standard deviation of a truth -> grouping factor of the primary model."""

SPREADS = (*GROUPS, "person_item_sd", "rating_sd")
"""Standard deviations of a truth, in points; those of slopes are apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true of people and stimuli in simulated studies; attributes have the same truth, and are independent.

    Ratings are ``mean + slope x (metric - its mean over the stimulus set)``, plus what people, recordings, stimuli and
    reducers differ by, rounded to `step` and, if `bounded`, kept within 0 to 100.

    slopes: ``metric`` or ``attribute/metric`` -> points per unit of the metric, 0 where left out. slope_sds,
    recording_slope_sds: metric -> standard deviation of people's and of recordings' own slopes; where left out, as much
    as makes them differ by so many points over one standard deviation of the metric within recordings. The others are
    standard deviations in points: of people, recordings, stimuli and reducers for everyone, of the same for one person
    besides, and of two ratings of one stimulus by one person. source: where they come from, in words.

    The defaults are rounded estimates of the primary model on ratings of 70 videos by 26 people (Netflix Public, 0 to
    100). Nothing was rated twice there: how single ratings (14.9 points) divide into `person_item_sd` and `rating_sd`
    is an assumption.
    """

    slopes: Mapping[str, float] = field(default_factory=dict)
    slope_sds: Mapping[str, float] = field(default_factory=dict)
    recording_slope_sds: Mapping[str, float] = field(default_factory=dict)
    slope_points: float = 3.0
    recording_slope_points: float = 3.0
    person_sd: float = 8.0
    recording_sd: float = 5.0
    item_sd: float = 7.0
    reducer_sd: float = 5.0
    person_recording_sd: float = 5.0
    person_reducer_sd: float = 2.0
    person_item_sd: float = 8.0
    rating_sd: float = 12.5
    mean: float = 50.0
    step: float = 0.1
    bounded: bool = True
    source: str = "ratings of 70 videos by 26 people (Netflix Public); no pilot data"

    def find_slope(self, attribute: str, metric: str) -> float:
        """Find the planted slope of one hypothesis, in points per unit of the metric."""
        return float(self.slopes.get(f"{attribute}/{metric}", self.slopes.get(metric, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Stimuli:
    """The stimuli of one study; scene, kind, source: codes, (n_items,); metrics: (n_items, n_metrics)."""

    scene: Codes
    kind: Codes
    source: Codes
    metrics: Samples

    @property
    def within(self) -> Samples:
        """Every metric minus its mean over the recording, (n_items, n_metrics)."""
        counts = np.bincount(self.scene).astype(np.float64)
        sums = np.zeros((len(counts), self.metrics.shape[1]))
        np.add.at(sums, self.scene, self.metrics)
        within: Samples = self.metrics - (sums / counts[:, None])[self.scene]
        return within


@dataclass(frozen=True, eq=False)
class PowerDesign:
    """The design of a study that is planned, and the truth planted in it.

    items: a row per test stimulus: recording, reducer, item, source where several recordings come from one, and a
    column per metric. metrics: those of the primary model. attributes: what people rate; each has a model. repeats:
    ratings that one person gives to one stimulus on one attribute; the analysis averages them.

    recordings, reducers: how many the study has, as many as `items` if left out. With another number every simulated
    study draws its own from those of `items`: without replacement, and where more are asked for, each as often as every
    other but for one. A recording keeps its reducers' metrics; a second copy counts as another recording with the same
    metrics.
    """

    items: DataFrame
    metrics: tuple[str, ...]
    truth: Truth
    attributes: tuple[str, ...] = ("rating",)
    participants: int = 20
    repeats: int = 1
    recordings: int = 0
    reducers: int = 0
    wanted: float = ENOUGH

    def __post_init__(self) -> None:
        """Count the recordings and reducers, and refuse a power that is no aim."""
        for name, own in zip(("recordings", "reducers"), self._count_own(), strict=True):
            object.__setattr__(self, name, int(getattr(self, name)) or own)
        if not LEVEL < self.wanted < 1:
            raise ValueError(f"wanted must be between {LEVEL} and 1, got {self.wanted}")

    def _count_own(self) -> tuple[int, int]:
        return int(self.items[SCENE].nunique()), int(self.items[REDUCER].nunique())

    @property
    def hypotheses(self) -> tuple[tuple[str, str], ...]:
        """Attribute and metric of every slope that is tested; Holm's method is over these."""
        return tuple(product(self.attributes, self.metrics))

    @property
    def level(self) -> float:
        """Level of the first step of Holm's method: 0.05 over the number of hypotheses."""
        return LEVEL / len(self.hypotheses)

    @property
    def sizes(self) -> dict[str, int]:
        """The numbers that distinguish it from other designs of a plan."""
        return {name: int(getattr(self, name)) for name in SIZES}

    @property
    def is_own(self) -> bool:
        """Whether the study has just the recordings and reducers of `items`."""
        return (self.recordings, self.reducers) == self._count_own()

    @property
    def trials(self) -> int:
        """Ratings that one person gives: stimuli, on average over what is drawn, x repeats x attributes."""
        scenes, kinds = self._count_own()
        n_items = round(len(self.items) * self.recordings * self.reducers / (scenes * kinds))
        return n_items * self.repeats * len(self.attributes)

    @cached_property
    def stimuli(self) -> Stimuli:
        """The stimuli of the whole set."""
        scene, kind = (self.items[name].factorize()[0] for name in (SCENE, REDUCER))
        source = self.items[SOURCE if SOURCE in self.items else SCENE].factorize()[0]
        return Stimuli(scene, kind, source, self.items[list(self.metrics)].to_numpy(np.float64))

    @cached_property
    def slope_sds(self) -> Samples:
        """Standard deviations of people's own slopes, (n_metrics,)."""
        return self._settle(self.truth.slope_sds, self.truth.slope_points)

    @cached_property
    def recording_slope_sds(self) -> Samples:
        """Standard deviations of recordings' own slopes, (n_metrics,)."""
        return self._settle(self.truth.recording_slope_sds, self.truth.recording_slope_points)

    def _settle(self, given: Mapping[str, float], points: float) -> Samples:
        within = self.stimuli.within.std(axis=0, ddof=1)
        pairs = zip(self.metrics, points / np.where(within > 0, within, np.inf), strict=True)
        return np.array([given.get(name, own) for name, own in pairs], dtype=np.float64)

    def draw(self, rng: np.random.Generator) -> Stimuli:
        """Draw a study's recordings and reducers from the set; all of them if it has just these."""
        whole = self.stimuli
        if self.is_own:
            return whole
        place = np.full((whole.scene.max() + 1, whole.kind.max() + 1), -1)
        place[whole.scene, whole.kind] = np.arange(len(whole.scene))
        scenes, copies = _pick(len(place), self.recordings, rng)
        kinds, _ = _pick(place.shape[1], self.reducers, rng)
        chosen = place[np.ix_(scenes, kinds)]
        scene, kind = np.nonzero(chosen >= 0)
        item = chosen[scene, kind]
        source = np.unique(whole.source[item] + copies[scene] * len(place), return_inverse=True)[1]
        return Stimuli(scene, kind, source, whole.metrics[item])


def _pick(count: int, wanted: int, rng: np.random.Generator) -> tuple[Codes, Codes]:
    """Pick a number of things, each as often as every other but for one, and number the copies of each."""
    whole, rest = divmod(wanted, count)
    left = np.sort(rng.choice(count, rest, replace=False)) if rest else np.empty(0, np.intp)
    picked = np.concatenate([np.tile(np.arange(count), whole), left]).astype(np.intp)
    return picked, np.arange(wanted) // count
