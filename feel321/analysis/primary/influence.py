"""What one stimulus, recording or reducer does to the primary slopes, and what is concluded from them.

Recordings (or their sources) and reducers are each left out in turn and the model fitted anew. Stimuli are too many for
that: those that move a slope most are found by leverage and residual in a regression of the stimuli's mean ratings,
and then left out in the same exact way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, WHO, make_cells, select_rows
from feel321.analysis.primary.sensitivity import (
    Variant,
    keep_columns,
    leave_out_items,
    leave_out_units,
)
from feel321.analysis.table.schema import HIGHEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame, Series

    from feel321.analysis.primary.model import Primary
    from feel321.types import Samples


PREDICTS, OPEN, NOT_ESTIMABLE = "predicts", "open", "not_estimable"
"""What may be concluded about a slope."""

LEVEL = 0.05
"""Of a verdict, after Holm's adjustment, and of an exceptional reducer, after Bonferroni's."""

STIMULUS, RECORDING = "stimulus", "recording"
CANDIDATES = 2
"""Stimuli per metric and way of centring that are left out exactly."""

MOVED = 1.0
"""Standard errors by which a slope must change to be named."""

MOST_CELLS = 20_000
"""Participants x stimuli beyond which some thirty models would take many minutes."""

LEAST_EXCESS = 5.0
"""Points that an exceptional reducer must differ by: less is also what the ends of the scale do to the best ones."""

FEWEST_REDUCERS = 5
"""Fewer than this do not say how far reducers differ from what their metrics predict."""

ESTIMATES = ("estimate", "se", "df", "p", "tenth", "tenth_low", "tenth_high")


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """What single stimuli, recordings and reducers do to the primary slopes of one attribute.

    exceptions, by reducer: excess (points by which its ratings exceed what the slopes without it predict, relative to
    the other reducers), t, df, p (Bonferroni over reducers), exceptional (p < .05, and 5 to 100 points: beyond the
    scale it is the metric that is out of range).
    """

    table: DataFrame
    exceptions: DataFrame
    notes: tuple[str, ...] = ()

    def find_turns(self, metric: str) -> DataFrame:
        """Find the units without which a metric's verdict or sign changes, the largest change first."""
        return self._find(metric, "turns")

    def find_moves(self, metric: str) -> DataFrame:
        """Find the units without which a metric's slope changes by more than its standard error, or turns."""
        return self._find(metric, "moves")

    def _find(self, metric: str, column: str) -> DataFrame:
        if self.table.empty:
            return self.table
        found = self.table[(self.table["metric"] == metric) & self.table[column]]
        return found.sort_values("shift", key=np.abs, ascending=False, kind="stable")


def conclude(p_holm: float) -> str:
    """Give the verdict on a slope: ``predicts``, ``open``, or ``not_estimable`` where there is no test (NaN).

    Examples
    --------
    >>> conclude(0.01), conclude(0.2), conclude(float("nan"))
    ('predicts', 'open', 'not_estimable')
    """
    if math.isnan(p_holm):
        return NOT_ESTIMABLE
    return PREDICTS if p_holm < LEVEL else OPEN


def measure_influence(
    rows: DataFrame, metrics: Sequence[str], whole: Primary, *, others: Sequence[float] = ()
) -> Influence:
    """Leave out each recording and reducer, and the stimuli that matter most, one at a time."""
    import pandas as pd

    rows, _ = select_rows(rows)
    found, slopes, notes = [], {}, []
    if len(rows[[WHO, ITEM]].drop_duplicates()) > MOST_CELLS:
        notes.append(
            f"Influence was not measured: more than {MOST_CELLS} participant x stimulus cells."
        )
    elif whole.slopes["estimable"].any():
        lean = keep_columns(rows, metrics)
        candidates = find_candidates(rows, metrics)
        before = _conclude(whole.slopes, others)
        for variant in (*leave_out_units(lean), *leave_out_items(lean, candidates)):
            table = _compare(variant, metrics, whole, before=before, others=others)
            found.append(table.assign(kind=variant.kind, unit=variant.left))
            if variant.kind == REDUCER:
                slopes[variant.left] = table.set_index("metric")["estimate"]
    table = pd.concat(found, ignore_index=True) if found else pd.DataFrame()
    return Influence(table, _find_exceptions(rows, metrics, slopes), tuple(notes))


def find_candidates(
    rows: DataFrame, metrics: Sequence[str], *, count: int = CANDIDATES
) -> list[str]:
    """Find the stimuli that move slopes most, in regressions of the stimuli's mean ratings.

    Notes
    -----
    Without stimulus i the slopes of ordinary least squares change by (X'X)^-1 x_i e_i / (1 - h_i), with e_i its
    residual and h_i its leverage (Belsley, Kuh & Welsch 1980, ISBN 0-471-05856-4).
    """
    items, values, ratings = _gather_items(rows, metrics)
    chosen: dict[str, None] = {}
    for groups in ([SCENE], [SCENE, REDUCER]):
        if not set(groups) <= set(items):
            continue
        dummies = _list_dummies(items, groups)
        x, y = (_centre(dummies, each) for each in (values, ratings[:, None]))
        for change in _measure_changes(
            x, y[:, 0], share=np.einsum("ij,ji->i", dummies, np.linalg.pinv(dummies))
        ).T:
            order = np.argsort(-np.abs(change), kind="stable")[:count]
            chosen |= dict.fromkeys(items[ITEM].iloc[order[np.abs(change[order]) > 0]])
    return list(chosen)


def _gather_items(rows: DataFrame, metrics: Sequence[str]) -> tuple[DataFrame, Samples, Samples]:
    """Gather stimuli, their metrics within recordings, and their mean ratings, people's levels taken out."""
    cells = make_cells(rows, metrics).table
    level = cells.groupby(WHO, observed=True)[RATING].transform("mean")
    means = (cells[RATING] - level).groupby(cells[ITEM], observed=True).mean()
    items = cells.drop_duplicates(ITEM).reset_index(drop=True)
    within = items[[f"{name}_w" for name in metrics]].to_numpy(np.float64)
    return items, within, items[ITEM].map(means).to_numpy(np.float64)


def _list_dummies(items: DataFrame, groups: Sequence[str]) -> Samples:
    from pandas import get_dummies

    return get_dummies(items[list(groups)].astype(str)).to_numpy(np.float64)


def _centre(dummies: Samples, values: Samples) -> Samples:
    centred: Samples = values - dummies @ np.linalg.lstsq(dummies, values, rcond=None)[0]
    return centred


def _measure_changes(x: Samples, y: Samples, *, share: Samples) -> Samples:
    """Compute how every slope changes without each stimulus; share is the leverage of what was taken out before."""
    inverse = np.linalg.pinv(x)
    residual = y - x @ (inverse @ y)
    leverage = share + np.einsum("ij,ji->i", x, inverse)
    changes: Samples = (inverse * (residual / np.maximum(1 - leverage, 1e-9))).T
    return changes


def _conclude(slopes: DataFrame, others: Sequence[float]) -> DataFrame:
    """Adjust the slopes' tests for each other and for those of other attributes, and give the verdicts."""
    import pandas as pd

    p_holm = adjust_holm([*slopes["p"], *others])[: len(slopes)]
    verdicts = [conclude(p) for p in p_holm]
    return pd.DataFrame({"p_holm": p_holm, "verdict": verdicts}, index=slopes.index)


def _compare(
    variant: Variant,
    metrics: Sequence[str],
    whole: Primary,
    *,
    before: DataFrame,
    others: Sequence[float],
) -> DataFrame:
    """Fit without a unit, and compare every slope with that of the whole."""
    fitted, _, reason = variant.try_to_fit(metrics)
    table = fitted.reindex(whole.slopes.index)[list(ESTIMATES)]
    table = table.join(_conclude(table, others))
    estimate = whole.slopes["estimate"]
    table["shift"] = (table["estimate"] - estimate) / whole.slopes["se"]
    known = table["verdict"] != NOT_ESTIMABLE
    turned = np.sign(table["estimate"]) * np.sign(estimate) < 0
    other = table["verdict"] != before["verdict"]
    table["turns"] = known & before["p_holm"].notna() & (other | turned)
    table["moves"] = table["turns"] | (known & (table["shift"].abs() > MOVED))
    table["reason"] = "" if fitted["estimate"].notna().any() else reason
    return table.rename_axis("metric").reset_index()


def _find_exceptions(
    rows: DataFrame, metrics: Sequence[str], slopes: dict[str, Series[float]]
) -> DataFrame:
    """Find reducers that are rated otherwise than the slopes of all others predict."""
    import pandas as pd
    from scipy.stats import t as student

    columns = ["excess", "t", "df", "p", "exceptional"]
    if len(slopes) < FEWEST_REDUCERS:
        return pd.DataFrame(columns=columns, index=pd.Index([], name=REDUCER))
    items, within, ratings = _gather_items(rows, metrics)
    own = _centre(_list_dummies(items, [SCENE]), ratings[:, None])[:, 0]
    found = {}
    for name, slope in slopes.items():
        weights = slope.reindex(list(metrics)).fillna(0).to_numpy()
        means = pd.Series(own - within @ weights).groupby(items[REDUCER].to_numpy()).mean()
        rest, df = means.drop(name), len(means) - 2
        excess = float(means[name] - rest.mean())
        spread = float(rest.std()) * math.sqrt(1 + 1 / len(rest))
        value = excess / spread if spread > 0 else math.nan
        p = min(1.0, len(means) * 2 * float(student.sf(abs(value), df))) if spread > 0 else math.nan
        found[name] = (excess, value, df, p, p < LEVEL and LEAST_EXCESS <= abs(excess) <= HIGHEST)
    return pd.DataFrame.from_dict(found, orient="index", columns=columns).rename_axis(REDUCER)
