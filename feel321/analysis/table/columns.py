"""Columns of tables: which are metrics and what each declares of itself, and the dictionary of every CSV file.

Any numeric column of a manifest is a metric. What it declares (`feel321.types.MetricInfo`) comes, the first that says
so, from the caller (`[metrics.NAME]` in ``study.toml``), from ``metrics`` in the ``manifest.json`` beside the
manifest, or from `feel321.stimuli.METRIC_INFO`. Nothing declared: higher is better, no bounds, its name for a label.

`dictionary.csv` beside this module is the only list of what columns are: its ``file`` is a pattern, and a row for one
file goes before one for all. Ends of intervals and tests (``slope_low``, ``slope_p``) follow from the column they
belong to, metrics from what they declare.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from feel321.analysis.table import schema
from feel321.types import MATCHES, METRIC_INFO, REDUCER_NAMES, WRITTEN, MetricInfo

# File beside a manifest whose ``metrics`` say what the columns of metrics are
DECLARED = "manifest.json"
TENTH = 0.1  # Step of a metric that is a share, such as a match from 0 to 1
ROUNDING = 1e-9  # Share of a bound by which a value may pass it: files hold rounded numbers
# Column derived from a metric and explored beside those that were planned -> what it is: per stimulus in the
# manifest, or per judgement in the ratings, where a stimulus has the mean over its judgements
FURTHER: Mapping[str, str] = {
    "spectral_match_rotation_mean": "mean of the spectral match over random orientations of the sensor",
    "spectral_match_rotation_sd": "standard deviation of the spectral match over random orientations of the sensor",
    "spectral_match_delivered": "spectral match of the signal as it was delivered",
    "spectral_match_energy_weighted": "spectral match with frequencies weighted by their energy",
    "temporal_match_rotation_mean": "mean of the temporal match over random orientations of the sensor",
    "temporal_match_rotation_sd": "standard deviation of the temporal match over random orientations of the sensor",
    "temporal_match_delivered": "temporal match of the signal as it was delivered",
    "temporal_match_invariant": "counterpart of the temporal match that no orientation changes",
    "spectral_match_bounded_rotation_mean": "mean of the spectral match bounded over random orientations of the sensor",
    "spectral_match_bounded_rotation_sd":
        "standard deviation of the spectral match bounded over random orientations of the sensor",
    "spectral_match_bounded_delivered": "spectral match bounded of the signal as it was delivered",
}  # fmt: skip
LABELS = {name: METRIC_INFO[name].label for name in MATCHES}
# Rotation statistics (Park & Kuchenbecker 2019), computed by `analyze`; a study may declare them
ROTATIONS: Mapping[str, MetricInfo] = {
    f"{name}_rotation_mean": replace(METRIC_INFO[name], label=f"mean {label} over orientations")
    for name, label in LABELS.items()
} | {
    f"{name}_rotation_sd": MetricInfo(f"spread of the {label} over orientations", "worse", low=0.0)
    for name, label in LABELS.items()
}
FILED = {"file", "sha256", "recording_sha256"}
NOT_METRICS = {"stimulus_id", *schema.NAMING, "role", "source", *FILED}


def describe_explored(metrics: Sequence[str]) -> dict[str, str]:
    """Say what the columns of metrics are that an analysis of other metrics explores."""
    every = {name: METRIC_INFO[name].label for name in WRITTEN} | dict(FURTHER)
    return {name: meaning for name, meaning in every.items() if name not in metrics}


def describe_manifest(metrics: Iterable[str] = ()) -> dict[str, str]:
    """List the columns that a manifest may have and their kinds, with the metrics that are asked for."""
    asked = dict.fromkeys([*describe_explored(()), *metrics], schema.METRIC)
    needed = {name: schema.MANIFEST[name] for name in schema.NEEDED[1]}
    return {**schema.MANIFEST, **asked, **needed}


def list_numeric(cells: DataFrame) -> list[str]:
    """List the columns, read as text, that hold numbers and are no identity: all that may be used as a metric."""
    found = []
    for name in (name for name in map(str, cells) if name not in NOT_METRICS):
        filled = cells.loc[cells[name] != "", name]
        if len(filled) and pd.to_numeric(filled, errors="coerce").notna().mean() > schema.MOSTLY:
            found.append(name)
    return found


def read_attributes(manifest: Path | DataFrame) -> DataFrame:
    """Read every numeric column of a manifest that may say what stimuli are like, by stimulus_id."""
    cells = schema.read_cells(manifest).set_index("stimulus_id")
    out = {schema.GAIN} | {name for name, kind in schema.MANIFEST.items() if kind == schema.UNUSED}
    names = [name for name in list_numeric(cells) if name not in out]
    numbers = {name: pd.to_numeric(cells[name], errors="coerce") for name in names}
    return pd.DataFrame(numbers, index=cells.index)


def gather_info(
    names: Collection[str], declared: Mapping[str, MetricInfo] | None, manifest: Path | DataFrame
) -> tuple[dict[str, MetricInfo], frozenset[str]]:
    """Find what each metric declares; also name those whose bounds a study or a manifest states."""
    stated, path = {}, Path()
    if isinstance(manifest, Path) and (path := manifest.with_name(DECLARED)).is_file():
        try:
            listed = json.loads(path.read_text(encoding="utf-8")).get("metrics", {})
            stated = {str(name): make_info(str(name), facts) for name, facts in listed.items()}
        except (AttributeError, RecursionError, TypeError, ValueError) as error:
            must = f"'metrics' must describe metrics by name; {error}"
            raise ValueError(f"{path.name}: {must}") from None
    stated |= declared or {}
    known = {**METRIC_INFO, **ROTATIONS, **stated}
    found = {name: known.get(name, MetricInfo(name)) for name in names}
    return found, frozenset(name for name in names if name in stated)


def make_info(name: str, facts: Mapping[str, object]) -> MetricInfo:
    """Make what a metric declares of the facts that a file gives; null and what is missing are the defaults."""
    wanted = {field.name for field in fields(MetricInfo)}
    given = {key: value for key, value in facts.items() if key in wanted and value is not None}
    given |= {end: float(str(given[end])) for end in ("low", "high") if end in given}
    try:
        return MetricInfo(**{"label": name, **given})  # type: ignore[arg-type]  # MetricInfo checks them
    except ValueError as error:
        raise ValueError(f"metric '{name}': {error}") from None


def refuse_unbounded(
    sheet: DataFrame, what: str, *, info: Mapping[str, MetricInfo], stated: Collection[str]
) -> Iterator[str]:
    """Refuse values beyond bounds that a study or manifest states; note those beyond bounds of our own metrics."""
    for name in (name for name in info if name in sheet):
        one, values = info[name], sheet[name]
        ends = [abs(end) for end in (one.low, one.high) if math.isfinite(end)]
        slack = ROUNDING * max(ends, default=0.0)
        beyond = values[(values < one.low - slack) | (values > one.high + slack)]
        if beyond.empty:
            continue
        if name in stated:
            do = "correct it, or the bounds that are declared"
            schema.refuse_lines(beyond, what, must=f"be {format_bounds(one)}", do=do)
        first = schema.shorten(str(sheet.loc[beyond.index[0], "stimulus_id"]))
        side = f"above {one.high:g}" if beyond.iloc[0] > one.high else f"below {one.low:g}"
        yield f"'{name}' is {side}, which no match can be, for {len(beyond)} stimuli, first {first}."


def format_bounds(info: MetricInfo) -> str:
    """Write the range of a metric, such as "0 to 1"; nothing where it has none."""
    if math.isfinite(info.low + info.high):
        return f"{info.low:g} to {info.high:g}"
    if math.isfinite(info.high):
        return f"{info.high:g} or less"
    return f"{info.low:g} or more" if math.isfinite(info.low) else ""


class Step(NamedTuple):
    """A step of a metric by which slopes are reported: its size, and how it is written."""

    size: float = TENTH
    per: str = f"+{TENTH}"


def find_steps(
    items: DataFrame, metrics: Iterable[str], info: Mapping[str, MetricInfo]
) -> dict[str, Step]:
    """Choose the step of each metric by which slopes are reported: 0.1 of a match or other share without a unit.

    Of any other it is the largest power of ten not above the distance of its quartiles within recordings.
    """
    steps = {}
    for name in metrics:
        one, values = info.get(name), items[name].astype(float)
        share = one is not None and not one.unit and abs(one.high) == 1
        within = (values - values.groupby(items["recording"]).transform("mean")).dropna()
        span = float(np.subtract(*np.percentile(within, [75, 25]))) if len(within) else 0.0
        tenth = share or not span > 0
        size = TENTH if tenth else 10.0 ** math.floor(math.log10(span) + ROUNDING)
        steps[name] = Step(size, f"+{size:g} {one.unit if one else ''}".rstrip())
    return steps


def order_reducers(names: Iterable[str]) -> list[str]:
    """Put reducer names into the order of `feel321.stimuli.REDUCERS`; unknown ones follow by alphabet."""
    found = set(names)
    return [name for name in REDUCER_NAMES if name in found] + sorted(found - set(REDUCER_NAMES))


# The data dictionary: type, unit, allowed values and meaning of every column.

DICTIONARY = "dictionary.csv"  # The file beside the tables that it describes
# Suffix of a column -> meaning of what stands for the rest of its name, and what is allowed
DERIVED: Mapping[str, tuple[str, str]] = {
    "low": ("lower end of the 95 % interval of {}", ""),
    "high": ("upper end of the 95 % interval of {}", ""),
    "se": ("standard error of {}", "0 or more"),
    "df": ("degrees of freedom of {}", "above 0"),
    "t": ("t statistic of {}", ""),
    "p": ("p of {}", "0 to 1"),
    "w": ("{} within recordings: less the mean over its recording's stimuli", ""),
    "b": ("{} between recordings: the mean over its recording's stimuli", ""),
    "step": ("{} within recordings, in steps (see slopes.csv)", ""),
}
UNITLESS = {"df", "t", "p", "step"}


class Variable(NamedTuple):
    """A column of a file, as the dictionary describes it."""

    file: str
    column: str
    type: str
    unit: str = ""
    allowed: str = ""
    meaning: str = ""


@cache
def read_dictionary() -> tuple[Variable, ...]:
    """Read the list; rows for one file first."""
    with Path(__file__).with_name(DICTIONARY).open(encoding="utf-8", newline="") as file:
        rows = [Variable(**row) for row in csv.DictReader(file)]
    rows.sort(key=lambda row: ("*" in row.column, row.file == "*", "*" in row.file))
    return tuple(rows)


def make_dictionary(
    tables: Mapping[str, DataFrame], info: Mapping[str, MetricInfo] | None = None
) -> DataFrame:
    """Describe the columns of tables by file, such as ``tradeoff/points.csv``; info: what further metrics declare."""
    itself = pd.DataFrame(read_dictionary()[:1])
    return pd.DataFrame(
        describe_column(file, str(name), frame[name], info=info or {})
        for file, frame in {**tables, DICTIONARY: itself}.items()
        for name in frame
    )


def describe_column(
    file: str, column: str, values: Series, *, info: Mapping[str, MetricInfo]
) -> Variable:
    """Describe a column; one that nothing is known of has no meaning, and the type of its values."""
    from pandas.api.types import is_bool_dtype, is_integer_dtype, is_numeric_dtype

    kinds = {"flag": is_bool_dtype, "integer": is_integer_dtype, "number": is_numeric_dtype}
    kind = next((name for name, is_kind in kinds.items() if is_kind(values)), "text")
    found = next(_find(file, column, info), Variable(file, column, kind))
    return found._replace(file=file.rsplit("/", 1)[-1], column=column)


@cache
def _read_rows(file: str) -> tuple[Variable, ...]:
    """Read the list's rows for a file."""
    names = (file, file.rsplit("/", 1)[-1])
    return tuple(row for row in read_dictionary() if any(fnmatch(one, row.file) for one in names))


def _find(file: str, column: str, info: Mapping[str, MetricInfo]) -> Iterator[Variable]:
    yield from (row for row in _read_rows(file) if fnmatch(column, row.column))
    if one := {**METRIC_INFO, **ROTATIONS, **info}.get(column):
        better = "larger is better" if one.higher == "better" else "smaller is better"
        told = f"metric: {one.label}; {better}"
        yield Variable(file, column, "number", one.unit, format_bounds(one), told)
    if column in FURTHER:
        yield Variable(file, column, "number", meaning=f"metric: {FURTHER[column]}")
    base, _, end = column.rpartition("_")
    for one_of in _find(file, base, info) if end in DERIVED else ():
        meaning, allowed = DERIVED[end]
        told = meaning.format(one_of.meaning.split(":")[-1].split(";")[0].strip() or base)
        unit = "" if end in UNITLESS else one_of.unit
        yield Variable(file, column, "number", unit, allowed, told)
