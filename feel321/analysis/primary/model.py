"""The primary analysis: slopes of ratings on metrics within recordings, for people and stimuli in general.

Stimuli are a sample as people are. A model without a term for them takes the many ratings of one stimulus for
independent evidence: in simulated studies 41 % of its tests found a metric that predicts nothing. The model here holds
every source of spread that the design has, and is reduced only where the data cannot carry it, each time in words;
never because a test says that a spread may be zero.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pandas as pd

from feel321.analysis.mixed.design import build_design
from feel321.analysis.mixed.model import Solved, report_fit, solve_design
from feel321.analysis.primary.plan import (
    ALIKE,
    FLAT,
    ITEM,
    LEVEL,
    LEVELS,
    RATING,
    REDUCER,
    SCENE,
    SOURCE,
    WHO,
    Cells,
    Terms,
    make_cells,
    plan_terms,
    take_out,
)
from feel321.analysis.table.items import Table, choose_arms, choose_metrics, open_ratings
from feel321.records import Statistic

TENTH = 0.1
FEW = 5  # Fewer people, recordings (or sources) or reducers leave their spread all but unknown
# Participants, recordings (or sources of them) and reducers; degrees of freedom. With fewer, no slope is estimable.
FEWEST, FEWEST_DF = 3, 2.0
TESTED = ("se", "df", "t", "p", "low", "high")  # What is NaN where it is not estimable
# Column of an estimate -> that of the slope which is centred on recordings and on reducers.
CENTRED = {"estimate": "centred", **{name: f"centred_{name}" for name in TESTED if name != "t"}}
NONE, IN_MODEL = float("nan"), "in_model"


class Primary(Statistic):
    """The primary model of one attribute, as `fit_primary` returns it."""

    __slots__ = ()


class Primaries(Statistic):
    """The primary models of several attributes: attribute -> its model."""

    __slots__ = ()

    def to_frame(self) -> pd.DataFrame:
        """Return all slopes, with p adjusted for their number: ``p_holm``, over all rows that are estimable."""
        return tabulate_slopes(self)


class Slopes(NamedTuple):
    """Slopes within recordings, and the model behind them: all that a refit is for.

    lack: what the design has too little of for any interval. scales: metric -> factor of its standardised slope.
    """

    table: pd.DataFrame
    cells: Cells
    terms: Terms
    solved: Solved
    lack: str
    scales: Mapping[str, float]


def fit_slopes(
    cells: Cells, *, correlated: bool = False, reducers: bool = True, near: Slopes | None = None
) -> Slopes:
    """Fit the primary model for its slopes alone, in a fifth of the time; near: that of much the same cells."""
    terms = plan_terms(cells, correlated=correlated, reducers=reducers)
    is_alike = near and (near.terms.random, near.terms.penalty) == (terms.random, terms.penalty)
    design = build_design(terms.formula, cells.table)
    start = near.solved.best.theta if near and is_alike else None
    solved = solve_design(design, penalty=terms.penalty, most_df=terms.most_df, near=start)
    sizes = {WHO: cells.count(WHO), SOURCE if cells.shared else SCENE: cells.n_sources}
    sizes |= {REDUCER: cells.count(REDUCER)} if REDUCER in cells.table else {}
    few = [f"{count} {name}{'s' * (count > 1)}" for name, count in sizes.items() if count < FEWEST]
    lack = f"with {' and '.join(few)}, where {FEWEST} are needed" if few else ""
    # What turns a slope of each metric into a standardised one.
    spread = cells.table[RATING].std()
    within = [name for name in terms.fixed if name.endswith("_w")]
    scales = {name[:-2]: float(cells.table[name].std() / spread) for name in within}
    # How far apart the quartiles of each metric within recordings are, each stimulus counted once.
    items, rows = cells.rated, {}
    for name, scale in scales.items():
        span = float(np.subtract(*np.percentile(items[f"{name}_w"], [75, 25])))
        row = _blank(solved.estimate({f"{name}_w": 1.0}), lack=lack)
        for prefix, unit in {"quartile": span, "tenth": TENTH, "standardised": scale}.items():
            key = "quartile_effect" if prefix == "quartile" else prefix
            row[key] = row["estimate"] * unit
            row |= {f"{prefix}_{end}": row[end] * unit for end in ("low", "high")}
        rows[name] = row | {"quartile_span": span, "estimable": bool(np.isfinite(row["se"]))}
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("metric")
    return Slopes(table, cells, terms, solved, lack, scales)


def fit_primary(
    table: Table | pd.DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    scale: str | None = None,
    level: str | None = None,
    reducers: bool = True,
    explain: bool = True,
) -> Primary:
    """Fit the primary model of one attribute.

    Parameters
    ----------
    table : Table or DataFrame
        One row per rating: participant, recording, reducer, item (recording x reducer), rating and a
        column per metric; source, where several recordings come from one source, turned, cut or edited. Rows
        marked in a column rejected are left out, and those whose role is not ``test`` (hidden references and anchors
        inflate every slope); the notes count them.
    metrics : sequence of str, optional
        One or more, such as ``["spectral_match", "temporal_match"]``; those of the Table if left out.
    scale, level : str, optional
        Which ratings; needed where the table holds several scales or levels.
    reducers : bool
        Let reducers feel different for reasons that no metric knows, for everyone and for each person; False is wrong
        too often where they do.
    explain : bool
        Fit the models without metrics (`item_variance_explained`), with ``centred`` slopes and without level
        (``plain`` slopes), too; what comes from them is NaN otherwise, in a third of the time.

    Returns
    -------
    Primary
        ``slopes`` within recordings, indexed by ``metric``: ``estimate se df t p low high`` per unit of the metric;
        ``quartile_effect quartile_low quartile_high`` in points from the lower to the upper quartile of the metric
        within recordings, over stimuli, which lie ``quartile_span`` apart; ``tenth tenth_low tenth_high`` points per
        +0.1; ``standardised`` with its ends, in standard deviations (within recordings, of the ratings); ``centred``
        with ``centred_se`` and so on, the slope of the metric centred on recordings and on reducers, whose differences
        are fixed effects then; ``plain plain_p`` the slope without level in the model, NaN where level is not in it;
        and ``estimable``. Where that is False, only the estimates themselves are not NaN. ``between``: slopes between
        recordings, empty where these are too few. ``differences``: every two metrics' slopes compared, and with
        ``standardised_`` before, the standardised ones. ``formula fit``: the model, all of it; ``marginal_r2
        conditional_r2``, of the metrics and of everything; ``item_variance_explained``, 1 - the variances between
        stimuli of a recording over those of a model without metrics. ``averaged``: whether repeats were; ``n_rows
        n_participants n_recordings n_items n_sources n_reducers``; ``reductions``, the terms that the data cannot
        carry, and why; ``model_frame``, the table fitted; ``penalty``; ``level``, what became of level (``in_model``,
        ``metric``, ``alike`` or ``unknown``); ``notes``.

    Notes
    -----
    For metrics a and b:
    ``rating ~ a_w + b_w + a_b + b_b + (1 + a_w + b_w || participant) + (1 + a_w + b_w || recording) +
    (1 | item) + (1 | participant:recording) + (1 | reducer) + (1 | participant:reducer)``, on means over repeats; on
    rows, plus ``(1 | participant:item)``, where repeats are unequal, unless single ratings have too many levels. ``_w``
    is the metric minus its recording's mean, ``_b`` that mean. Restricted maximum likelihood, Satterthwaite's degrees
    of freedom, at most twice as many as recordings less two.

    Recordings differ in their slopes as people do, and reducers are a random factor as stimuli are. Where fewer than 8
    reducers were rated, their spread gets the penalty of Chung et al. (2013).

    What loses energy matches worse and is weaker: the level of stimuli (``sensation_level_db``, else ``rms_m_s2``, else
    ``level_difference``) is in the model where each has one, within recordings: ``level_db``, no hypothesis.

    Where several recordings come from one source, slopes differ between sources: ``(1 | recording) + (1 + a_w + b_w ||
    source) + (1 | source:reducer)``, or each turned copy of a recording would count as evidence of its own.

    Below 3 participants, 3 recordings (or sources of them) or 2 degrees of freedom a slope is not estimable: nothing
    then says how people, recordings or reducers differ.

    References
    ----------
    Barr, Levy, Scheepers & Tily (2013), doi 10.1016/j.jml.2012.11.001; Chung, Rabe-Hesketh, Dorie, Gelman & Liu
    (2013), Psychometrika 78, 685-709, doi 10.1007/s11336-013-9328-2; Judd, Westfall & Kenny (2012), doi
    10.1037/a0028347; Luke (2017), doi 10.3758/s13428-016-0809-y.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> who, what = (part.ravel() for part in np.meshgrid(range(8), range(24), indexing="ij"))
    >>> rows = pd.DataFrame({"participant": who, "recording": what // 4, "reducer": what % 4, "item": what,
    ...     "match": rng.uniform(0, 1, 24)[what]})
    >>> rows["rating"] = 30 + 40 * rows["match"] + rng.normal(0, 5, 8)[who] + rng.normal(0, 8, 192)
    >>> primary = analysis.fit_primary(rows, ["match"])
    >>> primary.slopes[["tenth", "tenth_low", "tenth_high"]].round(1)
            tenth  tenth_low  tenth_high
    metric
    match     4.1        2.9         5.3
    """
    rows, names = choose_arms(table, scale, level), choose_metrics(table, metrics)
    cells = make_cells(open_ratings(rows), names)
    found = fit_slopes(cells, reducers=reducers)
    terms, lack, scales = found.terms, found.lack, found.scales
    fit = report_fit(terms.formula, found.solved)
    explained, why = _explain_items(found) if explain else (NONE, [])
    centred, why_not = _centre_slopes(found, wanted=explain)
    known = "alike" if LEVEL in cells.items else "unknown"
    level = "metric" if set(LEVELS) & {*names} else IN_MODEL if LEVEL in terms.fixed else known
    plain = found.table[[]].assign(plain=NONE, plain_p=NONE)
    if explain and level == IN_MODEL:
        bare = fit_slopes(cells.ignore_level(), reducers=reducers).table
        plain = bare[["estimate", "p"]].set_axis(["plain", "plain_p"], axis=1)
    differences = []
    for first, second in combinations(scales, 2):
        row: dict[str, object] = {"first": first, "second": second}
        both = {"": (1.0, 1.0), "standardised_": (scales[first], scales[second])}
        for prefix, (one, other) in both.items():
            estimate = found.solved.estimate({f"{first}_w": one, f"{second}_w": -other})
            row |= {f"{prefix}{name}": value for name, value in _blank(estimate, lack=lack).items()}
        differences.append(row)
    between = [name for name in terms.fixed if name[-2:] == "_b"]
    rows_between = [_blank(found.solved.estimate({name: 1.0}), lack=lack) for name in between]
    index = pd.Index([name[:-2] for name in between], name="metric", dtype=object)
    return Primary(
        "Primary", slopes=found.table.join([centred, plain]),
        between=pd.DataFrame(rows_between, index=index, columns=["estimate", *TESTED]),
        differences=pd.DataFrame(differences), formula=terms.formula, fit=fit, marginal_r2=fit.marginal_r2,
        conditional_r2=fit.conditional_r2, item_variance_explained=explained, averaged=cells.averaged,
        n_rows=fit.n_rows, n_participants=cells.count(WHO), n_recordings=cells.count(SCENE), n_items=cells.count(ITEM),
        n_sources=cells.n_sources, n_reducers=cells.count(REDUCER),
        reductions=terms.reductions, model_frame=cells.table,
        notes=(*cells.notes, *fit.notes, *why, *why_not, *_note_limits(found)),
        penalty=terms.penalty, level=level,
    )  # fmt: skip


def fit_attributes(
    table: Table | pd.DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    attribute: str | None = None,
) -> Primaries:
    """Fit the primary model of every attribute: every scale, at every level where there are several.

    Parameters
    ----------
    table : Table or DataFrame
        As for `fit_primary`, with a column that names the attribute.
    metrics : sequence of str, optional
        One or more; those of the Table if left out.
    attribute : str, optional
        The column's name; scale, and level where there are several, if left out.
    """
    rows, names = open_ratings(table), choose_metrics(table, metrics)
    several = attribute is None and "level" in rows and len(rows["level"].unique()) > 1
    columns = [attribute or "scale", *(["level"] if several else [])]
    if columns[0] not in rows:
        got = f"got no column {columns[0]!r}; name it with attribute="
        raise ValueError(f"rows must have a column that names the attribute, {got}")
    groups = rows.groupby(columns, observed=True, sort=True)
    models = {", ".join(map(str, key)): fit_primary(part, names) for key, part in groups}
    return Primaries("Primaries", **models)


def tabulate_slopes(models: Mapping[str, Primary]) -> pd.DataFrame:
    """List the slopes of all attributes and metrics, with p adjusted for their number by Holm's method."""
    if not models:
        raise ValueError("models must hold one attribute or more, got none")
    tables = [model.slopes.reset_index().assign(attribute=name) for name, model in models.items()]
    table = pd.concat(tables, ignore_index=True)
    table.insert(0, "attribute", table.pop("attribute"))
    plain = np.array(adjust_holm(table["plain_p"].fillna(table["p"]).tolist()))
    plain[table["plain_p"].isna()] = NONE
    holm: pd.DataFrame = table.assign(p_holm=adjust_holm(table["p"].tolist()), plain_p_holm=plain)
    return holm


def adjust_holm(p: Sequence[float]) -> list[float]:
    """Adjust probabilities for their number by Holm's step-down method (1979); NaN stays NaN and does not count."""
    # Not statsmodels' multipletests: it collects garbage each time, which took a fifth of a study's analysis.
    values = np.asarray(p, dtype=np.float64)
    order = np.argsort(values)[: np.isfinite(values).sum()]
    adjusted = np.full(len(values), np.nan)
    steps = values[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return [float(value) for value in adjusted]


def _blank(estimate: Statistic, *, lack: str) -> dict[str, float]:
    """Take the test and the interval from an estimate that the data cannot carry."""
    known = not lack and estimate.df >= FEWEST_DF
    return dict(estimate) if known else dict(estimate) | dict.fromkeys(TESTED, NONE)


def _centre_slopes(found: Slopes, *, wanted: bool) -> tuple[pd.DataFrame, list[str]]:
    """Estimate slopes with reducers as fixed effects and metrics centred on recordings and on reducers."""
    cells, terms, within = found.cells, found.terms, found.table.index
    table = pd.DataFrame(np.nan, index=within, columns=list(CENTRED.values()))
    term = f"(1 | {REDUCER})"
    if not wanted or term not in terms.random:
        return table, []
    names = [f"{name}_w" for name in within]
    random = tuple(one for one in terms.random if one != term)
    fixed = Terms((*terms.fixed, REDUCER), random, ())
    # Out of the metrics, over stimuli, what their recording and their reducer give.
    items = cells.table.drop_duplicates(ITEM).set_index(ITEM)
    values = items[names].to_numpy(np.float64)
    left = take_out(items[[SCENE, REDUCER]], values)
    left *= np.abs(left).max(axis=0) > FLAT * np.abs(values).max(axis=0)
    place = items.index.get_indexer(cells.table[ITEM].array)
    centred = {name: own[place] for name, own in zip(names, left.T, strict=True)}
    centred[REDUCER] = cells.table[REDUCER].astype(str).to_numpy()
    try:
        design = build_design(fixed.formula, cells.table.assign(**centred))
        solved = solve_design(design, most_df=terms.most_df)
    except ValueError as error:
        return table, [f"No slopes centred on reducers: {error}"]
    rows = [_blank(solved.estimate({name: 1.0}), lack=found.lack) for name in names]
    return pd.DataFrame(rows, index=within)[list(CENTRED)].rename(columns=CENTRED), []


def _explain_items(found: Slopes) -> tuple[float, list[str]]:
    """Compare what makes stimuli of a recording differ, for everyone, with that of a model without metrics."""

    def add_variances(solved: Solved) -> float:
        spreads = solved.list_spreads()
        return float(sum(own[0, 0] for group, _, own in spreads if group in {ITEM, REDUCER, ALIKE}))

    terms, none = found.terms, "No share of explained spread between stimuli"
    if f"(1 | {ITEM})" not in terms.random:
        return NONE, [f"{none}: the model has no such spread."]
    groups = [f"(1 | {term.split('|')[-1].strip(' )')})" for term in terms.random]
    empty = build_design(" + ".join([f"{RATING} ~ 1", *groups]), found.cells.table)
    before = add_variances(solve_design(empty, penalty=terms.penalty))
    if before == 0:
        return NONE, [f"{none}: without metrics none is seen."]
    return 1 - add_variances(found.solved) / before, []


def _note_limits(found: Slopes) -> Iterator[str]:
    """Say of what there is little, where that limits degrees of freedom, and which slopes are not estimable."""
    cells, limit = found.cells, found.terms.most_df
    scenes = "sources" if cells.shared else "recordings"
    sizes = {
        "participants": cells.count(WHO),
        "sources of recordings" if cells.shared else scenes: cells.n_sources,
        "reducers": cells.count(REDUCER),
    }
    for name in (name for name, count in sizes.items() if 1 < count < FEW):
        unknown = "the spread between them is all but unknown, intervals are wide or unstable"
        yield f"{sizes[name]} {name} only: {unknown}."
    if (found.table["df"] >= limit).any():
        few = f"Slopes seem to differ little between {cells.n_sources} {scenes}, which so few do not show"
        yield f"{few}: intervals are widened to at most {limit:g} degrees of freedom."
    for name in found.table.index[~found.table["estimable"]]:
        few = f"with fewer than {FEWEST_DF:g} degrees of freedom"
        yield f"The slope of {name} is not estimable {found.lack or few}: it has no test and no interval."
