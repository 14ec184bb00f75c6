"""Sections: correlations of mean ratings with metrics over all stimuli, with further metrics, and as other studies do.

They pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same recording
and is made in `feel321.analysis.report.primary`; correlations are beside it, for comparison with the literature.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association.classic import compare_dependent, repeated_measures_correlation
from feel321.analysis.association.correlate import Panel, correlate_items, make_panel
from feel321.analysis.figures.kinds import count_clipped, draw_scatters
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.section import Found, Picture, Row, Section, make_row, name_subject
from feel321.analysis.standard import compare_p1401, p1401
from feel321.analysis.table.items import Items, make_items
from feel321.analysis.table.metrics import describe_explored, order_reducers
from feel321.analysis.table.notes import SPACE, note_apart
from feel321.analysis.table.schema import APART, CHOSEN, PAIRED, RECAST
from feel321.analysis.words import (
    ONE_WAY,
    STUDENT,
    TWO_WAY,
    format_method,
    format_name,
    format_span,
    join_words,
)
from feel321.records import Statistic

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

LEADING, RANKED, DRAWN = "pearson", "spearman", "within"
"""The method that the words give, the one it is checked against, and the one that scatters and cards give."""


def compute(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric."""
    split, panels = list(split_parts(table)), []
    for part in split:
        rng = choices.make_rng("metrics", *part.place)
        panels.append(
            make_panel(part.rows, table.metrics, draws=choices.draws, rng=rng, info=table.info)
        )
    notes = (*_note_roles(table), *_note_panels(panels))
    if not panels:
        # Choices between two stimuli have an answer of their own.
        facts: dict[str, Any] = {
            "panels": [],
            "ranges": [],
            "map": SPACE if PAIRED in table.rows["scale"].unique() else "",
        }
        return Found(notes=notes, facts={} if table.rows["scale"].isin(CHOSEN).any() else facts)
    subjects = {part.place: part.subject for part in split}
    told = [_describe_panel(panel, subjects[panel.scale, panel.level]) for panel in panels]
    rows = {
        "associations": [
            row
            for panel in panels
            for one in panel.associations
            for row in list_association(one, _keys(panel))
        ],
        "differences": [
            row
            for panel in panels
            for one in panel.differences
            for row in _list_difference(one, _keys(panel))
        ],
        "stimuli": [row for panel in panels for row in _list_stimuli(panel)],
    }
    facts = {"panels": told, "map": "", "ranges": _find_ranges(told)}
    return Found(rows, facts, tuple(_draw(panels, table)), notes)


def _find_ranges(panels: Sequence[Row]) -> list[Row]:
    """Find the smallest and the largest correlation with each metric over scales and levels."""
    found: dict[str, list[float]] = {}
    for one in (
        one for panel in panels for one in panel["found"] if np.isfinite(one["r"]["value"])
    ):
        found.setdefault(one["metric"], []).append(one["r"]["value"])
    return [{"metric": name, "low": min(r), "high": max(r)} for name, r in found.items()]


def _keys(panel: Panel) -> dict[str, str]:
    return {"scale": panel.scale, "level": panel.level}


def list_association(one: Statistic, keys: dict[str, str]) -> Iterator[Row]:
    """List the rows of one correlation."""
    own = {**keys, "metric": one.metric, "method": format_method(one.method), "n": one.n_items}
    yield make_row("r", one.value, low=one.low, high=one.high, interval=TWO_WAY, **own)
    narrow = {"low": one.participants_low, "high": one.participants_high}
    yield make_row("r_participants_only", one.value, **narrow, interval=ONE_WAY, **own)
    if keys["scale"] == RECAST:  # the dissimilarity itself, which a similarity turns round
        yield make_row(
            "r_dissimilarity", -one.value, low=-one.high, high=-one.low, interval=TWO_WAY, **own
        )
    yield make_row("ceiling", one.ceiling, **own)
    yield make_row("r_over_ceiling", one.disattenuated, **own)
    for name in ("items", "participants", "recordings", "sources", "missing"):
        yield make_row(f"n_{name}", getattr(one, f"n_{name}"), **own)
    yield make_row("draws", one.draws, **own)


def _list_difference(one: Any, keys: dict[str, str]) -> Iterator[Row]:  # noqa: ANN401 - a Difference
    pair = {"metric": one.first, "second_metric": one.second, "method": format_method(one.method)}
    own = {**keys, **pair, "n": one.n_items, "interval": TWO_WAY}
    yield make_row("difference", one.value, low=one.low, high=one.high, **own)
    yield make_row("difference_z", one.z_value, low=one.z_low, high=one.z_high, **own)


def _list_stimuli(panel: Panel) -> Iterator[Row]:
    for row in panel.stimuli.to_dict("records"):
        keys: Row = {
            **_keys(panel),
            "stimulus": row["stimulus_id"],
            "recording": row["recording"],
            "reducer": row["reducer"],
        }
        ends = {
            "low": row["low"],
            "high": row["high"],
            "interval": STUDENT,
            "n": row["n_participants"],
        }
        yield make_row("mean", row["mean"], **ends, **keys)


def _describe_panel(panel: Panel, subject: str) -> Row:
    """Gather what the template says of the correlations of one scale and level."""
    ranked = {one.metric: one for one in panel.associations if one.method == RANKED}
    leading = [one for one in panel.associations if one.method == LEADING]
    found = []
    for one in leading:
        other = ranked[one.metric]
        # A few outlying values may hide what the ranks of all others show.
        contradicts = covers_zero(one) != covers_zero(other) or one.value * other.value < 0
        found.append({
            "metric": one.metric, "r": _ends(one), "covers": covers_zero(one),
            "ranks": _ends(other) if contradicts and not np.isnan(other.low) else None,
            "why": one.notes[0].removeprefix("No correlation: ").removesuffix(".") if one.notes else "",
        })  # fmt: skip
    differences = [
        {
            "metrics": [two.first, two.second], "r": _ends(two), "covers": covers_zero(two),
            "stronger": "" if np.isnan(two.low) or covers_zero(two)
            else two.first if abs(two.first_value) > abs(two.second_value) else two.second,
        }
        for two in panel.differences if two.method == LEADING
    ]  # fmt: skip
    return {
        **_keys(panel), "subject": subject, "found": found, "differences": differences,
        "ceiling": leading[0].ceiling, "n_items": leading[0].n_items,
    }  # fmt: skip


def _ends(one: Any) -> dict[str, float]:  # noqa: ANN401 - an Association or a Difference
    return {"value": one.value, "low": one.low, "high": one.high}


def covers_zero(one: Any) -> bool:  # noqa: ANN401 - an Association or a Difference
    """Tell whether an interval covers zero."""
    return bool(one.low <= 0 <= one.high)


def _draw(panels: Sequence[Panel], table: Table) -> Iterator[Picture]:
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    several = len({panel.level for panel in panels}) > 1
    metrics = list(table.metrics)
    names = [name_subject(panel.scale, panel.level * several).lower() for panel in panels]
    counts = [int(count) for panel in panels for count in panel.stimuli["n_participants"]]
    bars = "One participant each, so no intervals."
    if max(counts) >= SMALLEST:
        bars = (
            f"Grey bars: 95 % t intervals over the {format_span(counts)} participants who rated it."
        )
    cut = {name: sum(count_clipped(panel.stimuli, name) for panel in panels) for name in metrics}
    told = [f"{count} with {format_name(name)} below −1" for name, count in cut.items() if count]
    hollow = (
        f" Hollow markers at the left edge: {join_words(told)}; r uses their true values."
        if told
        else ""
    )
    caption = (
        f"Mean rating of each test stimulus against each metric: {join_words(names)}. r: {format_method(DRAWN)}, with "
        f"its 95 % two-way interval. {bars}{hollow}"
    )
    yield Picture(
        "scatter", caption, partial(draw_scatters, panels, metrics, method=DRAWN, looks=looks)
    )


def _note_roles(table: Table) -> Iterator[str]:
    rows = table.rows
    yield from note_apart(rows)
    left_out = rows.loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"]
    for role, count in left_out.value_counts().sort_index().items():
        yield f"Associations leave out {count} judgements of stimuli with role '{role}'."


def _note_panels(panels: Iterable[Panel]) -> Iterator[str]:
    for panel in panels:
        notes = [
            (note, f"{format_method(one.method)} with {one.metric}")
            for one in panel.associations for note in one.notes
        ] + [
            (note, f"{format_method(two.method)} with {two.first} less {two.second}")
            for two in panel.differences for note in two.notes
        ]  # fmt: skip
        yield from group_notes(notes, f"{panel.scale}, {panel.level}", most=len(panel.associations))


def group_notes(notes: Iterable[tuple[str, str]], lead: str, *, most: int) -> Iterator[str]:
    """Say each note once, with what it is about unless that is all of them."""
    told: dict[str, list[str]] = {}
    for note, name in notes:
        told.setdefault(note, []).append(name)
    for note, names in told.items():
        which = "" if len(names) >= most else f" ({'; '.join(names)})"
        yield f"{lead}{which}: {note}"


SECTION = Section("metrics", "Correlations of mean ratings with metrics", "predict", compute)


# Further metrics, explored: rotation statistics, metrics of what was delivered, rotation-invariant counterparts.

METHODS = (LEADING, RANKED, DRAWN)


def compute_further(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for."""
    rows: list[Row] = []
    notes: list[str] = []
    for part in split_parts(table):
        items, own = make_items(part.rows, table.further), []
        for place, metric in enumerate(table.further):
            alone = replace(items, metrics=items.metrics[[place]])
            for method in METHODS:
                rng = choices.make_rng("further", *part.place, metric, method)
                drawn = correlate_items(alone, (metric,), method, draws=choices.draws, rng=rng)
                own.append(drawn.associate(metric))
        rows += [row for one in own for row in list_association(one, part.keys)]
        told = [
            (note, f"{format_method(one.method)} with {one.metric}")
            for one in own
            for note in one.notes
        ]
        notes += group_notes(told, f"{part.lead}, further metrics", most=len(own))
    known = describe_explored(table.metrics)
    meanings = {name: known[name].meaning for name in table.further}
    return Found(
        {"further_associations": rows}, {"meanings": meanings} if rows else {}, notes=notes
    )


FURTHER = Section("further", "Further metrics, explored", "predict", compute_further, front=False)


# ITU-T P.1401 and the classic tests of correlations, for comparison with the literature: tables only.

ORDERS = (1, 3)
INDEPENDENT = "95 % interval that takes stimuli for independent"


def compute_standard(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compute what other studies print."""
    notes: list[str] = []
    rows: dict[str, list[Row]] = {
        "p1401": [],
        "p1401_differences": [],
        "dependent": [],
        "repeated": [],
    }
    for part in split_parts(table):
        items = make_items(part.rows, [*table.metrics, *table.further])
        judged = _judge(part, table, items, notes=notes)
        rows["p1401"] += [
            row for key, one in judged.items() for row in _list_judged(part, key, one)
        ]
        rows["p1401_differences"] += list(_compare_judged(part, table, judged))
        rows["dependent"] += list(_compare_classically(part, items, table.metrics, notes=notes))
        rows["repeated"] += list(_correlate_rows(part, table.metrics, notes))
    return Found(rows, {"any": True} if any(rows.values()) else {}, notes=notes)


Judged = dict[tuple[str, int, str], Statistic]
"""By metric, order and mapping."""


def _judge(part: RatingsPart, table: Table, items: Items, *, notes: list[str]) -> Judged:
    judged: Judged = {}
    names = enumerate((*table.metrics, *table.further))
    for (place, name), order, mapping in product(names, ORDERS, ("fitted", "held out")):
        groups = items.of_source[items.recordings] if mapping == "held out" else None
        higher = table.info[name].higher if name in table.info else None
        try:
            judged[name, order, mapping] = p1401(
                items.ratings.T, items.metrics[place], order=order, groups=groups, higher=higher
            )
        except ValueError as error:
            notes.append(f"{part.lead}, P.1401 of {name}: left out. {error}")
    return judged


def _list_judged(part: RatingsPart, key: tuple[str, int, str], one: Statistic) -> Iterator[Row]:
    keys: Row = {
        **part.keys,
        **dict(zip(("metric", "order", "mapping"), key, strict=True)),
        "n": one.n_items,
    }
    for quantity in ("plcc", "rmse"):
        ends = {end: getattr(one, f"{quantity}_{end}") for end in ("low", "high")}
        yield make_row(quantity, getattr(one, quantity), **ends, interval=INDEPENDENT, **keys)
    for quantity in ("srocc", "rmse_star", "outlier_ratio", "outlier_ratio_sd"):
        yield make_row(quantity, getattr(one, quantity), **keys)
    for power, value in enumerate(one.coefficients):
        yield make_row(f"coefficient_{power}", value, **keys)


def _compare_judged(part: RatingsPart, table: Table, judged: Judged) -> Iterator[Row]:
    planned = [key for key in judged if key[0] in table.metrics]
    for one, other in combinations(planned, 2):
        if one[1:] != other[1:]:
            continue
        found = compare_p1401(judged[one], judged[other])
        keys: Row = {
            **part.keys,
            "metric": one[0],
            "second_metric": other[0],
            "order": one[1],
            "mapping": one[2],
        }
        for quantity in ("plcc_z", "outlier_z", "rmse_f", "rmse_star_f"):
            p = getattr(found, f"{quantity[:-2]}_p")
            yield make_row(quantity, getattr(found, quantity), p=p, n=found.n_items, **keys)


def _compare_classically(
    part: RatingsPart, items: Items, metrics: Sequence[str], *, notes: list[str]
) -> Iterator[Row]:
    means = np.nanmean(items.ratings, axis=0)
    for (i, one), (j, other) in combinations(enumerate(metrics), 2):
        columns = np.array([means, items.metrics[i], items.metrics[j]])
        if (np.ptp(columns, axis=1) == 0).any():
            continue
        r, keys = (
            np.corrcoef(columns),
            {**part.keys, "metric": one, "second_metric": other, "n": len(means)},
        )
        try:
            found = compare_dependent(r[0, 1], r[0, 2], r[1, 2], len(means))
        except ValueError as error:
            notes.append(
                f"{part.lead}, dependent correlations of {one} and {other}: left out. {error}"
            )
            continue
        ends = {"low": found["zou_low"], "high": found["zou_high"]}
        yield make_row(
            "difference", r[0, 1] - r[0, 2], **ends, interval=f"Zou's {INDEPENDENT}", **keys
        )
        for name, kind in (("williams", "t"), ("steiger", "z"), ("meng", "z")):
            yield make_row(name, found[f"{name}_{kind}"], p=found[f"{name}_p"], **keys)


def _correlate_rows(part: RatingsPart, metrics: Sequence[str], notes: list[str]) -> Iterator[Row]:
    for name in metrics:
        columns = [part.rows[key].to_numpy() for key in (name, "rating", "participant")]
        try:
            found = repeated_measures_correlation(*columns)
        except ValueError as error:
            notes.append(
                f"{part.lead}, repeated-measures correlation with {name}: left out. {error}"
            )
            continue
        ends = {
            "low": found.low,
            "high": found.high,
            "interval": "95 % interval that takes rows for independent",
        }
        yield make_row("r", found.r, **ends, p=found.p, n=found.n, metric=name, **part.keys)


STANDARD = Section(
    "standard", "For comparison with the literature", "computed", compute_standard, front=False
)
