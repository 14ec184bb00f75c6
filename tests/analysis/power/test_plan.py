"""Which design is recommended, and what is said where none is enough."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from feel321 import analysis
from feel321.analysis.power import simulate
from feel321.analysis.power.truth import SIZES

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.power.draw import Scenario

    Make = Callable[..., Scenario]

TRY = {"participants": (8, 12, 24, 48), "recordings": (6, 12), "reducers": (6,), "repeats": (1, 2)}


def test_the_recommended_design_is_the_cheapest_that_is_enough(make_scenario: Make) -> None:
    case = make_scenario(participants=12, slopes={"spectral": 45.0}, recording_slope_points=0.5)
    stimuli = {name: sizes for name, sizes in TRY.items() if name != "participants"}
    plan = analysis.plan_power(case.design, case.truth, studies=0, **stimuli)
    table = plan.table
    assert plan.hypothesis == ("rating", "spectral")
    assert table["power"].between(0, 1).all()
    assert (table["enough"] == (table["power"] >= 0.8)).all()
    # The study's own stimuli are enough, so no others are recommended, whatever they would save.
    own = (table[list(SIZES[1:])] == [getattr(case.design, name) for name in SIZES[1:]]).all(axis=1)
    cost = (table["trials"] * table["participants"])[table["enough"] & own]
    chosen = table[table["recommended"]]
    assert len(chosen) == 1
    assert chosen.index[0] == cost.idxmin()
    sizes = {name: getattr(plan.recommended, name) for name in SIZES}
    assert chosen.iloc[0][list(SIZES)].to_dict() == sizes
    # One person fewer would not be enough, and the numbers are those of `find_power`.
    fewer = case.design.change(**sizes | {"participants": sizes["participants"] - 1})
    powers = [
        simulate.find_power(one, case.truth, studies=0).table.loc[0, "power"]
        for one in (plan.recommended, fewer)
    ]
    assert powers[0] == pytest.approx(chosen["power"].iloc[0])
    assert powers[0] >= 0.8 > powers[1]
    assert plan.verdict == "enough"
    assert plan.summary().splitlines()[0] == plan.answer


def test_named_numbers_of_participants_are_the_only_ones_recommended(make_scenario: Make) -> None:
    case = make_scenario(participants=12, slopes={"spectral": 45.0}, recording_slope_points=0.5)
    free = analysis.plan_power(case.design, case.truth, studies=0, recordings=(6,))
    plan = analysis.plan_power(
        case.design, case.truth, studies=0, recordings=(6,), participants=(5, 9, 31)
    )
    assert free.recommended.participants not in {5, 9, 31}
    assert plan.recommended.participants in {9, 31}


def test_other_stimuli_are_recommended_where_the_own_are_too_few(make_scenario: Make) -> None:
    case = make_scenario(slopes={"spectral": 8.0}, recording_slope_points=1.0)
    plan = analysis.plan_power(case.design, case.truth, studies=0, recordings=(6, 120, 240))
    table = plan.table
    assert not table["enough"][table["recordings"] == case.design.recordings].any()
    assert plan.recommended.recordings in {120, 240}


def test_every_design_is_listed_once(make_scenario: Make) -> None:
    case = make_scenario(participants=12)
    table = analysis.plan_power(case.design, case.truth, studies=0, **TRY).table
    tried = table[table["kind"] != "smallest"]
    assert not tried.duplicated(list(SIZES)).any()
    assert set(zip(tried["participants"], tried["recordings"], strict=True)) >= {
        (people, scenes) for people in TRY["participants"] for scenes in TRY["recordings"]
    }
    assert set(tried["repeats"]) == {1, 2}
    assert tried.iloc[0]["kind"] == "given"


def test_where_stimuli_set_the_ceiling_the_answer_says_so(make_scenario: Make) -> None:
    case = make_scenario(slopes={"spectral": 8.0})
    plan = analysis.plan_power(case.design, case.truth, studies=0, **TRY | {"recordings": (6,)})
    assert plan.recommended is None
    assert not plan.table["recommended"].any()
    assert plan.verdict == "ceiling"
    assert plan.table["ceiling"].max() < 0.8
    narrow = TRY | {"participants": (8,), "recordings": (6,), "repeats": (1,)}
    within = make_scenario(own=(2, 6), slopes={"spectral": 60.0})
    few = analysis.plan_power(
        within.design, within.truth, studies=0, **narrow | {"recordings": (2,)}
    )
    assert few.verdict == "not estimable"
    assert "number 2, where 3 are needed" in few.answer


def test_a_metric_that_stands_there_twice_is_not_blamed_on_recordings(make_scenario: Make) -> None:
    case = make_scenario()
    items = case.design.items.assign(temporal=lambda table: 2 * table["spectral"] + 1)
    design = replace(case.design, items=items)
    plan = analysis.plan_power(design, case.truth, studies=0, **TRY)
    assert plan.lack == "the metric cannot be told apart from the others"
    assert "spectral on rating cannot be tested" in " ".join(plan.notes)


def test_the_aim_is_what_can_be_tested_and_the_rest_is_named(make_scenario: Make) -> None:
    case = make_scenario(slopes={"spectral": 40.0, "temporal": 40.0})
    level = case.design.items["recording"].factorize()[0] * 1.0
    design = replace(case.design, items=case.design.items.assign(temporal=level))
    plan = analysis.plan_power(design, case.truth, studies=0, **TRY)
    assert plan.hypothesis == ("rating", "spectral")
    said = "slope of temporal on rating cannot be tested: the metric does not vary"
    assert said in " ".join(plan.notes)


def test_a_simulation_that_contradicts_the_closed_form_is_believed(make_scenario: Make) -> None:
    """Half of the people click at random, which the closed form does not know."""
    case = make_scenario(participants=8, slopes={"spectral": 70.0}, random_clickers=0.5)
    sizes = {"participants": (8,), "recordings": (6,), "reducers": (6,), "repeats": (1,)}
    plan = analysis.plan_power(case.design, case.truth, studies=8, **sizes)
    assert plan.table["enough"].any()
    seen = plan.table.dropna(subset="simulated")
    refuted = seen[seen["enough"] & (seen["simulated_high"] < 0.8)]
    assert len(refuted)
    assert not refuted["recommended"].any()
    assert plan.recommended is None
    assert plan.verdict == "refuted"
    assert plan.table["refuted"].tolist() == (plan.table["simulated_high"] < 0.8).tolist()
    assert any("Simulation contradicts the closed form" in note for note in plan.notes)


def test_after_a_refusal_clearly_larger_designs_are_simulated(make_scenario: Make) -> None:
    """Neighbours of a refuted design would be refuted too; far more people are enough in spite of the clickers."""
    case = make_scenario(participants=8, slopes={"spectral": 60.0}, random_clickers=0.4)
    sizes = {"recordings": (12,), "reducers": (6,), "repeats": (1,)}
    people = (*range(8, 15), 60)
    plan = analysis.plan_power(case.design, case.truth, studies=10, participants=people, **sizes)
    table = plan.table
    assert (table["enough"] & table["refuted"]).any()
    assert plan.recommended is not None
    assert table[table["recommended"]].iloc[0]["simulated_high"] >= 0.8


def test_a_simulation_without_tests_confirms_nothing(make_scenario: Make) -> None:
    case = make_scenario(
        slopes={"spectral": 90.0}, straight_liners=1.0, screening=("straight_lining",)
    )
    sizes = {"participants": (10,), "recordings": (6,), "reducers": (6,), "repeats": (1,)}
    plan = analysis.plan_power(case.design, case.truth, studies=1, **sizes)
    assert plan.table["enough"].any()
    assert plan.recommended is None
    assert any("no test in simulated studies" in note for note in plan.notes)


def test_what_cannot_be_planned_is_refused(make_scenario: Make) -> None:
    case = make_scenario()
    with pytest.raises(ValueError, match="rating/spectral, rating/temporal; got rating/other"):
        analysis.plan_power(case.design, case.truth, hypothesis=("rating", "other"))
    with pytest.raises(ValueError, match="plant one"):
        analysis.plan_power(case.design, analysis.Truth())


def test_results_are_kept_by_pickle_and_json(make_scenario: Make) -> None:
    case = make_scenario(own=(4, 4), participants=5)
    sizes = {"participants": (5,), "recordings": (4,), "reducers": (4,), "repeats": (1,)}
    plan = analysis.plan_power(case.design, case.truth, studies=1, **sizes)
    assert pickle.loads(pickle.dumps(plan)) == plan  # noqa: S301 - what was just written
    fields = json.loads(json.dumps(plan.to_dict(), allow_nan=False))
    assert fields["verdict"] == plan.verdict
    assert fields["powers"][0]["truth"]["slopes"] == {"spectral": 25.0}
    assert len(fields["table"]) == len(plan.to_frame())
