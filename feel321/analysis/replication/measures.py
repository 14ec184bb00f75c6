"""Measures that the claims of papers are examined with.

Landin et al. 2010 (doi:10.1007/978-3-642-14075-4_12): metrics of transforms, and how they were rated. Lee et al. 2022
(doi:10.1109/TOH.2022.3174229): one axis against three, and what the axes of maps mean; both take dissimilarities.
Park & Kuchenbecker 2019 (doi:10.1109/WHC.2019.8816148): mean and spread of matches over orientations of the sensor. A
low spread is meant to be good, but a reducer that matches nothing has nothing to lose when the sensor turns: where such
reducers were rated, spread and mean rise together, and alone the spread goes with ratings the wrong way.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis import maps, words
from feel321.analysis.association.correlate import correlate
from feel321.analysis.contrasts.compare import fit_reducers
from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary.model import fit_primary, fit_slopes
from feel321.analysis.primary.plan import REDUCER, make_cells
from feel321.analysis.primary.sensitivity import FEWEST_REDUCERS, measure_excess
from feel321.analysis.replication.claims import USUAL_LEVEL, ClaimValue, Ends
from feel321.analysis.table.metrics import ROTATIONS
from feel321.analysis.table.schema import PAIRED
from feel321.analysis.words import INTERVALS
from feel321.doors import check_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pandas import DataFrame, Series

    from feel321.analysis.replication.claims import PaperClaim
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

OVER_RECORDINGS = "95 % t interval over recordings"
LIMIT = 0.05
"""Where permutations cannot give a p below, nothing is estimated."""

MEAN, SD = "_rotation_mean", "_rotation_sd"


def require_option(claim: PaperClaim, name: str) -> str:
    """Take an option that a measure cannot do without."""
    if name not in claim.options:
        raise ValueError(f"options must name a {name}; add {name} = ... to the claim {claim.name}")
    return str(claim.options[name])


def tabulate_metric(table: Table, metric: str) -> DataFrame:
    """Tabulate a metric of the test stimuli of one level, rated or not: recordings by reducers."""
    stimuli = table.stimuli
    if stimuli is None or metric not in stimuli:
        raise ValueError(f"the manifest has no column {metric!r}")
    tests = stimuli[stimuli["role"] == "test"]
    rated = [str(level) for level in table.rows["level"].unique()]
    level = rated[0] if len(rated) == 1 else USUAL_LEVEL
    own = tests[tests["level"] == level] if (tests["level"] == level).any() else tests
    return own.pivot_table(metric, "recording", "reducer", observed=True).rename(columns=str)


def measure_metric(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Average a metric of a reducer over recordings; options: metric, reducer, recording (one alone), among."""
    metric, reducer = require_option(claim, "metric"), require_option(claim, "reducer")
    found = tabulate_metric(table, metric)
    if recording := claim.options.get("recording"):
        check_name(recording, sorted(found.index), "recording")
        found = found.loc[[recording]]
    elif table.stimuli is not None and "source" in table.stimuli:
        # Turned copies of one recording count once.
        sources = table.stimuli.drop_duplicates("recording").set_index("recording")["source"]
        found = found.groupby(sources.astype(str)).mean()
    check_name(reducer, sorted(map(str, found)), "reducer")
    own = found[reducer]
    others = choose_others(claim, found, reducer)
    beside = {name: _average(own - found[name]) for name in others}
    return ClaimValue(
        *_average(own), n=len(own), beside=beside, interval=OVER_RECORDINGS if len(own) > 1 else "",
        method=f"{metric} of {reducer}, mean over recordings", note=note_lacking(claim, found),
    )  # fmt: skip


def _average(values: Series[float]) -> Ends:
    """Average with a t interval."""
    from scipy.stats import t as student

    known = values.dropna()
    mean, n = float(known.mean()), len(known)
    if n < 2:  # noqa: PLR2004 - a spread needs two
        return mean, math.nan, math.nan
    half = float(student.ppf(0.975, n - 1) * known.std(ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half


def measure_rating(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate the mean rating of a reducer, and its difference from all others; options: reducer, among."""
    reducer = require_option(claim, "reducer")
    rows = table.rows[table.rows["role"] == "test"].assign(item=lambda part: part["stimulus_id"])
    rated = sorted(rows["reducer"].unique())
    check_name(reducer, rated, "reducer")
    if len(rated) < 2:  # noqa: PLR2004 - nothing to compare with
        raise ValueError("one reducer alone was rated")
    fit, terms, n = fit_reducers(rows, rated)
    mean = contrast(fit, {terms[reducer]: 1})
    beside = {}
    for name in choose_others(claim, rated, reducer):
        gap = contrast(fit, {terms[reducer]: 1, terms[name]: -1})
        beside[name] = (gap.estimate, gap.low, gap.high)
    return ClaimValue(
        mean.estimate, mean.low, mean.high, "rating", "points", n, "mixed model with reducers, mean rating",
        INTERVALS["satterthwaite"], beside, note_lacking(claim, rated),
    )  # fmt: skip


def measure_slope(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate the slope of ratings on a metric within recordings, all metrics together; option: metric."""
    metric = require_option(claim, "metric")
    metrics = dict.fromkeys([*table.metrics, metric])
    fit = fit_primary(table, list(metrics), explain=False)
    if metric not in fit.slopes.index or not fit.slopes.loc[metric, "estimable"]:
        raise ValueError(f"the slope on {metric} is not estimable")
    slope = fit.slopes.loc[[metric]].to_dict("records")[0]
    return ClaimValue(
        slope["tenth"], slope["tenth_low"], slope["tenth_high"], "slope", "points per +0.1", fit.n_items,
        f"mixed model, {metric} within recordings", INTERVALS["satterthwaite"],
    )  # fmt: skip


def choose_others(claim: PaperClaim, names: Iterable[object], own: str) -> list[str]:
    """Choose what a reducer is compared with: those of the option `among`, or all others."""
    known, among = [str(name) for name in names if name != own], claim.options.get("among")
    chosen = [name for name in known if among is None or name in among]
    if not chosen and claim.expect in {"highest", "lowest"}:
        raise ValueError(f"none of the reducers that {own} is to be compared with is there")
    return chosen


def note_lacking(claim: PaperClaim, names: Iterable[object]) -> str:
    """Name the reducers of the option `among` that a study lacks."""
    known = {str(name) for name in names}
    lacking = [name for name in claim.options.get("among", ()) if name not in known]
    return f"Not compared, because missing here: {', '.join(lacking)}." if lacking else ""


def measure_told_apart(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Take the reducer that is least clearly told from the original; option: reducer, for one alone.

    That all are told apart is shown where this one is, so that no adjustment for their number is needed.
    """
    found = compare_with_original(table.rows)
    single = found[found["reducer"] != EVERY].set_index("reducer")
    if reducer := claim.options.get("reducer"):
        single = single.loc[[check_name(str(reducer), sorted(single.index), "reducer")]]
    name = str(single["low"].idxmin())
    row = single.loc[name].to_dict()
    more = f"of {len(single)} reducers" if len(single) > 1 else ""
    d_prime = f"d' {row['d_prime']:.1f}" if row["area"] < 1 else "d' unbounded"
    return ClaimValue(
        row["difference"], row["low"], row["high"], "rating", "points", int(row["n_participants"]),
        f"dissimilarity of {name} from the original less that of identical pairs", "95 % t interval over participants",
        note=f"This is {name}, the least clear {more}".rstrip() + f" ({d_prime}).",
    )  # fmt: skip


def measure_attribute(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:
    """Take R² of an attribute on the axes of the maps, above that of permuted stimuli; option: attribute.

    The interval holds the middle 90 % of permutations: it excludes zero where p (one-sided) is below 0.05.
    """
    attribute = str(claim.options.get("attribute", maps.DIRECTIONS))
    rows = table.rows[table.rows["scale"] == PAIRED]
    if rows.empty:
        raise ValueError(f'no dissimilarity was rated; name options.scale = "{PAIRED}"')
    rng = choices.make_rng("lee", claim.name)
    whole = maps.map_all(rows, rng=rng)
    points = maps.gather_points(rows, table.stimuli, whole, rng=rng)
    check_name(attribute, sorted(points.attributes), "attribute")
    draws = min(choices.draws, 1000)
    (row,) = maps.regress_points(points.select(attribute), draws=draws, rng=rng)
    if row["p_least"] >= LIMIT:
        raise ValueError(
            f"permutations of {len(points.stimuli)} stimuli give no p below {row['p_least']:.2f} for {attribute}"
        )
    return ClaimValue(
        row["r2"] - row["chance"], row["r2"] - row["chance_high"], row["r2"] - row["chance_low"], "correlation",
        "of the variance above chance", row["n"],
        f"R² of {attribute} on the axes of the maps within recordings, less that of permuted stimuli",
        "90 % of permutations", note=f"R² is {row['r2']:.2f}, permutation p = {row['p']:.3f}.",
    )  # fmt: skip


def explain_spread(rows: DataFrame, metric: str) -> str:
    """Say why a spread may go with ratings the wrong way, where it rises with its mean; else nothing."""
    mean = metric.removesuffix(SD) + MEAN
    if not (metric in ROTATIONS and metric.endswith(SD) and {metric, mean} <= set(rows)):
        return ""
    items = rows.loc[rows["role"] == "test", ["recording", "reducer", mean, metric]]
    items = items.drop_duplicates()
    own = items[[mean, metric]].astype(float)
    within = own - own.groupby(items["recording"].astype(str)).transform("mean")
    sizes = within.to_numpy().std(axis=0)
    if len(items) < 3 or not (sizes > 1e-9).all():  # noqa: PLR2004 - two points are always on a line
        return ""
    together = float(np.corrcoef(within.to_numpy().T)[0, 1])
    if not together > 0:
        return ""
    means = own.groupby(items["reducer"].astype(str)).mean()
    lowest = str(means[mean].idxmin())
    is_smallest = means.loc[lowest, metric] == means[metric].min()
    least, spread = (words.format_number(float(means[one][lowest])) for one in (mean, metric))
    why = (
        f"a reducer that matches nothing has nothing to lose when the sensor turns, and {lowest} has the lowest "
        f"mean ({least}) and the smallest spread ({spread})"
        if is_smallest
        else f"reducers that match better vary more ({lowest}: lowest mean, {least}; spread {spread})"
    )
    return (
        f"a small {words.format_name(metric)} is no merit by itself: within recordings it rises with the mean (r = "
        f"{words.format_number(together)}): {why}. Alone, the spread may relate to ratings in the unexpected "
        "direction; with the mean in the model, its slope compares reducers that match equally well."
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
        interval=words.INTERVALS["two-way"], note=words.capitalise(explain_spread(table.rows, metric)) if wrong else "",
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
