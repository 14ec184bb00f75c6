"""The primary analysis: slopes of ratings on metrics within recordings, for people and stimuli in general.

Stimuli are a sample as people are. A model without a term for them takes the many ratings of one stimulus for
independent evidence: in simulated studies 41 % of its tests found a metric that predicts nothing. Nor are the stimuli
of one reducer independent: what a reducer feels like for reasons that no metric knows is the same in every recording.
The model here holds every source of spread that the design has, and is reduced only where the data cannot carry it,
each time in words; never because a test says that a spread may be zero.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.plan import (
    ALIKE,
    ITEM,
    RATING,
    REDUCER,
    SCENE,
    SOURCE,
    WHO,
    Cells,
    Plan,
    centre_twice,
    make_cells,
    plan_terms,
)
from feel321.analysis.table.items import open_ratings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.mixed.model import Estimate, MixedFit

TENTH = 0.1
FEW = 5
"""Fewer participants or recordings (or sources of them) than this leave their spread all but unknown."""

FEWEST, FEWEST_DF = 3, 2.0
"""Participants, recordings (or sources of them) and degrees of freedom below which a slope is not estimable."""

TESTED = ("se", "df", "t", "p", "low", "high")
"""Columns of an estimate that mean nothing where it is not estimable."""


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
        Slopes within recordings, indexed by ``metric``: ``estimate se df t p low high`` per unit of the metric;
        ``quartile_effect quartile_low quartile_high`` in points from the lower to the upper quartile of the metric
        within recordings, over stimuli, which lie ``quartile_span`` apart; ``tenth tenth_low tenth_high`` points per
        +0.1; ``standardised standardised_low standardised_high`` in standard deviations; ``centred centred_se
        centred_df centred_p centred_low centred_high`` the slope per unit of the metric centred on recordings and on
        reducers, whose differences are fixed effects then; and ``estimable``. Where that is False, everything but the
        estimates themselves is NaN.
    between : DataFrame
        Slopes between recordings, ``estimate`` to ``high``; empty where recordings are too few.
    differences : DataFrame
        Every two metrics' slopes compared: first, second, and the columns of `Estimate`; then the same of the
        standardised slopes, with ``standardised_`` before.
    marginal_r2, conditional_r2 : float
        Nakagawa's R²: of the metrics, and of everything in the model.
    item_variance_explained : float
        Share of the spread between stimuli of a recording (of stimuli, and of reducers) that the metrics account for:
        1 - the sum of these variances over that of a model without metrics; negative by chance, NaN where a model
        without metrics sees no such spread, or was not asked for.
    averaged : bool
        Whether repeats were averaged before.
    n_rows, n_participants, n_recordings, n_items : int
        Size of the data.
    n_sources : int
        What is independent among the recordings: as many, unless several come from one.
    n_reducers : int
        Different reducers; 0 where no column names them.
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
    n_reducers: int
    reductions: tuple[str, ...]
    notes: tuple[str, ...]


def fit_primary(
    rows: DataFrame,
    metrics: Sequence[str],
    *,
    correlated: bool = False,
    reducers: bool = True,
    explain: bool = True,
) -> Primary:
    """Fit the primary model of one attribute.

    Parameters
    ----------
    rows : DataFrame
        One row per rating of one attribute: participant, recording, reducer, item (recording x reducer), rating and a
        column per metric; source, where several recordings come from one source, turned, cut or edited. Rows
        marked in a column rejected are left out, and those whose role is not ``test`` (hidden references and anchors
        inflate every slope); the notes count them.
    metrics : sequence of str
        One or more, such as ``["spectral_match", "temporal_match"]``.
    correlated : bool
        Let people's slopes correlate; a sensitivity analysis, for it often has no stable answer.
    reducers : bool
        Let reducers feel different for reasons that no metric knows, for everyone and for each person; False is a
        sensitivity analysis, which is wrong too often where they do.
    explain : bool
        Fit two more models: the one without metrics, from which `item_variance_explained` comes, and the one whose
        slopes are ``centred``; both are NaN without them, in a third of the time.

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
    (1 | participant:recording) + (1 | reducer) + (1 | participant:reducer)``, on means over repeats; on rows, plus
    ``(1 | participant:item)``, where repeats are unequal; where single ratings have more levels than can be fitted, on
    means all the same, as `reductions` then says. ``_w`` is the metric minus its recording's mean, ``_b`` that mean.
    Restricted maximum likelihood, Satterthwaite's degrees of freedom.

    Reducers are a random factor as stimuli are: metrics differ mostly between reducers, so without these terms a
    reducer that feels odd in every recording counts as evidence of as many stimuli as there are recordings. Where
    fewer than 8 reducers were rated, their spread gets the penalty of Chung et al. (2013), -2 log SD added to the
    deviance, which keeps it from being estimated as zero when it is only unknown.

    False positives at nominal 5 % in simulated studies of 12 people, with the metrics that 6 or 9 reducers have on 6 or
    12 recordings of the bundled scenes (4800 studies of two slopes; without reducers and reducers fixed 1200;
    ``tests/bench/primary.py``), by what reducers differ in for reasons that no metric knows:

    ===================  =====  ========  ========
    model                0      3 points  8 points
    ===================  =====  ========  ========
    this one             0.038  0.054     0.052
    without reducers     0.044  0.173     0.363
    reducers fixed       0.046  0.049     0.046
    ===================  =====  ========  ========

    Single designs lie between 0.013 and 0.068 (this one) and 0.00 and 0.48 (without reducers). A slope of 2 points per
    +0.1, 6 recordings and 6 reducers: power 0.99, 0.96, 0.92 with, 0.99, 0.95, 0.78 without reducers. Without the
    penalty, 0.085 instead of 0.062 for temporal match at 3 points there.

    Where several recordings come from one source, plus ``(1 | source) + (1 | source:reducer)``. Turned copies of a
    recording, reduced alike, have nearly the same metrics and are felt nearly alike, for reasons that no metric
    knows: without the second term each copy would count as evidence of its own. A slope within recordings knows of
    no more, because what a source as a whole shares, for everyone or for one person, is the same for all stimuli of
    a recording; and what one person feels alike in all copies is, in means over people, part of what all do.

    Below 3 participants, 3 recordings (or sources of them) or 2 degrees of freedom a slope is not estimable: nothing
    then says how people, recordings or reducers differ.

    A standardised slope is the slope times the metric's standard deviation within recordings (over the rows),
    over the ratings' standard deviation.

    References
    ----------
    Barr, Levy, Scheepers & Tily (2013), doi 10.1016/j.jml.2012.11.001; Chung, Rabe-Hesketh, Dorie, Gelman & Liu
    (2013), Psychometrika 78, 685-709, doi 10.1007/s11336-013-9328-2; Judd, Westfall & Kenny (2012), doi
    10.1037/a0028347; Luke (2017), doi 10.3758/s13428-016-0809-y.
    """
    cells = make_cells(rows, metrics)
    plan = plan_terms(cells, correlated=correlated, reducers=reducers)
    fit = fit_mixed(plan.formula, cells.table, penalty=plan.penalty)
    within = tuple(name for name in cells.metrics if f"{name}_w" in plan.fixed)
    scales, why_none = _find_scales(cells, within), _find_lack(cells)
    explained, why = _explain_items(cells, plan, fit) if explain else (float("nan"), [])
    slopes = _table_slopes(fit, scales, _find_spans(cells, within), lack=why_none)
    centred, why_not = _centre_slopes(cells, plan, within, wanted=explain)
    return Primary(
        formula=plan.formula, fit=fit, slopes=slopes.join(_blank(centred, lack=why_none, prefix="centred_")),
        between=_blank(_table_between(fit, plan), lack=why_none),
        differences=_table_differences(fit, scales, lack=why_none),
        marginal_r2=fit.marginal_r2, conditional_r2=fit.conditional_r2, item_variance_explained=explained,
        averaged=cells.averaged, n_rows=fit.n_rows, n_participants=cells.count(WHO), n_recordings=cells.count(SCENE),
        n_items=cells.count(ITEM), n_sources=cells.n_sources,
        n_reducers=cells.count(REDUCER) if REDUCER in cells.table else 0, reductions=plan.reductions,
        notes=(*cells.notes, *fit.notes, *why, *why_not, *_warn_few(cells), *_note_lacks(slopes, why_none)),
    )  # fmt: skip


def fit_attributes(
    rows: DataFrame, metrics: Sequence[str], *, attribute: str = "scale"
) -> dict[str, Primary]:
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
        raise ValueError(
            f"rows: got no column {attribute!r}, which tells the attributes; name it with attribute="
        )
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
        rows that are estimable, which holds the chance of any false positive among them.

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
    known = table["p"].notna()
    adjusted = multipletests(table.loc[known, "p"], method="holm")[1] if known.any() else np.nan
    table.loc[known, "p_holm"] = adjusted
    return table


def _find_scales(cells: Cells, within: Sequence[str]) -> dict[str, float]:
    """Find what turns a slope into a standardised one."""
    spread = cells.table[RATING].std()
    return {name: float(cells.table[f"{name}_w"].std() / spread) for name in within}


def _find_spans(cells: Cells, within: Sequence[str]) -> dict[str, float]:
    """Find how far apart the quartiles of each metric within recordings are, each stimulus counted once."""
    items = cells.table.drop_duplicates(ITEM)
    return {
        name: float(np.subtract(*np.percentile(items[f"{name}_w"], [75, 25]))) for name in within
    }


def _find_lack(cells: Cells) -> str:
    """Say what the design has too little of for any interval; empty where nothing is lacking."""
    sizes = {"participant": cells.count(WHO), SOURCE if cells.shared else SCENE: cells.n_sources}
    few = [f"{count} {name}{'s' * (count > 1)}" for name, count in sizes.items() if count < FEWEST]
    return f"with {' and '.join(few)}, where {FEWEST} are needed" if few else ""


def _blank(table: DataFrame, *, lack: str, prefix: str = "") -> DataFrame:
    """Take the test and the interval from estimates that the data cannot carry."""
    none = ~(table[f"{prefix}df"] >= FEWEST_DF) | bool(lack)
    names = [f"{prefix}{name}" for name in TESTED if f"{prefix}{name}" in table]
    return table.assign(**{name: table[name].mask(none) for name in names})


def _table_slopes(
    fit: MixedFit, scales: Mapping[str, float], spans: Mapping[str, float], *, lack: str
) -> DataFrame:
    import pandas as pd

    terms = fit.fixed.loc[[f"{name}_w" for name in scales]]
    table = _blank(terms.set_axis(pd.Index(scales, name="metric")), lack=lack)
    tenths = dict.fromkeys(scales, TENTH)
    for name, prefix, unit in (
        ("quartile_effect", "quartile", spans),
        ("tenth", "tenth", tenths),
        ("standardised", "standardised", scales),
    ):
        factor = pd.Series(unit)
        table[name] = table["estimate"] * factor
        table[f"{prefix}_low"], table[f"{prefix}_high"] = (
            table["low"] * factor,
            table["high"] * factor,
        )
    return table.assign(quartile_span=pd.Series(spans), estimable=table["se"].notna())


def _note_lacks(slopes: DataFrame, lack: str) -> Iterator[str]:
    for name in slopes.index[~slopes["estimable"]]:
        few = f"with fewer than {FEWEST_DF:g} degrees of freedom"
        yield f"The slope of {name} is not estimable {lack or few}: it has no test and no interval."


def _centre_slopes(
    cells: Cells, plan: Plan, within: Sequence[str], *, wanted: bool
) -> tuple[DataFrame, list[str]]:
    """Estimate slopes with reducers as fixed effects and metrics centred on recordings and on reducers."""
    import pandas as pd

    columns = ("", *(f"_{name}" for name in TESTED if name != "t"))
    empty = pd.DataFrame(np.nan, index=list(within), columns=[f"centred{name}" for name in columns])
    term = f"(1 | {REDUCER})"
    if not wanted or term not in plan.random:
        return empty, []
    names = [f"{name}_w" for name in within]
    fixed = Plan((*plan.fixed, REDUCER), tuple(one for one in plan.random if one != term), ())
    try:
        found = fit_mixed(fixed.formula, centre_twice(cells.table, names)).fixed.loc[names]
    except ValueError as error:
        return empty, [f"No slopes centred on reducers: {error}"]
    values = found[["estimate", *(name for name in TESTED if name != "t")]]
    return values.set_axis(empty.columns, axis=1).set_axis(empty.index), []


def _table_between(fit: MixedFit, plan: Plan) -> DataFrame:
    import pandas as pd

    names = [name for name in plan.fixed if name.endswith("_b")]
    return fit.fixed.loc[names].set_axis(
        pd.Index([name[:-2] for name in names], name="metric", dtype=object)
    )


def _table_differences(fit: MixedFit, scales: Mapping[str, float], *, lack: str) -> DataFrame:
    import pandas as pd

    rows = []
    for first, second in combinations(scales, 2):
        plain = contrast(fit, {f"{first}_w": 1, f"{second}_w": -1})
        scaled = contrast(fit, {f"{first}_w": scales[first], f"{second}_w": -scales[second]})
        rows.append({"first": first, "second": second, **asdict(plain), **_prefix(scaled)})
    if not rows:
        return pd.DataFrame()
    return _blank(_blank(pd.DataFrame(rows), lack=lack), lack=lack, prefix="standardised_")


def _prefix(estimate: Estimate) -> dict[str, float]:
    return {f"standardised_{name}": value for name, value in asdict(estimate).items()}


def _explain_items(cells: Cells, plan: Plan, fit: MixedFit) -> tuple[float, list[str]]:
    """Compare the spread between stimuli with that of a model without metrics."""
    if f"(1 | {ITEM})" not in plan.random:
        return float("nan"), [
            "No share of explained spread between stimuli: the model has no such spread."
        ]
    groups = [f"(1 | {WHO})" if WHO in term and ":" not in term else term for term in plan.random]
    empty = fit_mixed(" + ".join([f"{RATING} ~ 1", *groups]), cells.table, penalty=plan.penalty)
    before, after = _item_variance(empty), _item_variance(fit)
    if before == 0:
        return float("nan"), [
            "No share of explained spread between stimuli: without metrics none is seen."
        ]
    return 1 - after / before, []


def _item_variance(fit: MixedFit) -> float:
    """Add up what makes stimuli of a recording differ, for everyone: stimuli, reducers, and what a source shares."""
    spreads = fit.variances.set_index("group")["sd"]
    return float(sum(spreads.get(group, 0.0) ** 2 for group in (ITEM, REDUCER, ALIKE)))


def _warn_few(cells: Cells) -> Iterator[str]:
    scenes = "sources of recordings" if cells.shared else "recordings"
    for name, count in (("participants", cells.count(WHO)), (scenes, cells.n_sources)):
        if 1 < count < FEW:
            yield f"{count} {name} only: the spread between them is all but unknown, intervals are wide or unstable."
