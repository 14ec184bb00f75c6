"""What people said of a scene: whether a reducer is shown to feel like the one that they rated highest.

The model is the report's (`feel321.analysis.report.reducers`) as far as it goes for one recording: ratings on
reducer, with a spread between participants. The margin is the study's: the one fixed beforehand, or half the spread
with which people repeat their ratings on that scale and level. A reducer passes if two one-sided tests show its
equivalence with the best-rated one on every scale and level that has a margin; "not significantly different" passes
nobody. Without a margin nothing can be shown, either way.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.contrasts.equivalence import equivalence
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.report.parts import find_repeat_sd, split_parts
from feel321.analysis.tradeoff.advise.scene import Rated

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.section import Part
    from feel321.analysis.table.reading import Table


def judge_ratings(table: Table, *, margin: float | None = None) -> dict[str, dict[str, Rated]]:
    """Judge the reducers of every recording by its ratings.

    Parameters
    ----------
    table : Table
        Ratings of a study.
    margin : float, optional
        Points that do not matter, fixed beforehand; half the spread of repeated ratings if left out.

    Returns
    -------
    dict
        Recording -> reducer -> what people said; without recordings of fewer than two rated reducers, and empty if
        there is no margin.
    """
    found = [(part, margin or _find_margin(part)) for part in split_parts(table)]
    parts = [(part, points) for part, points in found if points is not None]
    recordings = dict.fromkeys(
        name for part, _ in parts for name in part.rows["recording"].astype(str)
    )
    judged = {
        name: [_judge_part(part, points, name) for part, points in parts] for name in recordings
    }
    return {
        name: said
        for name, by_part in judged.items()
        if (said := _join([each for each in by_part if each]))
    }


def _find_margin(part: Part) -> float | None:
    sd, _ = find_repeat_sd(part.rows)
    return sd / 2 if sd > 0 else None


def _judge_part(part: Part, margin: float, recording: str) -> dict[str, Rated]:
    rows = part.rows[part.rows["recording"].astype(str) == recording]
    means = rows.groupby(rows["reducer"].astype(str))["rating"].mean()
    if len(means) < 2:  # noqa: PLR2004 - one reducer is like no other
        return {}
    best, simulated = str(means.idxmax()), bool(rows["simulated"].any())
    tested = _test(rows, best, margin=margin)
    return {
        str(name): Rated(
            is_best=name == best,
            best=best,
            p=tested.get(str(name), float("nan")),
            simulated=simulated,
        )
        for name in means.index
    }


def _test(rows: DataFrame, best: str, *, margin: float) -> dict[str, float]:
    """Test the equivalence of every reducer with the best; where ratings leave no error to test with, of none."""
    cells = (
        rows
        .astype({"reducer": str})
        .groupby(["participant", "reducer"], observed=True)["rating"]
        .mean()
    )
    names = sorted(set(cells.index.get_level_values("reducer")))
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    data = cells.reset_index().assign(which=lambda cell: cell["reducer"].map(codes))
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


def _join(by_part: list[dict[str, Rated]]) -> dict[str, Rated]:
    """Keep what each reducer is shown to be least: it must pass on every scale and level."""
    names = dict.fromkeys(name for found in by_part for name in found)
    return {
        name: _find_least([found[name] for found in by_part if name in found]) for name in names
    }


def _find_least(said: list[Rated]) -> Rated:
    least = max(
        said, key=lambda rated: 0.0 if rated.is_best else np.inf if np.isnan(rated.p) else rated.p
    )
    return replace(least, is_best=all(rated.is_best for rated in said))
