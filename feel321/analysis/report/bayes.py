"""Section: the primary slopes once more with priors, a sensitivity analysis that is made where it is asked for."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.primary.bayes import PRIORS, BayesianSlopes, fit_bayesian, require_numpyro
from feel321.analysis.report.parts import RatingsPart, thin_parts
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    RATINGS,
    TEXT,
    Column,
    Section,
    TableForm,
    estimate,
    read_methods,
)
from feel321.analysis.words import COUNT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

KEY, TITLE = "bayes", "Sensitivity: the slopes with priors"
WIDTHS = {"as_stated": 1.0, "twice_as_wide": 2.0}
"""Which priors -> factor on their scales."""

CREDIBLE = "95 % credible interval"
POINTS = "points of rating from the metric's lower to its upper quartile within recordings"
SLOPES = TableForm(
    "Sensitivity analysis, exploratory: slopes within recordings of the primary model with priors, in points from the "
    "lower to the upper quartile of the metric; hypotheses are decided by the primary model, whose slopes are beside. "
    "Direction: probability of the more probable sign. Within margin: posterior share of effects that do not matter. "
    "A dash: not estimable. Agrees: both intervals say the same of zero.",
    (
        RATINGS, METRIC, Column("Prior", "prior", TEXT),
        Column(
            "Posterior mean", "quartile_effect", "slope", "quartile_effect", f"posterior mean, {POINTS}", CREDIBLE,
            ends="quartile_",
        ),
        Column("Direction", "direction", end="direction", method="posterior probability of the more probable sign"),
        Column("Within margin", "negligible", end="negligible", method="posterior share of effects within the margin"),
        estimate("Primary model", "reml_effect", f"mixed model, {POINTS}", end="reml_effect", ends="reml_"),
        Column("Agrees", "_agrees", NAME),
        Column("R-hat", "rhat", "p", "rhat", "largest split R-hat of the fit"),
        Column("Effective draws", "ess", COUNT, "ess", "smallest effective number of draws of the fit"),
        Column("Divergences", "divergences", COUNT, "divergences"),
    ),
    path="bayes.{scale}.{level}.{metric}.{prior}", detail=False,
)  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:
    """Fit the primary model of every scale and level with priors, where that was asked for."""
    if not choices.bayes:
        return Section(KEY, TITLE)
    rows: list[dict[str, Any]] = []
    notes: list[str] = []
    for part in thin_parts(table, choices):
        try:
            found = _fit(part, table, choices)
        except ValueError as error:
            notes.append(f"{part.lead}: no Bayesian counterpart. {error}")
            continue
        rows += [row for prior, one in found.items() for row in _list_rows(part, prior, one)]
        notes += _list_notes(part, found)
    answers = [_describe(row) for row in rows if row["prior"] == "as_stated"]
    how = (*read_methods(KEY), *PRIORS)
    return Section(
        KEY, TITLE, answers, grids=(SLOPES.build(rows),), tables={KEY: rows}, notes=notes, how=how
    )


def _list_notes(part: RatingsPart, found: dict[str, BayesianSlopes]) -> Iterator[str]:
    for prior, one in found.items():
        named = words.format_name(prior)
        yield from (f"{part.lead}, priors {named}: {note}" for note in one.notes)


def describe_sampler() -> dict[str, str]:
    """Name the versions of what draws from the posterior; refuse where it is not installed."""
    require_numpyro()
    return {name: version(name) for name in ("numpyro", "jax")}


def _fit(part: RatingsPart, table: Table, choices: Choices) -> dict[str, BayesianSlopes]:
    """Fit with the priors as stated, and with wider ones."""
    return {
        prior: fit_bayesian(
            part.rows,
            table.metrics,
            margin=choices.margin,
            width=width,
            rng=choices.make_rng(KEY, *part.place, prior),
        )
        for prior, width in WIDTHS.items()
    }


def _list_rows(part: RatingsPart, prior: str, found: BayesianSlopes) -> Iterator[dict[str, Any]]:
    gates = {"rhat": found.rhat, "ess": found.ess, "divergences": found.divergences}
    more = {"prior": prior, "margin": found.margin, "n": len(part.rows)}
    for told in found.to_frame().to_dict("records"):
        row: dict[str, Any] = {str(key): value for key, value in told.items()}
        why = _explain(row, found)
        agrees = "not estimable" if why else ("no", "yes")[bool(row["agrees"])]
        row |= {"agrees": agrees, "_agrees": agrees, "reason": why}
        yield part.keys | row | gates | more


def _explain(row: dict[str, Any], found: BayesianSlopes) -> str:
    """Explain why there is no number; empty where there is one."""
    if not found.converged:
        return "the chains have not converged"
    return "" if np.isfinite(row["estimate"]) else "the primary slope is not estimable"


def _describe(row: dict[str, Any]) -> str:
    """Say what the posterior of a slope is, beside the primary one."""
    ratings, metric = words.format_name(row["scale"]), words.format_name(row["metric"])
    subject = f"{words.capitalise(ratings)}, {metric}"
    if row["reason"]:
        return f"{subject}: not estimable with priors, because {row['reason']}."
    told, interval = _format_effect(row, "quartile_effect", "quartile_")
    former, beside = _format_effect(row, "reml_effect", "reml_")
    sure = words.format_number(row["direction"], kind="correlation")
    other = "" if row["agrees"] == "yes" else "; they disagree on whether the effect may be zero"
    return (
        f"{subject}: with priors {told} points from quartile to quartile (95 % interval {interval}; probability of its "
        f"sign {sure}), in the primary model {former} ({beside}){other}."
    )


def _format_effect(row: dict[str, Any], key: str, ends: str) -> tuple[str, str]:
    return words.format_estimate(row[key], row[f"{ends}low"], row[f"{ends}high"], kind="slope")
