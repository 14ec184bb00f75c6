"""How well would more participants or more recordings know a slope? The standard error, taken apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

SIGNIFICANCE = 0.05
ENOUGH = 0.8
"""Power that is asked for."""

MOST = 10_000
"""Nobody recruits more."""


@dataclass(frozen=True, slots=True)
class Precision:
    """What the standard error of a slope within recordings is made of.

    Parameters
    ----------
    slope_sd : float
        Between participants, of the slope; points per unit of the metric.
    item_sd : float
        Between stimuli of a recording, of what the metrics leave unexplained; points.
    noise_sd : float
        Of one participant's mean rating of a stimulus, √(σ_PI² + σ_e²/K) for K repeats; points.
    square : float
        Σ over stimuli of the metric squared, less its recording's mean and less what the other metrics share.
    n_participants, n_recordings, n_items : int
        Size of the study.
    n_slopes : int
        Metrics in the model.

    Notes
    -----
    SE² = σ_S²/P + σ_I²/SS + (σ_PI² + σ_e²/K)/(P SS). The second part does not shrink with participants: stimuli set
    the ceiling of what a study can know.
    """

    slope_sd: float
    item_sd: float
    noise_sd: float
    square: float
    n_participants: int
    n_recordings: int
    n_items: int
    n_slopes: int = 1

    def find_se(self) -> tuple[float, float]:
        """Compute the standard error of the slope and its degrees of freedom.

        Returns
        -------
        se : float
            Standard error.
        df : float
            Degrees of freedom by Welch and Satterthwaite, from P - 1 and from stimuli - recordings - metrics.

        Examples
        --------
        >>> study = Precision(5, 4, 10, 2.5, n_participants=20, n_recordings=10, n_items=90)
        >>> [round(value, 2) for value in study.find_se()]
        [3.11, 95.47]
        >>> [round(value, 2) for value in study.enlarge(participants=10_000).find_se()]
        [2.53, 79.06]
        """
        people = self.slope_sd**2 / self.n_participants
        stimuli = self.item_sd**2 / self.square + self.noise_sd**2 / (self.n_participants * self.square)
        spare = max(self.n_items - self.n_recordings - self.n_slopes, 1)
        spread = people**2 / max(self.n_participants - 1, 1) + stimuli**2 / spare
        return math.sqrt(people + stimuli), (people + stimuli) ** 2 / spread if spread else math.inf

    def enlarge(self, *, participants: int | None = None, recordings: int | None = None) -> Precision:
        """Imagine the same study with other numbers.

        Parameters
        ----------
        participants, recordings : int, optional
            How many; each recording brings as many stimuli, and as different ones, as those here do on average.

        Returns
        -------
        Precision
            The same spreads.
        """
        share = (recordings or self.n_recordings) / self.n_recordings
        return replace(
            self, n_participants=participants or self.n_participants, n_recordings=recordings or self.n_recordings,
            square=self.square * share, n_items=round(self.n_items * share),
        )  # fmt: skip

    def find_power(self, slope: float) -> float:
        """Compute the chance that the 5 % test finds a slope.

        Parameters
        ----------
        slope : float
            The true one, in points per unit of the metric.

        Returns
        -------
        float
            By the noncentral t distribution, two-sided; NaN where nothing varies.
        """
        from scipy.stats import nct, norm, t

        se, df = self.find_se()
        if not 0 < se < math.inf:
            return math.nan
        limit, shift = float(t.ppf(1 - SIGNIFICANCE / 2, df)), abs(slope) / se
        power = float(nct.sf(limit, df, shift) + nct.cdf(-limit, df, shift))
        # SciPy's noncentral t gives up far out, where the normal distribution is as good.
        return power if math.isfinite(power) else float(norm.sf(limit - shift))

    def find_participants(self, slope: float) -> float:
        """Find how many participants give 80 % power with these recordings.

        Parameters
        ----------
        slope : float
            The true one.

        Returns
        -------
        float
            2 or more; NaN where not even 10 000 would do.
        """
        return _find_least(lambda number: self.enlarge(participants=number).find_power(slope))

    def find_recordings(self, slope: float) -> float:
        """Find how many recordings give 80 % power with these participants.

        Parameters
        ----------
        slope : float
            The true one.

        Returns
        -------
        float
            2 or more; NaN where not even 10 000 would do.
        """
        return _find_least(lambda number: self.enlarge(recordings=number).find_power(slope))

    def find_slope(self) -> float:
        """Find the smallest slope that this study would find with 80 % power.

        Returns
        -------
        float
            Points per unit of the metric; NaN where nothing varies.
        """
        from scipy.optimize import brentq

        se, _ = self.find_se()
        if not 0 < se < math.inf:
            return math.nan
        return float(brentq(lambda slope: self.find_power(slope) - ENOUGH, 0, 20 * se))


def find_own(metrics: np.ndarray, column: int) -> np.ndarray:
    """Find what one metric has and the others do not.

    Parameters
    ----------
    metrics : ndarray, shape (n_items, n_metrics)
        Less their recordings' means.
    column : int
        Which.

    Returns
    -------
    ndarray, shape (n_items,)
        Residuals of the metric on the others.

    Examples
    --------
    >>> find_own(np.array([[1.0, 0], [-1, 0], [0, 2], [0, -2]]), 0).tolist()
    [1.0, -1.0, 0.0, 0.0]
    """
    own, others = metrics[:, column], np.delete(metrics, column, axis=1)
    found: np.ndarray = own - others @ np.linalg.lstsq(others, own, rcond=None)[0] if others.shape[1] else own
    return found


def _find_least(power: Callable[[int], float]) -> float:
    """Search a number upwards of 2 by doubling, then by halving; power grows with it."""
    if not power(MOST) >= ENOUGH:
        return math.nan
    low, high = 1, 2
    while not power(high) >= ENOUGH:
        low, high = high, min(2 * high, MOST)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(middle) >= ENOUGH else (middle, high)
    return float(high)
