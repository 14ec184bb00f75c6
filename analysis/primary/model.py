"""The primary analysis: slopes of ratings on metrics within recordings, for people and stimuli in general.

Stimuli are a sample as people are. A model without a term for them takes the many ratings of one stimulus for
independent evidence: in simulated studies 41 % of its tests found a metric that predicts nothing. The model here
holds every source of spread that the design has, and is reduced only where the data cannot carry it, each time
in words; never because a test says that a spread may be zero.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from analysis.mixed.model import contrast, fit_mixed
from analysis.primary.cells import ITEM, RATING, SCENE, WHO, Cells, make_cells
from analysis.primary.plan import ALIKE, plan_terms
from analysis.table.tidy import open_ratings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pandas import DataFrame

    from analysis.mixed.inference import Estimate
    from analysis.mixed.model import MixedFit
    from analysis.primary.plan import Plan

TENTH = 0.1
FEW = 5
"""Fewer participants or recordings (or sources of them) than this leave their spread all but unknown."""


@dataclass(frozen=True, slots=True)
class Primary:
    """The primary model of one attribute.

    Parameters
    ----------
    formula : str
        The model, in lme4's notation.
    fit : MixedFit
        All of it.
    slopes : DataFrame
        Slopes within recordings, indexed by ``metric``: estimate se df t p low high per unit of the metric,
        ``tenth tenth_low tenth_high`` points per +0.1, ``standardised standardised_low standardised_high`` in
        standard deviations.
    between : DataFrame
        Slopes between recordings, the same columns but for the last six; empty where recordings are too few.
    differences : DataFrame
        Every two metrics' slopes compared: first, second, and the columns of `Estimate`; then the same of the
        standardised slopes, with ``standardised_`` before.
    marginal_r2, conditional_r2 : float
        Nakagawa's R²: of the metrics, and of everything in the model.
    item_variance_explained : float
        Share of the spread between stimuli of a recording that the metrics account for; negative by chance,
        NaN where a model without metrics sees no such spread, or was not asked for.
    averaged : bool
        Whether repeats were averaged before.
    n_rows, n_participants, n_recordings, n_items : int
        Size of the data.
    n_sources : int
        What is independent among the recordings: as many, unless several come from one.
    reductions : tuple of str
        What the full model has and this one has not, and why.
    notes : tuple of str
        What is unusual, one sentence each; singular fits among it.
    """

    formula: str
    fit: MixedFit
    slopes: DataFrame
    between: DataFrame
    differences: DataFrame
    marginal_r2: float
    conditional_r2: float
    item_variance_explained: float
    averaged: bool
    n_rows: int
    n_participants: int
    n_recordings: int
    n_items: int
    n_sources: int
    reductions: tuple[str, ...]
    notes: tuple[str, ...]


def fit_primary(
    rows: DataFrame,
    metrics: Sequence[str],
    *,
    correlated: bool = False,
    by_reducer: bool = False,
    explain: bool = True,
) -> Primary:
    """Fit the primary model of one attribute.

    Parameters
    ----------
    rows : DataFrame
        One row per rating of one attribute: participant, recording, item (recording x reducer), rating and a column
        per metric; source and reducer, where several recordings come from one source, turned, cut or edited. Rows
        marked in a column rejected are left out, and those whose role is not ``test`` (hidden references and anchors
        inflate every slope); the notes count them.
    metrics : sequence of str
        One or more, such as ``["spectral_match", "temporal_match"]``.
    correlated : bool
        Let people's slopes correlate; a sensitivity analysis, for it often has no stable answer.
    by_reducer : bool
        Let reducers feel different, in all recordings alike and for each person, for reasons that no metric knows; a
        sensitivity analysis, for what is left of a slope are differences between recordings within a reducer.
    explain : bool
        Fit the model without metrics too, from which `item_variance_explained` comes; NaN without it, in half the time.

    Returns
    -------
    Primary
        Slopes, their differences, explained variance, and what was reduced.

    Raises
    ------
    ValueError
        If the table is not as described, mixes several scales or levels, ratings or all metrics are constant, or too
        few rows are left for any model.

    Notes
    -----
    For metrics a and b:
    ``rating ~ a_w + b_w + a_b + b_b + (1 + a_w + b_w || participant) + (1 | recording) + (1 | item) +
    (1 | participant:recording)``, on means over repeats; on rows, plus ``(1 | participant:item)``, where
    repeats are unequal; where single ratings have more levels than can be fitted, on means all the same, as
    `reductions` then says. ``_w`` is the metric minus its recording's mean, ``_b`` that mean. Restricted maximum
    likelihood, Satterthwaite's degrees of freedom; in simulated studies of 12 people, 8 recordings and 6 reducers
    its nominal 5 % test was wrong in 6.5 %.

    Where several recordings come from one source, plus ``(1 | source) + (1 | source:reducer)``. Turned copies of a
    recording, reduced alike, have nearly the same metrics and are felt nearly alike, for reasons that no metric
    knows: without the second term each copy would count as evidence of its own. A slope within recordings knows of
    no more, because what a source as a whole shares, for everyone or for one person, is the same for all stimuli of
    a recording; and what one person feels alike in all copies is, in means over people, part of what all do.

    If a reducer feels different in all recordings for reasons that no metric knows, its stimuli are not independent
    of each other either: where that spread is 3 points (SD), the 5 % test of one slope was wrong in 22 % of 400
    simulated studies, with `by_reducer` in 8 % (of 150; ``(1 | reducer) + (1 | participant:reducer)``, which is a
    variant and not the primary model because few reducers with metrics that differ mostly between them leave little
    to estimate slopes from).

    A standardised slope is the slope times the metric's standard deviation within recordings (over the rows),
    over the ratings' standard deviation.

    References
    ----------
    Barr, Levy, Scheepers & Tily (2013), doi 10.1016/j.jml.2012.11.001; Judd, Westfall & Kenny (2012), doi
    10.1037/a0028347; Luke (2017), doi 10.3758/s13428-016-0809-y.
    """
    cells = make_cells(rows, metrics)
    plan = plan_terms(cells, correlated=correlated, by_reducer=by_reducer)
    fit = fit_mixed(plan.formula, cells.table)
    within = tuple(name for name in cells.metrics if f"{name}_w" in plan.fixed)
    scales = _find_scales(cells, within)
    explained, why = _explain_items(cells, plan, fit) if explain else (float("nan"), [])
    return Primary(
        formula=plan.formula, fit=fit, slopes=_table_slopes(fit, scales), between=_table_between(fit, plan),
        differences=_table_differences(fit, scales), marginal_r2=fit.marginal_r2, conditional_r2=fit.conditional_r2,
        item_variance_explained=explained, averaged=cells.averaged, n_rows=fit.n_rows,
        n_participants=cells.count(WHO), n_recordings=cells.count(SCENE), n_items=cells.count(ITEM),
        n_sources=cells.n_sources, reductions=plan.reductions,
        notes=(*cells.notes, *fit.notes, *why, *_warn_few(cells)),
    )  # fmt: skip


def fit_attributes(rows: DataFrame, metrics: Sequence[str], *, attribute: str = "scale") -> dict[str, Primary]:
    """Fit the primary model of every attribute.

    Parameters
    ----------
    rows : DataFrame
        As for `fit_primary`, with a column that names the attribute.
    metrics : sequence of str
        One or more.
    attribute : str
        The column's name.

    Returns
    -------
    dict
        Attribute -> its model, in alphabetical order.

    Raises
    ------
    ValueError
        If there is no such column, or as for `fit_primary`.
    """
    rows = open_ratings(rows, what="rows")
    if attribute not in rows:
        raise ValueError(f"rows: got no column {attribute!r}, which tells the attributes; name it with attribute=")
    groups = rows.groupby(attribute, observed=True, sort=True)
    return {str(name): fit_primary(part, metrics) for name, part in groups}


def tabulate_slopes(models: Mapping[str, Primary]) -> DataFrame:
    """List the slopes of all attributes and metrics, with p adjusted for their number.

    Parameters
    ----------
    models : Mapping of str to Primary
        Attribute -> its model.

    Returns
    -------
    DataFrame
        attribute, metric, the columns of `Primary.slopes`, and p_holm: Holm's step-down adjustment over all
        rows, which holds the chance of any false positive among them.

    Raises
    ------
    ValueError
        If there is no model.
    """
    import pandas as pd
    from statsmodels.stats.multitest import multipletests

    if not models:
        raise ValueError("models: got none, allowed is one attribute or more")
    tables = [model.slopes.reset_index().assign(attribute=name) for name, model in models.items()]
    table = pd.concat(tables, ignore_index=True)
    table.insert(0, "attribute", table.pop("attribute"))
    table["p_holm"] = multipletests(table["p"], method="holm")[1]
    return table


def _find_scales(cells: Cells, within: Sequence[str]) -> dict[str, float]:
    """Find what turns a slope into a standardised one."""
    spread = cells.table[RATING].std()
    return {name: float(cells.table[f"{name}_w"].std() / spread) for name in within}


def _table_slopes(fit: MixedFit, scales: Mapping[str, float]) -> DataFrame:
    import pandas as pd

    terms = fit.fixed.loc[[f"{name}_w" for name in scales]]
    table = terms.set_axis(pd.Index(scales, name="metric"))
    for prefix, factor in (("tenth", TENTH), ("standardised", pd.Series(scales))):
        table[prefix] = table["estimate"] * factor
        table[f"{prefix}_low"], table[f"{prefix}_high"] = table["low"] * factor, table["high"] * factor
    return table


def _table_between(fit: MixedFit, plan: Plan) -> DataFrame:
    import pandas as pd

    names = [name for name in plan.fixed if name.endswith("_b")]
    return fit.fixed.loc[names].set_axis(pd.Index([name[:-2] for name in names], name="metric", dtype=object))


def _table_differences(fit: MixedFit, scales: Mapping[str, float]) -> DataFrame:
    import pandas as pd

    rows = []
    for first, second in combinations(scales, 2):
        plain = contrast(fit, {f"{first}_w": 1, f"{second}_w": -1})
        scaled = contrast(fit, {f"{first}_w": scales[first], f"{second}_w": -scales[second]})
        rows.append({"first": first, "second": second, **asdict(plain), **_prefix(scaled)})
    return pd.DataFrame(rows)


def _prefix(estimate: Estimate) -> dict[str, float]:
    return {f"standardised_{name}": value for name, value in asdict(estimate).items()}


def _explain_items(cells: Cells, plan: Plan, fit: MixedFit) -> tuple[float, list[str]]:
    """Compare the spread between stimuli with that of a model without metrics."""
    if f"(1 | {ITEM})" not in plan.random:
        return float("nan"), ["No share of explained spread between stimuli: the model has no such spread."]
    groups = [f"(1 | {WHO})" if WHO in term and ":" not in term else term for term in plan.random]
    empty = fit_mixed(" + ".join([f"{RATING} ~ 1", *groups]), cells.table)
    before, after = _item_variance(empty), _item_variance(fit)
    if before == 0:
        return float("nan"), ["No share of explained spread between stimuli: without metrics none is seen."]
    return 1 - after / before, []


def _item_variance(fit: MixedFit) -> float:
    spreads = fit.variances.set_index("group")["sd"]
    return float(spreads[ITEM] ** 2 + spreads.get(ALIKE, 0.0) ** 2)


def _warn_few(cells: Cells) -> Iterator[str]:
    scenes = "sources of recordings" if cells.shared else "recordings"
    for name, count in (("participants", cells.count(WHO)), (scenes, cells.n_sources)):
        if 1 < count < FEW:
            yield f"{count} {name} only: the spread between them is all but unknown, intervals are wide or unstable."
