"""ITU-T P.1401 and the classic tests of correlations, for comparison with the literature."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from itertools import combinations, product
from typing import Any

import numpy as np

from feel321.analysis.association.classic import compare_dependent, repeated_measures_correlation
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.section import (
    METRIC,
    RATINGS,
    TEXT,
    Column,
    Section,
    TableForm,
    read_methods,
)
from feel321.analysis.resampling import Choices
from feel321.analysis.standard import P1401, compare_p1401, p1401
from feel321.analysis.table.items import Items, make_items
from feel321.analysis.table.reading import Table
from feel321.analysis.words import COUNT

ORDERS = (1, 3)
NUMBERS = (
    "plcc", "plcc_low", "plcc_high", "srocc", "rmse", "rmse_low", "rmse_high", "rmse_star", "outlier_ratio",
    "outlier_ratio_sd", "n_items",
)  # fmt: skip
INDEPENDENT = "95 % interval that takes stimuli for independent"
FIRST, SECOND = Column("First", "first", TEXT), Column("Second", "second", TEXT)
ORDER = Column("Order", "order", COUNT, "order")
MAPPING = Column("Mapping", "_which", TEXT)


def _judge(head: str, key: str, kind: str = "correlation", **more: str) -> Column:
    return Column(head, key, kind, key, f"P.1401 {key}", **more)


def _bound(head: str, key: str, kind: str) -> Column:
    return _judge(head, key, kind, interval=INDEPENDENT, ends=f"{key}_")


P1401_COLUMNS = (
    RATINGS, METRIC, ORDER, MAPPING, _bound("PLCC", "plcc", "correlation"), _judge("SROCC", "srocc"),
    _bound("rmse", "rmse", "rating"), _judge("rmse*", "rmse_star", "rating"),
    _judge("Outlier ratio", "outlier_ratio"),
)  # fmt: skip
DIFFERENCE_COLUMNS = (
    RATINGS, FIRST, SECOND, ORDER, MAPPING, _judge("Z of PLCC", "plcc_z"), _judge("p", "plcc_p", "p"),
    _judge("Z of outlier ratios", "outlier_z"), _judge("p", "outlier_p", "p"), _judge("F of rmse", "rmse_f"),
    _judge("p", "rmse_p", "p"), _judge("F of rmse*", "rmse_star_f"), _judge("p", "rmse_star_p", "p"),
    Column("Stimuli", "n_items", COUNT, "n_items"),
)  # fmt: skip
DEPENDENT_COLUMNS = (
    RATINGS, FIRST, SECOND,
    Column(
        "Difference", "difference", method="difference of Pearson correlations", interval=f"Zou's {INDEPENDENT}",
        ends="zou_", head_interval="Zou's interval",
    ),
    *(
        Column(f"{name.capitalize()} p", f"{name}_p", "p", f"{name}_p", f"{name}'s test")
        for name in ("williams", "steiger", "meng")
    ),
)  # fmt: skip
ROWS_INTERVAL = "95 % interval that takes rows for independent"
REPEATED_COLUMNS = (
    RATINGS, METRIC, Column("r", "r", method="repeated-measures correlation", interval=ROWS_INTERVAL),
    Column("Rows", "n", COUNT, "n"),
)  # fmt: skip
ANTICONSERVATIVE = "They treat stimuli as independent and are anticonservative."
TABLES = {
    "p1401": TableForm(
        "ITU-T P.1401. Errors in points, after mapping of the given order; fitted: by a mapping of the same stimuli, "
        "which is optimistic; held out: by one of recordings of other sources. 95 % intervals as the standard has "
        "them, stimuli treated as independent. Metrics other than the match metrics are exploratory.",
        P1401_COLUMNS, "p1401.{scale}.{level}.{metric}.order_{order}.{_which}", n="n_items",
    ),
    "p1401_differences": TableForm(
        "The tests of ITU-T P.1401 for a difference between two metrics: Z is positive where the first has the larger "
        "value, F is the larger squared error over the smaller; p are two-sided and not adjusted. They treat both "
        f"metrics' errors as unrelated. {ANTICONSERVATIVE} A dash: not defined.",
        DIFFERENCE_COLUMNS, "p1401_difference.{scale}.{level}.{first}.{second}.order_{order}.{_which}", n="n_items",
    ),
    "dependent": TableForm(
        f"Classic tests of the difference between two dependent correlations (first minus second). {ANTICONSERVATIVE}",
        DEPENDENT_COLUMNS, "dependent.{scale}.{level}.{first}.{second}", n="n_items",
    ),
    "repeated": TableForm(
        "Repeated-measures correlation of single ratings, within participants; its 95 % interval is far too narrow.",
        REPEATED_COLUMNS, "repeated.{scale}.{level}.{metric}", n="n",
    ),
}  # fmt: skip
"""File -> its table on the page."""


def compute(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Compute what other studies print."""
    notes: list[str] = []
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    for part in split_parts(table):
        for name, rows in _evaluate(part, table, notes).items():
            for row in rows:
                which = "held_out" if row.get("held_out") else "fitted"
                found[name].append(part.keys | row | {"_which": which})
    return Section(
        key="standard",
        title="For comparison with the literature",
        grids=[form.build(found[name]) for name, form in TABLES.items()],
        tables=found,
        notes=notes,
        how=read_methods("standard"),
    )


def _evaluate(part: RatingsPart, table: Table, notes: list[str]) -> dict[str, list[dict[str, Any]]]:
    names = (*table.metrics, *table.further)
    items = make_items(part.rows, list(names))
    judged: dict[tuple[str, int, bool], P1401] = {}
    for (place, name), order, held in product(enumerate(names), ORDERS, (False, True)):
        groups = items.of_source[items.recordings] if held else None
        higher = table.info[name].higher if name in table.info else None
        run = partial(
            p1401, items.ratings.T, items.metrics[place], order=order, groups=groups, higher=higher
        )
        result = _attempt(run, notes, f"{part.lead}, P.1401 of {name}")
        if result is not None:
            judged[name, order, held] = result
    rows = [
        {
            "metric": name, "order": order, "held_out": held, **{key: getattr(one, key) for key in NUMBERS},
            "coefficients": " ".join(f"{value:.6g}" for value in one.coefficients),
        }
        for (name, order, held), one in judged.items()
    ]  # fmt: skip
    differences = [
        {"first": one[0], "second": other[0], "order": one[1], "held_out": one[2]}
        | asdict(compare_p1401(judged[one], judged[other]))
        for one, other in combinations([key for key in judged if key[0] in table.metrics], 2)
        if one[1:] == other[1:]
    ]
    return {
        "p1401": rows,
        "p1401_differences": differences,
        "dependent": list(_compare_classically(part, items, table.metrics, notes)),
        "repeated": list(_correlate_rows(part, table.metrics, notes)),
    }


def _attempt(run: Callable[[], Any], notes: list[str], lead: str) -> Any:  # noqa: ANN401 - whatever is attempted
    try:
        return run()
    except ValueError as error:
        notes.append(f"{lead}: left out. {error}")
        return None


def _compare_classically(  # noqa: PLR0917 - notes are added to
    part: RatingsPart, items: Items, metrics: tuple[str, ...], notes: list[str]
) -> Iterator[dict[str, Any]]:
    means = np.nanmean(items.ratings, axis=0)
    for (i, one), (j, other) in combinations(enumerate(metrics), 2):
        columns = np.array([means, items.metrics[i], items.metrics[j]])
        if (np.ptp(columns, axis=1) == 0).any():
            continue
        r = np.corrcoef(columns)
        run = partial(compare_dependent, r[0, 1], r[0, 2], r[1, 2], len(means))
        lead = f"{part.lead}, dependent correlations of {one} and {other}"
        if (result := _attempt(run, notes, lead)) is not None:
            yield {"first": one, "second": other, "n_items": len(means)} | asdict(result)


def _correlate_rows(
    part: RatingsPart, metrics: tuple[str, ...], notes: list[str]
) -> Iterator[dict[str, Any]]:
    for name in metrics:
        columns = [part.rows[key].to_numpy() for key in (name, "rating", "participant")]
        run = partial(repeated_measures_correlation, *columns)
        lead = f"{part.lead}, repeated-measures correlation with {name}"
        if (result := _attempt(run, notes, lead)) is not None:
            yield {"metric": name} | asdict(result)
