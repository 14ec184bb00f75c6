"""What single stimuli, recordings and reducers do to the primary slopes, as tables of the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.numbers import make_number, name_path
from analysis.report.sections.effects import lay_estimate, name_estimate
from analysis.report.sections.section import Cell, Grid
from analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator

    from pandas import DataFrame

    from analysis.report.sections.answer import Finding

    Row = dict[Hashable, Any]

INFLUENCE = (
    "Influence: each recording (source, where several recordings come from one) and each reducer is left out in turn, "
    "and the stimuli that move a slope most by leverage and residual; metrics are centred anew, the model is fitted "
    "anew, p adjusted by Holm as in the whole. An exceptional reducer is one whose ratings differ from what the slopes "
    "without it predict, more than those of the other reducers do (t test, Bonferroni over reducers, and at least 5 "
    "points)."
)


def lay_influence(found: Iterable[Finding]) -> Iterator[Grid]:
    """Lay out the slopes without each unit, those first that turn a verdict or move a slope.

    Parameters
    ----------
    found : iterable of Finding
        One per part.

    Yields
    ------
    Grid
        What turns or moves, open; all others, folded.
    """
    head = ("Ratings", "Metric", "Left out", "Points per +0.1", "Interval", "Change in SE", "p (Holm)", "Verdict")
    shown: list[tuple[str | Cell, ...]] = []
    hidden: list[tuple[str | Cell, ...]] = []
    for one in found:
        table = one.influence.table
        for row in table.to_dict("records"):
            (shown if row["moves"] else hidden).append(_lay(one, row))
    caption = (
        "Without a single recording, reducer or stimulus: slopes within recordings, points per +0.1, with 95 % t "
        "intervals; by how many standard errors the slope changes; the verdict on what is left. "
    )
    if shown:
        yield Grid(f"{caption}Here: where the verdict or the sign turns, or the slope moves by more than its standard "
                   "error.", head, tuple(shown), detail=False)  # fmt: skip
    if hidden:
        yield Grid(f"{caption}Here: all others; the file tables/influence.csv has every one.", head, tuple(hidden))


def _lay(found: Finding, row: Row) -> tuple[str | Cell, ...]:
    name = name_path("influence", *found.part.place, row["metric"], row["kind"], row["unit"])
    n = found.model.n_rows
    how = f"mixed model without {row['kind']} {row['unit']}, points of rating per +0.1 of the metric"
    value = name_estimate(name, row, how, n=n, prefix="tenth")
    shift = make_number(f"{name}.shift", row["shift"], "change of the slope in standard errors of the whole", n=n)
    p = make_number(f"{name}.p_holm", row["p_holm"], "two-sided t test, Holm's adjustment", n=n)
    words = tell_name(found.part.lead), tell_name(row["metric"]), f"{row['kind']} {row['unit']}"
    return (*words, *lay_estimate(value, "slope"), Cell(shift, "slope"), Cell(p, "p"), tell_name(row["verdict"]))


def lay_exceptions(found: Iterable[Finding]) -> Iterator[Grid]:
    """Lay out by how much each reducer's ratings differ from what the slopes without it predict.

    Parameters
    ----------
    found : iterable of Finding
        One per part.

    Yields
    ------
    Grid
        One, or none.
    """
    rows: list[tuple[str | Cell, ...]] = []
    for one in found:
        for row in one.influence.exceptions.reset_index().to_dict("records"):
            name, n = name_path("exception", *one.part.place, row["reducer"]), one.model.n_rows
            excess = make_number(name, row["excess"], "rated above what slopes without the reducer predict", n=n)
            p = make_number(f"{name}.p", row["p"], "two-sided t test, Bonferroni over reducers", n=n)
            told = "yes" if row["exceptional"] else "no"
            rows.append((tell_name(one.part.lead), row["reducer"], Cell(excess, "rating"), Cell(p, "p"), told))
    if rows:
        caption = (
            "Reducers that the metrics do not account for: points by which a reducer's stimuli were rated above what "
            "the slopes without it predict, relative to the other reducers; p adjusted by Bonferroni over reducers."
        )
        yield Grid(caption, ("Ratings", "Reducer", "Excess", "p", "Exceptional"), tuple(rows))


def tabulate_influence(found: Iterable[Finding]) -> dict[str, DataFrame]:
    """Make the files ``influence`` and ``exceptions``; none where nothing was left out.

    Parameters
    ----------
    found : iterable of Finding
        One per part.

    Returns
    -------
    dict of str to DataFrame
        By name.
    """
    import pandas as pd

    found = list(found)
    tables = {
        "influence": [one.influence.table.assign(ratings=one.part.lead) for one in found],
        "exceptions": [one.influence.exceptions.reset_index().assign(ratings=one.part.lead) for one in found],
    }
    whole = {name: [table for table in parts if len(table)] for name, parts in tables.items()}
    return {name: pd.concat(parts, ignore_index=True) for name, parts in whole.items() if parts}
