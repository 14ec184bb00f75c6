"""Section on correlations of mean ratings with metrics over all stimuli: those of the analysis, and further ones.

They pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same recording
and is made in `feel321.analysis.report.primary`; correlations are beside it, for comparison with the literature.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association import correlate_items, make_panel
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row, read_ends
from feel321.analysis.table.items import Part, make_items, split_tests
from feel321.analysis.table.metrics import describe_explored, order_reducers
from feel321.analysis.table.reading import SPACE, note_apart
from feel321.analysis.table.schema import APART, CHOSEN, PAIRED, RECAST
from feel321.analysis.words import format_method, format_span

if TYPE_CHECKING:
    from feel321.analysis.association import Panel
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

LEADING, RANKED, DRAWN = "pearson", "spearman", "within"
"""The method that the words give, its counterpart by ranks, and the one that scatters and cards give."""


def compute(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric."""
    found = Found(key="metrics", notes=list(note_apart(table.rows)))
    left_out = (table.rows["role"] != "test") & ~table.rows["scale"].isin(APART)
    for role, count in table.rows.loc[left_out, "role"].value_counts().sort_index().items():
        found.notes.append(f"Associations leave out {count} judgements of stimuli with role '{role}'.")  # fmt: skip
    panels: list[Panel] = []
    told: list[Row] = []
    for part in split_tests(table):
        rng, draws = choices.make_rng("metrics", *part.place), choices.draws
        panel = make_panel(part.rows, table.metrics, draws=draws, rng=rng, info=table.info)
        panels.append(panel)
        told.append(_describe_panel(part, panel))
        _add_associations(found, part, panel.associations, name="associations")
        for two in panel.differences:
            found.add("differences", [two], method=format_method(two.method), **part.keys)
        found.add("stimuli", panel.stimuli, **part.keys)
        both = (*panel.associations, *panel.differences)
        found.notes += _gather_notes(both, part.lead, most=len(panel.associations))
        explored = list(explore(part, table.further, choices))
        _add_associations(found, part, explored, name="further_associations")
        lead = f"{part.lead}, further metrics"
        found.notes += _gather_notes(explored, lead, most=len(explored))
    ranges: dict[str, list[float]] = {}
    for one in (one for panel in told for one in panel["found"]):
        if np.isfinite(one["r"]["value"]):
            ranges.setdefault(one["metric"], []).append(one["r"]["value"])
    scales = table.rows["scale"]
    # Choices between two stimuli have an answer of their own.
    alone = not panels and not scales.isin(CHOSEN).any()
    meanings = describe_explored(table.metrics)
    found.facts = {
        "further": {name: meanings[name] for name in table.further} if panels else {},
        "panels": told, "alone": alone, "map": SPACE if alone and (scales == PAIRED).any() else "",
        "ranges": [{"metric": name, "low": min(r), "high": max(r)} for name, r in ranges.items()],
    }  # fmt: skip
    subjects = [one["subject"].lower() for one in told]
    drawn = list(zip(panels, subjects, strict=True))
    for slug, shown in parts.split_front("scatter", drawn):
        _draw(found, shown, table, slug=slug)
    return found


def _add_associations(found: Found, part: Part, every: Iterable[Statistic], *, name: str) -> None:
    for one in every:
        row: Row = {**one}
        if part.scale == RECAST:  # the dissimilarity itself, which a similarity turns round
            row |= {"turned": -one.value, "turned_low": -one.high, "turned_high": -one.low}
        found.add(name, [row], method=format_method(one.method), **part.keys)


def _describe_panel(part: Part, panel: Panel) -> Row:
    """Gather what the template says of the correlations of one scale and level."""
    leading = [one for one in panel.associations if one.method == LEADING]
    reasons = [one.notes[0] if one.notes else "" for one in leading]
    return {
        **part.keys, "subject": part.subject, "ceiling": leading[0].ceiling, "n_items": leading[0].n_items,
        "found": [
            {"metric": one.metric, "r": read_ends(one), "covers": covers_zero(one),
             "why": why.removeprefix("No correlation: ").removesuffix(".")}
            for one, why in zip(leading, reasons, strict=True)
        ],
        "differences": [
            {"metrics": [two.first, two.second], "r": read_ends(two), "covers": covers_zero(two)}
            for two in panel.differences if two.method == LEADING
        ],
    }  # fmt: skip


def covers_zero(one: Statistic) -> bool:
    """Tell whether an interval covers zero."""
    return bool(one.low <= 0 <= one.high)


def _draw(found: Found, shown: Sequence[tuple[Panel, str]], table: Table, *, slug: str) -> None:
    from feel321.analysis.figures.kinds import find_cut

    panels = [panel for panel, _ in shown]
    counts = [int(count) for panel in panels for count in panel.stimuli["n_participants"]]
    cut = [
        (int(sum((panel.stimuli[name] < find_cut(name)).sum() for panel in panels)), name)
        for name in table.metrics
    ]
    says = {
        "subjects": [name for _, name in shown], "cut": [pair for pair in cut if pair[0]],
        "method": format_method(DRAWN), "people": format_span(counts) if max(counts) >= SMALLEST else "",
    }  # fmt: skip
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    options: Row = {"method": DRAWN, "looks": looks, "detail": slug != "scatter"}
    found.draw("scatter", slug, panels, list(table.metrics), says=says, **options)


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


def explore(part: Part, metrics: Sequence[str], choices: Choices) -> Iterator[Statistic]:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for."""
    for metric, method in product(metrics, (LEADING, RANKED, DRAWN)):
        alone = make_items(part.rows, [metric])
        rng = choices.make_rng("further", *part.place, metric, method)
        (drawn,) = correlate_items(alone, (metric,), method, draws=choices.draws, rng=rng)
        yield drawn.associate(metric)
