"""The claims of a paper, and what this study's ratings say to each of them.

A measure is a function `measure_NAME(table, claim, choices) -> ClaimValue` of a module of this package, and one line in
`feel321.names.MEASURES`. It takes a table of one scale and one level, raises ValueError where the claim cannot be
estimated, and knows nothing of the paper's number: `judge` compares. Where a claim names exceptions, it is called a
second time without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.table.items import recast_pairs, split_tests
from feel321.analysis.table.schema import PAIRED
from feel321.names import MEASURES

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

AGREES, DIFFERS, OPEN, NOT_ESTIMABLE = "agrees", "differs", "open", "not_estimable"
"""Verdicts: the interval lies where the paper says, or elsewhere, or holds both; or there is no number."""

USUAL_LEVEL = "as_is"  # The level that a claim is about where it names none and there are several
Ends = tuple[float, float, float]  # A value and the ends of its interval
NO_NUMBER: Ends = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class PaperClaim:
    """A claim of a paper.

    source: where it was seen, one of `PROVENANCE`. expect: one of `EXPECTATIONS`. paper: the paper's number and its
    range, NaN where it is not known. exceptions: reducers that the paper names as exceptions. options: what the
    measure needs to know; `scale` and `level` choose the ratings.
    """

    name: str
    claim: str
    source: str
    measure: str
    expect: str = "positive"
    paper: Ends = NO_NUMBER
    exceptions: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Paper:
    """A paper that is replicated.

    seen: full text or abstract. published: its table of metrics, one row per number: recording, reducer, metric,
    paper, table, source. mountings: recording, reducer, metric, and mean and quantiles over orientations of the sensor.
    """

    citation: str
    doi: str
    seen: str
    claims: tuple[PaperClaim, ...] = ()
    published: DataFrame | None = None
    mountings: DataFrame | None = None


@dataclass(frozen=True, slots=True)
class ClaimValue:
    """What a measure found.

    kind: how the number is rounded, a key of `words.PLACES`. unit: what stands behind it. n: how many stimuli,
    recordings or participants it rests on. method, interval: how value and interval were computed. beside: for the
    expectations highest and lowest, by the name of each other unit, ours minus theirs with its interval. note: a
    sentence of the measure's own.
    """

    value: float
    low: float = math.nan
    high: float = math.nan
    kind: str = "correlation"
    unit: str = ""
    n: int = 0
    method: str = ""
    interval: str = ""
    beside: Mapping[str, Ends] = field(default_factory=dict)
    note: str = ""

    def describe(self) -> str:
        """Write the number with its unit and interval."""
        value, interval = words.format_estimate(self.value, self.low, self.high, kind=self.kind)
        unit = f" {self.unit}" if self.unit else ""
        return f"{value}{unit}" + (f" ({interval})" if interval != words.ABSENT else "")


Measure = Callable[["Table", PaperClaim, "Choices"], ClaimValue]


@dataclass(frozen=True, slots=True)
class PaperAnswer:
    """What this study says to a claim; found is None where there is no number, and the sentence says why."""

    claim: PaperClaim
    verdict: str
    sentence: str
    found: ClaimValue | None = None
    without: ClaimValue | None = None


def answer_claims(table: Table, paper: Paper, choices: Choices) -> Iterator[PaperAnswer]:
    """Answer every claim of a paper."""
    for claim in paper.claims:
        module, _, function = MEASURES[claim.measure].partition(":")
        measure: Measure = getattr(import_module(f"{__package__}.{module}"), function)
        try:
            own = narrow(table, claim)
            found = measure(own, claim, choices)
        except ValueError as error:
            yield PaperAnswer(claim, NOT_ESTIMABLE, f"{str(error).rstrip('.')}.")
            continue
        without = None
        # Without the exceptions that the paper names, where they were rated and enough is left.
        if set(claim.exceptions) & set(own.rows["reducer"]):
            with suppress(ValueError):
                without = measure(leave_out(own, claim.exceptions), claim, choices)
        verdict = judge(claim, found)
        yield PaperAnswer(claim, verdict, _describe(claim, found, without), found, without)


def narrow(table: Table, claim: PaperClaim) -> Table:
    """Select the ratings that a claim is about: scale and level of its options, or the first scale, as it is.

    Dissimilarities are those between all stimuli where the options name them, and else similarities to the original.
    """
    if claim.options.get("scale") == PAIRED:
        levels = sorted(table.rows.loc[table.rows["scale"] == PAIRED, "level"].unique())
        usual = USUAL_LEVEL if USUAL_LEVEL in levels else next(iter(levels), None)
        return table.select(PAIRED, level=str(claim.options.get("level", usual)))
    table = replace(table, rows=recast_pairs(table.rows))
    arms = [(part.scale, part.level) for part in split_tests(table)]
    if not arms:  # only pairs or choices were judged; a measure finds them in the whole table
        return table
    scale, level = (claim.options.get(name) for name in ("scale", "level"))
    fitting = [one for one in arms if scale in {None, one[0]} and level in {None, one[1]}]
    if not fitting:
        wanted = " and ".join(
            f"{key} {claim.options[key]!r}" for key in ("scale", "level") if key in claim.options
        )
        raise ValueError(
            f"nothing was rated on {wanted}; there are {', '.join(map(' '.join, arms))}"
        )
    chosen = next((one for one in fitting if one[1] == USUAL_LEVEL), fitting[0])
    return table.select(chosen[0], level=chosen[1])


def leave_out(table: Table, reducers: Iterable[str]) -> Table:
    """Leave out what was made with some reducers."""
    names = list(reducers)
    rows, stimuli = table.rows, table.stimuli
    out = rows["reducer"].isin(names) | rows["reference_reducer"].isin(names)
    kept = rows[~out].reset_index(drop=True)
    if stimuli is not None:
        stimuli = stimuli[~stimuli["reducer"].isin(names)]
    return replace(table, rows=kept, stimuli=stimuli)


def judge(claim: PaperClaim, found: ClaimValue) -> str:
    """Compare what was found with what the paper says.

    Of positive and negative, the whole interval must lie on one side of zero; of near, the value must lie within the
    paper's range (low to high), and what differs excludes it; of highest and lowest, the differences from all others
    must exclude zero. A number without an interval is taken as it is; a difference that is written as zero is none.
    """
    if not math.isfinite(found.value):
        return NOT_ESTIMABLE
    ends = _fill_ends((found.value, found.low, found.high))
    if claim.expect == "near":
        _, low, high = _fill_ends(claim.paper)
        if low <= found.value <= high:
            return AGREES
        return DIFFERS if ends[2] < low or ends[1] > high else OPEN
    ranked = claim.expect in {"highest", "lowest"}
    gaps = [_fill_ends(one) for one in found.beside.values()] if ranked else [ends]
    places = words.PLACES[found.kind]
    gaps = [one if one[1] < one[2] else (round(one[0], places),) * 3 for one in gaps]
    if claim.expect in {"negative", "lowest"}:
        gaps = [(-value, -high, -low) for value, low, high in gaps]
    if not gaps:
        return NOT_ESTIMABLE
    if any(high < 0 for _, _, high in gaps):
        return DIFFERS
    return AGREES if all(low > 0 for _, low, _ in gaps) else OPEN


def _fill_ends(ends: Ends) -> Ends:
    """Take a number without an interval as certain."""
    value, low, high = ends
    return ends if math.isfinite(low + high) else (value, value, value)


def _describe(claim: PaperClaim, found: ClaimValue, without: ClaimValue | None) -> str:
    """Say what was found, the paper's number beside it, and what it is without the exceptions."""
    parts = [f"here {found.describe()}"]
    value, low, high = claim.paper
    if math.isfinite(value):
        parts.append(f"the paper {words.format_number(value, kind=found.kind)}")
    elif math.isfinite(low + high):
        parts.append(f"the paper {words.format_interval(low, high, kind=found.kind)}")
    if claim.expect in {"highest", "lowest"} and found.beside:
        parts.append(
            describe_nearest(found.beside, upward=claim.expect == "highest", kind=found.kind)
        )
    if without is not None:
        parts.append(f"without {words.join_words(claim.exceptions)} {without.describe()}")
    return "; ".join(parts) + "." + (f" {found.note}" if found.note else "")


def describe_nearest(beside: Mapping[str, Ends], *, upward: bool, kind: str) -> str:
    """Name the unit that comes closest, or is beyond."""
    sign = 1 if upward else -1
    name, ends = min(beside.items(), key=lambda item: sign * item[1][0])
    way = 1 if ends[0] >= 0 else -1
    low, high = sorted(way * end for end in ends[1:])
    value, interval = words.format_estimate(way * ends[0], low, high, kind=kind)
    told = f" ({interval})" if interval != words.ABSENT else ""
    other = f"that of {words.format_name(name)}"
    if not told and value == words.format_number(0.0, kind=kind):
        return f"the same as {other}"
    return f"{value} {'higher' if way > 0 else 'lower'} than {other}{told}"
