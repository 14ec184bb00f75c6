"""Claims of papers: verdicts follow from intervals, and planted effects answer the claims of Park and of Lee."""

import math
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pandas as pd
import pytest

from feel321.analysis import replication
from feel321.analysis.primary.model import fit_slopes
from feel321.analysis.primary.plan import REDUCER, make_cells
from feel321.analysis.primary.sensitivity import measure_excess
from feel321.analysis.replication import (
    ClaimValue,
    Paper,
    PaperAnswer,
    PaperClaim,
    answer_claims,
    describe_nearest,
    explain_spread,
    judge,
)
from feel321.analysis.report import answer as opening
from feel321.analysis.report import primary
from feel321.analysis.report.section import Found
from feel321.analysis.resampling import Choices
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import Further, read_table
from feel321.analysis.words import render_words
from feel321.records import MEASURES

CLAIM = PaperClaim("one", "It is so", "ours", "slope")
NEAR = replace(CLAIM, expect="near", paper=(0.5, 0.4, 0.6))


def test_every_registered_measure_is_a_function() -> None:
    assert all(callable(getattr(replication, function)) for function in MEASURES.values())


@pytest.mark.parametrize(
    ("claim", "ends", "verdict"),
    [
        (CLAIM, (1, 0.5, 1.5), "agrees"),
        (CLAIM, (1, -0.5, 1.5), "open"),
        (CLAIM, (-1, -1.5, -0.5), "differs"),
        (CLAIM, (math.nan, math.nan, math.nan), "not_estimable"),
        (replace(CLAIM, expect="negative"), (-1, -1.5, -0.5), "agrees"),
        (replace(CLAIM, expect="negative"), (1, 0.5, 1.5), "differs"),
        (NEAR, (0.45, 0.1, 0.9), "agrees"),
        (NEAR, (0.8, 0.5, 1.1), "open"),
        (NEAR, (0.8, 0.7, 0.9), "differs"),
        (NEAR, (0.8, math.nan, math.nan), "differs"),
    ],
)
def test_a_verdict_follows_from_the_interval(
    claim: PaperClaim, ends: tuple[float, float, float], verdict: str
) -> None:
    assert judge(claim, ClaimValue(*ends)) == verdict


@pytest.mark.parametrize(
    ("gaps", "verdict"),
    [
        ({"b": (1, 0.5, 1.5), "c": (2, 1, 3)}, "agrees"),
        ({"b": (1, -0.5, 1.5), "c": (2, 1, 3)}, "open"),
        ({"b": (-1, -1.5, -0.5), "c": (2, 1, 3)}, "differs"),
        ({"b": (0.004, math.nan, math.nan), "c": (2, 1, 3)}, "open"),
        ({"b": (0.006, math.nan, math.nan), "c": (2, 1, 3)}, "agrees"),
        ({}, "not_estimable"),
    ],
)
def test_the_highest_is_above_all_others_and_the_lowest_below(
    gaps: dict[str, tuple[float, float, float]], verdict: str
) -> None:
    found = ClaimValue(5, 4, 6, beside=gaps)
    assert judge(replace(CLAIM, expect="highest"), found) == verdict
    turned = {name: (-value, -high, -low) for name, (value, low, high) in gaps.items()}
    assert judge(replace(CLAIM, expect="lowest"), replace(found, beside=turned)) == verdict


@pytest.mark.parametrize(
    ("gap", "told"),
    [
        ((0.31, 0.28, 0.35), "0.31 higher than that of b (0.28 to 0.35)"),
        ((-0.31, -0.35, -0.28), "0.31 lower than that of b (0.28 to 0.35)"),
        ((-0.001, math.nan, math.nan), "the same as that of b"),
    ],
)
def test_the_nearest_of_the_others_is_named_with_the_way_the_difference_goes(
    gap: tuple[float, float, float], told: str
) -> None:
    assert describe_nearest({"c": (2, 1, 3), "b": gap}, upward=True, kind="correlation") == told


KEPT = {"saz321": 0.15, "mag321": 0.3, "soc321": 0.5, "pca321": 0.62, "dft321": 0.85, "original": 1.0}  # fmt: skip
"""Planted: dissimilarity is 60 points times the difference in this."""

LOST = {"saz321": 0.4, "mag321": 0.9, "soc321": 0.2, "pca321": 0.7, "dft321": 0.3, "original": 1.0}
"""In no relation to what was felt."""


def plant(*, far: float = 60.0, people: int = 8, seed: int = 0) -> Table:
    rng = np.random.default_rng(seed)
    rows, stimuli = [], []
    for recording in ("tap", "drag", "slide"):
        for name, kept in KEPT.items():
            role = "reference" if name == "original" else "test"
            stimuli.append((f"{recording}-{name}", recording, name, role, kept, LOST[name]))
        for one, two in combinations_with_replacement(KEPT, 2):
            if one != two or one == "original":
                felt = 5 + far * abs(KEPT[one] - KEPT[two]) + rng.normal(0, 4, people)
                ids = (f"{recording}-{one}", f"{recording}-{two}")
                rows += [(f"p{who}", *ids, rating) for who, rating in enumerate(felt.clip(0, 100))]
    ratings = pd.DataFrame(rows, columns=["participant", "stimulus_id", "reference_id", "rating"])
    ratings = ratings.assign(scale="dissimilarity", trial=range(1, len(rows) + 1))
    columns = ["stimulus_id", "recording", "reducer", "role", "spectral_match_bounded", "temporal_match"]  # fmt: skip
    return read_table(ratings, pd.DataFrame(stimuli, columns=columns).assign(level="as_is"))


def ask(table: Table, measure: str, **options: str) -> PaperAnswer:
    options = {"scale": "dissimilarity", **options}
    claim = PaperClaim("one", "a claim", "abstract", measure, options=options)
    (answer,) = answer_claims(table, Paper("a", "10.1", "abstract", (claim,)), Choices(draws=720))
    return answer


def test_the_least_clear_reducer_answers_whether_all_are_told_apart() -> None:
    answer = ask(plant(), "one_axis_against_three")
    assert answer.verdict == "agrees"
    assert answer.found is not None
    assert answer.found.low < 60 * (1 - KEPT["dft321"]) < answer.found.high
    assert "This is dft321, the least clear of 5 reducers" in answer.sentence
    alone = ask(plant(), "one_axis_against_three", reducer="saz321")
    assert alone.found is not None
    assert alone.found.low < 60 * (1 - KEPT["saz321"]) < alone.found.high


def test_nobody_who_feels_no_difference_agrees() -> None:
    assert ask(plant(far=0.0), "one_axis_against_three").verdict != "agrees"


def test_an_attribute_of_the_axes_is_told_from_one_that_is_not_and_from_too_few() -> None:
    table = plant()
    names = ("spectral_match_bounded", "temporal_match", "directions")
    found = {name: ask(table, "map_attribute", attribute=name) for name in names}
    assert {name: one.verdict for name, one in found.items()} == {
        "spectral_match_bounded": "agrees",
        "temporal_match": "open",
        "directions": "not_estimable",
    }
    assert "permutations of 6 stimuli give no p below 0.17" in found["directions"].sentence
    assert "attribute must be one of" in ask(table, "map_attribute", attribute="colour").sentence


MEAN, SD = "temporal_match_rotation_mean", "temporal_match_rotation_sd"
REDUCERS = ("say321", "saz321", "soc321", "mag321", "pca321", "dft321")
MEANS = dict(zip(REDUCERS, (0.50, 0.48, 0.60, 0.02, 0.70, 0.66), strict=True))
SPREADS = dict(zip(REDUCERS, (0.20, 0.30, 0.18, 0.01, 0.25, 0.08), strict=True))
SLOPES = {MEAN: 50.0, SD: -40.0}


def make_table(
    *,
    bonus: float = 0.0,
    spreads: dict[str, float] = SPREADS,
    seed: int = 1,
    gain: float | None = None,
) -> Table:
    """Ratings of twelve people who follow mean and spread, and mag321 a bonus besides."""
    rng = np.random.default_rng(seed)
    scenes = [f"s{number}" for number in range(8)]
    manifest = pd.DataFrame(
        [
            {"stimulus_id": f"{scene}-{reducer}", "recording": scene, "reducer": reducer, "temporal_match": 0.5,
             MEAN: MEANS[reducer] + rng.normal(0, 0.05) * (reducer != "mag321"),
             SD: spreads[reducer] * rng.uniform(0.7, 1.3)}
            for scene in scenes for reducer in REDUCERS
        ]
    )  # fmt: skip
    felt = 20 + manifest[MEAN] * SLOPES[MEAN] + manifest[SD] * SLOPES[SD]
    felt += bonus * (manifest["reducer"] == "mag321") + rng.normal(0, 2, len(felt))
    rows = [
        {"participant": f"p{who}", "stimulus_id": name, "scale": "similarity", "trial": trial,
         "rating": float(np.clip(level + mean + rng.normal(0, 6), 0, 100))}
        for who in range(12)
        for level in [rng.normal(0, 5)]
        for trial, (name, mean) in enumerate(zip(manifest["stimulus_id"], felt, strict=True))
    ]  # fmt: skip
    ratings = pd.DataFrame(rows)
    if gain is not None:
        manifest["gain"], ratings["reference_id"] = gain, "surface"
    statistics = manifest.set_index("stimulus_id")[[MEAN, SD]]
    further = Further(statistics, ("Rotation statistics.",))
    return read_table(
        ratings, manifest.drop(columns=[MEAN, SD]), metrics=[MEAN, SD], further=further
    )


def test_a_spread_that_rises_with_its_mean_is_explained() -> None:
    told = explain_spread(make_table().rows, SD)
    assert "nothing to lose when the sensor turns, and mag321 has the lowest mean (0.02)" in told
    assert "and the smallest spread (0.01)" in told
    steady = make_table(spreads=dict.fromkeys(REDUCERS, 0.2) | {"mag321": 0.05, "soc321": 0.01})
    assert "reducers that match better vary more (mag321: " in explain_spread(steady.rows, SD)
    falling = make_table(spreads={name: 0.8 - mean for name, mean in MEANS.items()})
    assert explain_spread(falling.rows, SD) == ""


def test_the_report_holds_the_plants_and_explains_the_spread() -> None:
    section = primary.compute(make_table(), Choices(draws=2))
    for row in section.rows["slopes"]:
        if row["quantity"] == "slope":
            assert row["low"] < SLOPES[row["metric"]] / 10 < row["high"]
    said = render_words("primary", **section.facts)
    (line,) = [line for line in said if "spread over orientations" in line]
    assert "no merit by itself" in line
    assert "opposite direction" not in " ".join(said)


def say(found: Found) -> tuple[str, ...]:
    return render_words("paper", **found.facts)


# The measures of the paper's claims.

CLAIMS = (
    PaperClaim("mean", "the mean is felt", "abstract", "correlation", exceptions=("mag321",),
               options={"metric": MEAN, "method": "within"}),
    PaperClaim("spread", "the spread is felt", "abstract", "correlation", "negative", exceptions=("mag321",),
               options={"metric": SD, "method": "within"}),
    PaperClaim("excess", "vector magnitude feels good", "abstract", "rating_excess", options={"reducer": "mag321"}),
)  # fmt: skip


def answer(table: Table) -> dict[str, PaperAnswer]:
    paper = Paper("Park & Kuchenbecker 2019", "10.1109/WHC.2019.8816148", "abstract", CLAIMS)
    return {one.claim.name: one for one in answer_claims(table, paper, Choices(draws=200, seed=1))}


def test_claims_are_answered_with_and_without_the_exception() -> None:
    found = answer(make_table(bonus=45))
    mean, spread, excess = (found[name] for name in ("mean", "spread", "excess"))
    assert mean.found.value < 0 < mean.without.low
    assert "without mag321 0." in mean.sentence
    assert spread.without.high < 0
    assert excess.verdict == "agrees"
    assert excess.found.low < 45 < excess.found.high
    assert excess.without is None


def test_no_excess_is_found_where_none_was_planted() -> None:
    for seed in range(6):
        table = make_table(seed=seed)
        cells = make_cells(table.rows, table.metrics)
        others = fit_slopes(cells.leave_out(REDUCER, "mag321"))
        excess, se, _ = measure_excess(cells, "mag321", others)
        assert abs(excess) < 2 * se
        items = table.rows.drop_duplicates("stimulus_id")
        means = items.groupby("reducer", observed=True)[[MEAN, SD]].mean()
        gap = means.loc["mag321"] - means.drop("mag321").mean()
        alone = others.solved.estimate({f"{name}_w": gap[name] for name in (MEAN, SD)})
        assert se > alone.se
    section = primary.compute(table, Choices(draws=2))
    assert not any(row["note"] == "yes" for row in section.rows["exceptions"])


def test_the_first_sentence_names_a_planted_surprise() -> None:
    table, choices = make_table(bonus=45), Choices(draws=50)
    paper = Paper("Park & Kuchenbecker 2019", "10.1109/WHC.2019.8816148", "abstract", CLAIMS)
    found = {"primary": primary.compute(table, choices)}
    first = say(opening.compute_paper(table, choices, paper=paper, others=found))[1]
    assert "mag321 was rated 4" in first.lower()
    assert "points higher than the metrics predict from the other reducers" in first
    assert "the paper names it as an exception too" in first
