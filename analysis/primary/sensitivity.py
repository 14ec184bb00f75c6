"""The primary slopes under other choices: one recording or reducer less, another use of the scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers
from analysis.primary.cells import RATING, REDUCER, SCENE, SOURCE, WHO
from analysis.primary.model import fit_primary
from analysis.table.reading import order_reducers
from analysis.table.sources import find_sources
from analysis.table.tidy import leave_rejected, leave_untested, name_items, open_ratings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from pandas import DataFrame

CORRELATED, WITHOUT_REDUCERS = "correlated slopes", "without reducers"
COLUMNS = ("estimate", "se", "df", "t", "p", "low", "high", "standardised", "standardised_low", "standardised_high")


def vary_primary(
    rows: DataFrame, metrics: Sequence[str], *, top: float = 100.0, leave_out: bool = True
) -> DataFrame:
    """Repeat the primary analysis under other choices.

    Parameters
    ----------
    rows : DataFrame
        As for `fit_primary`; with a column ``reducer``, each reducer is left out in turn.
    metrics : sequence of str
        One or more.
    top : float
        Upper end of the rating scale, which starts at 0.
    leave_out : bool
        Whether to leave each recording and each reducer out in turn.

    Returns
    -------
    DataFrame
        One row per variant and metric: variant, unit (of estimate, low and high: points, rater SDs or logits,
        per unit of the metric), metric, estimate se df t p low high, standardised slope with its interval,
        singular, and reason (why a variant has no numbers, or what its model lacks or leaves out).

    Raises
    ------
    ValueError
        If the primary model itself cannot be fitted, or ratings are outside of 0..top.

    Notes
    -----
    Variants: people's slopes correlated; the model without its terms for reducers, which takes what a reducer feels
    like for other reasons for evidence of its metric; without each recording (without each source, where several
    recordings come from one: the others of it would stand in for what is left out); without each reducer (metrics
    are split anew over what is left, so that nothing of it leaks in); each rater's ratings standardised, which takes
    out how much of the scale they use (raters whose ratings are all the same cannot be, and are left out, as the
    reason says); ratings as logits
    of (y (n - 1) + 1/2) / n, y = rating / top and n their number (Smithson & Verkuilen 2006), which takes out the
    crowding at the scale's ends. Only standardised slopes compare across units.

    References
    ----------
    Smithson & Verkuilen (2006), doi 10.1037/1082-989X.11.1.54.
    """
    import pandas as pd

    rows, notes = leave_rejected(name_items(open_ratings(rows, what="rows")))
    rows, untested = leave_untested(rows)
    ratings = read_numbers(rows[RATING], what=f"rows, {RATING!r}")
    rows = rows.assign(**{RATING: ratings})
    if ratings.min() < 0 or ratings.max() > top:
        raise ValueError(f"rows: got ratings {ratings.min():g} to {ratings.max():g}, allowed is 0 to {top:g}; give top")
    tables = [_tabulate(variant, rows, metrics) for variant in ("primary", CORRELATED, WITHOUT_REDUCERS)]
    tables += [_tabulate(name, part, metrics) for name, part in (_leave_out(rows) if leave_out else ())]
    tables.append(_tabulate_standardised(rows, metrics))
    tables.append(_tabulate("logits", _squeeze(rows, top), metrics, unit="logits"))
    table = pd.concat(tables, ignore_index=True)
    return table.assign(reason=[" ".join(filter(None, (*notes, *untested, reason))) for reason in table["reason"]])


def _leave_out(rows: DataFrame) -> Iterator[tuple[str, DataFrame]]:
    sources = find_sources(rows)
    if not sources.is_unique:
        rows = rows.assign(**{SOURCE: rows[SCENE].map(sources)})
    for column in (SCENE if sources.is_unique else SOURCE, REDUCER):
        names = _order(rows[column].unique(), column) if column in rows else []
        for name in names if len(names) > 1 else []:
            yield f"without {column} {name}", rows[rows[column] != name]


def _order(names: Iterable[str], column: str) -> list[str]:
    """Put names in the same order whatever was rated, so that scales can be compared."""
    return order_reducers(names) if column == REDUCER else sorted(names, key=str)


def _tabulate_standardised(rows: DataFrame, metrics: Sequence[str]) -> DataFrame:
    steady = rows.groupby(WHO, observed=True)[RATING].transform("std").fillna(0) == 0
    table = _tabulate("rater-standardised", _standardise(rows[~steady]), metrics, unit="rater SDs")
    if steady.any():
        names = ", ".join(map(str, rows.loc[steady, WHO].unique()))
        table["reason"] = f"Without {names}, whose ratings are all the same. " + table["reason"]
    return table


def _standardise(rows: DataFrame) -> DataFrame:
    own = rows.groupby(WHO, observed=True)[RATING]
    return rows.assign(**{RATING: (rows[RATING] - own.transform("mean")) / own.transform("std")})


def _squeeze(rows: DataFrame, top: float) -> DataFrame:
    share = (rows[RATING] / top * (len(rows) - 1) + 0.5) / len(rows)
    return rows.assign(**{RATING: np.log(share / (1 - share))})


def _tabulate(variant: str, rows: DataFrame, metrics: Sequence[str], *, unit: str = "points") -> DataFrame:
    import pandas as pd

    try:
        model = fit_primary(
            rows, metrics, correlated=variant == CORRELATED, reducers=variant != WITHOUT_REDUCERS, explain=False
        )
    except ValueError as error:
        if variant == "primary":
            raise
        table = pd.DataFrame(np.nan, index=list(metrics), columns=list(COLUMNS))
        singular, reason = False, str(error)
    else:
        table = model.slopes[list(COLUMNS)].reindex(list(metrics))
        singular, reason = model.fit.singular, " ".join(model.reductions)
    table = table.rename_axis("metric").reset_index().assign(singular=singular, reason=reason)
    table.insert(0, "unit", unit)
    table.insert(0, "variant", variant)
    return table
