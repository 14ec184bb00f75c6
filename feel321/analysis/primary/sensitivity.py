"""What the primary slopes hinge on: other choices, single stimuli, recordings or reducers, and level.

Recordings (or their sources) and reducers are each left out in turn and the model fitted anew. Stimuli are too many for
that: those that move a slope most are found by leverage and residual in a regression of the stimuli's mean ratings,
and then left out in the same exact way.
"""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from feel321.analysis.arrays import read_numbers
from feel321.analysis.primary.model import IN_MODEL, Primary, Slopes, adjust_holm, fit_slopes
from feel321.analysis.primary.plan import (
    ITEM,
    RATING,
    REDUCER,
    SCENE,
    SOURCE,
    WHO,
    Cells,
    make_cells,
    select_rows,
    take_out,
)
from feel321.analysis.primary.plan import LEVEL as COVARIATE
from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.schema import HIGHEST, LOWEST

PREDICTS, OPEN, NOT_ESTIMABLE = "predicts", "open", "not_estimable"  # Verdicts
SURVIVES, LOST = "survives", "lost"  # What becomes of a verdict with level in the model
LEVEL = 0.05  # Of a verdict, after Holm's adjustment, and of an exceptional reducer (Bonferroni)
STIMULUS = "stimulus"
CANDIDATES = 2  # Stimuli per metric and way of centring that are left out exactly
MOVED = 1.0  # Standard errors by which a slope must change to be named
MOST_CELLS = 20_000  # Participants x stimuli beyond which thirty models would take many minutes
MOST_UNITS = 100  # Recordings, or sources, beyond which a model without each would take hours
LEAST_EXCESS = 5.0  # Points of an exceptional reducer at least: less may be the ends of the scale
FEWEST_REDUCERS = 5  # Fewer do not say how far reducers differ from what metrics predict
DELIVERED = "_delivered"  # Suffix of the columns of metrics of what was delivered
RIGS = ("rig", "calibration")  # Columns on what people felt the stimuli on, where they differ
COLUMNS = (
    "estimate", "se", "df", "t", "p", "low", "high", "standardised", "standardised_low", "standardised_high",
)  # fmt: skip

TENTHS = ("tenth", "tenth_low", "tenth_high")
UNITS = {"rater-standardised": "rater SDs", "logits": "logits"}  # Of slopes that are not in points
Variant = tuple[str, Callable[[], Cells], str, dict[str, bool]]  # Name, cells, note, and terms


def _fit(
    make: Callable[[], Cells], metrics: Sequence[str],
    *, correlated: bool = False, reducers: bool = True, near: Slopes | None = None,
) -> tuple[pd.DataFrame, str, Slopes | None]:  # fmt: skip
    """Fit the slopes; also what their model lacks. NaN, the reason and None where the rows carry no model."""
    try:
        found = fit_slopes(make(), correlated=correlated, reducers=reducers, near=near)
    except ValueError as error:
        index = pd.Index(metrics, name="metric")
        return pd.DataFrame(np.nan, index=index, columns=[*COLUMNS, *TENTHS]), str(error), None
    reason = " ".join(found.terms.reductions)
    return found.table.reindex(list(found.cells.metrics)), reason, found


def vary_primary(rows: pd.DataFrame, metrics: Sequence[str]) -> pd.DataFrame:
    """Repeat the primary analysis under other choices: one row per variant and metric.

    rows: as for `fit_primary`; ratings from 0 to 100. Columns: variant, unit (of estimate, low and high: points, rater
    SDs or logits, per unit of the metric), metric, estimate se df t p low high, standardised slope with its interval,
    singular, and reason (why a variant has no numbers, or what its model lacks or leaves out).

    Variants: people's slopes correlated; no terms for reducers; no level; each rater's ratings standardised, which
    takes out how much of the scale they use; ratings as logits of (y (n - 1) + 1/2) / n, y = rating / 100 and n their
    number (Smithson & Verkuilen 2006, doi 10.1037/1082-989X.11.1.54), which takes out the crowding at the scale's
    ends. Only standardised slopes compare across units. Where rows have them: the metrics of what was delivered; the
    rig as a factor (mean ratings of each rig and recording taken out); without the people on each rig.
    """
    rows, notes = select_rows(rows)
    ratings = read_numbers(rows[RATING], what=f"rows, {RATING!r}")
    if ratings.min() < LOWEST or ratings.max() > HIGHEST:
        got = f"got {ratings.min():g} to {ratings.max():g}"
        raise ValueError(f"rows must have ratings from 0 to 100, {got}; leave others out")
    rows = rows.assign(**{RATING: ratings})
    cells, own = make_cells(rows, metrics), rows.groupby(WHO, observed=True)[RATING]
    spread = own.transform("std").fillna(0)
    steady = spread == 0
    names = ", ".join(map(str, rows.loc[steady, WHO].unique()))
    note = f"Without {names}, whose ratings are all the same." if names else ""
    scaled = rows.assign(**{RATING: (rows[RATING] - own.transform("mean")) / spread.mask(steady)})
    share = (rows[RATING] / HIGHEST * (len(rows) - 1) + 0.5) / len(rows)
    logits = rows.assign(**{RATING: np.log(share / (1 - share))})
    variants: list[Variant] = [
        ("primary", lambda: cells, "", {}),
        ("correlated slopes", lambda: cells, "", {"correlated": True}),
        ("without reducers", lambda: cells, "", {"reducers": False}),
        *([("without level", cells.ignore_level, "", {})] if COVARIATE in cells.table else []),
        *_vary_rigs(rows, metrics, cells),
        ("rater-standardised", partial(make_cells, scaled[~steady], metrics), note, {}),
        ("logits", partial(make_cells, logits, metrics), "", {}),
    ]
    tables: list[pd.DataFrame] = []
    near: Slopes | None = None
    for name, make, said, terms in variants:
        table, lack, slopes = _fit(make, metrics, near=near, **terms)
        near = near or slopes
        if name == "primary" and not slopes:
            raise ValueError(lack)
        reason = " ".join(filter(None, (*notes, said, lack)))
        table = table[list(COLUMNS)].rename_axis("metric").reset_index()
        table.insert(0, "variant", name)
        table.insert(1, "unit", UNITS.get(name, "points"))
        is_singular = slopes is not None and bool(slopes.solved.note_zeros())
        tables.append(table.assign(singular=is_singular, reason=reason))
    return pd.concat(tables, ignore_index=True)


def _vary_rigs(rows: pd.DataFrame, metrics: Sequence[str], cells: Cells) -> Iterator[Variant]:
    """Take the metrics of what was delivered; take out what a rig does to ratings; leave each rig out."""
    delivered = {name: rows[name + DELIVERED] for name in metrics if name + DELIVERED in rows}
    if delivered:
        lacking = [name for name in metrics if name not in delivered]
        note = f"Of {', '.join(lacking)}, the intended one." if lacking else ""
        make = partial(make_cells, rows.assign(**delivered), metrics)
        yield "delivered metrics", make, note, {}
    for name in (name for name in RIGS if name in rows):
        both = (rows.groupby(keys, observed=True)[RATING] for keys in ([name, SCENE], SCENE))
        means, whole = (ratings.transform("mean") for ratings in both)
        left = rows.assign(**{RATING: rows[RATING] - means + whole})
        yield f"{name} as a factor", partial(make_cells, left, metrics), "", {}
        for value, people in rows.drop_duplicates(WHO).groupby(name)[WHO]:
            # The rest is most, and more than one.
            if 2 * len(people) <= cells.count(WHO) > len(people) + 1:
                make = partial(cells.leave_out, WHO, *people)
                yield f"without {name} {str(value) or 'unknown'}", make, "", {}


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """What single stimuli, recordings and reducers do to the primary slopes of one attribute.

    exceptions, by reducer: excess (points by which its ratings exceed what the slopes without it predict, relative to
    the other reducers), t, df, p (Bonferroni over reducers), exceptional (p < .05, and 5 to 100 points: beyond the
    scale it is the metric that is out of range).
    """

    table: pd.DataFrame
    exceptions: pd.DataFrame
    notes: tuple[str, ...] = ()

    def find_moves(self, metric: str) -> pd.DataFrame:
        """Find the units without which a metric's slope changes by more than its standard error, or turns."""
        if self.table.empty:
            return self.table
        found = self.table[(self.table["metric"] == metric) & self.table["moves"]]
        return found.sort_values("shift", key=np.abs, ascending=False, kind="stable")


def conclude(p_holm: float) -> str:
    """Give the verdict on a slope: ``predicts``, ``open``, or ``not_estimable`` where there is no test (NaN)."""
    if math.isnan(p_holm):
        return NOT_ESTIMABLE
    return PREDICTS if p_holm < LEVEL else OPEN


def judge_level(level: str, p_holm: float, plain_p_holm: float) -> str:
    """Say what a verdict owes to level: it survives it, or is lost to it; else what became of level in the model.

    level: of `Primary`; plain_p_holm: of the model without level. Empty where nothing is claimed either way.
    """
    if level != IN_MODEL:
        return level
    verdict, plain = conclude(p_holm), conclude(plain_p_holm)
    if plain == PREDICTS != verdict:
        return LOST
    return SURVIVES if verdict == PREDICTS else ""


def list_changes(slopes: Iterable[Mapping[Any, Any]]) -> Iterator[Mapping[Any, Any]]:
    """List the slopes without flagged raters from which another conclusion follows than from everyone's."""
    slopes, keys = list(slopes), itemgetter("scale", "level", "metric")
    # The direction in which a metric predicts; 0 where nothing is claimed, as where everyone's model was not fitted.
    claims = [np.sign(row["tenth"]) if row["verdict"] == PREDICTS else 0.0 for row in slopes]
    pairs = list(zip(slopes, claims, strict=True))
    whole = {keys(row): claim for row, claim in pairs if row["panel"] == "everyone"}
    yield from (row for row, claim in pairs if claim != whole.get(keys(row), 0.0))


def leave_out_units(cells: Cells) -> Iterator[tuple[str, Hashable]]:
    """List each recording, or source of recordings where several come from one, and each reducer: column and name.

    Names stand in the same order whatever was rated, so that scales can be compared.
    """
    for column in (SOURCE if cells.shared else SCENE, REDUCER):
        names = list(cells.items[column].unique() if column in cells.items else ())
        ordered = order_reducers(names) if column == REDUCER else sorted(names, key=str)
        yield from ((column, name) for name in ordered if 1 < len(names) <= MOST_UNITS)


def measure_influence(
    rows: pd.DataFrame, metrics: Sequence[str], whole: Primary, *, others: Sequence[float] = ()
) -> Influence:
    """Leave out each recording and reducer, and the stimuli that matter most, one at a time."""
    cells, found, notes = make_cells(rows, metrics), [], []
    slopes: dict[Hashable, Slopes] = {}
    units: list[tuple[str, Hashable]] = []
    if cells.count(WHO, ITEM) > MOST_CELLS:
        most = f"more than {MOST_CELLS} participant x stimulus cells"
        notes.append(f"Influence was not measured: {most}.")
    elif whole.slopes["estimable"].any():
        if cells.n_sources > MOST_UNITS:
            what = "Sources" if cells.shared else "Recordings"
            notes.append(f"{what} were not left out in turn: more than {MOST_UNITS}.")
        units = [*leave_out_units(cells), *((ITEM, name) for name in find_candidates(cells))]
    near: Slopes | None = None
    for column, name in units:
        left, reason, fitted = _fit(partial(cells.leave_out, column, name), metrics, near=near)
        near = near or fitted
        if column == REDUCER and fitted:
            slopes[name] = fitted
        left = left.reindex(whole.slopes.index)[["estimate", "se", "df", "p", *TENTHS]]
        is_known = left["estimate"].notna().any()
        unit = {"kind": STIMULUS if column == ITEM else column, "unit": str(name)}
        unit |= {"reason": "" if is_known else reason}
        p_holm = adjust_holm([*left["p"], *others])
        found += [
            {"metric": metric, **row, "p_holm": p, "verdict": conclude(p), **unit}
            for (metric, row), p in zip(left.to_dict("index").items(), p_holm, strict=False)
        ]
    table = pd.DataFrame(found)
    if found:
        holm = adjust_holm([*whole.slopes["p"], *others])[: len(whole.slopes)]
        before = whole.slopes.assign(p_holm=holm).loc[table["metric"]].reset_index()
        known = table["verdict"] != NOT_ESTIMABLE
        turned = np.sign(table["estimate"]) * np.sign(before["estimate"]) < 0
        other = table["verdict"] != before["p_holm"].map(conclude)
        table["shift"] = (table["estimate"] - before["estimate"]) / before["se"]
        table["turns"] = known & before["p_holm"].notna() & (other | turned)
        table["moves"] = table["turns"] | (known & (table["shift"].abs() > MOVED))
    return Influence(table, _find_exceptions(cells, slopes), tuple(notes))


def find_candidates(cells: Cells, *, count: int = CANDIDATES) -> list[str]:
    """Find the stimuli that move slopes most, in regressions of the stimuli's mean ratings.

    Without stimulus i the slopes of ordinary least squares change by (X'X)^-1 x_i e_i / (1 - h_i), with e_i its
    residual and h_i its leverage (Belsley, Kuh & Welsch 1980, ISBN 0-471-05856-4).
    """
    items, values, ratings = cells.averages
    chosen: dict[str, None] = {}
    for groups in ([SCENE], [SCENE, REDUCER]):
        if not set(groups) <= set(items):
            continue
        left = take_out(items[groups], np.eye(len(items)))
        x, y = left @ values, left @ ratings
        inverse = np.linalg.pinv(x)
        residual = y - x @ (inverse @ y)
        leverage = 1 - left.diagonal() + np.einsum("ij,ji->i", x, inverse)
        for change in inverse * (residual / np.maximum(1 - leverage, 1e-9)):
            order = np.argsort(-np.abs(change), kind="stable")[:count]
            chosen |= dict.fromkeys(items[ITEM].iloc[order[np.abs(change[order]) > 0]])
    return list(chosen)


def _find_exceptions(cells: Cells, slopes: Mapping[Hashable, Slopes]) -> pd.DataFrame:
    """Find reducers that are rated otherwise than the slopes of all others predict."""
    columns = ["excess", "t", "df", "p", "exceptional"]
    if len(slopes) < FEWEST_REDUCERS:
        return pd.DataFrame(columns=columns, index=pd.Index([], name=REDUCER))
    found, n = {}, cells.count(REDUCER)
    for name, others in slopes.items():
        excess, se, df = measure_excess(cells, name, others)
        value = excess / se if se > 0 else math.nan
        p = min(1.0, 2 * n * float(student.sf(abs(value), df))) if se > 0 else math.nan
        found[name] = (excess, value, df, p, p < LEVEL and LEAST_EXCESS <= abs(excess) <= HIGHEST)
    return pd.DataFrame.from_dict(found, orient="index", columns=columns).rename_axis(REDUCER)


def measure_excess(cells: Cells, name: Hashable, others: Slopes) -> tuple[float, float, float]:
    """Measure by how many points a reducer is rated above what the slopes of all others predict: excess, se, df.

    Two variances add up: of what the slopes leave of reducers, s² (1 + 1/n) over the n others, and of the prediction
    itself, which may lie far from the metrics of the others. Their degrees of freedom are put together as by Welch and
    Satterthwaite. Without the second, four slopes on six reducers named a reducer that had no excess in 53 % of 30
    simulated studies, and the interval held a planted one in 33 %; with it in none, and in 93 %.
    """
    items, within, ratings = cells.averages
    left = np.column_stack([take_out(items[[SCENE]], ratings), within])
    table = pd.DataFrame(left).groupby(items[REDUCER].to_numpy()).mean()
    is_own = table.index == name
    rest = table[~is_own].to_numpy()
    gap = table[is_own].to_numpy()[0] - rest.mean(axis=0)
    names = [f"{metric}_w" for metric in cells.metrics]
    slope = others.solved.estimate(dict(zip(names, gap[1:].tolist(), strict=True)))
    weights = others.table["estimate"].reindex(list(cells.metrics)).fillna(0).to_numpy()
    spread = float((rest[:, 0] - rest[:, 1:] @ weights).std(ddof=1))
    parts = (spread * math.sqrt(1 + 1 / len(rest)), len(rest) - 1.0), (slope.se, slope.df)
    known = [(se, df) for se, df in parts if se > 0 and df > 0]
    se = math.hypot(*(se for se, _ in known))
    df = se**4 / sum(one**4 / df for one, df in known) if known else math.nan
    return float(gap[0]) - slope.estimate, se, df
