"""Power in closed form: standard errors from the planted spreads, and the noncentral t distribution.

The standard error is that of `SlopePrecision`, which takes one that was estimated apart. Where a design draws its
recordings or reducers, power is the mean over draws. A draw whose slope is not estimable, which has no test in the
report either, counts as no power there; standard errors are those of the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.power import draw
from feel321.analysis.primary import precision
from feel321.analysis.primary.model import FEWEST, FEWEST_DF

if TYPE_CHECKING:
    from feel321.types import Samples

DRAWS = 25
"""Of stimuli, where a design draws them."""

TURNS = 12
"""Designs that are computed in search of the number of recordings that is enough."""

WIDER = (20, 100, 1000, 10_000)
"""Standard errors within which the slope is sought that is found with the wanted power."""

FLAT = 1e-9
"""Share of a metric's size below which what the others leave of it is rounding."""


def draw_sets(scenario: draw.Scenario, *, seed: int = 0) -> list[draw.Stimuli]:
    """Draw the stimuli of several studies; a single set where there is nothing to draw."""
    count = 1 if scenario.design.is_own else DRAWS
    return [scenario.draw(np.random.default_rng([seed, place])) for place in range(count)]


@dataclass(frozen=True)
class ClosedForm:
    """The precision of a weighted sum of slopes; weights: (n_metrics,), sets: the stimuli of possible studies."""

    scenario: draw.Scenario
    sets: list[draw.Stimuli]
    weights: Samples
    level: float

    @cached_property
    def precisions(self) -> list[precision.SlopePrecision]:
        """What the standard error is made of, for every set of stimuli."""
        return self.find_precisions(self.scenario.design.participants)

    def find_precisions(self, participants: int) -> list[precision.SlopePrecision]:
        """Take the standard error apart, for a number of participants."""
        return [self._find_precision(stimuli, participants) for stimuli in self.sets]

    def _find_precision(self, stimuli: draw.Stimuli, participants: int) -> precision.SlopePrecision:
        truth, kinds = self.scenario.truth, int(stimuli.kind.max()) + 1
        noise = math.hypot(
            truth.person_item_sd, truth.rating_sd / math.sqrt(self.scenario.design.repeats)
        )
        several = kinds > 1 and stimuli.scene.max() > 0
        study = precision.SlopePrecision(
            slope_sd=float(np.linalg.norm(self.weights * self.scenario.planted.slope_sds)), item_sd=truth.item_sd,
            noise_sd=noise, square=1.0, n_participants=participants, n_recordings=int(stimuli.source.max()) + 1,
            n_items=len(stimuli.scene), n_slopes=len(self.weights), reducer_sd=truth.reducer_sd,
            rater_reducer_sd=truth.person_reducer_sd, n_reducers=kinds if several else 0,
            n_alike=len(stimuli.scene) / kinds, level=self.level,
        )  # fmt: skip
        return self._add_squares(study, stimuli)

    def _add_squares(
        self, study: precision.SlopePrecision, stimuli: draw.Stimuli
    ) -> precision.SlopePrecision:
        """Find the sums of squares of the metric whose slope is the weighted sum, among the others."""
        place = int(np.argmax(np.abs(self.weights)))
        if not self.weights[place]:  # of a difference of metrics that do not vary within recordings
            return replace(study, square=0.0)
        basis = np.eye(len(self.weights))
        basis[place] = self.weights
        metrics = stimuli.within @ np.linalg.inv(basis)
        own, alike = precision.find_own(
            metrics, place, stimuli.kind, variances=precision.find_variances(study)
        )
        size = float((metrics[:, place] ** 2).sum())
        square = float((own**2).sum())
        units = study.n_recordings, len(np.unique(stimuli.kind))
        if not square > FLAT * size or min(units) < FEWEST:
            square = 0.0
        study = replace(study, square=square, reducer_square=float((alike**2).sum()))
        spreads = stimuli.within * self.scenario.planted.recording_sds
        return replace(
            study,
            recording_variance=precision.find_recording_variance(
                study, own, alike, scenes=stimuli.source, spreads=spreads
            ),
        )

    def find_power(self, value: float, *, participants: int | None = None) -> float:
        """Compute the power to find a sum of slopes of some size; NaN where it cannot be estimated."""
        found = self.find_precisions(participants) if participants else self.precisions
        return _average(found, value)

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
        return float(2 * t.ppf(1 - precision.SIGNIFICANCE / 2, df) * se)

    def find_ceiling(self, value: float) -> float:
        """Compute the power with participants without end."""
        return self.find_power(value, participants=precision.MOST)

    def find_detectable(self, wanted: float) -> float:
        """Find the smallest sum of slopes that is found with the wanted power."""
        from scipy.optimize import brentq

        se, _ = _find_errors(self.precisions)
        tops = (factor * se.max() for factor in WIDER) if se.size else ()
        top = next((one for one in tops if self.find_power(one) >= wanted), None)
        if top is None:
            return math.nan
        return float(brentq(lambda value: self.find_power(value) - wanted, 0, top))

    def find_participants(self, value: float, wanted: float) -> float:
        """Find how many participants give the wanted power with these recordings; NaN beyond 10 000."""
        return precision.find_least(
            lambda number: self.find_power(value, participants=number),
            least=precision.FEWEST_PEOPLE, enough=wanted,
        )  # fmt: skip

    def find_recordings(self, value: float, wanted: float) -> float:
        """Find how many recordings give the wanted power with as many participants; NaN beyond 10 000.

        What more recordings would bring is imagined, then computed for a study that has them, and imagined anew from
        there, until a study of so many has the power.
        """
        form, least = self, precision.FEWEST_RECORDINGS
        for _ in range(TURNS):
            number = form.imagine_recordings(value, wanted, least=least)
            if math.isnan(number):
                return math.nan
            form = self.change(recordings=int(number))
            if form.find_power(value) >= wanted:
                return number
            least = int(number) + 1
        return math.nan

    def imagine_recordings(self, value: float, wanted: float, *, least: int) -> float:
        """Find how many recordings like these give the wanted power."""
        return precision.find_least(
            lambda number: _average([one.enlarge(recordings=number) for one in self.precisions], value),
            least=least, enough=wanted,
        )  # fmt: skip

    def change(self, **sizes: int) -> ClosedForm:
        """Compute the same sum of slopes in a design of other sizes."""
        design = self.scenario.design.change(**sizes)
        scenario = draw.Scenario(design, self.scenario.truth)
        return replace(self, scenario=scenario, sets=draw_sets(scenario))

    def find_lack(self) -> str:
        """Say why the sum of slopes is not estimable with any of the sets; nothing where it is with one."""
        if _find_errors(self.precisions)[0].size:
            return ""
        sources = max(one.n_recordings for one in self.precisions)
        if sources < FEWEST:
            return f"recordings (or their sources) number {sources}, where {FEWEST} are needed"
        kinds = max(len(np.unique(one.kind)) for one in self.sets)
        if kinds < FEWEST:
            return f"reducers number {kinds}, where {FEWEST} are needed"
        if not max(float(np.abs(one.within @ self.weights).max()) for one in self.sets) > FLAT:
            return "the metric does not vary within recordings"
        if not max(one.square for one in self.precisions) > 0:
            return "the metric cannot be told apart from the others"
        return f"fewer than {FEWEST_DF:g} degrees of freedom are left with the planted spreads"


def _find_errors(precisions: list[precision.SlopePrecision]) -> tuple[Samples, Samples]:
    """Compute standard errors and degrees of freedom of the sets whose slope has a test."""
    known = np.array([one.find_se() for one in precisions if one.square > 0]).reshape(-1, 2)
    tested = known[known[:, 1] >= FEWEST_DF]
    return tested[:, 0], tested[:, 1]


def _average(precisions: list[precision.SlopePrecision], value: float) -> float:
    """Average power over sets, with no power where there is no test; NaN where no set has one."""
    se, df = _find_errors(precisions)
    if not se.size:
        return math.nan
    chances = precision.find_chance(abs(value) / se, df, level=precisions[0].level)
    return float(chances.sum() / len(precisions))
