"""What the primary model is said to show: a direction where Holm's p leaves no doubt, and what it hinges on."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.primary import sensitivity
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import Influence, find_candidates
from feel321.analysis.report import primary
from feel321.analysis.report.primary import keep_steady
from feel321.analysis.report.section import Found, find_row, read_declared
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table
from feel321.analysis.words import render_words
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS

METRICS = ("spectral_match_bounded", "temporal_match")
TIDY = ("spectral_match", "temporal_match")


def plant(
    *, seed: int = 1, people: int = 6, recordings: int = 6, spectral: float = 40.0, temporal: float = 30.0, **odd: Any,
) -> pd.DataFrame:  # fmt: skip
    """Rate stimuli by two metrics, both drawn evenly from 0 to 1; `odd` changes what one reducer has or is felt as."""
    rng = np.random.default_rng(seed)
    stimuli = pd.MultiIndex.from_product(
        [range(recordings), DEFAULT_REDUCERS], names=["recording", "reducer"]
    )
    items = stimuli.to_frame(index=False).assign(
        recording=lambda frame: "rec" + frame["recording"].astype(str)
    )
    for name in METRICS:
        items[name] = rng.uniform(0, 1, len(items))
    own = items["reducer"] == odd.get("reducer")
    if "metric" in odd:
        items.loc[own, METRICS[0]] = odd["metric"][: own.sum()]
    slope = np.where(own, odd.get("slope", spectral), spectral)
    felt = (
        20 + slope * items[METRICS[0]] + temporal * items[METRICS[1]] + own * odd.get("points", 0.0)
    )
    items["stimulus_id"] = items["recording"] + "_" + items["reducer"]
    rows = [
        items.assign(
            participant=f"p{person}", rating=felt + rng.normal(0, 4) + rng.normal(0, 4, len(items))
        )
        for person in range(people)
    ]
    whole = pd.concat(rows, ignore_index=True)
    common = {
        "scale": "realism", "level": "as_is", "role": "test", "simulated": True, "repeat": "1",
    }  # fmt: skip
    return whole.assign(
        **common, source=whole["recording"], reference_id="", item=whole["stimulus_id"]
    )


def compute(rows: pd.DataFrame, metrics: tuple[str, ...] = METRICS) -> Found:
    return primary.compute(Table(rows, metrics, ()), Choices(draws=2))


def say(found: Found) -> list[str]:
    return [
        line.replace("\N{NO-BREAK SPACE}", " ") for line in render_words("primary", **found.facts)
    ]


def tell(rows: pd.DataFrame) -> tuple[dict[str, float], list[str], str]:
    """Holm's p per metric, the sentence of each metric, and all that is said."""
    found = compute(rows, TIDY)
    p = {row["metric"]: row["p"] for row in found.rows["slopes"] if row["quantity"] == "slope"}
    lines = say(found)
    return p, lines[1:3], " ".join(lines)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave nothing out: what single units do is another test's."""
    nothing = Influence(pd.DataFrame(), pd.DataFrame({"exceptional": []}))
    monkeypatch.setattr(sensitivity, "measure_influence", lambda *_, **__: nothing)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("slope", "way"), [(30.0, "higher"), (-30.0, "lower")])
def test_a_direction_follows_the_sign_and_few_recordings_weaken_it(
    tidy: Callable[..., pd.DataFrame], slope: float, way: str
) -> None:
    p, (spectral, temporal), whole = tell(tidy(1, participants=8, recordings=4, spectral=slope))
    assert p["spectral_match"] < 0.05 <= p["temporal_match"]
    assert spectral.startswith("Realism: Spectral match predicts realism ratings")
    against = "in the opposite direction (higher spectral match, lower ratings)" in spectral
    assert against == (way == "lower")
    assert ("points higher" in spectral) == (way == "higher")
    assert temporal.startswith("Realism: Whether temporal match predicts realism ratings is open.")
    better = "comparison: spectral match predicts realism ratings better than temporal match."
    assert (better in whole) == (way == "higher")
    assert "With 4 recordings this is a hint rather than a result. No" in whole


@pytest.mark.usefixtures("quick")
def test_what_holds_before_holms_adjustment_only_is_not_claimed(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate = primary.tabulate_slopes
    changed = {"p": 0.03, "p_holm": 0.06}
    monkeypatch.setattr(
        primary, "tabulate_slopes", lambda models: tabulate(models).assign(**changed)
    )
    _, answers, whole = tell(tidy(1, participants=8, recordings=4))
    assert all("is open." in answer and "p (Holm) = 0.060" in answer for answer in answers)
    assert "predicts realism ratings." not in whole


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda _: 0.5, "the stimuli of a recording do not differ in it"),
        (lambda rows: 1 - rows["spectral_match"], "within recordings it follows from the other metrics"),
    ],
)  # fmt: skip
def test_a_declared_metric_without_a_slope_is_not_passed_over(
    tidy: Callable[..., pd.DataFrame], change: Callable[[pd.DataFrame], object], why: str
) -> None:
    found = compute(tidy(1, participants=4, recordings=4).assign(temporal_match=change), TIDY)
    lead = "Realism: Whether temporal match predicts realism ratings cannot be estimated"
    assert f"{lead}: {why}." in say(found)
    verdicts = {one["metric"]: one["verdict"] for one in found.verdicts}
    assert verdicts["temporal_match"] == "not_estimable"
    assert list(verdicts) == list(TIDY)


# What single stimuli, recordings and reducers do to the slopes: planted, found and named.


def plant_flipping() -> pd.DataFrame:
    # Fewer recordings leave too few degrees of freedom, as their slopes all come from this reducer.
    metric = np.linspace(-3, 3, 12)
    return plant(spectral=0.0, recordings=12, reducer="mag321", metric=metric, slope=8.0)


@pytest.fixture(scope="module")
def flipping() -> Found:
    """One reducer alone makes the slope: it is rated by the metric, and all others whatever it is."""
    return compute(plant_flipping())


def test_a_verdict_that_one_reducer_turns_names_it_first(flipping: Found) -> None:
    spectral, temporal = flipping.verdicts
    assert (spectral["verdict"], spectral["direction"]) == ("predicts", "higher")
    assert "reducer mag321" in spectral["hinges_on"]
    assert (temporal["verdict"], temporal["hinges_on"]) == ("predicts", [])
    said = say(flipping)
    assert "hinges on the reducer mag321: without it the association is open" in said[1]
    assert said[3] == "Realism, comparison: the data do not show which metric predicts better."
    shown = read_declared("primary")[0]["models"].show(flipping.rows["models"])
    sizes = dict(zip(shown["head"], shown["rows"][0], strict=True))
    units = [sizes[name] for name in ("Participants", "Recordings", "Reducers")]
    assert units == ["6", "12", str(len(DEFAULT_REDUCERS))]


def test_every_omission_is_a_refit_of_the_rest(flipping: Found) -> None:
    rows = plant_flipping()
    rest = fit_primary(rows[rows["reducer"] != "mag321"], METRICS, explain=False)
    slopes = [row for row in flipping.rows["influence"] if row["quantity"] == "slope"]
    row = find_row(slopes, "slope", unit="mag321", metric=METRICS[0])
    assert row["value"] == pytest.approx(rest.slopes.loc[METRICS[0], "tenth"], rel=1e-6)
    kinds = [row["kind"] for row in slopes]
    assert {kind: kinds.count(kind) for kind in ("recording", "reducer")} == {
        "recording": 24,
        "reducer": 18,
    }


def test_points_planted_on_a_reducer_are_named_and_the_slopes_hold() -> None:
    found = compute(plant(reducer="mag321", points=45.0))
    (line,) = [line for line in say(found) if ", exceptions: " in line]
    assert "mag321 was rated 4" in line
    assert "points higher than the metrics predict from the other reducers" in line
    odd = [row["reducer"] for row in found.rows["exceptions"] if row["note"] == "yes"]
    assert odd == ["mag321"]
    assert find_row(found.rows["exceptions"], "excess", reducer="mag321")["value"] == pytest.approx(
        45, abs=3
    )
    for name, planted in zip(METRICS, (4.0, 3.0), strict=True):
        row = find_row(found.rows["slopes"], "slope", metric=name)
        assert row["low"] < planted < row["high"]
    assert all(one["verdict"] == "predicts" and not one["hinges_on"] for one in found.verdicts)


def test_an_outlying_stimulus_is_found_and_named() -> None:
    rows = plant().rename(columns={METRICS[0]: "spectral_match"})
    rows.loc[rows["item"] == "rec2_mag321", "spectral_match"] = -781.0
    found = compute(rows, TIDY)
    spectral, _ = found.verdicts
    assert (spectral["verdict"], spectral["direction"]) == (
        "predicts",
        "higher",
    )  # planted: 4 points
    assert spectral["hinges_on"] == []
    said = say(found)
    assert "the stimulus rec2_mag321" in said[1]
    assert any(", unbounded metric: " in line for line in said)
    assert not any("mag321 was rated" in line for line in said)


@pytest.mark.parametrize("outlying", [None, -50.0])
def test_candidates_are_those_that_move_a_regression_most(outlying: float | None) -> None:
    rows = plant(people=3, recordings=4, seed=5)
    if outlying is not None:
        rows.loc[rows["item"] == "rec1_pca321", METRICS[0]] = outlying
    wanted = {"recording": "first", "rating": "mean", METRICS[0]: "first", METRICS[1]: "first"}
    items = rows.groupby("item", sort=False).agg(wanted)

    def regress(table: pd.DataFrame) -> np.ndarray:
        dummies = pd.get_dummies(table["recording"]).astype(float)
        design = np.column_stack([table[list(METRICS)], dummies])
        return np.linalg.lstsq(design, table["rating"], rcond=None)[0][:2]

    whole = regress(items)
    moved = [regress(items.drop(name)) - whole for name in items.index]
    changes = pd.DataFrame(moved, index=items.index).abs()
    for count in (1, 3):
        found = find_candidates(make_cells(rows.drop(columns="reducer"), METRICS), count=count)
        assert set(found) == {*changes[0].nlargest(count).index, *changes[1].nlargest(count).index}


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (plant(people=2), "cannot be estimated with 2 participants: at least 3 are needed."),
        (plant(recordings=1), "cannot be estimated with 1 recording: at least 3 are needed."),
        (plant(people=1, recordings=2), "with 1 participant and 2 recordings: at least 3 are needed of each."),
        (plant(people=3).assign(rating=50.0), "cannot be estimated: all ratings are the same."),
    ],
)  # fmt: skip
def test_what_cannot_be_estimated_is_said_and_nothing_else(rows: pd.DataFrame, why: str) -> None:
    found = compute(rows)
    assert [one["verdict"] for one in found.verdicts] == ["not_estimable"] * 2
    assert not any(one["direction"] or one["hinges_on"] for one in found.verdicts)
    _, line = say(found)
    start = "Realism: Whether bounded spectral match or temporal match predicts realism ratings"
    assert line.startswith(start)
    assert line.endswith(why)
    assert all(math.isnan(row["low"]) for row in found.rows["slopes"])


def test_no_metric_is_better_than_one_whose_verdict_a_single_unit_turns() -> None:
    steady = {"metric": "a", "hinges_on": [], "better_than": ["b", "c"]}
    unsteady = {"metric": "b", "hinges_on": ["recording oak"], "better_than": []}
    assert keep_steady([steady, unsteady]) == [steady | {"better_than": ["c"]}, unsteady]


def test_variants_without_any_interval_tell_nothing() -> None:
    said = {known: render_words("robustness", turned=[], known=known)[0] for known in (True, False)}
    assert said[True].endswith("tells the same as in the primary model.")
    assert said[False].startswith("No slope can be estimated")
