"""Section: a paper's own questions, each answered by this study; it opens the report of a replication."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from feel321.analysis import replication as paper_claims
from feel321.analysis.replication import (
    AGREES,
    DIFFERS,
    NOT_ESTIMABLE,
    PaperAnswer,
    tabulate_metric,
)
from feel321.analysis.report.answer import list_exceptional
from feel321.analysis.report.section import Found, Row, make_row
from feel321.analysis.words import capitalise, format_interval, format_number

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication import Paper
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

WAYS = {"positive": "higher", "negative": "lower"}


def compute(table: Table, choices: Choices, *, paper: Paper, others: Mapping[str, Found]) -> Found:
    """Answer the claims of a paper; others: what the sections that follow found."""
    found, answers = Found(key="paper"), list(paper_claims.answer_claims(table, paper, choices))
    odd = others["primary"].rows["exceptions"] if "primary" in others else []
    found.facts = {
        "citation": paper.citation, "seen": paper.seen,
        "answers": [
            {"name": one.claim.name, "claim": one.claim.claim, "source": one.claim.source, "verdict": one.verdict,
             "sentence": capitalise(one.sentence)}
            for one in answers
        ],
        "surprises": list(_list_surprises(paper, odd)) or list(_list_excesses(answers)),
        "ours": sum(one.claim.source == "ours" for one in answers),
        "counts": {
            verdict: [one.claim.name for one in answers if one.verdict == verdict]
            for verdict in (DIFFERS, AGREES, paper_claims.OPEN, NOT_ESTIMABLE)
        },
    }  # fmt: skip
    for one in answers:
        found.rows["paper_claims"] += _list_answer(one)
    for row in tabulate_metrics(table, paper).to_dict("records"):
        known = {name: value for name, value in row.items() if value == value}  # noqa: PLR0124 - is a number
        if "paper" in known:
            known["told"] = f"{row['shown']} ({row['table']}, {row['source']})"
        found.add("paper_metrics", [known], n=1)
    return found


def _list_answer(one: PaperAnswer) -> Iterator[Row]:
    claim, found = one.claim, one.found
    keys: Row = {"claim": claim.name, "measure": claim.measure, "source": claim.source}
    keys |= {"n": found.n if found else 0}
    kind = found.kind if found else "correlation"
    yield make_row("verdict", one.verdict.replace("_", " "), **keys)
    value, low, high = claim.paper
    told = format_interval(low, high, kind=kind)
    if math.isfinite(value):
        told = format_number(value, kind=kind)
    ends = {"low": low, "high": high, "interval": "the paper's range"}
    yield make_row("paper", value, note=told, **ends, **keys)
    for name, own in (("here", found), ("without", one.without)):
        if own is not None:
            ends = {"low": own.low, "high": own.high, "interval": own.interval}
            yield make_row(name, own.value, note=own.describe(), **ends, **keys)


def _list_surprises(paper: Paper, odd: Sequence[Row]) -> Iterator[Row]:
    """List reducers that were rated otherwise than the metrics predict, and whether the paper names them too."""
    named: dict[str, set[str]] = {name: set() for one in paper.claims for name in one.exceptions}
    for claim in paper.claims:
        if claim.measure == "rating_excess" and claim.expect in WAYS:
            named.setdefault(str(claim.options.get("reducer")), set()).add(WAYS[claim.expect])
    rows = sorted(list_exceptional(odd), key=lambda row: abs(row["value"]))
    for reducer in dict.fromkeys(row["reducer"] for row in list_exceptional(odd)):
        own = [row for row in rows if row["reducer"] == reducer]
        ways = sorted({"higher" if row["value"] > 0 else "lower" for row in own})
        yield {
            "reducer": reducer, "ways": ways, "points": [abs(own[0]["value"]), abs(own[-1]["value"])], "metrics": [],
            "where": [f"{row['scale']}, {row['level']}" for row in own], "named": reducer in named,
            "otherwise": [] if named.get(reducer, set()) >= set(ways) else sorted(named.get(reducer, ())),
        }  # fmt: skip


def _list_excesses(answers: Sequence[PaperAnswer]) -> Iterator[Row]:
    """List the reducers of claims about an excess that is not open, where the primary model cannot tell."""
    for one in answers:
        settled = one.claim.expect in WAYS and one.verdict in {AGREES, DIFFERS}
        if one.claim.measure == "rating_excess" and one.found and settled:
            metrics = one.claim.options.get("metrics", ())
            yield {
                "reducer": one.claim.options["reducer"], "points": [abs(one.found.value)] * 2, "where": [],
                "ways": ["higher" if one.found.value > 0 else "lower"],
                "metrics": [metrics] if isinstance(metrics, str) else list(metrics),
                "named": one.verdict == AGREES, "otherwise": [],
            }  # fmt: skip


# The paper's table: metrics of every recording and transform, with the paper's numbers and other mountings beside.

MATCH_METRICS = ("spectral_match", "temporal_match")


def tabulate_metrics(table: Table, paper: Paper) -> DataFrame:
    """Tabulate the match metrics of every recording and reducer, with the paper's numbers and mountings beside."""
    import pandas as pd

    known = [name for name in MATCH_METRICS if table.stimuli is not None and name in table.stimuli]
    if paper.published is None or not known:
        return pd.DataFrame()
    wide = {name: tabulate_metric(table, name).reset_index() for name in known}
    long = (
        own.melt("recording", var_name="reducer", value_name="value").assign(metric=name)
        for name, own in wide.items()
    )
    found = pd.concat(long, ignore_index=True).dropna(subset="value")
    for beside in (paper.published, paper.mountings):
        if beside is not None:
            found = found.merge(beside, how="left", on=["recording", "reducer", "metric"])
    later = ~found["recording"].isin(paper.published["recording"])  # first what the paper shows
    return found.assign(later=later).sort_values(["later", "recording", "metric"], kind="stable")
