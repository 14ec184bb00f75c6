"""The answer that opens a report: cards and the clauses of its sentence, decided from verdicts and rows.

A clause claims no more than its verdicts: a direction only where Holm's p is below .05, a better metric only where the
difference is clear and that metric predicts, nothing where a slope is not estimable. ``words/headline.j2`` phrases it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

from feel321.analysis.primary.sensitivity import LOST, NOT_ESTIMABLE, OPEN, PREDICTS
from feel321.analysis.report.section import Found, find_row
from feel321.analysis.words import format_method, format_name, join_words

if TYPE_CHECKING:
    from feel321.analysis.report.section import Row

OPPOSITE = "opposite"
NAMED = 2
"""Exceptional reducers, and findings of other protocols, that the sentence names before it only counts."""

PLACE = ("scale", "level", "metric")


def make_cards(found: Mapping[str, Found]) -> list[Row]:
    """Make a card of every slope: its verdict, effect, correlation alone, noise ceiling, and what it depends on."""
    primary, metrics, raters = (found.get(key, Found()) for key in ("primary", "metrics", "raters"))
    slopes, alone = primary.rows.get("slopes", ()), metrics.rows.get("associations", ())
    without = raters.facts.get("unflagged", ())
    unflagged = {tuple(row[key] for key in PLACE): row["verdict"] for row in without}
    blank: Row = dict.fromkeys(("value", "low", "high"), math.nan)
    cards = []
    for verdict in primary.verdicts:
        place = {key: verdict[key] for key in PLACE}
        within = place | {"method": format_method("within")}
        effect, r = (
            find_row(slopes, "slope_quartile", **place),
            find_row(alone, "r", **within) or blank,
        )
        others = [one["metric"] for one in primary.verdicts if one["subject"] == verdict["subject"]]
        known = [
            name
            for name in others
            if name != verdict["metric"]
            and find_row(slopes, "slope_quartile", **place | {"metric": name})
        ]
        way = "higher" if r["value"] > 0 else "lower"
        predicts, size = verdict["verdict"] == PREDICTS, (effect or blank)["value"]
        cards.append({
            **verdict, "effect": {end: (effect or blank)[end] for end in blank}, "r": {end: r[end] for end in blank},
            "ceiling": (find_row(alone, "ceiling", **within) or blank)["value"],
            "given": known if effect else [], "unflagged": unflagged.get(tuple(place.values()), ""),
            "outcome": OPPOSITE if verdict["opposite"] else verdict["verdict"],
            # How ratings go with a metric alone; empty where its interval covers zero.
            "turned": predicts and size * r["value"] < 0, "alone": way if r["low"] * r["high"] > 0 else "",
        })  # fmt: skip
    return cards


# The clauses of the sentence.


def list_clauses(cards: Sequence[Row], found: Mapping[str, Found]) -> list[Row]:
    """Decide what the headline says: of every metric and scale, and of every protocol that has no card."""
    by_metric = {
        metric: [card for card in cards if card["metric"] == metric]
        for metric in dict.fromkeys(card["metric"] for card in cards)
    }
    alike: dict[tuple[Any, ...], list[str]] = {}
    for metric, own in by_metric.items():
        outcomes = tuple((card["outcome"], card["turned"]) for card in own)
        alike.setdefault(outcomes, []).append(metric)
    clauses = [clause for group in alike.values() for clause in _group(cards, group)]
    if "primary" in found:
        clauses += _list_exceptions(cards, found["primary"].rows.get("exceptions", ()))
    for metric, every in by_metric.items():
        if own := [card for card in every if card["beyond_level"] == LOST]:
            clauses.append({"kind": "lost", "metric": metric, "what": name_scales(own, every)})
    if "raters" in found and any(card["unflagged"] for card in cards):
        # Verdicts that are others without the raters whom screening rules flag.
        ways: dict[tuple[str, str], list[str]] = {}
        for metric, every in by_metric.items():
            for way in dict.fromkeys(card["unflagged"] for card in every if card["unflagged"]):
                own = [card for card in every if card["unflagged"] == way]
                turned = way == PREDICTS and own[0]["verdict"] == PREDICTS
                key = OPPOSITE if turned else way, name_scales(own, every)
                ways.setdefault(key, []).append(metric)
        told = [{"kind": way, "what": what, "metrics": own} for (way, what), own in ways.items()]
        sizes = {name: found["raters"].facts[name] for name in ("flagged", "n_raters")}
        clauses.append({"kind": "unflagged", **sizes, "ways": told})
    others = [{"kind": "other", "text": text} for one in found.values() for text in one.clauses]
    # More of them stand beneath the cards, where they would be said a second time.
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
    return join_words([
        name[:1].lower() + name[1:] if name[1:2].islower() else name for name in subjects
    ])


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


# Where correlations over all stimuli pooled, another question, disagree with the primary model.


def reconcile(panels: Iterable[Row], verdicts: Iterable[Row]) -> None:
    """Mark in the facts of the correlations where they disagree with the verdicts on the same ratings."""

    def disagrees(one: Row, verdict: Row) -> bool:
        if math.isnan(one["r"]["low"]):
            return False
        if one["covers"]:
            return bool(verdict["verdict"] == PREDICTS)
        higher = verdict["direction"] == "higher"
        return bool(verdict["verdict"] == OPEN or higher != (one["r"]["value"] > 0))

    known = {
        tuple(one[key] for key in PLACE): one for one in verdicts if one["verdict"] != NOT_ESTIMABLE
    }
    for panel in panels:
        own = {
            metric: one
            for (scale, level, metric), one in known.items()
            if (scale, level) == (panel["scale"], panel["level"])
        }
        found = (one for one in panel["found"] if one["metric"] in own)
        panel["against"] = [one for one in found if disagrees(one, own[one["metric"]])]
        panel["stronger"] = [
            two for two in panel["differences"]
            if two["stronger"] and set(two["metrics"]) <= set(own)
            and not set(two["metrics"]) - {two["stronger"]} & set(own[two["stronger"]]["better_than"])
        ]  # fmt: skip
