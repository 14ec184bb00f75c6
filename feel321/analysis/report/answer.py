"""The answer that opens the report, and what it hinges on.

Every sentence is made from numbers of ``results.json`` and claims no more than they do: a direction only where Holm's p
is below .05, a better metric only where the difference is clear and that metric predicts, and nothing where a slope is
not estimable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.primary.influence import NOT_ESTIMABLE, OPEN, PREDICTS, conclude
from feel321.analysis.report._old import Cell, Grid, lay_estimate, name_estimate
from feel321.analysis.table.items import tell_recordings
from feel321.analysis.words import (
    Claim,
    Line,
    list_words,
    make_number,
    name_path,
    start,
    tell_ends,
    tell_name,
    tell_number,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Sequence

    from pandas import DataFrame

    from feel321.analysis.primary.influence import Influence
    from feel321.analysis.primary.model import Primary
    from feel321.analysis.report.parts import RatingsPart as Part

    Row = dict[Hashable, Any]

# The sentences that open a report: what the primary model shows, on what that hinges, and how the metrics compare.

UNBOUNDED = "spectral_match"
HIGHER, LOWER = "higher", "lower"
FEW = 5
"""Participants or recordings below which a finding is a hint."""

NAMED = 3
"""How many units a sentence names before it only counts."""

FEWEST = 3
"""Participants or recordings below which nothing is estimable."""


@dataclass(frozen=True, slots=True)
class Lost:
    """What is said of ratings that no model can be fitted to."""

    lines: tuple[Line, ...] = ()
    claims: tuple[Claim, ...] = ()

    def add(self, part: Part, metrics: Sequence[str], reason: str) -> Lost:
        """Add a part and the reason why it has no model."""
        named = list_words([tell_name(name) for name in metrics], "or")
        alike = part.rows["rating"].min() == part.rows["rating"].max()
        why = "all ratings are the same" if alike else reason.removesuffix(".")
        line = Line(
            f"Whether {named} predicts {part.ratings} cannot be estimated: {why}.",
            start(part.subject),
        )
        claims = [
            Claim(
                part.scale,
                part.level,
                name,
                NOT_ESTIMABLE,
                "",
                name_path("slope", *part.place, name),
            )
            for name in metrics
        ]
        return Lost((*self.lines, line), (*self.claims, *claims))


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """A slope of the primary model and all that its sentence needs."""

    row: Row
    part: Part
    model: Primary
    influence: Influence

    @property
    def metric(self) -> str:
        """Name of the metric."""
        return str(self.row["metric"])

    @property
    def verdict(self) -> str:
        """What is concluded."""
        return conclude(self.row["p_holm"])

    @property
    def direction(self) -> str:
        """Where ratings go with a higher metric; empty where nothing is claimed."""
        if self.verdict != PREDICTS:
            return ""
        return HIGHER if self.row["estimate"] > 0 else LOWER

    @property
    def turns(self) -> DataFrame:
        """Units without which verdict or sign change."""
        return self.influence.find_turns(self.metric)

    @property
    def moves(self) -> DataFrame:
        """Those units, and units without which the slope changes by more than its standard error."""
        return self.influence.find_moves(self.metric)

    def make_claim(self, number: str) -> Claim:
        """State the conclusion for a program."""
        turns = [f"{row['kind']} {row['unit']}" for row in self.turns.to_dict("records")]
        return Claim(
            self.part.scale,
            self.part.level,
            self.metric,
            self.verdict,
            self.direction,
            number,
            tuple(turns),
            better_than=tuple(self._list_worse()),
        )

    def _list_worse(self) -> Iterator[str]:
        if self.verdict != PREDICTS or not self.turns.empty:
            return
        for row in self.model.differences.to_dict("records"):
            pair = [str(row["first"]), str(row["second"])]
            if self.metric in pair and find_better(row, self.model.slopes) == self.metric:
                yield from (name for name in pair if name != self.metric)


def tell_findings(found: Sequence[Finding], needs: Sequence[str]) -> Iterator[Line]:
    """Say what the model of a part shows, the finding of each metric first."""
    part, model, influence = found[0].part, found[0].model, found[0].influence
    subject = start(part.subject)
    if all(one.verdict == NOT_ESTIMABLE for one in found):
        yield Line(f"{_tell_blank(found)}{_tell_lack(model)}.", subject)
        return
    for one in found:
        yield Line(tell_finding(one), subject)
    for row in model.differences.to_dict("records"):
        if told := _compare(row, found):
            yield Line(told, subject, "comparison")
    if told := _tell_exceptions(influence, part):
        yield Line(told, subject, "exceptions")
    if told := " ".join(filter(None, needs)):
        yield Line(told, subject, "sample size")
    if any(one.metric == UNBOUNDED for one in found):
        yield Line(RAW, subject, "unbounded metric")
    yield Line(_tell_evidence(found), subject, "evidence")


RAW = (
    "spectral match is the paper's eq. 1 here, which has no lower bound, so that a few stimuli may decide its slope; "
    "read its rank correlation and what single stimuli do to it, or build the stimulus set again and use "
    "spectral_match_bounded."
)


def tell_finding(found: Finding) -> str:
    """Say whether a metric predicts ratings, how strongly, and on what that hinges."""
    metric, ratings = tell_name(found.metric), found.part.ratings
    if found.verdict == NOT_ESTIMABLE:
        return f"{_tell_blank([found])}{_tell_lack(found.model)}."
    hinge = _tell_hinge(found)
    if found.verdict == OPEN:
        return f"Whether {metric} predicts {ratings} is open{hinge}. {_tell_effect(found)}"
    opposite = (
        ""
        if found.direction == HIGHER
        else f" in the opposite direction (higher match, {LOWER} ratings)"
    )
    return f"{start(metric)} predicts {ratings}{opposite}{hinge}. {_tell_effect(found)}"


def _tell_blank(found: Sequence[Finding]) -> str:
    names = list_words([tell_name(one.metric) for one in found], "or")
    return f"Whether {names} predicts {found[0].part.ratings} cannot be estimated"


def _tell_effect(found: Finding) -> str:
    """Give the effect over the metric's own spread first, per +0.1 second."""
    row, positive = found.row, found.direction == HIGHER
    span, reach = _tell_change(
        row["quartile_effect"], row["quartile_low"], row["quartile_high"], positive=positive
    )
    tenth, narrow = _tell_change(
        row["tenth"], row["tenth_low"], row["tenth_high"], positive=positive
    )
    p = tell_number(row["p_holm"], kind="p")
    p = f"p (Holm) {p if p.startswith('<') else f'= {p}'}"
    return (
        "Among stimuli from the same recording, going from its lower to its upper quartile is associated with "
        f"{span} (95 % CI {reach}; {p}), each +0.1 with {tenth} ({narrow})."
    )


def _tell_change(value: float, low: float, high: float, *, positive: bool) -> tuple[str, str]:
    told, interval = tell_ends(value, low, high, kind="rating")
    return (f"ratings {told} points higher" if positive else f"a change of {told} points"), interval


def _tell_hinge(found: Finding) -> str:
    """Say which units a verdict hinges on, and what would be concluded without the most influential one."""
    rows = found.moves.to_dict("records")
    turns = [row for row in rows if row["turns"]]
    if turns:
        join = ", but" if found.verdict == PREDICTS else ", and"
        others = _tell_others(turns, "; it also turns without")
        return f"{join} this hinges on {_tell_unit(turns[0])}: without it {_tell_without(turns[0], found)}{others}"
    if not rows:
        return ""
    value, interval = tell_ends(*_ends(rows[0]), kind="rating")
    instead = tell_number(found.row["tenth"], kind="rating")
    told = f"{value}, {interval}, instead of {instead} points per +0.1{_tell_others(rows, '; also without')}"
    return f"; the slope changes by more than its standard error without {_tell_unit(rows[0])} ({told})"


def _tell_others(rows: Sequence[Row], lead: str) -> str:
    """Name the units after the first, and count those after the third."""
    names, more = [_tell_unit(row) for row in rows[1:NAMED]], len(rows) - NAMED
    if not names:
        return ""
    return (
        f"{lead} {', '.join(names)} and {more} more" if more > 0 else f"{lead} {list_words(names)}"
    )


def _tell_without(row: Row, found: Finding) -> str:
    value, interval = tell_ends(*_ends(row), kind="rating")
    evidence = f"{value} points per +0.1, {interval}"
    if row["verdict"] == OPEN and found.verdict == PREDICTS:
        return f"the association is open ({evidence})"
    if row["verdict"] == PREDICTS:
        way = HIGHER if row["tenth"] > 0 else LOWER
        return f"a higher {tell_name(found.metric)} goes with {way} ratings ({evidence})"
    return f"the estimate changes its sign ({evidence})"


def _ends(row: Row) -> tuple[float, float, float]:
    return row["tenth"], row["tenth_low"], row["tenth_high"]


def _tell_unit(row: Row) -> str:
    return f"the {row['kind']} {row['unit']}"


def _compare(row: Row, found: Sequence[Finding]) -> str:
    """Say which of two metrics predicts better, in the same model and over the spread of each."""
    by_metric = {one.metric: one for one in found}
    first, second = by_metric[row["first"]], by_metric[row["second"]]
    ends = (row["standardised_estimate"], row["standardised_low"], row["standardised_high"])
    if math.isnan(ends[1]) or NOT_ESTIMABLE in {first.verdict, second.verdict}:
        return ""
    if unsteady := [tell_name(one.metric) for one in (first, second) if not one.turns.empty]:
        return f"which metric predicts better is left open: the verdict on {list_words(unsteady)} is not stable."
    value, interval = tell_ends(*ends, kind="slope")
    evidence = f"standardised slopes differ by {value}, 95 % CI {interval}"
    better = find_better(row, first.model.slopes)
    if not better or by_metric[better].verdict != PREDICTS:
        names = f"{tell_name(first.metric)} or {tell_name(second.metric)}"
        return f"the data do not show whether {names} predicts {first.part.ratings} better ({evidence})."
    worse = second if better == first.metric else first
    return f"{tell_name(better)} predicts {first.part.ratings} better than {tell_name(worse.metric)} does ({evidence})."


def find_better(row: Row, slopes: DataFrame) -> str:
    """Find which of two metrics has the stronger standardised slope."""
    if (
        math.isnan(row["standardised_low"])
        or row["standardised_low"] <= 0 <= row["standardised_high"]
    ):
        return ""
    sizes = slopes["standardised"].abs().to_dict()
    return str(max((row["first"], row["second"]), key=lambda name: sizes[name]))


def _tell_exceptions(influence: Influence, part: Part) -> str:
    told = [
        f"{row['reducer']} was rated {tell_number(abs(row['excess']), kind='rating')} points "
        f"{HIGHER if row['excess'] > 0 else LOWER} than the metrics predict from the other reducers"
        for row in influence.exceptions.reset_index().to_dict("records")
        if row["exceptional"]
    ]
    return f"{'; '.join(told)} ({part.ratings})." if told else ""


def _tell_lack(model: Primary) -> str:
    few = [
        f"{size} {name}{'s' * (size != 1)}"
        for name, size in _count_units(model).items()
        if size < FEWEST
    ]
    if not few:
        return ": too few degrees of freedom are left for a test"
    return f" with {' and '.join(few)}: at least {FEWEST} are needed{' of each' * (len(few) > 1)}"


def _count_units(model: Primary) -> dict[str, int]:
    scene = "source" if model.n_sources < model.n_recordings else "recording"
    return {"participant": model.n_participants, scene: model.n_sources}


def _tell_evidence(found: Sequence[Finding]) -> str:
    """Say what the findings rest on, and how far they reach."""
    model = found[0].model
    people = f"{model.n_participants} participant{'s' * (model.n_participants != 1)}"
    reducers = (
        f", {model.n_reducers} reducer{'s' * (model.n_reducers != 1)}" if model.n_reducers else ""
    )
    sizes = f"{people}, {tell_recordings(model.n_recordings, model.n_sources)}{reducers}, {model.n_items} stimuli"
    together = "; one mixed model with all metrics" if len(found) > 1 else "; mixed model"
    few = [f"{name}s" for name, size in _count_units(model).items() if FEWEST <= size < FEW]
    claimed = any(one.verdict == PREDICTS for one in found)
    hint = (
        f" With so few {list_words(few)} this is a hint rather than a result."
        if few and claimed
        else ""
    )
    steady = [
        tell_name(one.metric) for one in found if one.verdict != NOT_ESTIMABLE and one.turns.empty
    ]
    units = "No single recording or reducer, and none of the most influential stimuli, turns the verdict on"
    told = (
        f" {units} {list_words(steady, 'or')}." if steady and len(found[0].influence.table) else ""
    )
    return f"{sizes}{together}.{hint}{told}"


# What single stimuli, recordings and reducers do to the primary slopes, as tables of the page.

INFLUENCE = (
    "Influence: each recording (source, where several recordings come from one) and each reducer is left out in turn, "
    "and the stimuli that move a slope most by leverage and residual; metrics are centred anew, the model is fitted "
    "anew, p adjusted by Holm as in the whole. An exceptional reducer is one whose ratings differ from what the slopes "
    "without it predict, more than those of the other reducers do (t test, Bonferroni over reducers, and at least 5 "
    "points)."
)


def lay_influence(found: Iterable[Finding]) -> Iterator[Grid]:
    """Lay out the slopes without each unit, those first that turn a verdict or move a slope."""
    head = (
        "Ratings",
        "Metric",
        "Left out",
        "Points per +0.1",
        "Interval",
        "Change in SE",
        "p (Holm)",
        "Verdict",
    )
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
        yield Grid(
            f"{caption}Here: where the verdict or the sign turns, or the slope moves by more than its standard "
            "error.",
            head,
            tuple(shown),
            detail=False,
        )
    if hidden:
        yield Grid(
            f"{caption}Here: all others; the file tables/influence.csv has every one.",
            head,
            tuple(hidden),
        )


def _lay(found: Finding, row: Row) -> tuple[str | Cell, ...]:
    name = name_path("influence", *found.part.place, row["metric"], row["kind"], row["unit"])
    n = found.model.n_rows
    how = (
        f"mixed model without {row['kind']} {row['unit']}, points of rating per +0.1 of the metric"
    )
    value = name_estimate(name, row, how, n=n, prefix="tenth")
    shift = make_number(
        f"{name}.shift", row["shift"], "change of the slope in standard errors of the whole", n=n
    )
    p = make_number(f"{name}.p_holm", row["p_holm"], "two-sided t test, Holm's adjustment", n=n)
    words = tell_name(found.part.lead), tell_name(row["metric"]), f"{row['kind']} {row['unit']}"
    return (
        *words,
        *lay_estimate(value, "slope"),
        Cell(shift, "slope"),
        Cell(p, "p"),
        tell_name(row["verdict"]),
    )


def lay_exceptions(found: Iterable[Finding]) -> Iterator[Grid]:
    """Lay out by how much each reducer's ratings differ from what the slopes without it predict."""
    rows: list[tuple[str | Cell, ...]] = []
    for one in found:
        for row in one.influence.exceptions.reset_index().to_dict("records"):
            name, n = name_path("exception", *one.part.place, row["reducer"]), one.model.n_rows
            excess = make_number(
                name, row["excess"], "rated above what slopes without the reducer predict", n=n
            )
            p = make_number(
                f"{name}.p", row["p"], "two-sided t test, Bonferroni over reducers", n=n
            )
            told = "yes" if row["exceptional"] else "no"
            rows.append((
                tell_name(one.part.lead),
                row["reducer"],
                Cell(excess, "rating"),
                Cell(p, "p"),
                told,
            ))
    if rows:
        caption = (
            "Reducers that the metrics do not account for: points by which a reducer's stimuli were rated above what "
            "the slopes without it predict, relative to the other reducers; p adjusted by Bonferroni over reducers."
        )
        yield Grid(caption, ("Ratings", "Reducer", "Excess", "p", "Exceptional"), tuple(rows))


def tabulate_influence(found: Iterable[Finding]) -> dict[str, DataFrame]:
    """Make the files ``influence`` and ``exceptions``; none where nothing was left out."""
    import pandas as pd

    found = list(found)
    tables = {
        "influence": [one.influence.table.assign(ratings=one.part.lead) for one in found],
        "exceptions": [
            one.influence.exceptions.reset_index().assign(ratings=one.part.lead) for one in found
        ],
    }
    whole = {name: [table for table in parts if len(table)] for name, parts in tables.items()}
    return {name: pd.concat(parts, ignore_index=True) for name, parts in whole.items() if parts}
