"""The headline and the cards: they claim what the verdicts do, whatever the study, and nothing else."""

import math
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.analysis.primary.sensitivity import list_changes
from feel321.analysis.report.answer import list_clauses, make_cards
from feel321.analysis.report.raters import conclude_panels
from feel321.analysis.report.section import Found, make_row
from feel321.analysis.words import render_words

OUTCOMES = ("predicts", "opposite", "open", "not_estimable")
NONE = {"value": math.nan, "low": math.nan, "high": math.nan}


def make_card(scale: str, metric: str, outcome: str, **more: Any) -> dict[str, Any]:
    direction = {"predicts": "higher", "opposite": "lower"}.get(outcome, "")
    card = {
        "scale": scale, "level": "as_is", "metric": metric, "subject": scale.capitalize(),
        "ratings": f"{scale} ratings", "verdict": "predicts" if outcome == "opposite" else outcome,
        "outcome": outcome, "direction": direction, "higher": "better", "opposite": outcome == "opposite",
        "hinges_on": [], "better_than": [], "few": [], "beyond_level": "", "effect": NONE, "r": NONE,
        "ceiling": math.nan, "given": [], "unflagged": "", "turned": False, "alone": "",
    }  # fmt: skip
    return card | more


def say(cards: Sequence[dict[str, Any]], **found: Found) -> str:
    (line,) = render_words("headline", clauses=list_clauses(cards, found))
    return line.replace("\N{NO-BREAK SPACE}", " ")


@st.composite
def studies(draw: st.DrawFn) -> list[dict[str, Any]]:
    scales = ["realism", "similarity", "roughness"][: draw(st.integers(1, 3))]
    metrics = ["spectral_match", "temporal_match"][: draw(st.integers(1, 2))]
    return [
        make_card(scale, metric, draw(st.sampled_from(OUTCOMES)))
        for scale in scales
        for metric in metrics
    ]


@given(studies())
def test_the_sentence_claims_what_the_verdicts_do(cards: list[dict[str, Any]]) -> None:
    said, outcomes = say(cards), {card["outcome"] for card in cards}
    assert ("predict" in said) == bool({"predicts", "opposite"} & outcomes)
    assert ("opposite" in said) == ("opposite" in outcomes)
    assert ("is open" in said) == ("open" in outcomes)
    assert ("cannot be estimated" in said) == ("not_estimable" in outcomes)
    every = "both rating scales" in said or "all 3 rating scales" in said
    assert all(card["scale"] in said.casefold() or every for card in cards)
    assert said[0].isupper()
    assert said.endswith(".")
    assert said.count(".") == 1


def test_the_sentence_as_it_is_read() -> None:
    spectral, temporal = (
        make_card("realism", f"{name}_match", "predicts") for name in ("spectral", "temporal")
    )
    assert say([spectral, temporal]) == "Spectral match and temporal match predict realism ratings."
    better = spectral | {"better_than": ["temporal_match"]}
    assert say([better, temporal]).endswith("ratings, spectral match more strongly.")
    hinging = spectral | {"hinges_on": ["reducer mag321"]}
    assert say([hinging, temporal]).endswith(", which in part hinges on the reducer mag321.")
    few = [card | {"few": ["3 recordings"]} for card in (spectral, temporal)]
    assert "(with 3 recordings, a hint rather than a result)." in say(few)
    none = [make_card(scale, "spectral_match", "open") for scale in ("realism", "mushra")]
    assert say(none) == "Whether the ratings on both rating scales follow spectral match is open."
    blank = make_card("realism", "spectral_match", "not_estimable", few=["3 people", "4 reducers"])
    assert say([blank]).endswith("cannot be estimated with 3 people and 4 reducers.")
    lost = make_card("realism", "spectral_match", "open", beyond_level="lost")
    assert say([lost]).endswith(
        "without level in the model realism ratings would go with spectral match."
    )


def test_a_slope_that_turns_alone_is_said() -> None:
    spectral = make_card("realism", "spectral_match", "predicts")
    turned = make_card(
        "realism", "temporal_match", "opposite", turned=True, given=["spectral_match"], alone="higher",
    )  # fmt: skip
    told = "(at equal spectral match, higher temporal match goes with lower ratings; alone, with higher ratings)."
    assert say([spectral, turned]).endswith(told)
    assert "alone, its direction is open" in say([spectral, turned | {"alone": ""}])


def test_a_surprising_reducer_is_named_where_metrics_predict() -> None:
    rows = [
        row
        for scale, excess in (("realism", 31.24), ("mushra", 35.0))
        for keys in [{"scale": scale, "level": "as_is", "reducer": "mag321"}]
        for row in (make_row("excess", excess, **keys), make_row("exceptional", note="yes", **keys))
    ]
    odd = Found({"exceptions": rows})
    cards = [make_card(scale, "spectral_match", "predicts") for scale in ("realism", "mushra")]
    told = "mag321 was rated 31.2 to 35.0 points higher on realism and mushra than its metrics would suggest."
    assert say(cards, primary=odd).endswith(told)
    opened = [make_card(scale, "spectral_match", "open") for scale in ("realism", "mushra")]
    assert "mag321" not in say(opened, primary=odd)


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("open", "is open."),
        ("not_estimable", "cannot be estimated."),
        ("opposite", "predicts mushra ratings, but in the direction opposite to the one declared."),
    ],
)
def test_a_verdict_that_changes_without_flagged_raters_is_in_the_sentence(
    verdict: str, said: str
) -> None:
    raters = Found(facts={"flagged": 13, "n_raters": 16})
    card = make_card("mushra", "temporal_match", "predicts", unflagged=verdict)
    told = say([card], raters=raters)
    assert "without the 13 of 16 raters whom screening rules flag" in told
    assert told.endswith(said)
    assert "13" not in say([card | {"unflagged": ""}], raters=raters)


def test_cards_take_their_numbers_from_the_rows() -> None:
    place = {"scale": "realism", "level": "as_is", "metric": "temporal_match"}
    verdict = {
        key: make_card("realism", "temporal_match", "predicts")[key]
        for key in ("subject", "opposite", "verdict", "higher")
    }
    ends = {"low": 1.0, "high": 7.0, "interval": "t"}
    within = {**place, "method": "Pearson within recordings"}
    found = {
        "primary": Found(
            {"slopes": [make_row("slope_quartile", 4.0, **ends, **place)]}, verdicts=[place | verdict]
        ),
        "metrics": Found({"associations": [
            make_row("r", -0.5, low=-0.7, high=-0.2, interval="b", **within), make_row("ceiling", 0.9, **within),
        ]}),
        "raters": Found(facts={"unflagged": [{**place, "verdict": "predicts", "tenth": -3.0}]}),
    }  # fmt: skip
    (card,) = make_cards(found)
    assert card["effect"] == {"value": 4.0, "low": 1.0, "high": 7.0}
    assert (card["r"]["value"], card["ceiling"], card["alone"], card["turned"]) == (
        -0.5, 0.9, "lower", True,
    )  # fmt: skip
    assert card["unflagged"] == "opposite"


@pytest.mark.parametrize(
    ("p", "tenth", "changes"),
    [(0.001, 3.0, False), (0.04, 3.0, True), (0.001, -3.0, True), (math.nan, math.nan, True)],
)
def test_verdicts_without_flagged_raters_are_adjusted_as_the_primary_ones(
    p: float, tenth: float, *, changes: bool
) -> None:
    rows = [
        {
            "scale": "mushra", "level": "as_is", "panel": panel, "metric": metric, "p": p, "tenth": tenth,
        }
        for panel, p, tenth in (("everyone", 0.001, 3.0), ("any", p, tenth))
        for metric in ("spectral_match", "temporal_match")
    ]  # fmt: skip
    metrics = {row["metric"] for row in list_changes(conclude_panels(rows))}
    assert metrics == ({"spectral_match", "temporal_match"} if changes else set())


@pytest.mark.parametrize("scales", [["realism"], ["realism", "roughness"]])
def test_the_first_line_on_correlations_says_what_they_are_and_that_they_are_not_the_slopes(
    scales: list[str],
) -> None:
    r = {"value": 0.7, "low": 0.4, "high": 0.9}
    found = [{"metric": "spectral_match", "r": r, "covers": False, "why": ""}]
    panels = [
        {"subject": scale.capitalize(), "found": found, "n_items": 9, "ceiling": math.nan}
        for scale in scales
    ]  # fmt: skip
    ranges = [{"metric": "spectral_match", "low": 0.7, "high": 0.7}]
    first, *rest = render_words("metrics", panels=panels, map="", ranges=ranges)
    assert first.startswith(
        "Realism, over all 9 stimuli pooled: r = 0.70 with spectral match"
        if len(scales) == 1
        else "Over all stimuli pooled, mean ratings correlate with spectral match at r = 0.70"
    )
    assert "That is another question than the slopes answer" in first
    assert not any("another question" in line for line in rest)


PROFILE = {"subject": "Realism", "clear": True, "high": ["dft321"], "low": ["mag321"], "ways": ["high", "low"],
           "top": 80.0, "bottom": 30.0}  # fmt: skip
PAIR = {"subject": "Realism", "differ": 1, "n_pairs": 36, "same": [], "margin": None, "hint": []}


@pytest.mark.parametrize(
    ("name", "macro", "facts", "said"),
    [
        ("contrasts", "lines", {"parts": [PAIR]}, "1 of 36 pairs of reducers differs after"),
        ("contrasts", "lines", {"parts": [PAIR, PAIR | {"differ": 3, "n_pairs": 10}]},
         "In 2 sets of ratings, 1 to 3 of 10 to 36 pairs of reducers differ after"),
        ("reducers", "lines", {"parts": [PROFILE] * 2}, "In both sets of ratings the reducers rated highest"),
        ("reducers", "lines", {"parts": [PROFILE] * 3}, "In all 3 sets of ratings the reducers rated highest"),
        ("reducers", "lines", {"parts": [PROFILE, PROFILE | {"clear": False}]}, "In 1 of 2 sets of ratings the"),
        ("discrimination", "clause", {"apart": 1, "n": 3}, "1 of 3 reducers and anchors was distinguished"),
        ("told_apart", "lines", {"parts": [{"level": "", "apart": [], "n": 1, "rest": ["mag321"]}]},
         "for 0 of 1 reducers. No difference was shown for mag321"),
    ],
)  # fmt: skip
def test_counts_are_said_as_such(name: str, macro: str, facts: dict[str, Any], said: str) -> None:
    assert said in " ".join(render_words(name, macro, **facts))
