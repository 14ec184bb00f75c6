"""Further metrics, explored: rotation statistics, metrics of what was delivered, rotation-invariant counterparts."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

from analysis.association.correlate import correlate
from analysis.numbers import COUNT, TWO_WAY, count_number, make_interval, make_number, name_path
from analysis.report.sections.parts import split_parts
from analysis.report.sections.section import INTERVAL, Cell, Grid, Section
from analysis.table.schema import describe_explored
from analysis.words import tell_method, tell_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from analysis.association.correlate import Association
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Found = list[tuple[Part, Association]]

KEY, TITLE = "further", "Further metrics, explored"
METHODS = ("pearson", "spearman", "within")
COUNTS = ("n_items", "n_participants", "n_recordings", "n_sources", "draws")


def compute(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Draws and seed.

    Returns
    -------
    Section
        Correlations with two-way intervals, folded away; nothing where there are no such metrics.
    """
    found = [
        (part, correlate(part.rows, metric, method=method, draws=choices.draws, rng=rng))
        for part in split_parts(table)
        for metric in table.further
        for method in METHODS
        for rng in [choices.make_rng(KEY, *part.place, metric, method)]
    ]
    if not found:
        return Section(KEY, TITLE)
    known = describe_explored(table.metrics)
    meanings = "; ".join(f"{tell_name(name)}: {known[name].meaning}" for name in table.further)
    return Section(
        key=KEY, title=TITLE, grids=(_lay(found),), tables={"further_associations": _stack(found)},
        notes=tuple(dict.fromkeys(_note(found))), how=(f"Further metrics: {meanings}.",),
    )  # fmt: skip


def _note(found: Found) -> Iterator[str]:
    """Say each note once: of all that was explored, or of the correlations that it is about."""
    told: dict[tuple[str, str], list[str]] = {}
    for part, result in found:
        for note in result.notes:
            whose = f"{tell_method(result.method)} with {tell_name(result.metric)}"
            told.setdefault((part.lead, note), []).append(whose)
    sizes = Counter(part.lead for part, _ in found)
    for (lead, note), names in told.items():
        whose = "further metrics" if len(names) == sizes[lead] else "; ".join(names)
        yield f"{lead}, {whose}: {note}"


def _stack(found: Found) -> DataFrame:
    import pandas as pd

    rows = [
        {"scale": part.scale, "level": part.level, **asdict(result), "notes": " ".join(result.notes)}
        for part, result in found
    ]
    return pd.DataFrame(rows)


def _lay(found: Found) -> Grid:
    caption = (
        "Exploratory: correlation of mean ratings with metrics that the analysis was not planned for. None of them has "
        "a part in the mixed models or in the correction for several tests. Two-way intervals (other people and other "
        "recordings) are 95 % intervals, not adjusted for their number: one of several may miss zero by chance."
    )
    head = (
        "Ratings", "Metric", "Method", "r", "Two-way interval", "Noise ceiling", "r / ceiling",
        "Stimuli", "Participants", "Recordings", "Sources", "Draws",
    )  # fmt: skip
    return Grid(caption, head, tuple(_lay_one(part, result) for part, result in found))


def _lay_one(part: Part, result: Association) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY, *part.place, result.metric, result.method), result.n_items
    how = f"{result.method} correlation of mean ratings of test stimuli with {result.metric}, exploratory"
    value = make_interval(make_number(name, result.value, how, n=n), result.low, result.high, uncertainty=TWO_WAY)
    ceiling = make_number(f"{name}.ceiling", result.ceiling, "sqrt(ICC(C,k)), k participants", n=n)
    ratio = make_number(f"{name}.disattenuated", result.disattenuated, "correlation / ceiling", n=n)
    counts = [Cell(count_number(f"{name}.{what}", getattr(result, what), n=n), COUNT) for what in COUNTS]
    place = f"{tell_name(part.scale)}, {tell_name(part.level)}"
    return (
        place, tell_name(result.metric), tell_method(result.method), Cell(value), Cell(value, part=INTERVAL),
        Cell(ceiling), Cell(ratio), *counts,
    )  # fmt: skip
