"""How well a study knows a slope: the standard error, taken apart.

SE² = σ_S²/P + V_C + 1 / (SS_w/v + SS_r/(v + m v_r)): slopes differ by σ_S between P people; v = σ_I² + (σ_PI² +
σ_e²/K)/P of a stimulus and v_r = σ_R² + σ_PR²/P of a reducer in m recordings; SS_r is the sum of squares of the metric
that is the same for a reducer in all recordings, SS_w what is left. V_C comes from slopes that differ between
recordings, those of all metrics: with weights w of the stimuli, Σ_k σ_Ck² Σ_recordings (Σ w x_k)². Recordings and
stimuli do not become more with participants: they set the ceiling of what a study can know. What only reducers tell
(SS_r) becomes no more with recordings either, because m grows with SS_r.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.primary.plan import find_most_df
from feel321.records import Result

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from feel321.types import Samples

SIGNIFICANCE = 0.05
ENOUGH = 0.8
"""Power that is asked for."""

MOST = 10_000
"""Nobody recruits more."""

FEWEST_PEOPLE, FEWEST_RECORDINGS = 6, 4
"""No smaller study is advised, however large the slope: intervals over fewer are too unsure of themselves."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class SlopePrecision(Result):
    """What the standard error of a slope within recordings is made of.

    In points, the slope's per unit of the metric: slope_sd between participants; item_sd between stimuli of a
    recording, of what the metrics leave unexplained; noise_sd of one participant's mean rating of a stimulus,
    √(σ_PI² + σ_e²/K) for K repeats; reducer_sd, rater_reducer_sd between reducers, of what the metrics leave
    unexplained, for everyone and for one participant. square: Σ over stimuli of the metric squared, less its
    recording's mean and less what the other metrics share; reducer_square: the part of it that is the same for a
    reducer in every recording. n_reducers is 0 where the model has no spread between them, n_alike the stimuli of
    each. recording_variance: of the slope, because slopes differ between recordings. level: of the test, 0.05 over the
    number of slopes tested, which is Holm's first step.
    """

    slope_sd: float
    item_sd: float
    noise_sd: float
    square: float
    n_participants: int
    n_recordings: int
    n_items: int
    n_slopes: int = 1
    reducer_sd: float = 0.0
    rater_reducer_sd: float = 0.0
    reducer_square: float = 0.0
    n_reducers: int = 0
    n_alike: float = 1.0
    level: float = SIGNIFICANCE
    recording_variance: float = 0.0

    def find_se(self) -> tuple[float, float]:
        """Compute the slope's standard error and its degrees of freedom, by Welch and Satterthwaite.

        Degrees of freedom come from participants, recordings, stimuli and reducers less what is estimated from each.
        """
        people, (stimulus, reducer) = self.slope_sd**2 / self.n_participants, find_variances(self)
        scenes = self.recording_variance
        within, between = (
            (self.square - self.reducer_square) / stimulus,
            self.reducer_square / reducer,
        )
        stimuli = 1 / (within + between)
        others = max(self.n_reducers - 1, 0)
        spare = self.n_items - self.n_recordings - self.n_slopes - others, others - self.n_slopes
        unsure = within**2 / max(spare[0], 1) + between**2 / max(spare[1], 1)
        spread = people**2 / max(self.n_participants - 1, 1) + stimuli**4 * unsure
        spread += scenes**2 / max(self.n_recordings - 1, 1)
        variance = people + scenes + stimuli
        df = variance**2 / spread if spread else math.inf
        return math.sqrt(variance), min(df, find_most_df(self.n_recordings))

    def enlarge(
        self, *, participants: int | None = None, recordings: int | None = None
    ) -> SlopePrecision:
        """Imagine the same study with other numbers; each recording brings as many stimuli, of the same reducers."""
        share = (recordings or self.n_recordings) / self.n_recordings
        return replace(
            self,
            n_participants=participants or self.n_participants,
            n_recordings=recordings or self.n_recordings,
            square=self.square * share,
            reducer_square=self.reducer_square * share,
            n_alike=self.n_alike * share,
            recording_variance=self.recording_variance / share,
            n_items=round(self.n_items * share),
        )

    def find_power(self, slope: float) -> float:
        """Compute the chance that the two-sided test at `level` finds a true slope; NaN where nothing varies."""
        se, df = self.find_se()
        if not 0 < se < math.inf:
            return math.nan
        return float(find_chance(np.array(abs(slope) / se), np.array(df), level=self.level))

    def find_participants(self, slope: float) -> float:
        """Find how many participants give 80 % power with these recordings: 6 or more, NaN beyond 10 000."""
        return find_least(
            lambda number: self.enlarge(participants=number).find_power(slope), least=FEWEST_PEOPLE
        )

    def find_recordings(self, slope: float) -> float:
        """Find how many recordings give 80 % power with these participants: 4 or more, NaN beyond 10 000."""
        return find_least(
            lambda number: self.enlarge(recordings=number).find_power(slope),
            least=FEWEST_RECORDINGS,
        )

    def find_slope(self) -> float:
        """Find the smallest slope that this study finds with 80 % power; NaN where nothing varies."""
        from scipy.optimize import brentq

        se, _ = self.find_se()
        if not 0 < se < math.inf:
            return math.nan
        return float(brentq(lambda slope: self.find_power(slope) - ENOUGH, 0, 20 * se))


def find_chance(shift: Samples, df: Samples, *, level: float) -> Samples:
    """Compute the power of two-sided t tests; shift: true value over its standard error."""
    from scipy.stats import nct, norm, t

    limit = t.ppf(1 - level / 2, df)
    power = nct.sf(limit, df, shift) + nct.cdf(-limit, df, shift)
    # SciPy's noncentral t gives up far out, where the normal distribution is as good.
    found: Samples = np.where(np.isfinite(power), power, norm.sf(limit - shift))
    return found


def find_variances(study: SlopePrecision) -> tuple[float, float]:
    """Compute the variance of a stimulus's mean rating, and n times that of the mean over n stimuli of a reducer."""
    alike = study.reducer_sd**2 + study.rater_reducer_sd**2 / study.n_participants
    # Nothing is known exactly: without any noise the sums of squares would be divided by zero.
    stimulus = max(study.item_sd**2 + study.noise_sd**2 / study.n_participants, 1e-300)
    return stimulus, stimulus + study.n_alike * alike


def find_own(
    metrics: np.ndarray,
    column: int,
    reducers: np.ndarray | None = None,
    *,
    variances: tuple[float, float] = (1, 1),
) -> tuple[np.ndarray, np.ndarray]:
    """Find what one metric has and the others do not, and the part of it that is the same for a reducer.

    metrics: (n_items, n_metrics); reducers, and both that are returned: (n_items,).
    """
    alike = np.zeros_like(metrics)
    if reducers is not None:
        marks = np.eye(int(reducers.max()) + 1)[reducers]
        alike = marks @ (marks.T @ metrics / marks.sum(axis=0)[:, None])
    weighted = np.vstack([
        (metrics - alike) / math.sqrt(variances[0]),
        alike / math.sqrt(variances[1]),
    ])
    others = np.delete(weighted, column, axis=1)
    weights = np.insert(-np.linalg.lstsq(others, weighted[:, column], rcond=None)[0], column, 1.0)
    return metrics @ weights, alike @ weights


def find_recording_variance(
    study: SlopePrecision,
    own: Samples,
    alike: Samples,
    *,
    scenes: NDArray[np.intp],
    spreads: Samples,
) -> float:
    """Compute the variance that recordings' own slopes give an estimate, weighted as if they did not differ.

    own, alike: as `find_own` returns them; scenes: (n_items,) numbers of recordings; spreads: (n_items, n_metrics),
    metrics within recordings, each times the standard deviation of its slopes between recordings.
    """
    stimulus, reducer = find_variances(study)
    weights = (own - alike) / stimulus + alike / reducer
    known = (study.square - study.reducer_square) / stimulus + study.reducer_square / reducer
    marks = np.eye(int(scenes.max()) + 1)[scenes]
    return float(((marks.T @ (weights[:, None] * spreads)) ** 2).sum() / known**2) if known else 0.0


def find_least(power: Callable[[int], float], *, least: int, enough: float = ENOUGH) -> float:
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
