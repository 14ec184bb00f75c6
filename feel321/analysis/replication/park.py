"""Measures of Park & Kuchenbecker 2019 (doi:10.1109/WHC.2019.8816148): metrics over orientations of the sensor.

The paper's four metrics are mean and spread of two matches over orientations. A low spread is meant to be good, but a
reducer that matches nothing has nothing to lose when the sensor turns: where such reducers were rated, spread and mean
rise together, and alone the spread goes with ratings the wrong way.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis import words
from feel321.analysis.association.correlate import correlate
from feel321.analysis.primary.model import fit_slopes
from feel321.analysis.primary.plan import REDUCER, make_cells
from feel321.analysis.primary.sensitivity import FEWEST_REDUCERS, measure_excess
from feel321.analysis.replication.claims import ClaimValue, require_option
from feel321.analysis.table.metrics import ROTATIONS
from feel321.doors import check_name

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication.claims import PaperClaim
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

MEAN, SD = "_rotation_mean", "_rotation_sd"


class Companions(NamedTuple):
    """How spread and mean of a match go together within recordings.

    r: their correlation over stimuli, each less its recording's mean; reducer: the one with the lowest mean; mean,
    spread: its two; rank: how many reducers have a smaller spread.
    """

    r: float
    reducer: str
    mean: float
    spread: float
    rank: int


def compare_spread(rows: DataFrame, metric: str) -> Companions | None:
    """Compare a spread with its mean over the rated test stimuli; None where the rows hold no two such metrics."""
    mean = metric.removesuffix(SD) + MEAN
    if not (metric in ROTATIONS and metric.endswith(SD) and {metric, mean} <= set(rows)):
        return None
    items = rows.loc[rows["role"] == "test", ["recording", "reducer", mean, metric]]
    items = items.drop_duplicates()
    own = items[[mean, metric]].astype(float)
    within = own - own.groupby(items["recording"].astype(str)).transform("mean")
    sizes = within.to_numpy().std(axis=0)
    if len(items) < 3 or not (sizes > 1e-9).all():  # noqa: PLR2004 - two points are always on a line
        return None
    means = own.groupby(items["reducer"].astype(str)).mean()
    names, values = list(means.index), means.to_numpy()
    lowest = int(values[:, 0].argmin())
    least, spread = values[lowest].tolist()
    rank = int((values[:, 1] < spread).sum())
    return Companions(
        float(np.corrcoef(within.to_numpy().T)[0, 1]), names[lowest], least, spread, rank
    )


def explain_spread(rows: DataFrame, metric: str) -> str:
    """Say why a spread may go with ratings the wrong way, where it rises with its mean; else nothing."""
    found = compare_spread(rows, metric)
    if found is None or not found.r > 0:
        return ""
    name, r = words.format_name(metric), words.format_number(found.r)
    mean, spread = (words.format_number(one) for one in (found.mean, found.spread))
    why = (
        f"a reducer that matches nothing has nothing to lose when the sensor turns, and {found.reducer} has the lowest "
        f"mean ({mean}) and the smallest spread ({spread})"
        if not found.rank
        else f"reducers that match better vary more ({found.reducer}: lowest mean, {mean}; spread {spread})"
    )
    return (
        f"a small {name} is no merit by itself: within recordings it rises with the mean (r = {r}): {why}. Alone, "
        "the spread may relate to ratings in the unexpected direction; with the mean in the model, its slope compares "
        "reducers that match equally well."
    )


def measure_correlation(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:
    """Correlate mean ratings with a metric over stimuli; options: metric, and method (`correlate`)."""
    metric = require_option(claim, "metric")
    method = str(claim.options.get("method", "pearson"))
    rng = choices.make_rng("paper", claim.name)
    found = correlate(table, metric, method=method, draws=choices.draws, rng=rng)
    if not math.isfinite(found.value + found.low + found.high):
        raise ValueError(" ".join(found.notes) or "the correlation has no interval")
    wrong = metric in ROTATIONS and metric.endswith(SD) and found.value > 0
    return ClaimValue(
        found.value, found.low, found.high, n=found.n_items,
        method=f"{words.format_method(method)} of mean ratings with {words.format_name(metric)}",
        interval=words.TWO_WAY, note=words.capitalise(explain_spread(table.rows, metric)) if wrong else "",
    )  # fmt: skip


def measure_rating_excess(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate how much higher a reducer is rated than metrics predict from all others; options: reducer, metrics."""
    from scipy.stats import t as student

    reducer = require_option(claim, "reducer")
    metrics = claim.options.get("metrics", table.metrics)
    cells = make_cells(table.rows, [metrics] if isinstance(metrics, str) else list(metrics))
    rated = list(map(str, cells.items[REDUCER].unique()))
    check_name(reducer, rated, "reducer")
    if len(rated) < FEWEST_REDUCERS:
        raise ValueError(f"{len(rated)} reducers were rated, {FEWEST_REDUCERS} are needed")
    excess, se, df = measure_excess(cells, reducer, fit_slopes(cells.leave_out(REDUCER, reducer)))
    half = float(student.ppf(0.975, df)) * se
    if not half > 0:
        raise ValueError(f"the excess of {reducer} has no interval")
    return ClaimValue(
        excess, excess - half, excess + half, "rating", "points", len(rated),
        f"rating of {reducer} beyond what slopes on the metrics, fitted without it, predict",
        "95 % t interval over reducers, with the uncertainty of the slopes",
    )  # fmt: skip
