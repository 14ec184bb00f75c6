"""Whether the ratings of a recording show that a reducer feels like the one rated highest.

The model is the report's (`feel321.analysis.report.reducers`) as far as it goes for one recording: ratings on
reducer, with a spread between participants. The margin is the study's: the one fixed beforehand, or half the spread
with which people repeat their ratings on that scale and level. A reducer passes if two one-sided tests show its
equivalence with the best-rated one on every scale and level that has a margin; "not significantly different" passes
nobody. Without a margin nothing can be shown, either way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.contrasts.equivalence import equivalence
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.report.parts import find_repeat_sd, split_parts

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.table.reading import Table

SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True)
class Rated:
    """What the ratings of a recording show about a reducer.

    best: the one rated highest, on the scale and level where equivalence with it is shown least; p: of that
    equivalence, by two one-sided tests, NaN where there is no test, as for the best itself; simulated: whether any of
    the ratings come from simulated participants.
    """

    is_best: bool
    best: str
    p: float
    simulated: bool = False

    @property
    def suffices(self) -> bool:
        """Whether it is the best, or shown to be equivalent to it."""
        return self.is_best or self.p < SIGNIFICANCE


def judge_ratings(table: Table, *, margin: float | None = None) -> dict[str, dict[str, Rated]]:
    """Judge the reducers of every recording by its ratings: recording -> reducer -> what they show.

    margin: points that do not matter, fixed beforehand; half the spread of repeated ratings if left out. Recordings of
    fewer than two rated reducers are left out; empty if there is no margin.
    """
    judged: dict[str, list[dict[str, Rated]]] = {}
    for part in split_parts(table):
        sd, _ = (2 * margin, 0) if margin else find_repeat_sd(part.rows)
        if not sd > 0:
            continue
        for name, rows in part.rows.groupby(part.rows["recording"].astype(str), sort=False):
            judged.setdefault(str(name), []).append(_judge(rows, margin=sd / 2))
    found = {name: _join([each for each in parts if each]) for name, parts in judged.items()}
    return {name: ratings for name, ratings in found.items() if ratings}


def _judge(rows: DataFrame, *, margin: float) -> dict[str, Rated]:
    means = rows.groupby(rows["reducer"].astype(str))["rating"].mean()
    if len(means) < 2:  # noqa: PLR2004 - one reducer has no other to be compared with
        return {}
    best, simulated = str(means.idxmax()), bool(rows["simulated"].any())
    tested = _test(rows, best, margin=margin)
    return {
        str(name): Rated(name == best, best, tested.get(str(name), float("nan")), simulated)
        for name in means.index
    }


def _test(rows: DataFrame, best: str, *, margin: float) -> dict[str, float]:
    """Test the equivalence of every reducer with the best; where ratings leave no error to test with, of none."""
    by = ["participant", "reducer"]
    data = rows.astype({"reducer": str}).groupby(by, observed=True)["rating"].mean().reset_index()
    names = sorted(set(data["reducer"]))
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    data["which"] = data["reducer"].map(codes)
    try:
        fit = fit_mixed("rating ~ 0 + which + (1 | participant)", data)
        found = {
            name: contrast(fit, {f"which{codes[name]}": 1, f"which{codes[best]}": -1})
            for name in names
            if name != best
        }
    except ValueError:
        return {}
    return {
        name: equivalence(one.estimate, one.se, one.df, low=-margin, high=margin).p
        for name, one in found.items()
        if 0 < one.se < np.inf
    }


def _join(parts: list[dict[str, Rated]]) -> dict[str, Rated]:
    """Keep of each reducer the scale and level on which least is shown: it must pass on all of them."""

    def order(rated: Rated) -> float:
        return 0.0 if rated.is_best else np.inf if np.isnan(rated.p) else rated.p

    found = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        own = [part[name] for part in parts if name in part]
        found[name] = replace(max(own, key=order), is_best=all(rated.is_best for rated in own))
    return found
