"""Metrics as columns of a table: what each declares of itself, which others are explored, steps to report slopes by.

Any numeric column of a manifest is a metric. What it declares (`feel321.types.MetricInfo`) comes, the first that says
so, from the caller (`[metrics.NAME]` in ``study.toml``), from ``metrics`` in the ``manifest.json`` beside the
manifest, or from `feel321.stimuli.METRIC_INFO`. Nothing declared: higher is better, no bounds, its name for a label.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.table import schema
from feel321.types import MATCHES, METRIC_INFO, REDUCER_NAMES, WRITTEN, MetricInfo

if TYPE_CHECKING:
    from pandas import DataFrame

DECLARED = "manifest.json"
"""File beside a manifest whose ``metrics`` say what the columns of metrics are."""

TENTH = 0.1  # Step of a metric that is a share, such as a match from 0 to 1
ROUNDING = 1e-9  # Share of a bound by which a value may pass it: files hold rounded numbers
KINDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "rotation_mean": ("mean of the {} over random orientations of the sensor", MATCHES),
    "rotation_sd": ("standard deviation of the {} over random orientations of the sensor", MATCHES),
    "delivered": ("{} of the signal as it was delivered", MATCHES),
    "energy_weighted": ("{} with frequencies weighted by their energy", ("spectral_match",)),
    "invariant": ("counterpart of the {} that no orientation changes", ("temporal_match",)),
}
"""Suffix of a metric's name -> meaning, and the metrics that have it: per stimulus in the manifest, or per judgement in
the ratings, where a stimulus has the mean over its judgements."""

FURTHER: Mapping[str, str] = {
    f"{metric}_{kind}": meaning.format(metric.replace("_", " "))
    for metric in MATCHES
    for kind, (meaning, of) in KINDS.items()
    if metric in of
}
"""Column derived from a metric and explored beside those that were planned -> what it is."""

_LABELS = {name: METRIC_INFO[name].label for name in MATCHES}
ROTATIONS: Mapping[str, MetricInfo] = {
    f"{name}_rotation_mean": replace(METRIC_INFO[name], label=f"mean {label} over orientations")
    for name, label in _LABELS.items()
} | {
    f"{name}_rotation_sd": MetricInfo(f"spread of the {label} over orientations", "worse", low=0.0)
    for name, label in _LABELS.items()
}
"""Rotation statistics (Park & Kuchenbecker 2019), computed by `analyze`; a study may declare them."""

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
    import pandas as pd

    found = []
    for name in (name for name in map(str, cells) if name not in NOT_METRICS):
        filled = cells.loc[cells[name] != "", name]
        share = pd.to_numeric(filled, errors="coerce").notna().mean() if len(filled) else 0
        found += [name] if share > schema.MOSTLY else []
    return found


def read_attributes(manifest: Path | DataFrame) -> DataFrame:
    """Read every numeric column of a manifest that may say what stimuli are like, by stimulus_id."""
    import pandas as pd

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
        many = f"for {len(beyond)} stimuli, first {first}"
        yield f"'{name}' is {side}, which no match can be, {many}."


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
        one = info.get(name)
        share = one is not None and not one.unit and abs(one.high) == 1
        values = items[name].astype(float)
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
