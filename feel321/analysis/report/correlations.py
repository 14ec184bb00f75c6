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

from feel321.analysis import words
from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association.correlate import correlate_items, make_panel
from feel321.analysis.figures import kinds
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.report.section import Found, Picture, Row, Section, list_rows
from feel321.analysis.standard import (
    compare_dependent,
    compare_p1401,
    p1401,
    repeated_measures_correlation,
)
from feel321.analysis.table.items import Part, make_items, split_tests
from feel321.analysis.table.metrics import describe_explored, order_reducers
from feel321.analysis.table.notes import SPACE, note_apart
from feel321.analysis.table.schema import APART, CHOSEN, PAIRED, RECAST
from feel321.analysis.words import TWO_WAY, format_method, format_name
from feel321.records import Statistic

if TYPE_CHECKING:
    from feel321.analysis.association.correlate import Panel
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Items, Table

LEADING, RANKED, DRAWN = "pearson", "spearman", "within"
"""The method that the words give, the one it is checked against, and the one that scatters and cards give."""

COUNTS = ("n_items", "n_participants", "n_recordings", "n_sources", "n_missing", "draws")


def compute(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric."""
    rows: dict[str, list[Row]] = {"associations": [], "differences": [], "stimuli": []}
    notes, panels, told = list(_note_roles(table)), [], []
    for part in split_tests(table):
        rng, draws = choices.make_rng("metrics", *part.place), choices.draws
        panel = make_panel(part.rows, table.metrics, draws=draws, rng=rng, info=table.info)
        panels.append((part, panel))
        told.append(_describe_panel(part, panel))
        rows["associations"] += [row for one in panel.associations for row in list_association(part, one)]  # fmt: skip
        for two in panel.differences:
            quantities = {"difference": "value low high", "difference_z": "z_value z_low z_high"}
            pair = {"metric": "first", "second_metric": "second", "n": "n_items"}
            own: Row = {"method": format_method(two.method), "interval": TWO_WAY, **part.keys}
            rows["differences"] += list_rows([two], quantities, pair, **own)
        keys = {"stimulus": "stimulus_id", "recording": "recording", "reducer": "reducer"}
        keys["n"] = "n_participants"
        mean = {"mean": "mean low high"}
        spread = {"interval": words.STUDENT, **part.keys}
        rows["stimuli"] += list_rows(panel.stimuli, mean, keys, **spread)
        both = (*panel.associations, *panel.differences)
        notes += _gather_notes(both, part.lead, most=len(panel.associations))
    if not panels:
        # Choices between two stimuli have an answer of their own.
        answered = table.rows["scale"].isin(CHOSEN).any()
        where = SPACE if PAIRED in table.rows["scale"].unique() else ""
        facts: dict[str, Any] = {"panels": [], "ranges": [], "map": where}
        return Found(notes=notes, facts={} if answered else facts)
    facts = {"panels": told, "map": "", "ranges": _find_ranges(told)}
    return Found(rows, facts, [_draw(panels, table)], notes)


def _find_ranges(panels: Sequence[Row]) -> list[Row]:
    """Find the smallest and the largest correlation with each metric over scales and levels."""
    found: dict[str, list[float]] = {}
    for one in (one for panel in panels for one in panel["found"]):
        if np.isfinite(one["r"]["value"]):
            found.setdefault(one["metric"], []).append(one["r"]["value"])
    return [{"metric": name, "low": min(r), "high": max(r)} for name, r in found.items()]


def list_association(part: Part, one: Statistic) -> list[Row]:
    """List the rows of one correlation."""
    keys = {"metric": one.metric, "method": format_method(one.method), "n": one.n_items}
    record = dict(one)
    own: Row = {**part.keys, **keys}
    rows = list_rows([record], {"r": "value low high"}, interval=TWO_WAY, **own)
    narrow = {"r_participants_only": "value participants_low participants_high"}
    rows += list_rows([record], narrow, interval=words.ONE_WAY, **own)
    if part.scale == RECAST:  # the dissimilarity itself, which a similarity turns round
        turned = {"value": -one.value, "low": -one.high, "high": -one.low}
        rows += list_rows([turned], {"r_dissimilarity": "value low high"}, interval=TWO_WAY, **own)
    sizes = {"ceiling": "ceiling", "r_over_ceiling": "disattenuated"}
    return rows + list_rows([record], sizes | dict(zip(COUNTS, COUNTS, strict=True)), **own)


def _describe_panel(part: Part, panel: Panel) -> Row:
    """Gather what the template says of the correlations of one scale and level."""
    ranked = {one.metric: one for one in panel.associations if one.method == RANKED}
    leading = [one for one in panel.associations if one.method == LEADING]
    found, differences = [], []
    for one in leading:
        other, why = ranked[one.metric], one.notes[0] if one.notes else ""
        # A few outlying values may hide what the ranks of all others show.
        contradicts = covers_zero(one) != covers_zero(other) or one.value * other.value < 0
        found.append({
            "metric": one.metric, "r": _ends(one), "covers": covers_zero(one),
            "ranks": _ends(other) if contradicts and not np.isnan(other.low) else None,
            "why": why.removeprefix("No correlation: ").removesuffix("."),
        })  # fmt: skip
    for two in (two for two in panel.differences if two.method == LEADING):
        clear = not np.isnan(two.low) and not covers_zero(two)
        larger = two.first if abs(two.first_value) > abs(two.second_value) else two.second
        differences.append({
            "metrics": [two.first, two.second], "r": _ends(two), "covers": covers_zero(two),
            "stronger": larger if clear else "",
        })  # fmt: skip
    return {
        **part.keys, "subject": part.subject, "found": found, "differences": differences,
        "ceiling": leading[0].ceiling, "n_items": leading[0].n_items,
    }  # fmt: skip


def _ends(one: Any) -> dict[str, float]:  # noqa: ANN401 - an Association or a Difference
    return {"value": one.value, "low": one.low, "high": one.high}


def covers_zero(one: Any) -> bool:  # noqa: ANN401 - an Association or a Difference
    """Tell whether an interval covers zero."""
    return bool(one.low <= 0 <= one.high)


def _draw(panels: Sequence[tuple[Part, Panel]], table: Table) -> Picture:
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    metrics = list(table.metrics)
    names = words.join_words([part.subject.lower() for part, _ in panels])
    counts = [int(count) for _, panel in panels for count in panel.stimuli["n_participants"]]
    bars = "One participant each, so no intervals."
    if max(counts) >= SMALLEST:
        people = f"{words.format_span(counts)} participants who rated it"
        bars = f"Grey bars: 95 % t intervals over the {people}."
    cut = {
        name: sum(kinds.count_clipped(panel.stimuli, name) for _, panel in panels)
        for name in metrics
    }
    told = [f"{count} with {format_name(name)} below −1" for name, count in cut.items() if count]
    caption = (
        f"Mean rating of each test stimulus against each metric: {names}. r: {format_method(DRAWN)}, with its 95 % "
        f"two-way interval. {bars}"
    )
    if told:
        caption += (
            f" Hollow markers at the left edge: {words.join_words(told)}; r uses their true values."
        )
    drawn = [panel for _, panel in panels]
    draw = partial(kinds.draw_scatters, drawn, metrics, method=DRAWN, looks=looks)
    return Picture("scatter", caption, draw)


def _note_roles(table: Table) -> Iterator[str]:
    rows = table.rows
    yield from note_apart(rows)
    left_out = rows.loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"]
    for role, count in left_out.value_counts().sort_index().items():
        yield f"Associations leave out {count} judgements of stimuli with role '{role}'."


def _gather_notes(found: Iterable[Any], lead: str, *, most: int) -> Iterator[str]:
    """Say each note once, with what it is about unless that is all of them."""
    told: dict[str, list[str]] = {}
    for one in found:
        of = one.metric if hasattr(one, "metric") else f"{one.first} less {one.second}"
        for note in one.notes:
            told.setdefault(note, []).append(f"{format_method(one.method)} with {of}")
    for note, names in told.items():
        which = "" if len(names) >= most else f" ({'; '.join(names)})"
        yield f"{lead}{which}: {note}"


# Further metrics, explored: rotation statistics, metrics of what was delivered, rotation-invariant counterparts.


def compute_further(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for."""
    rows: list[Row] = []
    notes: list[str] = []
    for part in split_tests(table):
        items, own = make_items(part.rows, table.further), []
        for place, metric in enumerate(table.further):
            alone = replace(items, metrics=items.metrics[[place]])
            for method in (LEADING, RANKED, DRAWN):
                rng = choices.make_rng("further", *part.place, metric, method)
                drawn = correlate_items(alone, (metric,), method, draws=choices.draws, rng=rng)
                own.append(drawn.associate(metric))
        rows += [row for one in own for row in list_association(part, one)]
        notes += _gather_notes(own, f"{part.lead}, further metrics", most=len(own))
    known = describe_explored(table.metrics)
    meanings = {name: known[name] for name in table.further}
    facts = {"meanings": meanings} if rows else {}
    return Found({"further_associations": rows}, facts, notes=notes)


# ITU-T P.1401 and the classic tests of correlations, for comparison with the literature: tables only.

INDEPENDENT = "95 % interval that takes {} for independent"
STIMULI = INDEPENDENT.format("stimuli")


def compute_standard(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compute what other studies print."""
    notes: list[str] = []
    tables = ("p1401", "p1401_differences", "dependent", "repeated")
    rows: dict[str, list[Row]] = {name: [] for name in tables}
    for part in split_tests(table):
        items = make_items(part.rows, [*table.metrics, *table.further])
        judged = _judge(part, table, items, notes=notes)
        for key, one in judged.items():
            rows["p1401"] += _list_judged(part, key, one)
        for first, other in combinations((key for key in judged if key[0] in table.metrics), 2):
            if first[1:] == other[1:]:
                found = compare_p1401(judged[first], judged[other])
                tests = ("plcc_z", "outlier_z", "rmse_f", "rmse_star_f")
                names = dict(zip(("metric", "order", "mapping"), first, strict=True))
                rows["p1401_differences"] += list_rows(
                    [found],
                    {name: f"{name} - - {name[:-2]}_p" for name in tests},
                    {"n": "n_items"},
                    second_metric=other[0],
                    **names,
                    **part.keys,
                )
        rows["dependent"] += _compare_classically(part, items, table.metrics, notes=notes)
        for name in table.metrics:
            columns = [part.rows[key].to_numpy() for key in (name, "rating", "participant")]
            try:
                found = repeated_measures_correlation(*columns)
            except ValueError as error:
                notes.append(f"{part.lead}, repeated-measures correlation with {name}: {error}")
                continue
            own: Row = {"metric": name, "interval": INDEPENDENT.format("rows"), **part.keys}
            rows["repeated"] += list_rows([found], {"r": "r low high p"}, ["n"], **own)
    return Found(rows, {"any": True} if any(rows.values()) else {}, notes=notes)


ERRORS = ("srocc", "rmse_star", "outlier_ratio", "outlier_ratio_sd")


Judged = dict[tuple[str, int, str], Statistic]
"""By metric, order and mapping."""


def _judge(part: Part, table: Table, items: Items, *, notes: list[str]) -> Judged:
    judged: Judged = {}
    names = enumerate((*table.metrics, *table.further))
    for (place, name), order, mapping in product(names, (1, 3), ("fitted", "held out")):
        groups = items.of_source[items.recordings] if mapping == "held out" else None
        higher = table.info[name].higher if name in table.info else None
        votes, values = items.ratings.T, items.metrics[place]
        try:
            judged[name, order, mapping] = p1401(
                votes, values, order=order, groups=groups, higher=higher
            )
        except ValueError as error:
            notes.append(f"{part.lead}, P.1401 of {name}: left out. {error}")
    return judged


def _list_judged(part: Part, key: tuple[str, int, str], one: Statistic) -> Iterator[Row]:
    found = dict(one)
    found |= {f"coefficient_{power}": value for power, value in enumerate(found["coefficients"])}
    quantities = {name: f"{name} {name}_low {name}_high" for name in ("plcc", "rmse")}
    single = (*ERRORS, *(name for name in found if name.startswith("coefficient_")))
    quantities |= dict(zip(single, single, strict=True))
    own: Row = dict(zip(("metric", "order", "mapping"), key, strict=True))
    yield from list_rows(
        [found], quantities, {"n": "n_items"}, interval=STIMULI, **own, **part.keys
    )


def _compare_classically(
    part: Part, items: Items, metrics: Sequence[str], *, notes: list[str]
) -> Iterator[Row]:
    means = np.nanmean(items.ratings, axis=0)
    for (i, one), (j, other) in combinations(enumerate(metrics), 2):
        columns = np.array([means, items.metrics[i], items.metrics[j]])
        if (np.ptp(columns, axis=1) == 0).any():
            continue
        r = np.corrcoef(columns)
        try:
            found = dict(compare_dependent(r[0, 1], r[0, 2], r[1, 2], len(means)))
        except ValueError as error:
            notes.append(f"{part.lead}, dependent correlations of {one} and {other}: {error}")
            continue
        quantities = {"difference": "difference zou_low zou_high"}
        for name, kind in (("williams", "t"), ("steiger", "z"), ("meng", "z")):
            quantities[name] = f"{name}_{kind} - - {name}_p"
        found["difference"] = r[0, 1] - r[0, 2]
        own: Row = {"metric": one, "second_metric": other, "n": len(means)}
        yield from list_rows([found], quantities, interval=f"Zou's {STIMULI}", **own, **part.keys)


SECTIONS = (
    Section("metrics", "Correlations of mean ratings with metrics", "predict", compute),
    Section("further", "Further metrics, explored", "predict", compute_further, front=False),
    Section(
        "standard", "For comparison with the literature", "computed", compute_standard, front=False
    ),
)
