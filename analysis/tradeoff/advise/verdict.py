"""Is a reducer as good as the best? Shortfalls in units of the tolerance, one per criterion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.advise.draws import TURNS_ALONG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.tradeoff.advise.measures import Measures
    from analysis.tradeoff.advise.simplicity import Cost
    from analysis.tradeoff.advise.tolerance import Tolerance

SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True)
class Shortfall:
    """How far a reducer stays behind the best one of each criterion; 1 is the tolerance, 0 the best itself.

    Parameters
    ----------
    level, spectrum, time, change : float
        By criterion.
    """

    level: float
    spectrum: float
    time: float
    change: float

    @property
    def worst(self) -> float:
        """The largest of them."""
        return max(self.level, self.spectrum, self.time, self.change)

    @property
    def criterion(self) -> str:
        """Where it is largest, the first among equals."""
        return max((field.name for field in fields(self)), key=lambda name: float(getattr(self, name)))


@dataclass(frozen=True, slots=True)
class Rated:
    """What the ratings of a scene say of a reducer.

    Parameters
    ----------
    is_best : bool
        Whether it was rated highest.
    best : str
        Which was, on the scale and level where equivalence is shown least.
    p : float
        Of equivalence with that, two one-sided tests; NaN where there is no test, as for the best itself.
    simulated : bool
        Whether simulated participants are among those who said so.
    """

    is_best: bool
    best: str
    p: float
    simulated: bool = False

    @property
    def suffices(self) -> bool:
        """Whether it is the best, or shown to be equivalent to it."""
        return self.is_best or self.p < SIGNIFICANCE


@dataclass(frozen=True, slots=True)
class Verdict:
    """A reducer judged on a scene.

    Parameters
    ----------
    cost : Cost
        Its record.
    measures : Measures
        What it makes of the scene in the draw that decides.
    shortfall : Shortfall
        Against the best of all reducers in that draw, in the budget or not.
    in_budget : bool
        Whether it may run in the context.
    rated : Rated or None
        What people said; None where nobody was asked about it.
    needs_ratings : bool
        Whether the scene was rated, so that a reducer which was not cannot be called sufficient.
    best_spectrum, best_time : float
        The best reducer's, in the draw that decides.
    suits, segments : int
        In how many segments it is within tolerance whatever the mounting, and of how many.
    """

    cost: Cost
    measures: Measures
    shortfall: Shortfall
    in_budget: bool
    rated: Rated | None = None
    needs_ratings: bool = False
    best_spectrum: float = 1.0
    best_time: float = 1.0
    suits: int = 1
    segments: int = 1

    @property
    def name(self) -> str:
        """The reducer."""
        return self.cost.name

    @property
    def fits(self) -> bool:
        """Whether it is within tolerance of the best on every criterion."""
        return self.shortfall.worst <= 1

    @property
    def is_sufficient(self) -> bool:
        """Whether it fits, and people agree if they were asked."""
        return self.fits and (self.rated.suffices if self.rated else not self.needs_ratings)

    @property
    def suits_partly(self) -> bool:
        """Whether it suffices in some segments and not in others, by no chance of the mounting."""
        return 0 < self.suits < self.segments and not self.fits and self.name.partition("@")[0] in TURNS_ALONG

    @property
    def margin(self) -> float:
        """Share of the tolerance that is left."""
        return 1 - self.shortfall.worst


def compare(
    scores: NDArray[np.float64], gains_db: NDArray[np.float64], tolerance: Tolerance
) -> NDArray[np.float64]:
    """Compare every reducer with the best one of each criterion, draw by draw.

    Parameters
    ----------
    scores : ndarray, shape (n_reducers, n_draws, 4)
        Level in dB, spectrum, time and change; NaN where a reducer was not tried.
    gains_db : ndarray, shape (n_reducers, 1)
        Fixed gains, as `Measures.gain_db`.
    tolerance : Tolerance
        What is as good.

    Returns
    -------
    ndarray, shape (n_reducers, n_draws, 4)
        Shortfalls, in the order of `Shortfall`'s fields; NaN as before.
    """
    level_db, spectrum, time, change = np.moveaxis(scores, -1, 0)
    deviation = np.maximum(np.abs(level_db), gains_db - level_db)
    best_time = np.fmax.reduce(time, axis=0)
    shares = np.divide(time, best_time, out=np.where(np.isnan(time), np.nan, 1.0), where=best_time > 0)
    shortfalls = (
        (deviation - np.fmin.reduce(deviation, axis=0)) / tolerance.level_db,
        (np.fmax.reduce(spectrum, axis=0) - spectrum) / tolerance.spectrum,
        (1 - shares**2) / tolerance.time,
        (change - np.fmin.reduce(change, axis=0)) / tolerance.change,
    )
    return np.stack(shortfalls, axis=-1)
