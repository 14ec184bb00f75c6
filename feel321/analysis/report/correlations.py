"""Sections: correlations of mean ratings with metrics over all stimuli, with further metrics, and as other studies do.

They pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same recording
and is made in `feel321.analysis.report.primary`; correlations are beside it, for comparison with the literature.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association.correlate import correlate_items, make_panel
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row
from feel321.analysis.table.items import Part, make_items, split_tests
from feel321.analysis.table.metrics import describe_explored, order_reducers
from feel321.analysis.table.notes import SPACE, note_apart
from feel321.analysis.table.schema import APART, CHOSEN, PAIRED, RECAST
from feel321.analysis.words import format_method, format_span

if TYPE_CHECKING:
    from feel321.analysis.association.correlate import Panel
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

LEADING, RANKED, DRAWN = "pearson", "spearman", "within"
"""The method that the words give, the one it is checked against, and the one that scatters and cards give."""


def compute(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric."""
    found = Found(key="metrics", notes=list(note_apart(table.rows)))
    found.facts = {"panels": [], "ranges": [], "map": "", "alone": False}
    left_out = (table.rows["role"] != "test") & ~table.rows["scale"].isin(APART)
    for role, count in table.rows.loc[left_out, "role"].value_counts().sort_index().items():
        found.notes.append(f"Associations leave out {count} judgements of stimuli with role '{role}'.")  # fmt: skip
    panels: list[Panel] = []
    for part in split_tests(table):
        rng, draws = choices.make_rng("metrics", *part.place), choices.draws
        panel = make_panel(part.rows, table.metrics, draws=draws, rng=rng, info=table.info)
        panels.append(panel)
        found.facts["panels"].append(_describe_panel(part, panel))
        _add_associations(found, part, panel.associations, name="associations")
        for two in panel.differences:
            found.add("differences", [two], method=format_method(two.method), **part.keys)
        found.add("stimuli", panel.stimuli, **part.keys)
        both = (*panel.associations, *panel.differences)
        found.notes += _gather_notes(both, part.lead, most=len(panel.associations))
    if not panels and not table.rows["scale"].isin(CHOSEN).any():
        # Choices between two stimuli have an answer of their own.
        where = SPACE if PAIRED in table.rows["scale"].unique() else ""
        found.facts |= {"alone": True, "map": where}
    ranges: dict[str, list[float]] = {}
    for one in (one for panel in found.facts["panels"] for one in panel["found"]):
        if np.isfinite(one["r"]["value"]):
            ranges.setdefault(one["metric"], []).append(one["r"]["value"])
    found.facts["ranges"] = [
        {"metric": name, "low": min(r), "high": max(r)} for name, r in ranges.items()
    ]
    for slug, chosen in parts.split_front("scatter", range(len(panels))):
        _draw(found, [panels[number] for number in chosen], table, slug=slug)
    return found


def _add_associations(found: Found, part: Part, every: Iterable[Statistic], *, name: str) -> None:
    for one in every:
        row: Row = {**one}
        if part.scale == RECAST:  # the dissimilarity itself, which a similarity turns round
            row |= {"turned": -one.value, "turned_low": -one.high, "turned_high": -one.low}
        found.add(name, [row], method=format_method(one.method), **part.keys)


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


def _ends(one: Statistic) -> dict[str, float]:
    return {"value": one.value, "low": one.low, "high": one.high}


def covers_zero(one: Statistic) -> bool:
    """Tell whether an interval covers zero."""
    return bool(one.low <= 0 <= one.high)


def _draw(found: Found, panels: Sequence[Panel], table: Table, *, slug: str) -> None:
    from feel321.analysis.figures.kinds import find_cut
    from feel321.analysis.figures.style import assign_looks

    looks, metrics = assign_looks(order_reducers(table.rows["reducer"])), list(table.metrics)
    counts = [int(count) for panel in panels for count in panel.stimuli["n_participants"]]
    cut = [
        (int(sum((panel.stimuli[name] < find_cut(name)).sum() for panel in panels)), name)
        for name in metrics
    ]
    says = {
        "subjects": [
            one["subject"].lower() for one in found.facts["panels"]
            if (one["scale"], one["level"]) in {(panel.scale, panel.level) for panel in panels}
        ],
        "cut": [pair for pair in cut if pair[0]],
        "method": format_method(DRAWN), "people": format_span(counts) if max(counts) >= SMALLEST else "",
    }  # fmt: skip
    options: Row = {"method": DRAWN, "looks": looks, "detail": slug != "scatter"}
    found.draw("scatter", slug, panels, metrics, says=says, **options)


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
    found = Found(key="further")
    for part in split_tests(table) if table.further else ():
        items, own = make_items(part.rows, table.further), []
        for (place, metric), method in product(enumerate(table.further), (LEADING, RANKED, DRAWN)):
            alone = replace(items, metrics=items.metrics[[place]])
            rng = choices.make_rng("further", *part.place, metric, method)
            drawn = correlate_items(alone, (metric,), method, draws=choices.draws, rng=rng)
            own.append(drawn.associate(metric))
        _add_associations(found, part, own, name="further_associations")
        found.notes += _gather_notes(own, f"{part.lead}, further metrics", most=len(own))
    if found.rows["further_associations"]:
        known = describe_explored(table.metrics)
        found.facts["meanings"] = {name: known[name] for name in table.further}
    return found
