"""Power in closed form: standard errors from the planted spreads, and the noncentral t distribution.

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
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from feel321.analysis.power.design import LEAST, LEVEL, PowerDesign, Stimuli
from feel321.analysis.primary.model import FEWEST, FEWEST_DF
from feel321.analysis.primary.plan import find_most_df
from feel321.types import Samples

MOST_PEOPLE, MOST_RECORDINGS = 10_000, 1000  # Nobody recruits or records more
DRAWS = 25  # Of stimuli, where a design draws them

WIDER = (20, 100, 1000, 10_000)
"""Standard errors within which the slope is sought that is found with the wanted power."""

FLAT = 1e-9  # Share of a metric's size below which what the others leave of it is rounding
Error = tuple[float, float]  # A standard error and its degrees of freedom
NO_TEST: Error = (math.nan, math.nan)


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

    def measure(self, stimuli: Stimuli, participants: int) -> Error:
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
        weighted = np.vstack([
            (within - alike) / math.sqrt(stimulus),
            alike / math.sqrt(of_reducer),
        ])
        others = np.delete(weighted, self.place, axis=1)
        rest = -np.linalg.lstsq(others, weighted[:, self.place], rcond=None)[0]
        weights = np.insert(rest, self.place, 1.0)
        own, common = within @ weights, alike @ weights
        square, reducer_square = float(own @ own), float(common @ common)
        recordings = len(np.unique(stimuli.source))
        is_flat = not square > FLAT * float((within[:, self.place] ** 2).sum())
        if is_flat or min(recordings, len(np.unique(stimuli.kind))) < FEWEST:
            return NO_TEST
        of_items, of_kinds = (square - reducer_square) / stimulus, reducer_square / of_reducer
        known = of_items + of_kinds
        moved = ((own - common) / stimulus + common / of_reducer)[:, None] * within
        by_scene = np.zeros((recordings, within.shape[1]))
        np.add.at(by_scene, stimuli.source, moved * design.recording_slope_sds)
        of_people = float(design.slope_sds[self.place]) ** 2 / participants
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
        from scipy.stats import nct, norm, t

        errors = self.errors if participants is None else self._find_errors(participants)
        if not len(errors):
            return math.nan
        shift, df = abs(value) / errors[:, 0], errors[:, 1]
        limit = t.ppf(1 - self.design.level / 2, df)
        power = nct.sf(limit, df, shift) + nct.cdf(-limit, df, shift)
        # SciPy's noncentral t gives up far out, where the normal distribution is as good.
        chances = np.where(np.isfinite(power), power, norm.sf(limit - shift))
        return float(chances.sum() / len(self.sets))

    def find_ceiling(self, value: float) -> float:
        """Compute the power with participants without end."""
        return self.find_power(value, participants=MOST_PEOPLE)

    def find_error(self) -> Error:
        """Compute the standard error (root mean square) and degrees of freedom (mean); NaN without any."""
        if not len(self.errors):
            return NO_TEST
        se, df = self.errors.T
        return float(np.sqrt(np.mean(se**2))), float(np.mean(df))

    def find_width(self) -> float:
        """Compute the width of the 95 % interval."""
        from scipy.stats import t

        se, df = self.find_error()
        return float(2 * t.ppf(1 - LEVEL / 2, df) * se)

    def find_detectable(self) -> float:
        """Find the smallest slope that is found with the wanted power."""
        from scipy.optimize import brentq

        wanted, se = self.design.wanted, self.errors[:, 0]
        tops = (factor * se.max() for factor in WIDER) if se.size else ()
        top = next((one for one in tops if self.find_power(one) >= wanted), None)
        if top is None:
            return math.nan
        return float(brentq(lambda value: self.find_power(value) - wanted, 0, top))

    def find_participants(self, value: float) -> float:
        """Find how many participants give the wanted power with these recordings; NaN beyond 10 000."""
        return find_least(
            lambda number: self.find_power(value, participants=number),
            ends=(LEAST["participants"], MOST_PEOPLE), enough=self.design.wanted,
        )  # fmt: skip

    def find_recordings(self, value: float) -> float:
        """Find how many recordings give the wanted power with as many participants; NaN beyond 1000."""

        def find_power(number: int) -> float:
            return ClosedForm(replace(self.design, recordings=number), self.place).find_power(value)

        ends = LEAST["recordings"], MOST_RECORDINGS
        return find_least(find_power, ends=ends, enough=self.design.wanted)

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


def find_least(power: Callable[[int], float], *, ends: tuple[int, int], enough: float) -> float:
    """Search a number from the least up by doubling, then by halving; power grows with it."""
    least, most = ends
    if not power(most) >= enough:
        return math.nan
    low, high = least - 1, least
    while not power(high) >= enough:
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(middle) >= enough else (middle, high)
    return float(high)
