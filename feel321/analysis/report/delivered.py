"""Section: the vibration that was delivered to the hand, beside what was intended."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.figures.kinds import draw_delivered
from feel321.analysis.report.section import Found, Picture, Row, Section, count_rows, make_row
from feel321.analysis.table.schema import ERROR, SOURCE
from feel321.names import MATCHES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

KEY, SUFFIX, UNKNOWN = "delivered", "_delivered", "unknown"


def compute(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare the metrics of what was delivered with those intended, and describe the level errors."""
    rows = table.rows[table.rows["role"] == "test"]
    names = [name for name in MATCHES if name in rows and name + SUFFIX in rows]
    errors = rows[rows[ERROR].notna()] if ERROR in rows else rows[:0]
    if not names and errors.empty:
        return Found()
    items = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")
    matched = [_compare(items, name) for name in names]
    levels = [_describe_levels(part, source) for source, part in _split(errors)]
    listed = {KEY: [row for one in matched for row in _list_matched(one)]}
    names_db = ("n_judgements", "median", "q05", "q95", "largest")
    listed["level_errors"] = [
        row
        for one in levels
        for row in count_rows(
            {key: one[key] for key in names_db}, source=one["source"], n=one["n_judgements"]
        )
    ]
    listed["delivered_stimuli"] = [
        make_row(quantity, item[name + suffix], metric=name, stimulus=stimulus, n=1)
        for name in names for stimulus, item in items.iterrows()
        for quantity, suffix in (("intended", ""), ("delivered", SUFFIX))
    ]  # fmt: skip
    caption = (
        "What was delivered against what was intended: match metrics of each test stimulus (on the line: as intended), "
        "and level errors of all judgements of test stimuli."
    )
    columns = ["reducer", *names, *(name + SUFFIX for name in names)]
    values = errors[ERROR].to_numpy(np.float64) if levels else np.zeros(0)
    draw = partial(draw_delivered, items[columns], names, values)
    facts = {"levels": levels, "matched": matched, "n": len(rows)}
    return Found(listed, facts, (Picture(KEY, caption, draw),))


def _split(errors: DataFrame) -> Iterator[tuple[str, DataFrame]]:
    """Split judgements by how their delivery is known; tables from elsewhere need not say it."""
    if SOURCE in errors:
        for source, part in errors.groupby(errors[SOURCE].replace("", UNKNOWN), observed=True):
            yield str(source), part
    elif len(errors):
        yield UNKNOWN, errors


def _compare(items: DataFrame, name: str) -> Row:
    intended, delivered = (items[column].to_numpy(np.float64) for column in (name, name + SUFFIX))
    difference = delivered - intended
    largest = int(np.argmax(np.abs(difference)))
    return {
        "metric": name, "n_stimuli": len(items), "intended": intended.mean(), "delivered": delivered.mean(),
        "difference": difference.mean(), "largest": difference[largest], "stimulus": str(items.index[largest]),
    }  # fmt: skip


def _list_matched(one: Row) -> Iterator[Row]:
    keys: Row = {"metric": one["metric"], "n": one["n_stimuli"]}
    names = ("n_stimuli", "intended", "delivered", "difference", "largest")
    yield from count_rows({name: one[name] for name in names}, **keys)
    yield make_row("stimulus", note=one["stimulus"], **keys)


def _describe_levels(part: DataFrame, source: str) -> Row:
    values = part[ERROR].to_numpy(np.float64)
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    largest = values[int(np.argmax(np.abs(values)))]
    ends = {"median": middle, "q05": low, "q95": high, "largest": largest}
    return {"source": source, "n_judgements": len(values), **ends}


SECTION = Section(KEY, "Delivered vibration", "trust", compute)
