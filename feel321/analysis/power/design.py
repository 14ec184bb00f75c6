"""The design of a study that is planned, the truth planted in it, and its power in closed form.

SE² = σ_S²/P + V_C + 1 / (SS_w/v + SS_r/(v + m v_r)): slopes differ by σ_S between P people; v = σ_I² + (σ_PI² +
σ_e²/K)/P of a stimulus and v_r = σ_R² + σ_PR²/P of a reducer in m recordings; SS_r is the sum of squares of the metric
that is the same for a reducer in all recordings, SS_w what is left. V_C comes from slopes that differ between
recordings, those of all metrics: with weights w of the stimuli, Σ_k σ_Ck² Σ_recordings (Σ w x_k)². Recordings and
stimuli do not become more with participants: they set the ceiling of what a study can know. What only reducers tell
(SS_r) becomes no more with recordings either, because m grows with SS_r.

That is the standard error of generalised least squares, with degrees of freedom of Welch and Satterthwaite and the
level of Holm's first step. V_C is that of an estimate that does not know it: the whole is 4 to 9 % more than with the
best weights, in designs of 4 to 20 recordings. The ends of the scale and the penalty of few reducers are not in it.
Where a design draws its recordings or reducers, power is the mean over draws. A draw whose slope is not estimable,
which has no test in the report either, counts as no power.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame
from scipy.optimize import brentq
from scipy.stats import nct, norm, t

from feel321.analysis.primary.model import FEWEST, FEWEST_DF
from feel321.analysis.primary.plan import ITEM, REDUCER, SCENE, SOURCE, find_most_df
from feel321.types import Samples

Codes = NDArray[np.intp]
LEVEL = 0.05  # Of all tests of a study together, by Holm's method
ENOUGH = 0.8  # Power that is asked for
SIZES = ("participants", "recordings", "reducers", "repeats")  # What a plan varies
# No smaller study is advised, however large the slope: intervals over fewer are too unsure of themselves.
LEAST = {"participants": 6, "recordings": 4, "reducers": 3}
MOST = {"participants": 10_000, "recordings": 1000}  # Nobody recruits or records more
DRAWS = 25  # Of stimuli, where a design draws them
WIDER = (20, 100, 1000, 10_000)  # Standard errors within which the detectable slope is sought
FLAT = 1e-9  # Share of a metric's size below which what the others leave of it is rounding
# Standard deviation of a truth -> grouping factor of the primary model
GROUPS = {
    "person_sd": "participant", "recording_sd": SCENE, "item_sd": ITEM, "reducer_sd": REDUCER,
    "person_recording_sd": f"participant:{SCENE}", "person_reducer_sd": f"participant:{REDUCER}",
}  # fmt: skip


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
        marks = np.eye(int(self.scene.max()) + 1)[self.scene]
        means: Samples = marks.T @ self.metrics / marks.sum(axis=0)[:, None]
        return self.metrics - means[self.scene]


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
        for name, own in zip(("recordings", "reducers"), self._own, strict=True):
            object.__setattr__(self, name, int(getattr(self, name)) or own)
        if not LEVEL < self.wanted < 1:
            raise ValueError(f"wanted must be between {LEVEL} and 1, got {self.wanted}")

    @property
    def _own(self) -> tuple[int, int]:
        """Recordings and reducers of `items`."""
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
        return (self.recordings, self.reducers) == self._own

    @property
    def trials(self) -> int:
        """Ratings that one person gives: stimuli, on average over what is drawn, x repeats x attributes."""
        share = self.recordings * self.reducers / math.prod(self._own)
        return round(len(self.items) * share) * self.repeats * len(self.attributes)

    @cached_property
    def stimuli(self) -> Stimuli:
        """The stimuli of the whole set."""
        columns = (SCENE, REDUCER, SOURCE if SOURCE in self.items else SCENE)
        scene, kind, source = (self.items[name].factorize()[0] for name in columns)
        return Stimuli(scene, kind, source, self.items[list(self.metrics)].to_numpy(np.float64))

    @cached_property
    def slope_sds(self) -> tuple[Samples, Samples]:
        """Standard deviations of people's own slopes, and of recordings', each (n_metrics,)."""
        truth, spread = self.truth, self.stimuli.within.std(axis=0, ddof=1)
        usual = 1 / np.where(spread > 0, spread, np.inf)
        people, recordings = (
            np.array([given.get(*one) for one in zip(self.metrics, points * usual, strict=True)])
            for given, points in (
                (truth.slope_sds, truth.slope_points),
                (truth.recording_slope_sds, truth.recording_slope_points),
            )
        )
        return people, recordings

    def draw(self, rng: np.random.Generator) -> Stimuli:
        """Draw a study's recordings and reducers from the set; all of them if it has just these."""
        whole = self.stimuli
        if self.is_own:
            return whole
        place = np.full((whole.scene.max() + 1, whole.kind.max() + 1), -1)
        place[whole.scene, whole.kind] = np.arange(len(whole.scene))
        picked: list[Codes] = []
        for count, wanted in zip(place.shape, (self.recordings, self.reducers), strict=True):
            times, rest = divmod(wanted, count)
            left = np.sort(rng.choice(count, rest, replace=False)) if rest else np.arange(0)
            picked.append(np.concatenate([np.tile(np.arange(count), times), left]))
        chosen = place[np.ix_(*picked)]
        scene, kind = np.nonzero(chosen >= 0)
        item, copy = chosen[scene, kind], scene // len(place)
        source = np.unique(whole.source[item] + copy * len(place), return_inverse=True)[1]
        return Stimuli(scene, kind, source, whole.metrics[item])


@dataclass(frozen=True)
class ClosedForm:
    """The power to find the slope of one metric, by its place among them."""

    design: PowerDesign
    place: int

    @cached_property
    def sets(self) -> list[Stimuli]:
        """The stimuli of several possible studies; a single set where there is nothing to draw."""
        count = 1 if self.design.is_own else DRAWS
        return [self.design.draw(np.random.default_rng([0, number])) for number in range(count)]

    @cached_property
    def errors(self) -> Samples:
        """Standard error and degrees of freedom with every set of stimuli that gives a test, (n, 2)."""
        return self._find_errors(self.design.participants)

    def _find_errors(self, participants: int) -> Samples:
        found = np.array([self.measure(one, participants) for one in self.sets])
        return found[found[:, 1] >= FEWEST_DF]

    def measure(self, stimuli: Stimuli, participants: int) -> tuple[float, float]:
        """Compute the standard error and its degrees of freedom with one set of stimuli; NaN where there is no test.

        The degrees of freedom come from participants, recordings, stimuli and reducers, less what is estimated of each.
        """
        design, truth = self.design, self.design.truth
        kinds, within, n_items = int(stimuli.kind.max()) + 1, stimuli.within, len(stimuli.scene)
        noise = truth.person_item_sd**2 + truth.rating_sd**2 / design.repeats
        # Nothing is known exactly: without any noise the sums of squares would be divided by zero.
        stimulus = max(truth.item_sd**2 + noise / participants, 1e-300)
        of_kind = truth.reducer_sd**2 + truth.person_reducer_sd**2 / participants
        of_reducer = stimulus + n_items / kinds * of_kind
        # What the metric has and the others do not, and the part of it that is the same for a reducer.
        marks = np.eye(kinds)[stimuli.kind]
        alike = marks @ (marks.T @ within / np.maximum(marks.sum(axis=0), 1)[:, None])
        weighted = np.vstack([(within - alike) / stimulus**0.5, alike / of_reducer**0.5])
        others = np.delete(weighted, self.place, axis=1)
        rest = -np.linalg.lstsq(others, weighted[:, self.place], rcond=None)[0]
        weights = np.insert(rest, self.place, 1.0)
        own, common = within @ weights, alike @ weights
        square, reducer_square = float(own @ own), float(common @ common)
        recordings = len(np.unique(stimuli.source))
        is_flat = not square > FLAT * float((within[:, self.place] ** 2).sum())
        if is_flat or min(recordings, len(np.unique(stimuli.kind))) < FEWEST:
            return math.nan, math.nan
        of_items, of_kinds = (square - reducer_square) / stimulus, reducer_square / of_reducer
        known, (people_sds, scene_sds) = of_items + of_kinds, design.slope_sds
        moved = ((own - common) / stimulus + common / of_reducer)[:, None] * within
        by_scene = np.zeros((recordings, within.shape[1]))
        np.add.at(by_scene, stimuli.source, moved * scene_sds)
        of_people = float(people_sds[self.place]) ** 2 / participants
        of_scenes = float((by_scene**2).sum()) / known**2
        free_kinds = kinds - 1 if kinds > 1 and stimuli.scene.max() > 0 else 0
        free_items = n_items - recordings - len(design.metrics) - free_kinds
        unsure = of_items**2 / max(free_items, 1)
        unsure += of_kinds**2 / max(free_kinds - len(design.metrics), 1)
        spread = of_people**2 / max(participants - 1, 1) + of_scenes**2 / max(recordings - 1, 1)
        spread += unsure / known**4
        variance = of_people + of_scenes + 1 / known
        df = variance**2 / spread if spread else math.inf
        return math.sqrt(variance), min(df, find_most_df(recordings))

    def find_power(self, value: float, *, participants: int | None = None) -> float:
        """Compute the power to find a slope of some size, averaged over sets; NaN where no set has a test."""
        errors = self.errors if participants is None else self._find_errors(participants)
        if not len(errors):
            return math.nan
        shift, df = abs(value) / errors[:, 0], errors[:, 1]
        limit = t.ppf(1 - self.design.level / 2, df)
        power = nct.sf(limit, df, shift) + nct.cdf(-limit, df, shift)
        # SciPy's noncentral t gives up far out, where the normal distribution is as good.
        chances = np.where(np.isfinite(power), power, norm.sf(limit - shift))
        return float(chances.sum() / len(self.sets))

    def describe(self, slope: float) -> dict[str, float]:
        """Compute what is reported of a slope, NaN without any test.

        ``se`` (root mean square over sets), ``df`` (mean), ``width`` of the 95 % interval, ``power``, ``ceiling`` (with
        participants without end) and ``detectable``, the smallest slope that is found with the wanted power.
        """
        se = df = detectable = math.nan
        if len(self.errors):
            se, df = math.sqrt((self.errors[:, 0] ** 2).mean()), float(self.errors[:, 1].mean())
            tops, wanted = self.errors[:, 0].max() * np.array(WIDER), self.design.wanted
            top = next((one for one in tops if self.find_power(one) >= wanted), None)
            if top is not None:
                detectable = float(brentq(lambda one: self.find_power(one) - wanted, 0, top))
        return {
            "se": se, "df": df, "width": float(2 * t.ppf(1 - LEVEL / 2, df) * se), "power": self.find_power(slope),
            "ceiling": self.find_power(slope, participants=MOST["participants"]), "detectable": detectable,
        }  # fmt: skip

    def find_least(self, name: str, slope: float) -> float:
        """Find the least participants or recordings, all else equal, with the wanted power; NaN beyond `MOST`.

        They are doubled from the fewest that are advised, then halved; power grows with them.
        """

        def is_enough(number: int) -> bool:
            if name == "participants":
                return self.find_power(slope, participants=number) >= self.design.wanted
            other = replace(self.design, recordings=number)
            return ClosedForm(other, self.place).find_power(slope) >= self.design.wanted

        if not is_enough(MOST[name]):
            return math.nan
        low, high = LEAST[name] - 1, LEAST[name]
        while not is_enough(high):
            low, high = high, min(2 * high, MOST[name])
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if is_enough(middle) else (middle, high)
        return float(high)

    def find_lack(self) -> str:
        """Say why the slope is not estimable with any of the sets; nothing where it is with one."""
        if len(self.errors):
            return ""
        sources = max(len(np.unique(one.source)) for one in self.sets)
        kinds = max(len(np.unique(one.kind)) for one in self.sets)
        for name, count in (("recordings (or their sources)", sources), ("reducers", kinds)):
            if count < FEWEST:
                return f"{name} number {count}, where {FEWEST} are needed"
        if all(math.isnan(self.measure(one, self.design.participants)[0]) for one in self.sets):
            return "the metric does not vary within recordings, or cannot be told apart from the others"
        return f"fewer than {FEWEST_DF:g} degrees of freedom are left with the planted spreads"
