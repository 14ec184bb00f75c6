"""ITU-T P.1401 and the classic tests of correlations, for comparison with the literature."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.association.dependent import compare_dependent
from feel321.analysis.association.repeated import repeated_measures_correlation
from feel321.analysis.p1401.difference import compare_p1401
from feel321.analysis.p1401.mapping import p1401
from feel321.analysis.report._old import INTERVAL, Cell, Grid
from feel321.analysis.report.parts import split_parts
from feel321.analysis.report.section import Section
from feel321.analysis.table.items import make_items
from feel321.analysis.words import (
    COUNT,
    count_number,
    make_interval,
    make_number,
    name_path,
    tell_name,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from pandas import DataFrame

    from feel321.analysis.p1401.mapping import P1401
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.table.items import Items
    from feel321.analysis.table.reading import Table

    Row = dict[Hashable, Any]

KEY, TITLE = "standard", "For comparison with the literature"
ORDERS = (1, 3)
NUMBERS = (
    "plcc", "plcc_low", "plcc_high", "srocc", "rmse", "rmse_low", "rmse_high", "rmse_star", "outlier_ratio",
    "outlier_ratio_sd", "n_items",
)  # fmt: skip
TESTS = {
    "plcc_z": "Z of PLCC", "plcc_p": "p", "outlier_z": "Z of outlier ratios", "outlier_p": "p", "rmse_f": "F of rmse",
    "rmse_p": "p", "rmse_star_f": "F of rmse*", "rmse_star_p": "p",
}  # fmt: skip
INDEPENDENT = "95 % interval that takes stimuli for independent"
HOW = (
    "ITU-T P.1401: the metric is mapped to mean ratings (first order, and monotone third order), then PLCC, SROCC, "
    "rmse, rmse* and outlier ratio; out of fold: mapped without the stimulus's recording, and without "
    "all others of its source. Its intervals and tests, the classic tests of dependent correlations (Williams, "
    "Steiger, Meng, Zou) and the repeated-measures correlation take stimuli or rows for independent, which those of "
    "one recording are not: in simulated studies without any difference or relation they found one in "
    "13 to 51 %. Nothing is concluded from them here.",
)


def compute(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Compute what other studies print."""
    notes: list[str] = []
    found: dict[str, list[Row]] = {
        "p1401": [],
        "p1401_differences": [],
        "dependent": [],
        "repeated": [],
    }
    for part in split_parts(table):
        items = make_items(part.rows, [*table.metrics, *table.further])
        place: Row = {"scale": part.scale, "level": part.level}
        for kind, rows in _evaluate(part, items, table, notes).items():
            found[kind] += [place | row for row in rows]
    makers = {
        "p1401": _lay_p1401,
        "p1401_differences": _lay_differences,
        "dependent": _lay_dependent,
        "repeated": _lay_repeated,
    }
    grids = tuple(make(found[kind]) for kind, make in makers.items() if found[kind])
    return Section(
        key=KEY,
        title=TITLE,
        grids=grids,
        tables=_make_tables(found),
        notes=tuple(dict.fromkeys(notes)),
        how=HOW if grids else (),
    )


def _evaluate(part: Part, items: Items, table: Table, notes: list[str]) -> dict[str, list[Row]]:  # noqa: PLR0917 - notes are added to
    judged: dict[tuple[str, int, bool], P1401] = {}
    for (place, name), order, held in product(
        enumerate((*table.metrics, *table.further)), ORDERS, (False, True)
    ):
        groups = items.of_source[items.recordings] if held else None
        lead = f"{part.lead}, P.1401 of {name}"
        run = partial(p1401, items.ratings.T, items.metrics[place], order=order, groups=groups)
        result = _attempt(run, notes, lead)
        if result is not None:
            judged[name, order, held] = result
    rows: list[Row] = [
        {
            "metric": name,
            "order": order,
            "held_out": held,
            **{key: getattr(one, key) for key in NUMBERS},
            "coefficients": " ".join(f"{value:.6g}" for value in one.coefficients),
        }
        for (name, order, held), one in judged.items()
    ]
    planned = {key: one for key, one in judged.items() if key[0] in table.metrics}
    return {
        "p1401": rows, "p1401_differences": list(_compare(planned)),
        "dependent": list(_compare_classically(part, items, table.metrics, notes)),
        "repeated": list(_correlate_rows(part, table.metrics, notes)),
    }  # fmt: skip


def _attempt(run: Callable[[], Any], notes: list[str], lead: str) -> Any:  # noqa: ANN401 - whatever is attempted
    try:
        return run()
    except ValueError as error:
        notes.append(f"{lead}: left out. {error}")
        return None


def _compare(judged: dict[tuple[str, int, bool], P1401]) -> Iterator[Row]:
    for one, other in combinations(judged, 2):
        if one[1:] == other[1:]:
            told: Row = dict(asdict(compare_p1401(judged[one], judged[other])).items())
            yield {"first": one[0], "second": other[0], "order": one[1], "held_out": one[2]} | told


def _compare_classically(  # noqa: PLR0917 - notes are added to
    part: Part, items: Items, metrics: tuple[str, ...], notes: list[str]
) -> Iterator[Row]:
    means = np.nanmean(items.ratings, axis=0)
    if np.ptp(means) == 0:
        return
    for one, other in combinations(range(len(metrics)), 2):
        columns = np.array([means, items.metrics[one], items.metrics[other]])
        if (np.ptp(columns, axis=1) == 0).any():
            continue
        r = np.corrcoef(columns)
        lead = f"{part.lead}, dependent correlations of {metrics[one]} and {metrics[other]}"
        result = _attempt(
            partial(compare_dependent, r[0, 1], r[0, 2], r[1, 2], len(means)), notes, lead
        )
        if result is not None:
            told: Row = dict(asdict(result).items())
            yield {"first": metrics[one], "second": metrics[other], "n_items": len(means)} | told


def _correlate_rows(part: Part, metrics: tuple[str, ...], notes: list[str]) -> Iterator[Row]:
    for name in metrics:
        columns = [part.rows[key].to_numpy() for key in (name, "rating", "participant")]
        lead = f"{part.lead}, repeated-measures correlation with {name}"
        result = _attempt(partial(repeated_measures_correlation, *columns), notes, lead)
        if result is not None:
            told: Row = dict(asdict(result).items())
            yield {"metric": name} | told


def _tell_place(row: Row) -> str:
    return f"{tell_name(row['scale'])}, {tell_name(row['level'])}"


def _lay_p1401(rows: list[Row]) -> Grid:
    caption = (
        "ITU-T P.1401. Errors in points, after mapping of the given order; fitted: by a mapping of the same "
        "stimuli, which flatters; held out: by one of recordings of other sources. 95 % intervals as the standard "
        "has them, stimuli taken for independent. Metrics other than the match metrics are explored only."
    )
    head = (
        "Ratings",
        "Metric",
        "Order",
        "Mapping",
        "PLCC",
        "Interval",
        "SROCC",
        "rmse",
        "Interval",
        "rmse*",
        "Outlier ratio",
    )
    return Grid(caption, head, tuple(map(_lay_judged, rows)))


def _lay_judged(row: Row) -> tuple[str | Cell, ...]:
    held, n = "held_out" if row["held_out"] else "fitted", row["n_items"]
    name = name_path(
        "p1401", row["scale"], row["level"], row["metric"], f"order_{row['order']}", held
    )

    def bounded(key: str) -> Any:  # noqa: ANN401 - a number with its interval
        number = make_number(f"{name}.{key}", row[key], f"P.1401 {key}", n=n)
        return make_interval(number, row[f"{key}_low"], row[f"{key}_high"], uncertainty=INDEPENDENT)

    plcc, rmse = bounded("plcc"), bounded("rmse")
    srocc, star, ratio = (
        make_number(f"{name}.{key}", row[key], f"P.1401 {key}", n=n)
        for key in ("srocc", "rmse_star", "outlier_ratio")
    )
    order = Cell(count_number(f"{name}.order", row["order"], n=n), COUNT)
    return (
        _tell_place(row), tell_name(row["metric"]), order, held.replace("_", " "),
        Cell(plcc), Cell(plcc, part=INTERVAL), Cell(srocc), Cell(rmse, "rating"), Cell(rmse, "rating", INTERVAL),
        Cell(star, "rating"), Cell(ratio),
    )  # fmt: skip


def _lay_differences(rows: list[Row]) -> Grid:
    caption = (
        "The tests of ITU-T P.1401 for a difference between two metrics: Z is positive where the first has the larger "
        "value, F is the larger squared error over the smaller; p are two-sided and not adjusted. They take stimuli "
        "for independent and both metrics' errors for unrelated, and find too much. A dash: not defined."
    )
    head = ("Ratings", "First", "Second", "Order", "Mapping", *TESTS.values(), "Stimuli")
    return Grid(caption, head, tuple(map(_lay_difference, rows)))


def _lay_difference(row: Row) -> tuple[str | Cell, ...]:
    held, n = "held_out" if row["held_out"] else "fitted", row["n_items"]
    place = row["scale"], row["level"], row["first"], row["second"], f"order_{row['order']}", held
    name = name_path("p1401_difference", *place)
    order, items = (
        Cell(count_number(f"{name}.{key}", row[key], n=n), COUNT) for key in ("order", "n_items")
    )
    tests = [
        Cell(
            make_number(f"{name}.{key}", row[key], f"P.1401 {key}", n=n),
            "p" if key.endswith("_p") else "correlation",
        )
        for key in TESTS
    ]
    names = tell_name(row["first"]), tell_name(row["second"])
    return (_tell_place(row), *names, order, held.replace("_", " "), *tests, items)


def _lay_dependent(rows: list[Row]) -> Grid:
    caption = (
        "Classic tests of the difference between two dependent correlations (first minus second), which take "
        "stimuli for independent and find too much."
    )
    head = (
        "Ratings",
        "First",
        "Second",
        "Difference",
        "Zou's interval",
        "Williams p",
        "Steiger p",
        "Meng p",
    )
    laid: list[tuple[str | Cell, ...]] = []
    for row in rows:
        name, n = (
            name_path("dependent", row["scale"], row["level"], row["first"], row["second"]),
            row["n_items"],
        )
        value = make_number(name, row["difference"], "difference of Pearson correlations", n=n)
        value = make_interval(
            value, row["zou_low"], row["zou_high"], uncertainty=f"Zou's {INDEPENDENT}"
        )
        tests = [
            Cell(make_number(f"{name}.{test}_p", row[f"{test}_p"], f"{test}'s test", n=n), "p")
            for test in ("williams", "steiger", "meng")
        ]
        names = tell_name(row["first"]), tell_name(row["second"])
        laid.append((_tell_place(row), *names, Cell(value), Cell(value, part=INTERVAL), *tests))
    return Grid(caption, head, tuple(laid))


def _lay_repeated(rows: list[Row]) -> Grid:
    caption = (
        "Repeated-measures correlation of single ratings, within participants; its 95 % interval "
        "is far too narrow."
    )
    laid = []
    for row in rows:
        name = name_path("repeated", row["scale"], row["level"], row["metric"])
        value = make_number(name, row["r"], "repeated-measures correlation", n=row["n"])
        value = make_interval(
            value,
            row["low"],
            row["high"],
            uncertainty="95 % interval that takes rows for independent",
        )
        rows_of = Cell(count_number(f"{name}.n", row["n"], n=row["n"]), COUNT)
        laid.append((
            _tell_place(row),
            tell_name(row["metric"]),
            Cell(value),
            Cell(value, part=INTERVAL),
            rows_of,
        ))
    return Grid(caption, ("Ratings", "Metric", "r", "Interval", "Rows"), tuple(laid))


def _make_tables(found: dict[str, list[Row]]) -> dict[str, DataFrame]:
    import pandas as pd

    def flatten(row: Row) -> Row:
        return {key: " ".join(value) if key == "notes" else value for key, value in row.items()}

    return {kind: pd.DataFrame(list(map(flatten, rows))) for kind, rows in found.items() if rows}
