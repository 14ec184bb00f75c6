"""Is a reducer as good as the best? Shortfalls in units of the tolerance, one per criterion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

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
        What it makes of the scene.
    shortfall : Shortfall
        Against the best of all reducers, in the budget or not.
    in_budget : bool
        Whether it may run in the context.
    rated : Rated or None
        What people said; None where nobody was asked about it.
    needs_ratings : bool
        Whether the scene was rated, so that a reducer which was not cannot be called sufficient.
    """

    cost: Cost
    measures: Measures
    shortfall: Shortfall
    in_budget: bool
    rated: Rated | None = None
    needs_ratings: bool = False

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
    def margin(self) -> float:
        """Share of the tolerance that is left."""
        return 1 - self.shortfall.worst


def compare(measured: Sequence[Measures], tolerance: Tolerance) -> list[Shortfall]:
    """Compare every reducer with the best one of each criterion.

    Parameters
    ----------
    measured : sequence of Measures
        All reducers of a scene.
    tolerance : Tolerance
        What is as good.

    Returns
    -------
    list of Shortfall
        In the same order.
    """
    level = min(each.deviation_db for each in measured)
    spectrum = max(each.spectrum for each in measured)
    time = max(each.time for each in measured)
    change = min(each.change for each in measured)
    return [
        Shortfall(
            level=(each.deviation_db - level) / tolerance.level_db,
            spectrum=(spectrum - each.spectrum) / tolerance.spectrum,
            time=(1 - (each.time / time) ** 2 if time > 0 else 0.0) / tolerance.time,
            change=(each.change - change) / tolerance.change,
        )
        for each in measured
    ]
