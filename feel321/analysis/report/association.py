"""Sections: correlations of ratings with metrics, the metric of the paper, and further metrics beside them."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from feel321.analysis.association.correlate import correlate, make_panel, stack_records
from feel321.analysis.figures.scatter import count_clipped
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.p1401.mapping import p1401
from feel321.analysis.primary.influence import NOT_ESTIMABLE, OPEN, PREDICTS, find_candidates
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.report._old import (
    INTERVAL,
    VALUE,
    Cell,
    Grid,
    lay_estimate,
    name_estimate,
    name_mean,
    tell_associations,
)
from feel321.analysis.report.parts import split_parts
from feel321.analysis.report.pictures import picture_mapping, picture_scatter
from feel321.analysis.report.section import Section
from feel321.analysis.report.verdict import LEADING, UNADJUSTED, judge_absence, sum_up_panels
from feel321.analysis.table.items import make_items
from feel321.analysis.table.reading import order_reducers
from feel321.analysis.table.schema import STAND_INS, describe_explored
from feel321.analysis.table.sheet import APART, note_apart
from feel321.analysis.words import (
    COUNT,
    ONE_WAY,
    TWO_WAY,
    count_number,
    make_interval,
    make_number,
    name_path,
    start,
    tell_ends,
    tell_method,
    tell_name,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.association.correlate import Association, Difference, Panel
    from feel321.analysis.p1401.mapping import P1401
    from feel321.analysis.primary.model import Primary
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.table.reading import Table
    from feel321.analysis.words import Claim, Number

    Mappings = list[tuple[Panel, Association, P1401]]
    Found = list[tuple[Part, Association]]

# Ratings against metrics: correlations over stimuli with intervals for other people and other recordings.

KEY_ASSOCIATION = "metrics"
MAPPED = 3
"""Order of the mapping that is drawn: P.1401's monotone cubic."""


def compute_association(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric."""
    parts = list(split_parts(table))
    panels = [
        make_panel(
            part.rows,
            table.metrics,
            draws=choices.draws,
            rng=choices.make_rng(KEY_ASSOCIATION, *part.place),
        )
        for part in parts
    ]
    title = "Correlations of mean ratings with metrics"
    notes = (*_note_roles(table), *_note_panels(panels))
    if not panels:
        return Section(
            KEY_ASSOCIATION, title, notes=notes, verdict=judge_absence(table.rows["scale"].unique())
        )
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    mappings = [found for pair in zip(parts, panels, strict=True) for found in _map_panel(*pair)]
    grids = [
        _lay_associations(panels),
        *([_lay_differences(panels)] if panels[0].differences else []),
    ]
    return Section(
        key=KEY_ASSOCIATION, title=title, answers=(*sum_up_panels(panels), UNADJUSTED), panels=tuple(panels),
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
    roles = (
        rows
        .loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"]
        .value_counts()
        .sort_index()
    )
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
                told.setdefault(note, []).append(
                    f"{tell_method(two.method)} with {two.first} less {two.second}"
                )
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
    names = (
        _tell_place(panel),
        tell_name(found.first),
        tell_name(found.second),
        tell_method(found.method),
    )
    return (
        *names,
        *(Cell(number, part=part) for number in (value, z_value) for part in (VALUE, INTERVAL)),
    )


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
    yield make_number(
        f"{name}.lowest",
        float(values.min()),
        f"smallest {metric} of the test stimuli",
        n=len(values),
    )


def _name_association(result: Association, place: tuple[str, str]) -> Iterator[Number]:
    name, n = name_path("association", *place, result.metric, result.method), result.n_items
    value = make_number(
        name,
        result.value,
        f"{result.method} correlation of mean ratings of test stimuli with {result.metric}",
        n=n,
    )
    yield make_interval(value, result.low, result.high, uncertainty=TWO_WAY)
    narrow = make_number(f"{name}.participants_only", result.value, value.method, n=n)
    yield make_interval(
        narrow, result.participants_low, result.participants_high, uncertainty=ONE_WAY
    )
    yield make_number(f"{name}.ceiling", result.ceiling, "sqrt(ICC(C,k)), k participants", n=n)
    yield make_number(f"{name}.disattenuated", result.disattenuated, "correlation / ceiling", n=n)
    yield from _count_data(name, result)


def _name_difference(result: Difference, place: tuple[str, str]) -> Iterator[Number]:
    name, n = (
        name_path("difference", *place, result.first, result.second, result.method),
        result.n_items,
    )
    method = f"{result.method} correlation with {result.first} minus that with {result.second}"
    yield make_interval(
        make_number(name, result.value, method, n=n), result.low, result.high, uncertainty=TWO_WAY
    )
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


# Further metrics, explored: rotation statistics, metrics of what was delivered, rotation-invariant counterparts.

KEY_FURTHER, TITLE = "further", "Further metrics, explored"
METHODS = ("pearson", "spearman", "within")
COUNTS = ("n_items", "n_participants", "n_recordings", "n_sources", "draws")


def compute_further(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for."""
    found = [
        (part, correlate(part.rows, metric, method=method, draws=choices.draws, rng=rng))
        for part in split_parts(table)
        for metric in table.further
        for method in METHODS
        for rng in [choices.make_rng(KEY_FURTHER, *part.place, metric, method)]
    ]
    if not found:
        return Section(KEY_FURTHER, TITLE)
    known = describe_explored(table.metrics)
    meanings = "; ".join(f"{tell_name(name)}: {known[name].meaning}" for name in table.further)
    return Section(
        key=KEY_FURTHER,
        title=TITLE,
        grids=(_lay_further(found),),
        tables={"further_associations": _stack(found)},
        notes=tuple(dict.fromkeys(_note(found))),
        how=(f"Further metrics: {meanings}.",),
    )


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
        {
            "scale": part.scale,
            "level": part.level,
            **asdict(result),
            "notes": " ".join(result.notes),
        }
        for part, result in found
    ]
    return pd.DataFrame(rows)


def _lay_further(found: Found) -> Grid:
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
    name, n = name_path(KEY_FURTHER, *part.place, result.metric, result.method), result.n_items
    how = f"{result.method} correlation of mean ratings of test stimuli with {result.metric}, exploratory"
    value = make_interval(
        make_number(name, result.value, how, n=n), result.low, result.high, uncertainty=TWO_WAY
    )
    ceiling = make_number(f"{name}.ceiling", result.ceiling, "sqrt(ICC(C,k)), k participants", n=n)
    ratio = make_number(f"{name}.disattenuated", result.disattenuated, "correlation / ceiling", n=n)
    counts = [
        Cell(count_number(f"{name}.{what}", getattr(result, what), n=n), COUNT) for what in COUNTS
    ]
    place = f"{tell_name(part.scale)}, {tell_name(part.level)}"
    return (
        place, tell_name(result.metric), tell_method(result.method), Cell(value), Cell(value, part=INTERVAL),
        Cell(ceiling), Cell(ratio), *counts,
    )  # fmt: skip


# Where correlations over all stimuli pooled, another question, point elsewhere than the primary model.

HIGHER, POOLED = "higher", "pearson"


def name_subject(panel: Panel, *, several: bool) -> str:
    """Name what a panel's lines stand under on the page."""
    return start(tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else ""))


def reconcile(panel: Panel, claims: Sequence[Claim]) -> str:
    """Say where correlations over all stimuli pooled, another question, point elsewhere than the primary model."""
    place = panel.scale, panel.level
    own = [
        claim
        for claim in claims
        if (claim.scale, claim.level) == place and claim.verdict != NOT_ESTIMABLE
    ]
    verdicts = {claim.metric: claim for claim in own}
    told = [
        _contrast(one)
        for one in panel.associations
        if one.method == POOLED and one.metric in verdicts and _disagrees(one, verdicts[one.metric])
    ]
    told += [
        f"{tell_name(stronger)} correlates more (difference in r {' ('.join(tell_ends(two.value, two.low, two.high))})"
        for two in panel.differences
        if two.method == POOLED
        and (stronger := _find_stronger(two))
        and {two.first, two.second} <= set(verdicts)
        and ({two.first, two.second} - {stronger}).isdisjoint(verdicts[stronger].better_than)
    ]
    if not told:
        return ""
    return (
        f"over all stimuli pooled, {'; '.join(told)}. That is another question: it also counts differences between "
        "recordings, and each metric alone."
    )


def _find_stronger(two: Difference) -> str:
    """Find which of two metrics correlates more strongly; empty where that is open."""
    if math.isnan(two.low) or two.low <= 0 <= two.high:
        return ""
    return two.first if abs(two.first_value) > abs(two.second_value) else two.second


def _disagrees(one: Association, claim: Claim) -> bool:
    if math.isnan(one.low):
        return False
    if one.low <= 0 <= one.high:
        return claim.verdict == PREDICTS
    return claim.verdict == OPEN or (claim.direction == HIGHER) != (one.value > 0)


def _contrast(one: Association) -> str:
    told, interval = tell_ends(one.value, one.low, one.high)
    zero = ", which covers zero" if one.low <= 0 <= one.high else ""
    return f"mean ratings correlate with {tell_name(one.metric)} at r = {told} (95 % CI {interval}{zero})"


# The paper's own spectral match beside the bounded one: by ranks, and raw with what a single stimulus does to it.

BOUNDED, RANKS = "spectral_match_bounded", "within_spearman"
RAW = STAND_INS[BOUNDED]


def lay_paper(
    table: Table, fits: Mapping[str, tuple[Part, Primary]], choices: Choices
) -> Iterator[Grid]:
    """Lay out the paper's metric, where the primary analysis is about the bounded one and the manifest has both.

    fits: part's lead -> part and model.
    """
    if BOUNDED not in table.metrics or RAW not in table.further:
        return
    metrics = [RAW if name == BOUNDED else name for name in table.metrics]
    rows = [
        _lay_paper(part, metrics, choices)
        for part, model in fits.values()
        if model.slopes["estimable"].any()
    ]
    if rows:
        caption = (
            "Spectral match as in the paper (eq. 1), in place of the bounded one. It has no lower bound, so that a few "
            "stimuli may decide its slope: Spearman's correlation within recordings with the two-way interval; the "
            "slope, in points per +0.1, and the same without the stimulus that moves it most; 95 % intervals."
        )
        head = (
            "Ratings",
            "By ranks",
            "Interval",
            "Raw slope",
            "Interval",
            "Without",
            "Raw slope",
            "Interval",
        )
        yield Grid(caption, head, tuple(rows))


def _lay_paper(part: Part, metrics: list[str], choices: Choices) -> tuple[str | Cell, ...]:
    name = name_path("paper", *part.place, RAW)
    rng = choices.make_rng("paper", *part.place)
    ranks = correlate(part.rows, RAW, method=RANKS, draws=choices.draws, rng=rng)
    how = "Spearman's correlation within recordings of mean ratings with eq. 1"
    value = make_number(f"{name}.ranks", ranks.value, how, n=ranks.n_items)
    value = make_interval(value, ranks.low, ranks.high, uncertainty=TWO_WAY)
    item = find_candidates(part.rows, metrics, count=1)[0]
    rest = part.rows[part.rows["item"] != item]
    whole, left = (
        _fit(f"{name}.raw", part.rows, metrics),
        _fit(f"{name}.raw_without", rest, metrics),
    )
    words = tell_name(part.lead)
    slopes = *lay_estimate(whole, "slope"), item, *lay_estimate(left, "slope")
    return (words, *lay_estimate(value, "correlation"), *slopes)


def _fit(name: str, rows: DataFrame, metrics: list[str]) -> Number:
    model = fit_primary(rows, metrics, explain=False)
    row: dict[Hashable, Any] = model.slopes.loc[RAW].to_dict()
    return name_estimate(
        name, row, "mixed model, points of rating per +0.1 of eq. 1", n=model.n_rows, prefix="tenth"
    )
