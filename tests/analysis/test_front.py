from __future__ import annotations

import html
import json
import math
import re
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.analysis.primary.sensitivity import list_changes
from feel321.analysis.report.front import (
    OPPOSITE,
    QUESTIONS,
    VERDICTS,
    MetricCard,
    _list_unflagged,
    describe_turn,
    explain_blank,
    group_sections,
    order_scales,
    write_headline,
)
from feel321.analysis.report.raters import _conclude_panels, _describe_changes
from feel321.analysis.report.section import Section
from feel321.analysis.table.items import Table
from feel321.analysis.words import Line, keep_together, make_number

if TYPE_CHECKING:
    from pathlib import Path

SIZES = [
    make_number(f"size.{name}", 12, "count", n=9) for name in ("participant", "recording", "source")
]
STATUSES = ("predicts", OPPOSITE, "open", "not_estimable")


def make_card(scale: str, metric: str, status: str, **more: object) -> MetricCard:
    numbers = [field.name for field in fields(MetricCard) if field.type == "float"]
    verdict = "predicts" if status == OPPOSITE else status
    direction = {"predicts": "higher", OPPOSITE: "lower"}.get(status, "")
    words = (scale, "as_is", scale.capitalize(), metric, verdict, direction, "better", "")
    return replace(MetricCard(*words, **dict.fromkeys(numbers, math.nan)), **more)


@st.composite
def studies(draw: st.DrawFn) -> list[MetricCard]:
    scales = ["realism", "similarity", "roughness"][: draw(st.integers(1, 3))]
    metrics = ["spectral_match", "temporal_match"][: draw(st.integers(1, 2))]
    return [
        make_card(scale, metric, draw(st.sampled_from(STATUSES)))
        for scale in scales
        for metric in metrics
    ]


@given(studies())
def test_the_sentence_claims_what_the_verdicts_do(cards: list[MetricCard]) -> None:
    said, statuses = write_headline(cards, [], SIZES), {card.outcome for card in cards}
    assert ("predict" in said) == bool({"predicts", OPPOSITE} & statuses)
    assert ("opposite" in said) == (OPPOSITE in statuses)
    assert ("is open" in said) == ("open" in statuses)
    assert ("cannot be estimated" in said) == ("not_estimable" in statuses)
    every = "both rating scales" in said or "all 3 rating scales" in said
    for scale in {card.scale for card in cards}:
        assert scale in said.casefold() or every
    assert said[0].isupper()
    assert said.endswith(".")
    assert said.count(".") == 1


def test_sentences_as_they_are_read() -> None:
    both = [make_card("realism", name, "predicts") for name in ("spectral_match", "temporal_match")]
    assert write_headline(both, [], SIZES) == (
        "Spectral match and temporal match predict realism ratings."
    )
    better = [replace(both[0], better_than=("temporal_match",)), both[1]]
    assert "ratings, spectral match more strongly." in write_headline(better, [], SIZES)
    hinging = [replace(both[0], hinge="the reducer mag321"), both[1]]
    assert "which in part hinges on the reducer mag321." in write_headline(hinging, [], SIZES)
    none = [
        make_card("realism", "spectral_match", "open"),
        make_card("mushra", "spectral_match", "open"),
    ]
    assert write_headline(none, [], SIZES) == (
        "Whether the ratings on both rating scales follow spectral match is open."
    )
    few = [replace(card, few=("3 recordings",)) for card in both]
    assert "(with 3 recordings, a hint rather than a result)." in write_headline(few, [], SIZES)
    assert "hint" not in write_headline(
        [replace(card, few=("3 reducers",)) for card in none], [], SIZES
    )
    table = pd.DataFrame({
        "ratings": ["realism, as_is", "mushra, as_is"],
        "reducer": "mag321",
        "excess": [31.24, 35.0],
        "exceptional": True,
    })
    odd = [Section("primary", "", tables={"exceptions": table})]
    assert "mag321" not in write_headline(none, odd, SIZES)
    assert write_headline([*both[:1], none[1]], odd, SIZES).endswith(
        "is open; mag321 was rated 31.2 points higher on realism than its metrics would suggest."
    )
    all_predict = [replace(card, verdict="predicts", direction="higher") for card in none]
    assert write_headline(all_predict, odd, SIZES).endswith(
        "mag321 was rated 31.2 to 35.0 points higher on realism and mushra than its metrics would suggest."
    )


def test_levels_are_not_scales() -> None:
    arms = [
        replace(
            make_card("realism", "spectral_match", "open"),
            level=level,
            subject=f"Realism (level {level})",
        )
        for level in ("as is", "loud")
    ]
    told = "Whether realism ratings at both levels follow spectral match is open."
    assert write_headline(arms, [], SIZES) == told
    more = [*arms, *(replace(card, scale="mushra", subject=f"MUSHRA{card.level}") for card in arms)]
    told = "Whether the ratings on both rating scales at both levels follow spectral match is open."
    assert write_headline(more, [], SIZES) == told
    assert "all ratings" in write_headline(more[:3], [], SIZES)


def test_a_slope_that_turns_alone_is_said() -> None:
    spectral, temporal = (
        make_card("realism", name, "predicts", effect=36.9)
        for name in ("spectral_match", "temporal_match")
    )
    found = {"correlation": 0.85, "correlation_low": 0.6, "correlation_high": 0.95}
    lower = {"direction": "lower", "effect": -27.5, "given": ("spectral_match",)}
    turned = replace(temporal, **lower, **found)
    told = write_headline([spectral, turned], [], SIZES)
    assert told.endswith(
        "(at equal spectral match, higher temporal match goes with lower ratings, but alone with higher ratings)."
    )
    assert "opposite" in told
    assert describe_turn(replace(temporal, **found)) == ""
    unsure = describe_turn(replace(turned, correlation_low=-0.1))
    assert unsure.endswith("; alone, its direction is open")


def test_every_protocol_with_a_verdict_is_in_the_sentence() -> None:
    asked = ("triplets show this", "preferences show that", "0 of 4 were distinguished")
    lines = [
        Section("primary", "", verdict=(Line("nothing"),)),
        Section("choices", "", verdict=[Line("at length", clause=one) for one in asked[:2]]),
        Section("discrimination", "", verdict=(Line("at length", clause=asked[2]),)),
    ]
    card = make_card("realism", "spectral_match", "open")
    for cards in ([], [card]):
        said = write_headline(cards, lines, SIZES).casefold()
        assert all(one in said for one in asked)
        assert ("realism" in said) == bool(cards)


def test_a_verdict_that_changes_without_flagged_raters_is_in_the_sentence() -> None:
    card = make_card("mushra", "temporal_match", "predicts", effect=3.0)
    flagged = [*SIZES, make_number("screening_panel.any", 13, "count", n=16)]
    assert "13" not in write_headline([card], [], flagged)
    for verdict, said in (("open", "is open"), ("not_estimable", "cannot be estimated")):
        told = write_headline([replace(card, unflagged=verdict)], [], flagged)
        assert "without the 13 of 16 raters whom screening rules flag" in told
        assert told.endswith(f"{said}.")
    told = write_headline([replace(card, unflagged="predicts")], [], flagged)
    assert told.endswith("in the opposite direction.")


def test_few_people_recordings_or_reducers_are_named() -> None:
    units = ("3 people", "4 reducers")
    card = make_card("realism", "spectral_match", "predicts", hinge="the recording r", few=units)
    assert write_headline([card], [], SIZES) == (
        "Spectral match predicts realism ratings (with 3 people and 4 reducers, a hint rather than a result), "
        "which hinges on the recording r."
    )
    blank = replace(card, verdict="not_estimable", direction="", hinge="")
    assert write_headline([blank], [], SIZES).endswith(
        "cannot be estimated with 3 people and 4 reducers."
    )
    assert explain_blank(blank).startswith("3 people and 4 reducers: at least ")
    assert explain_blank(replace(blank, few=())).startswith("too few degrees of freedom")


def test_a_card_says_what_its_effect_and_its_correlation_are_of() -> None:
    found = {"effect": 4.0, "effect_low": 1.0, "effect_high": 7.0, "correlation": 0.5}
    card = make_card("realism", "spectral_match", "predicts", **found)
    joint = replace(card, given=("temporal_match",))
    assert joint.condition == "at equal temporal match"
    assert joint.r.endswith("metric alone")
    assert card.condition == ""
    assert not card.r.endswith("alone")


def test_scales_come_in_the_order_of_the_study() -> None:
    rows = pd.DataFrame({"protocol": list("bbaac"), "scale": list("BBAAC"), "rating": range(5)})
    table = Table(rows, (), ())
    found = order_scales(table, ("a", "b"))
    assert list(found.rows["scale"]) == list("AABBC")
    assert list(found.rows["rating"]) == [2, 3, 0, 1, 4]
    assert order_scales(table, ("b", "a")) is order_scales(table, ()) is table


def test_every_section_answers_a_question() -> None:
    asked = [key for _, keys in QUESTIONS.values() for key in keys]
    assert len(asked) == len(set(asked))
    own = Section("paper", "Paper", answers=("yes",))
    blocks = group_sections([*(Section(key, key, answers=("x",)) for key in reversed(asked)), own])
    assert blocks[0].sections == (own,)
    assert [section.key for block in blocks[1:] for section in block.sections] == asked


def test_cards_hold_the_numbers_of_the_results(report: Path) -> None:
    results = json.loads((report / "results.json").read_text(encoding="utf-8"))
    found = {entry["name"]: entry for entry in results["numbers"]}
    claims = {(one["scale"], one["level"], one["metric"]): one for one in results["verdicts"]}
    cards = {(one["scale"], one["level"], one["metric"]): one for one in results["cards"]}
    assert list(cards) == [
        (scale, "as_is", metric)
        for scale in ("realism", "similarity")
        for metric in ("spectral_match", "temporal_match")
    ]
    page = html.unescape((report / "index.html").read_text(encoding="utf-8"))
    shown = re.findall(r'<div class="card">.*?</ul>', page, flags=re.DOTALL)
    for place, card in cards.items():
        path = ".".join(place)
        slope, r = found[f"slope.{path}.quartile_effect"], found[f"association.{path}.within"]
        for name, entry in (("effect", slope), ("correlation", r)):
            ends = [card[f"{name}{end}"] for end in ("", "_low", "_high")]
            assert ends == [entry["value"], entry["low"], entry["high"]]
        assert card["ceiling"] == found[f"association.{path}.within.ceiling"]["value"]
        claim = claims[place]
        assert (card["verdict"], card["hinge"]) == (claim["verdict"], claim["hinge"])
        (own,) = [text for text in shown if f"<h3>{card['subject']}</h3>" in text]
        (line,) = [
            text
            for text in re.findall(r"<li>.*?</li>", own, flags=re.DOTALL)
            if f"<span>{place[2].replace('_', ' ')}" in text.casefold()
        ]
        made = MetricCard(**{
            key: math.nan if value is None else value for key, value in card.items()
        })
        for told in (
            made.points,
            made.condition,
            made.r,
            VERDICTS[made.verdict],
            f'aria-label="{made.described}"',
        ):
            assert told in line
    assert keep_together(results["headline"]) in page


def test_tables_from_elsewhere_open_with_the_question(report: Path) -> None:
    page = (report / "index.html").read_text(encoding="utf-8")
    assert "<h1>Do the metrics predict the ratings?</h1>" in page
    assert "<time" not in page


@pytest.mark.parametrize(
    ("p", "tenth", "changes"),
    [(0.001, 3.0, False), (0.04, 3.0, True), (0.001, -3.0, True), (math.nan, math.nan, True)],
)
def test_verdicts_without_flagged_raters_are_adjusted_as_the_primary_ones(
    p: float, tenth: float, *, changes: bool
) -> None:
    rows = [
        {
            "scale": "mushra",
            "level": "as_is",
            "panel": panel,
            "metric": metric,
            "p": p,
            "tenth": tenth,
        }
        for panel, p, tenth in (("everyone", 0.001, 3.0), ("any", p, tenth))
        for metric in ("spectral_match", "temporal_match")
    ]
    found = _conclude_panels(rows)
    metrics = {row["metric"] for row in list_changes(found)}
    assert metrics == ({"spectral_match", "temporal_match"} if changes else set())
    section = Section("raters", "", tables={"slopes_without_hits": found})
    assert {place[2] for place, _ in _list_unflagged([section])} == metrics
    assert ("changes no verdict" in _describe_changes(found)) != changes


def test_a_model_that_everyone_lacks_claims_nothing() -> None:
    row = {"scale": "realism", "level": "as_is", "panel": "any", "metric": "temporal_match"}
    assert list(list_changes([row | {"verdict": "open", "tenth": 3.0}])) == []
    assert len(list(list_changes([row | {"verdict": "predicts", "tenth": 3.0}]))) == 1
