"""Power in closed form: standard errors from the planted spreads, and the noncentral t distribution.

SE² = σ_S²/P + V_C + 1 / (SS_w/v + SS_r/(v + m v_r)): slopes differ by σ_S between P people; v = σ_I² + (σ_PI² +
σ_e²/K)/P of a stimulus and v_r = σ_R² + σ_PR²/P of a reducer in m recordings; SS_r is the sum of squares of the metric
that is the same for a reducer in all recordings, SS_w what is left. V_C comes from slopes that differ between
recordings, those of all metrics: with weights w of the stimuli, Σ_k σ_Ck² Σ_recordings (Σ w x_k)². Recordings and
stimuli do not become more with participants: they set the ceiling of what a study can know. What only reducers tell
(SS_r) becomes no more with recordings either, because m grows with SS_r.

That is the standard error of generalised least squares, with degrees of freedom of Welch and Satterthwaite and the
level of Holm's first step. V_C is that of an estimate that does not know it: the whole is 4 to 9 % more than with the
best weights, in designs of 4 to 20 recordings. The ends of the scale, lapses, careless people and the penalty of few
reducers are not in it. Where a design draws its recordings or reducers, power is the mean over draws. A draw whose
slope is not estimable, which has no test in the report either, counts as no power.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.power.simulate import Scenario, Stimuli
from feel321.analysis.power.truth import LEAST, LEVEL
from feel321.analysis.primary.model import FEWEST, FEWEST_DF
from feel321.analysis.primary.plan import find_most_df

if TYPE_CHECKING:
    from feel321.types import Samples

MOST = 10_000
"""Nobody recruits more."""

DRAWS = 25
"""Of stimuli, where a design draws them."""

TURNS = 12
"""Designs that are computed in search of the number of recordings that is enough."""

WIDER = (20, 100, 1000, 10_000)
"""Standard errors within which the slope is sought that is found with the wanted power."""

FLAT = 1e-9
"""Share of a metric's size below which what the others leave of it is rounding."""


@dataclass(frozen=True, slots=True)
class Precision:
    """What the standard error of a slope is made of, with one set of stimuli; square 0: it is not estimable.

    Variances, as in the module's formula: people σ_S²/P, scenes V_C, stimulus v, reducer v_r, n_alike m, square SS_w +
    SS_r, reducer_square SS_r. n_reducers is 0 where the model has no spread between them.
    """

    people: float
    scenes: float
    stimulus: float
    reducer: float
    square: float
    reducer_square: float
    n_alike: float
    n_participants: int
    n_recordings: int
    n_reducers: int
    n_items: int
    n_slopes: int

    def find_se(self) -> tuple[float, float]:
        """Compute the standard error and its degrees of freedom.

        These come from participants, recordings, stimuli and reducers, less what is estimated from each.
        """
        within = (self.square - self.reducer_square) / self.stimulus
        between = self.reducer_square / (self.stimulus + self.n_alike * self.reducer)
        stimuli, others = 1 / (within + between), max(self.n_reducers - 1, 0)
        spare = self.n_items - self.n_recordings - self.n_slopes - others, others - self.n_slopes
        unsure = within**2 / max(spare[0], 1) + between**2 / max(spare[1], 1)
        spread = self.people**2 / max(self.n_participants - 1, 1) + stimuli**4 * unsure
        spread += self.scenes**2 / max(self.n_recordings - 1, 1)
        variance = self.people + self.scenes + stimuli
        df = variance**2 / spread if spread else math.inf
        return math.sqrt(variance), min(df, find_most_df(self.n_recordings))

    def enlarge(self, recordings: int) -> Precision:
        """Imagine more recordings; each brings as many stimuli, of the same reducers."""
        share = recordings / self.n_recordings
        return replace(
            self, n_recordings=recordings, square=self.square * share, n_alike=self.n_alike * share,
            reducer_square=self.reducer_square * share, scenes=self.scenes / share, n_items=round(self.n_items * share),
        )  # fmt: skip


@dataclass(frozen=True)
class ClosedForm:
    """The precision of the slope of one metric, by its place among them."""

    scenario: Scenario
    place: int

    @cached_property
    def sets(self) -> list[Stimuli]:
        """The stimuli of several possible studies; a single set where there is nothing to draw."""
        count = 1 if self.scenario.design.is_own else DRAWS
        return [self.scenario.draw(np.random.default_rng([0, number])) for number in range(count)]

    @cached_property
    def precisions(self) -> list[Precision]:
        """What the standard error is made of, for every set of stimuli."""
        return [self.measure(one, self.scenario.design.participants) for one in self.sets]

    def measure(self, stimuli: Stimuli, participants: int) -> Precision:
        """Measure what the metric has and the others do not, and the part of it that is the same for a reducer."""
        design, truth, planted = self.scenario.design, self.scenario.truth, self.scenario.planted
        kinds, within, n_items = int(stimuli.kind.max()) + 1, stimuli.within, len(stimuli.scene)
        noise = truth.person_item_sd**2 + truth.rating_sd**2 / design.repeats
        # Nothing is known exactly: without any noise the sums of squares would be divided by zero.
        stimulus = max(truth.item_sd**2 + noise / participants, 1e-300)
        reducer = truth.reducer_sd**2 + truth.person_reducer_sd**2 / participants
        of_reducer = stimulus + n_items / kinds * reducer
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
        known = (square - reducer_square) / stimulus + reducer_square / of_reducer
        moved = ((own - common) / stimulus + common / of_reducer)[:, None] * within
        by_scene = np.zeros((int(stimuli.source.max()) + 1, within.shape[1]))
        np.add.at(by_scene, stimuli.source, moved * planted.recording_sds)
        is_flat = not square > FLAT * float((within[:, self.place] ** 2).sum())
        few = min(len(by_scene), len(np.unique(stimuli.kind))) < FEWEST
        several = kinds > 1 and stimuli.scene.max() > 0
        return Precision(
            people=float(planted.slope_sds[self.place]) ** 2 / participants, stimulus=stimulus, reducer=reducer,
            scenes=float((by_scene**2).sum()) / known**2 if known else 0.0, n_alike=n_items / kinds,
            square=0.0 if is_flat or few else square, reducer_square=reducer_square,
            n_participants=participants, n_recordings=len(by_scene), n_reducers=kinds if several else 0,
            n_items=n_items, n_slopes=len(design.metrics),
        )  # fmt: skip

    def find_power(self, value: float, *, participants: int | None = None) -> float:
        """Compute the power to find a slope of some size; NaN where it cannot be estimated."""
        precisions = self.precisions
        if participants is not None:
            precisions = [self.measure(one, participants) for one in self.sets]
        return self._average(precisions, value)

    def _average(self, precisions: list[Precision], value: float) -> float:
        """Average power over sets, with no power where there is no test; NaN where no set has one."""
        se, df = _find_errors(precisions)
        if not se.size:
            return math.nan
        chances = find_chance(abs(value) / se, df, level=self.scenario.design.level)
        return float(chances.sum() / len(precisions))

    def find_ceiling(self, value: float) -> float:
        """Compute the power with participants without end."""
        return self.find_power(value, participants=MOST)

    def find_errors(self) -> tuple[float, float]:
        """Compute the standard error (root mean square) and degrees of freedom (mean); NaN without any."""
        se, df = _find_errors(self.precisions)
        if not se.size:
            return math.nan, math.nan
        return float(np.sqrt(np.mean(se**2))), float(np.mean(df))

    def find_width(self) -> float:
        """Compute the width of the 95 % interval."""
        from scipy.stats import t

        se, df = self.find_errors()
        return float(2 * t.ppf(1 - LEVEL / 2, df) * se)

    def find_detectable(self) -> float:
        """Find the smallest slope that is found with the wanted power."""
        from scipy.optimize import brentq

        wanted, (se, _) = self.scenario.design.wanted, _find_errors(self.precisions)
        tops = (factor * se.max() for factor in WIDER) if se.size else ()
        top = next((one for one in tops if self.find_power(one) >= wanted), None)
        if top is None:
            return math.nan
        return float(brentq(lambda value: self.find_power(value) - wanted, 0, top))

    def find_participants(self, value: float) -> float:
        """Find how many participants give the wanted power with these recordings; NaN beyond 10 000."""
        return find_least(
            lambda number: self.find_power(value, participants=number),
            least=LEAST["participants"], enough=self.scenario.design.wanted,
        )  # fmt: skip

    def find_recordings(self, value: float) -> float:
        """Find how many recordings give the wanted power with as many participants; NaN beyond 10 000.

        What more recordings like these would bring is imagined, then computed for a study that has them, and imagined
        anew from there, until a study of so many has the power.
        """
        form, least, wanted = self, LEAST["recordings"], self.scenario.design.wanted
        for _ in range(TURNS):
            own = form.precisions
            number = find_least(
                lambda count, own=own: self._average([one.enlarge(count) for one in own], value),  # type: ignore[misc]  # a lambda's default has no type
                least=least, enough=wanted,
            )  # fmt: skip
            if math.isnan(number):
                break
            larger = replace(self.scenario.design, recordings=int(number))
            form = ClosedForm(Scenario(larger, self.scenario.truth), self.place)
            if form.find_power(value) >= wanted:
                return number
            least = int(number) + 1
        return math.nan

    def find_lack(self) -> str:
        """Say why the slope is not estimable with any of the sets; nothing where it is with one."""
        if _find_errors(self.precisions)[0].size:
            return ""
        sources = max(one.n_recordings for one in self.precisions)
        kinds = max(len(np.unique(one.kind)) for one in self.sets)
        for name, count in (("recordings (or their sources)", sources), ("reducers", kinds)):
            if count < FEWEST:
                return f"{name} number {count}, where {FEWEST} are needed"
        if not max(one.square for one in self.precisions) > 0:
            return "the metric does not vary within recordings, or cannot be told apart from the others"
        return f"fewer than {FEWEST_DF:g} degrees of freedom are left with the planted spreads"


def _find_errors(precisions: list[Precision]) -> tuple[Samples, Samples]:
    """Compute standard errors and degrees of freedom of the sets whose slope has a test."""
    known = np.array([one.find_se() for one in precisions if one.square > 0]).reshape(-1, 2)
    tested = known[known[:, 1] >= FEWEST_DF]
    return tested[:, 0], tested[:, 1]


def find_chance(shift: Samples, df: Samples, *, level: float) -> Samples:
    """Compute the power of two-sided t tests; shift: true value over its standard error."""
    from scipy.stats import nct, norm, t

    limit = t.ppf(1 - level / 2, df)
    power = nct.sf(limit, df, shift) + nct.cdf(-limit, df, shift)
    # SciPy's noncentral t gives up far out, where the normal distribution is as good.
    found: Samples = np.where(np.isfinite(power), power, norm.sf(limit - shift))
    return found


def find_least(power: Callable[[int], float], *, least: int, enough: float) -> float:
    """Search a number from the least up by doubling, then by halving; power grows with it."""
    if not power(MOST) >= enough:
        return math.nan
    low, high = least - 1, least
    while not power(high) >= enough:
        low, high = high, min(2 * high, MOST)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(middle) >= enough else (middle, high)
    return float(high)
