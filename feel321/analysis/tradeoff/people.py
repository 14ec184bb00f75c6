"""What people's ratings say of the reducers of each recording, if a margin was fixed beforehand.

Ratings of a recording on reducer, with a spread between participants; each reducer is compared with the one rated
highest. *Equivalent*: two one-sided tests place the difference within the margin. *Worse*: the 90 % interval of the
difference lies beyond it. *Open* otherwise: "not significantly different" shows nothing. On several scales and levels
the least favourable counts.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from feel321.analysis.contrasts.compare import equivalence
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.table.items import split_arms

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.table.items import Table

NEEDED = ("participant", "recording", "reducer", "scale", "level", "rating")
COLUMNS = ("recording", "reducer", "agree", "best", "difference", "low", "high", "simulated")

BEST, EQUIVALENT, OPEN, WORSE = "best", "equivalent", "open", "worse"
FAVOUR = (BEST, EQUIVALENT, OPEN, WORSE)
"""What ratings say of a reducer, from the most favourable on."""

SIGNIFICANCE = 0.05


def compare_rated(ratings: Table | DataFrame | None, *, margin: float | None = None) -> DataFrame:
    """Compare the reducers of every recording with the best-rated: one row each; none without ratings or margin."""
    import pandas as pd

    found: list[dict[str, Any]] = []
    rows = None if ratings is None else read_ratings(ratings)
    if margin is not None and not (isfinite(margin) and margin > 0):
        raise ValueError(f"margin must be a number of points above 0, got {margin:g}")
    if rows is not None and margin is not None:
        for part in split_arms(rows):
            scenes = part.rows["recording"].astype(str)
            for recording, own in part.rows.groupby(scenes, sort=False):
                found += [{"recording": str(recording), **one} for one in _compare(own, margin)]
    frame = pd.DataFrame(found, columns=list(COLUMNS))
    place = frame["agree"].map({name: number for number, name in enumerate(FAVOUR)})
    order = frame.assign(place=place).sort_values("place", kind="stable")
    worst = order.groupby(["recording", "reducer"], sort=False).tail(1)
    return worst.drop(columns="place").reset_index(drop=True)


def read_ratings(ratings: Table | DataFrame) -> DataFrame:
    """Take ratings of test stimuli; of a data frame every row is one, and nobody simulated, if not said."""
    from feel321.analysis.arrays import check_columns
    from feel321.analysis.table.items import (
        Table,
        leave_rejected,
        name_items,
        open_ratings,
        select_tests,
    )

    if isinstance(ratings, Table):
        return select_tests(ratings)
    rows, _ = leave_rejected(name_items(open_ratings(ratings)))
    check_columns(rows, NEEDED, "ratings")
    return rows.assign(simulated=rows.get("simulated", False))


def _compare(rows: DataFrame, margin: float) -> list[dict[str, Any]]:
    """Compare the reducers of one recording; of fewer than two there is nothing to compare."""
    data = (
        rows
        .astype({"reducer": str})
        .groupby(["participant", "reducer"], observed=True)["rating"]
        .mean()
        .reset_index()
    )
    means = data.groupby("reducer")["rating"].mean()
    if len(means) < 2:  # noqa: PLR2004 - one reducer has no other
        return []
    best = str(means.idxmax())
    codes = {name: f"c{number}" for number, name in enumerate(means.index)}
    data["which"] = data["reducer"].map(codes)
    try:
        fit = fit_mixed("rating ~ 0 + which + (1 | participant)", data)
    except ValueError:  # too few ratings leave no error to test with
        fit = None
    found = []
    for name, code in codes.items():
        row = {"reducer": name, "agree": BEST if name == best else OPEN, "best": best}
        row |= {
            "difference": float(means[name] - means[best]),
            "simulated": bool(rows["simulated"].any()),
        }
        if fit is not None and name != best:
            one = contrast(fit, {f"which{code}": 1, f"which{codes[best]}": -1})
            if 0 < one.se < float("inf"):
                test = equivalence(one.estimate, one.se, one.df, low=-margin, high=margin)
                row |= {"difference": one.estimate, "low": test.low90, "high": test.high90}
                row["agree"] = (
                    EQUIVALENT
                    if test.p < SIGNIFICANCE
                    else WORSE
                    if test.high90 < -margin
                    else OPEN
                )
        found.append(row)
    return found
