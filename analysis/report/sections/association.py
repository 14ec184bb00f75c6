"""Ratings against metrics: correlations over stimuli with intervals for other people and other recordings."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from analysis.figures.scatter import count_clipped
from analysis.figures.style import assign_looks
from analysis.findings import make_panel, stack_records
from analysis.numbers import COUNT, ONE_WAY, TWO_WAY, count_number, make_interval, make_number, name_path
from analysis.p1401.mapping import p1401
from analysis.report.how import tell_associations
from analysis.report.pictures import picture_mapping, picture_scatter
from analysis.report.sections.means import name_mean
from analysis.report.sections.parts import split_parts
from analysis.report.sections.section import INTERVAL, VALUE, Cell, Grid, Section
from analysis.report.verdict import LEADING, UNADJUSTED, judge_absence, sum_up_panels
from analysis.table.items import make_items
from analysis.table.reading import order_reducers
from analysis.table.scales import APART, note_apart
from analysis.words import tell_method, tell_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from analysis.association.correlate import Association, Difference
    from analysis.findings import Panel
    from analysis.numbers import Number
    from analysis.p1401.mapping import P1401
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Mappings = list[tuple[Panel, Association, P1401]]

KEY = "metrics"
MAPPED = 3
"""Order of the mapping that is drawn: P.1401's monotone cubic."""


def compute(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Draws and seed.

    Returns
    -------
    Section
        Correlations by every method, differences between metrics, a scatter per scale, level and metric, and the
        same recording by recording with the mapping of P.1401 and the noise ceiling.
    """
    parts = list(split_parts(table))
    panels = [
        make_panel(part.rows, table.metrics, draws=choices.draws, rng=choices.make_rng(KEY, *part.place))
        for part in parts
    ]
    title = "Correlations of mean ratings with metrics"
    notes = (*_note_roles(table), *_note_panels(panels))
    if not panels:
        return Section(KEY, title, notes=notes, verdict=judge_absence(table.rows["scale"].unique()))
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    mappings = [found for pair in zip(parts, panels, strict=True) for found in _map_panel(*pair)]
    grids = [_lay_associations(panels), *([_lay_differences(panels)] if panels[0].differences else [])]
    return Section(
        key=KEY, title=title, answers=(*sum_up_panels(panels), UNADJUSTED), panels=tuple(panels),
        grids=tuple(grids),
        unseen=(*(number for panel in panels for number in _collect_panel(panel)), *_name_mappings(mappings)),
        tables=_make_tables(panels),
        pictures=(
            *(
                picture_scatter(panel, found, looks=looks)
                for panel in panels for found in panel.associations if found.method == LEADING
            ),
            *(picture_mapping(panel, found, judged, looks=looks) for panel, found, judged in mappings),
        ),
        notes=notes, how=tell_associations(choices.draws),
    )  # fmt: skip


def _map_panel(part: Part, panel: Panel) -> Iterator[tuple[Panel, Association, P1401]]:
    """Map every metric to the ratings; what P.1401 refuses is said where its table stands."""
    for found in panel.associations:
        if found.method == LEADING:
            with suppress(ValueError):
                items = make_items(part.rows, [found.metric])
                yield panel, found, p1401(items.ratings.T, items.metrics[0], order=MAPPED)


def _name_mappings(mappings: Mappings) -> Iterator[Number]:
    for panel, found, judged in mappings:
        name = name_path("mapping", panel.scale, panel.level, found.metric)
        for power, value in enumerate(judged.coefficients):
            how = f"P.1401 mapping of order {judged.order}: points per {found.metric} to the power {power}"
            yield make_number(f"{name}.coefficient_{power}", value, how, n=judged.n_items)


def _make_tables(panels: list[Panel]) -> dict[str, DataFrame]:
    import pandas as pd

    tables = {
        "associations": stack_records(panels, "associations"),
        "differences": stack_records(panels, "differences"),
        "stimuli": pd.concat([panel.stimuli for panel in panels]),
    }
    return {name: rows for name, rows in tables.items() if len(rows)}


def _note_roles(table: Table) -> Iterator[str]:
    rows = table.rows
    yield from note_apart(rows)
    roles = rows.loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"].value_counts().sort_index()
    for role, count in roles.items():
        yield f"Associations leave out {count} judgements of stimuli with role '{role}'."


def _note_panels(panels: list[Panel]) -> Iterator[str]:
    """Say each note once: of everything, or of the correlations that it is about."""
    for panel in panels:
        told: dict[str, list[str]] = {}
        for one in panel.associations:
            for note in one.notes:
                told.setdefault(note, []).append(f"{tell_method(one.method)} with {one.metric}")
        for two in panel.differences:
            for note in two.notes:
                told.setdefault(note, []).append(f"{tell_method(two.method)} with {two.first} less {two.second}")
        for note, names in told.items():
            whose = "" if len(names) >= len(panel.associations) else f" ({'; '.join(names)})"
            yield f"{panel.scale}, {panel.level}{whose}: {note}"


def _lay_associations(panels: list[Panel]) -> Grid:
    caption = (
        "Correlation of mean ratings with each metric over test stimuli. Conclude from the two-way interval (other "
        "people and other recordings); the interval over participants only treats these stimuli as the only ones. All "
        "intervals are 95 % intervals."
    )
    head = (
        "Ratings", "Metric", "Method", "r", "Two-way interval", "Participants only", "Noise ceiling", "r / ceiling",
        "Stimuli", "Participants", "Recordings", "Sources", "Draws",
    )  # fmt: skip
    rows = [_lay_association(panel, found) for panel in panels for found in panel.associations]
    return Grid(caption, head, tuple(rows))


def _lay_association(panel: Panel, found: Association) -> tuple[str | Cell, ...]:
    value, narrow, ceiling, ratio, *counts = _name_association(found, (panel.scale, panel.level))
    draws, people, recordings, sources, items, _ = counts
    return (
        _tell_place(panel), tell_name(found.metric), tell_method(found.method), Cell(value), Cell(value, part=INTERVAL),
        Cell(narrow, part=INTERVAL), Cell(ceiling), Cell(ratio),
        *(Cell(number, COUNT) for number in (items, people, recordings, sources, draws)),
    )  # fmt: skip


def _lay_differences(panels: list[Panel]) -> Grid:
    caption = (
        "Correlation with the first metric minus correlation with the second. An interval that covers zero leaves open "
        "which metric predicts better. All intervals are 95 % intervals."
    )
    head = (
        "Ratings", "First", "Second", "Method", "Difference of r", "Two-way interval", "Difference of Fisher’s z",
        "Two-way interval",
    )  # fmt: skip
    rows = [_lay_difference(panel, found) for panel in panels for found in panel.differences]
    return Grid(caption, head, tuple(rows))


def _lay_difference(panel: Panel, found: Difference) -> tuple[str | Cell, ...]:
    value, z_value, *_ = _name_difference(found, (panel.scale, panel.level))
    names = _tell_place(panel), tell_name(found.first), tell_name(found.second), tell_method(found.method)
    return (*names, *(Cell(number, part=part) for number in (value, z_value) for part in (VALUE, INTERVAL)))


def _tell_place(panel: Panel) -> str:
    return f"{tell_name(panel.scale)}, {tell_name(panel.level)}"


def _collect_panel(panel: Panel) -> Iterator[Number]:
    place = panel.scale, panel.level
    for association in panel.associations:
        yield from _name_association(association, place)
        if association.method == LEADING:
            yield from _name_edge(panel, association.metric)
    for difference in panel.differences:
        yield from _name_difference(difference, place)
    for row in panel.stimuli.to_dict("records"):
        yield name_mean(name_path("stimulus", *place, row["stimulus_id"]), row)


def _name_edge(panel: Panel, metric: str) -> Iterator[Number]:
    name, values = name_path("scatter", panel.scale, panel.level, metric), panel.stimuli[metric]
    yield count_number(f"{name}.n_below_edge", count_clipped(values.to_numpy()), n=len(values))
    yield make_number(f"{name}.lowest", float(values.min()), f"smallest {metric} of the test stimuli", n=len(values))


def _name_association(result: Association, place: tuple[str, str]) -> Iterator[Number]:
    name, n = name_path("association", *place, result.metric, result.method), result.n_items
    value = make_number(
        name, result.value, f"{result.method} correlation of mean ratings of test stimuli with {result.metric}", n=n
    )
    yield make_interval(value, result.low, result.high, uncertainty=TWO_WAY)
    narrow = make_number(f"{name}.participants_only", result.value, value.method, n=n)
    yield make_interval(narrow, result.participants_low, result.participants_high, uncertainty=ONE_WAY)
    yield make_number(f"{name}.ceiling", result.ceiling, "sqrt(ICC(C,k)), k participants", n=n)
    yield make_number(f"{name}.disattenuated", result.disattenuated, "correlation / ceiling", n=n)
    yield from _count_data(name, result)


def _name_difference(result: Difference, place: tuple[str, str]) -> Iterator[Number]:
    name, n = name_path("difference", *place, result.first, result.second, result.method), result.n_items
    method = f"{result.method} correlation with {result.first} minus that with {result.second}"
    yield make_interval(make_number(name, result.value, method, n=n), result.low, result.high, uncertainty=TWO_WAY)
    of_z = make_number(f"{name}.z", result.z_value, f"{method}, as a difference of Fisher's z", n=n)
    yield make_interval(of_z, result.z_low, result.z_high, uncertainty=f"{TWO_WAY}, on Fisher's z")
    for which in ("first", "second"):
        alone = f"{result.method} correlation with {getattr(result, which)}"
        yield make_number(f"{name}.{which}_value", getattr(result, f"{which}_value"), alone, n=n)
    yield from _count_data(name, result)


def _count_data(name: str, result: Association | Difference) -> Iterator[Number]:
    yield count_number(f"{name}.draws", result.draws, n=result.draws)
    for what in ("n_participants", "n_recordings", "n_sources", "n_items", "n_missing"):
        yield count_number(f"{name}.{what}", getattr(result, what), n=result.n_items)
