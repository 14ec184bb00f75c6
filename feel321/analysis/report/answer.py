"""What opens a report: the cards, the clauses of its sentence, and the claims of the paper that it replicates.

A clause claims no more than its verdicts: a direction only where Holm's p is below .05, a better metric only where the
difference is clear and that metric predicts, nothing where a slope is not estimable. ``words/headline.j2`` phrases it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import pandas as pd
from pandas import DataFrame

from feel321.analysis.primary.sensitivity import LOST, NOT_ESTIMABLE, OPEN, PREDICTS
from feel321.analysis.report.section import Found, Row, find_row, make_row, read_ends
from feel321.analysis.words import (
    capitalise,
    format_interval,
    format_method,
    format_name,
    format_number,
    join_words,
)

if TYPE_CHECKING:
    from feel321.analysis.replication import Paper, PaperAnswer
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

OPPOSITE = "opposite"
# Exceptional reducers, and findings of other protocols, that the sentence names before it only counts
NAMED = 2
PLACE = ("scale", "level", "metric")


def make_cards(found: Mapping[str, Found]) -> list[Row]:
    """Make a card of every slope: its verdict, effect, correlation alone, noise ceiling, and what it depends on."""
    primary, metrics, raters = (found.get(key, Found()) for key in ("primary", "metrics", "raters"))
    slopes = (row for row in primary.rows["slopes"] if row["quantity"] == "slope_quartile")
    effects, without = (
        {tuple(row[key] for key in PLACE): row for row in rows}
        for rows in (slopes, raters.facts.get("unflagged", ()))
    )
    alone, blank, cards = metrics.rows["associations"], make_row(""), []
    for verdict in primary.verdicts:
        place = {key: verdict[key] for key in PLACE}
        *part, metric = spot = tuple(place.values())
        within = place | {"method": format_method("within")}
        left, better = without.get(spot, {"verdict": ""}), verdict["higher"] == "better"
        against = left["verdict"] == PREDICTS and (left["tenth"] > 0) != better
        effect, r = effects.get(spot, blank), find_row(alone, "r", **within) or blank
        others = [other for *of, other in effects if of == part and other != metric]
        cards.append({
            **verdict, "effect": read_ends(effect), "r": read_ends(r),
            "ceiling": (find_row(alone, "ceiling", **within) or blank)["value"],
            "given": others if spot in effects else [], "unflagged": OPPOSITE if against else left["verdict"],
            "outcome": OPPOSITE if verdict["opposite"] else verdict["verdict"],
            # How ratings go with a metric alone; empty where its interval covers zero.
            "turned": verdict["verdict"] == PREDICTS and effect["value"] * r["value"] < 0,
            "alone": ("higher" if r["value"] > 0 else "lower") if r["low"] * r["high"] > 0 else "",
        })  # fmt: skip
    return cards


def list_clauses(cards: Sequence[Row], found: Mapping[str, Found]) -> list[Row]:
    """Decide what the headline says: of every metric and scale, and of every protocol that has no card."""
    by_metric: dict[str, list[Row]] = {}
    for card in cards:
        by_metric.setdefault(card["metric"], []).append(card)
    alike: dict[tuple[Any, ...], list[str]] = {}
    for metric, own in by_metric.items():
        outcomes = tuple((card["outcome"], card["turned"]) for card in own)
        alike.setdefault(outcomes, []).append(metric)
    clauses = [clause for group in alike.values() for clause in _group(cards, group)]
    clauses += _list_exceptions(cards, found.get("primary", Found()).rows["exceptions"])
    for metric, every in by_metric.items():
        if own := [card for card in every if card["beyond_level"] == LOST]:
            clauses.append({"kind": "lost", "metric": metric, "what": name_scales(own, every)})
    # The verdicts that are others without the raters whom screening rules flag, each once.
    ways: dict[tuple[str, str], Row] = {}
    for metric, every in by_metric.items():
        for way in dict.fromkeys(card["unflagged"] for card in every if card["unflagged"]):
            what = name_scales([card for card in every if card["unflagged"] == way], every)
            said: Row = {"kind": way, "what": what, "metrics": [], "few": []}
            ways.setdefault((way, what), said)["metrics"].append(metric)
    if ways:
        sizes = {name: found["raters"].facts[name] for name in ("flagged", "n_raters")}
        clauses.append({"kind": "unflagged", **sizes, "ways": list(ways.values())})
    others = [{"kind": "other", "text": text} for one in found.values() for text in one.clauses]
    # More of them are left to the first sentences of their own sections.
    return clauses + (others if len(others) <= NAMED or not clauses else [])


def _group(cards: Sequence[Row], metrics: Sequence[str]) -> Iterator[Row]:
    """Say what metrics have in common that have the same verdicts on all scales."""
    every = [card for card in cards if card["metric"] == metrics[0]]
    for outcome, turned in product((PREDICTS, OPPOSITE, OPEN, NOT_ESTIMABLE), (False, True)):
        own = [card for card in every if (card["outcome"], card["turned"]) == (outcome, turned)]
        if not own:
            continue
        subjects = {card["subject"] for card in own}
        same = [card for card in cards if card["metric"] in metrics and card["subject"] in subjects]
        hinges = list(dict.fromkeys(tuple(card["hinges_on"]) for card in same if card["hinges_on"]))
        # The metric that predicts better than each other one of the group on all of these scales.
        best = [
            metric for metric in metrics if len(metrics) > 1 and all(
                {*metrics} - {metric} <= {*card["better_than"]} for card in same if card["metric"] == metric
            )
        ]  # fmt: skip
        yield {
            "kind": outcome, "metrics": list(metrics), "what": name_scales(own, every), "best": (*best, "")[0],
            "few": list(dict.fromkeys(unit for card in same for unit in card["few"])),
            "turns": [card for card in same if card["turned"]],
            "hinges": list(hinges[0]) if len(hinges) == 1 else ["several"] * len(hinges),
            "in_part": bool(hinges) and not all(card["hinges_on"] for card in same),
        }  # fmt: skip


def name_scales(own: Sequence[Row], every: Sequence[Row]) -> str:
    """Name the ratings of some scales and levels, or say that it is all of them."""
    if len(own) == len(every) > 1:
        scales, levels = ({card[name] for card in own} for name in ("scale", "level"))
        if len(scales) * len(levels) != len(own):
            return "all ratings"
        many = {len(one): f"all {len(one)}" for one in (scales, levels)} | {2: "both"}
        where = f" at {many[len(levels)]} levels" if len(levels) > 1 else ""
        if len(scales) > 1:
            return f"the ratings on {many[len(scales)]} rating scales{where}"
        return f"{format_name(own[0]['scale'])} ratings{where}"
    names = list_subjects([card["subject"] for card in own])
    return f"ratings of {names}" if "(" in names else f"{names} ratings"


def list_subjects(subjects: Sequence[str]) -> str:
    """List scales within a sentence, in lower case but for abbreviations."""
    lowered = (name[:1].lower() + name[1:] if name[1:2].islower() else name for name in subjects)
    return join_words(list(lowered))


def _list_exceptions(cards: Sequence[Row], rows: Sequence[Row]) -> Iterator[Row]:
    """Name the reducers that were rated otherwise than metrics suggest that predict there, and on which scales."""
    predicted = [card for card in cards if card["verdict"] == PREDICTS]
    subjects = {(card["scale"], card["level"]): card["subject"] for card in predicted}
    ways: dict[tuple[str, bool], dict[str, float]] = {}
    for row in list_exceptional(rows):
        if subject := subjects.get((row["scale"], row["level"])):
            ways.setdefault((row["reducer"], row["value"] > 0), {})[subject] = abs(row["value"])
    if len(ways) > NAMED:
        where = list(dict.fromkeys(subject for points in ways.values() for subject in points))
        reducers = list(dict.fromkeys(name for name, _ in ways))
        yield {"kind": "exceptions", "reducers": reducers, "where": list_subjects(where)}
        return
    for (name, above), points in ways.items():
        yield {
            "kind": "exception", "reducer": name, "above": above,
            "points": [min(points.values()), max(points.values())], "where": list_subjects(list(points)),
        }  # fmt: skip


def list_exceptional(rows: Sequence[Row]) -> list[Row]:
    """List the excess of every reducer that is exceptional."""
    keys = ("scale", "level", "reducer")
    flagged = {tuple(row[key] for key in keys) for row in rows if row["note"] == "yes"}
    excesses = (row for row in rows if row["quantity"] == "excess")
    return [row for row in excesses if tuple(row[key] for key in keys) in flagged]


# A paper's own questions, each answered by this study; they open the report of a replication.

WAYS = {"positive": "higher", "negative": "lower"}


def compute_paper(
    table: Table, choices: Choices, *, paper: Paper, others: Mapping[str, Found]
) -> Found:
    """Answer the claims of a paper; others: what the sections that follow found."""
    from feel321.analysis.replication import AGREES, DIFFERS, answer_claims

    found, answers = Found(key="paper"), list(answer_claims(table, paper, choices))
    odd = others["primary"].rows["exceptions"] if "primary" in others else []
    verdicts = {verdict: [one.claim.name for one in answers if one.verdict == verdict]
                for verdict in (DIFFERS, AGREES, OPEN, NOT_ESTIMABLE)}  # fmt: skip
    found.facts = {
        "citation": paper.citation, "seen": paper.seen, "counts": verdicts,
        "answers": [
            {"name": one.claim.name, "claim": one.claim.claim, "source": one.claim.source, "verdict": one.verdict,
             "sentence": capitalise(one.sentence)}
            for one in answers
        ],
        "surprises": list(_list_surprises(paper, odd, answers)),
        "ours": sum(one.claim.source == "ours" for one in answers),
    }  # fmt: skip
    for one in answers:
        found.rows["paper_claims"] += _list_answer(one)
    metrics = tabulate_metrics(table, paper)
    if len(metrics):
        told = metrics["shown"] + " (" + metrics["table"] + ", " + metrics["source"] + ")"
        found.add("paper_metrics", metrics.assign(told=told), n=1)
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


def _list_surprises(
    paper: Paper, odd: Sequence[Row], answers: Sequence[PaperAnswer]
) -> Iterator[Row]:
    """List reducers that were rated otherwise than the metrics predict, and whether the paper names them too.

    Where the primary model cannot tell which reducers are exceptional, list the excesses that claims are about.
    """
    named: dict[str, set[str]] = {name: set() for one in paper.claims for name in one.exceptions}
    for claim in paper.claims:
        if claim.measure == "rating_excess" and claim.expect in WAYS:
            named.setdefault(str(claim.options.get("reducer")), set()).add(WAYS[claim.expect])
    rows = list_exceptional(odd)
    for reducer in dict.fromkeys(row["reducer"] for row in rows):
        own = [row for row in rows if row["reducer"] == reducer]
        own.sort(key=lambda row: abs(row["value"]))
        ways = sorted({"higher" if row["value"] > 0 else "lower" for row in own})
        yield {
            "reducer": reducer, "ways": ways, "points": [abs(own[0]["value"]), abs(own[-1]["value"])], "metrics": [],
            "where": [f"{row['scale']}, {row['level']}" for row in own], "named": reducer in named,
            "otherwise": [] if named.get(reducer, set()) >= set(ways) else sorted(named.get(reducer, ())),
        }  # fmt: skip
    for one in answers if not rows else ():
        claim, metrics = one.claim, one.claim.options.get("metrics", ())
        if (
            claim.measure == "rating_excess"
            and one.found
            and claim.expect in WAYS
            and one.verdict in {"agrees", "differs"}
        ):
            yield {
                "reducer": claim.options["reducer"], "points": [abs(one.found.value)] * 2, "where": [], "otherwise": [],
                "ways": ["higher" if one.found.value > 0 else "lower"], "named": one.verdict == "agrees",
                "metrics": [metrics] if isinstance(metrics, str) else list(metrics),
            }  # fmt: skip


def tabulate_metrics(table: Table, paper: Paper) -> DataFrame:
    """Tabulate the match metrics of every recording and reducer, with the paper's numbers and mountings beside."""
    from feel321.analysis.replication import tabulate_metric

    matches = ("spectral_match", "temporal_match")
    known = [name for name in matches if table.stimuli is not None and name in table.stimuli]
    if paper.published is None or not known:
        return pd.DataFrame()
    long = [
        tabulate_metric(table, name).melt(var_name="reducer", ignore_index=False).assign(metric=name).reset_index()
        for name in known
    ]  # fmt: skip
    found = pd.concat(long, ignore_index=True).dropna(subset="value")
    for beside in (paper.published, paper.mountings):
        if beside is not None:
            found = found.merge(beside, how="left", on=["recording", "reducer", "metric"])
    later = ~found["recording"].isin(paper.published["recording"])  # first what the paper shows
    return found.assign(later=later).sort_values(["later", "recording", "metric"], kind="stable")
