"""Measures of Landin et al. 2010 (doi:10.1007/978-3-642-14075-4_12): metrics of transforms, and how they were rated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from feel321.analysis.contrasts.compare import fit_reducers
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.replication.claims import USUAL_LEVEL, ClaimValue, Ends, require_option
from feel321.analysis.words import SATTERTHWAITE
from feel321.doors import check_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pandas import DataFrame, Series

    from feel321.analysis.replication.claims import PaperClaim
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

OVER_RECORDINGS = "95 % t interval over recordings"


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
        SATTERTHWAITE, beside, note_lacking(claim, rated),
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
        f"mixed model, {metric} within recordings", SATTERTHWAITE,
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
