"""Section: what the hand got of each stimulus, beside what was intended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.figures.delivered import draw_delivered
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    TEXT,
    Column,
    Picture,
    Section,
    TableForm,
    read_methods,
)
from feel321.analysis.table.schema import ERROR, SOURCE
from feel321.analysis.words import COUNT
from feel321.names import MATCHES

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.reading import Table

Row = dict[str, Any]

KEY = "delivered"
TITLE = "Delivered vibration"
SUFFIX = "_delivered"
UNKNOWN = "unknown"
SOURCES = {"sensor": "measured by the sensor", "certificate": "predicted by the certificate"}
MATCHED = TableForm(
    "Metrics of what was delivered beside those intended, over test stimuli: means, mean of the difference (delivered "
    "minus intended), its largest size and the stimulus that has it.",
    (
        METRIC, Column("Stimuli", "n", COUNT, "stimuli"),
        Column("Intended", "intended", end="intended", method="mean over test stimuli"),
        Column("Delivered", "delivered", end="delivered", method="mean over test stimuli, each a mean over judgements"),
        Column("Difference", "difference", end="difference", method="mean difference, delivered - intended"),
        Column("Largest", "largest", end="largest", method="largest difference in size"),
        Column("Of stimulus", "stimulus", NAME),
    ),
    path="delivered.{metric}", detail=False,
)  # fmt: skip
LEVELS = TableForm(
    "Level of the vibration delivered over that asked for, in dB, over judgements: median, middle 90 %, largest size.",
    (
        Column("Known from", "source", TEXT), Column("Judgements", "n", COUNT, "judgements"),
        Column("Median", "median", "rating", "median", "median over judgements"),
        Column("5 %", "low", "rating", "low", "5 % quantile over judgements"),
        Column("95 %", "high", "rating", "high", "95 % quantile over judgements"),
        Column("Largest", "largest", "rating", "largest", "largest size over judgements"),
    ),
    path="level_error.{source}", detail=False,
)  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - called as all sections are
    """Compare the metrics of what was delivered with those intended, and describe the level errors."""
    rows = table.rows[table.rows["role"] == "test"]
    names = [name for name in MATCHES if name in rows and name + SUFFIX in rows]
    errors = rows[rows[ERROR].notna()] if ERROR in rows else rows[:0]
    if not names and errors.empty:
        return Section(key=KEY, title=TITLE)
    items = rows.drop_duplicates("stimulus_id").set_index("stimulus_id")
    matched = [_compare(items, name) for name in names]
    levels = [_describe_levels(part[ERROR], source) for source, part in _split(errors)]
    columns = [*names, *(name + SUFFIX for name in names)]
    levels_db = errors[ERROR].to_numpy(np.float64) if levels else np.zeros(0)
    draw = partial(draw_delivered, items[["reducer", *columns]], names, levels_db)
    caption = (
        "What was delivered against what was intended: match metrics of each test stimulus (on the line: as intended), "
        "and level errors of all judgements of test stimuli."
    )
    return Section(
        key=KEY,
        title=TITLE,
        answers=[*_sum_up_levels(levels, n=len(rows)), *map(_sum_up, matched)],
        grids=(MATCHED.build(matched), LEVELS.build(levels)),
        tables={"delivered": items[columns].reset_index() if names else [], "level_errors": levels},
        pictures=[Picture(KEY, caption, draw)],
        how=read_methods(KEY),
    )


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
        "metric": name,
        "n": len(items),
        "intended": intended.mean(),
        "delivered": delivered.mean(),
        "difference": difference.mean(),
        "largest": difference[largest],
        "stimulus": str(items.index[largest]),
    }


def _describe_levels(errors_db: Series, source: str) -> Row:
    values = errors_db.to_numpy(np.float64)
    low, median, high = np.quantile(values, (0.05, 0.5, 0.95))
    largest = values[int(np.argmax(np.abs(values)))]
    ends = {"median": median, "low": low, "high": high, "largest": largest}
    return {"source": source, "n": len(values), **ends}


def _sum_up_levels(levels: Sequence[Row], *, n: int) -> Iterator[str]:
    for row in levels:
        how = SOURCES.get(row["source"], "given without a source")
        median, low, high = (
            words.format_number(row[name], kind="rating") for name in ("median", "low", "high")
        )
        yield (
            f"Level error of {row['n']} of {n} judgements of test stimuli ({how}): median {median} dB, 90 % of them "
            f"from {low} to {high} dB."
        )


def _sum_up(row: Row) -> str:
    difference, largest = (words.format_number(row[name]) for name in ("difference", "largest"))
    metric = words.capitalise(words.format_name(row["metric"]))
    return (
        f"{metric} as delivered differs from the intended one by {difference} on average, by {largest} at most "
        f"({row['stimulus']})."
    )
