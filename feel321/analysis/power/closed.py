"""Power in closed form: standard errors from the planted spreads, and the noncentral t distribution.

The standard error is that of generalised least squares (`SlopePrecision` takes it apart), degrees of freedom are those
of Welch and Satterthwaite, the level is that of Holm's first step. Slopes that differ between recordings add to the
variance as to an estimate that does not know it: the whole then is 4 to 9 % more than with the best weights, in designs
of 4 to 20 recordings. The ends of the scale, lapses, careless people and the penalty of few reducers are not in it.

Where a design draws its recordings or reducers, power is the mean over draws. A draw whose slope is not estimable,
which has no test in the report either, counts as no power there; standard errors are those of the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.power.simulate import Scenario, Stimuli
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
    def precisions(self) -> list[precision.SlopePrecision]:
        """What the standard error is made of, for every set of stimuli."""
        people = self.scenario.design.participants
        return [self._find_precision(stimuli, people) for stimuli in self.sets]

    def _find_precision(self, stimuli: Stimuli, participants: int) -> precision.SlopePrecision:
        design, truth, planted = self.scenario.design, self.scenario.truth, self.scenario.planted
        kinds, within = int(stimuli.kind.max()) + 1, stimuli.within
        several = kinds > 1 and stimuli.scene.max() > 0
        study = precision.SlopePrecision(
            slope_sd=float(planted.slope_sds[self.place]), item_sd=truth.item_sd,
            noise_sd=math.hypot(truth.person_item_sd, truth.rating_sd / math.sqrt(design.repeats)), square=1.0,
            n_participants=participants, n_recordings=int(stimuli.source.max()) + 1, n_items=len(stimuli.scene),
            n_slopes=len(design.metrics), reducer_sd=truth.reducer_sd, rater_reducer_sd=truth.person_reducer_sd,
            n_reducers=kinds if several else 0, n_alike=len(stimuli.scene) / kinds, level=design.level,
        )  # fmt: skip
        own, alike = precision.find_own(
            within, self.place, stimuli.kind, variances=precision.find_variances(study)
        )
        square = float((own**2).sum())
        units = study.n_recordings, len(np.unique(stimuli.kind))
        if not square > FLAT * float((within[:, self.place] ** 2).sum()) or min(units) < FEWEST:
            square = 0.0
        study = replace(study, square=square, reducer_square=float((alike**2).sum()))
        spreads = within * planted.recording_sds
        variance = precision.find_recording_variance(
            study, own, alike, scenes=stimuli.source, spreads=spreads
        )
        return replace(study, recording_variance=variance)

    def find_power(self, value: float, *, participants: int | None = None) -> float:
        """Compute the power to find a slope of some size; NaN where it cannot be estimated."""
        if participants is None:
            return _average(self.precisions, value)
        return _average([self._find_precision(one, participants) for one in self.sets], value)

    def find_ceiling(self, value: float) -> float:
        """Compute the power with participants without end."""
        return self.find_power(value, participants=precision.MOST)

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
        return precision.find_least(
            lambda number: self.find_power(value, participants=number),
            least=precision.FEWEST_PEOPLE, enough=self.scenario.design.wanted,
        )  # fmt: skip

    def find_recordings(self, value: float) -> float:
        """Find how many recordings give the wanted power with as many participants; NaN beyond 10 000.

        What more recordings like these would bring is imagined, then computed for a study that has them, and imagined
        anew from there, until a study of so many has the power.
        """
        form, least, wanted = self, precision.FEWEST_RECORDINGS, self.scenario.design.wanted
        for _ in range(TURNS):
            own = form.precisions
            number = precision.find_least(
                lambda count, own=own: _average([one.enlarge(recordings=count) for one in own], value),  # type: ignore[misc]  # a lambda's default has no type
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
