"""What a power analysis assumes: planted slopes, and standard deviations from pilot ratings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.power import design as records
from feel321.analysis.primary import model as primary

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.power.design import Truth
    from feel321.analysis.report.parts import RatingsPart
    from feel321.analysis.table.metrics import Step

WHO, ITEM, RATING = "participant", "item", "rating"


@dataclass(frozen=True, slots=True)
class Effects:
    """What is planted and where it comes from.

    points: per step of each metric, by attribute; given: whether a user said so; steps: by metric.
    """

    points: DataFrame
    steps: Mapping[str, Step]
    given: tuple[str, ...] = ()

    def is_given(self, attribute: str, metric: str) -> bool:
        """Check whether a user said the slope of a hypothesis."""
        return not {metric, f"{attribute}/{metric}"}.isdisjoint(self.given)

    def to_slopes(self) -> dict[str, float]:
        """Return the slopes of a Truth: points per unit of the metric, by attribute/metric."""
        return {
            f"{attribute}/{metric}": float(self.points.loc[attribute, metric]) / step.size
            for attribute in self.points.index
            for metric, step in self.steps.items()
        }


def fit_truths(rated: Sequence[RatingsPart], known: Mapping[str, Any]) -> Truth:
    """Fit the primary model of every attribute and pool the standard deviations, as their root mean square."""
    found = [_fit_truth(part, known) for part in rated]
    pooled: dict[str, Any] = {
        name: _pool([getattr(one, name) for one in found]) for name in records.SPREADS
    }
    for kind in ("slope_sds", "recording_slope_sds"):
        metrics = set.intersection(*(set(getattr(one, kind)) for one in found))
        pooled[kind] = {
            name: _pool([getattr(one, kind)[name] for one in found]) for name in sorted(metrics)
        }
    mean = float(np.mean([one.mean for one in found]))
    return replace(found[0], mean=mean, **pooled)


def _pool(sds: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(sds))))


def _fit_truth(part: RatingsPart, known: Mapping[str, Any]) -> Truth:
    """Take the spreads of one attribute; what repeats differ by is told from taste where there are repeats."""
    rows, changes = part.rows, dict(known)
    metrics = list(dict.fromkeys(name.split("/")[-1] for name in known["slopes"]))
    fit = primary.fit_primary(rows, metrics, explain=False)
    cells = rows.groupby([WHO, ITEM], observed=True)[RATING]
    if spare := len(rows) - cells.ngroups:
        squares = ((rows[RATING] - cells.transform("mean")) ** 2).sum()
        changes["rating_sd"] = float(np.sqrt(squares / spare))
    return records.Truth.from_fit(fit, repeats=round(len(rows) / cells.ngroups), **changes)
