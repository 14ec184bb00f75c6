"""Which design is recommended, and what is said where none is enough."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from feel321 import analysis
from feel321.analysis.power.plan import find_power
from feel321.analysis.power.truth import SIZES

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.power.plan import PowerPlan
    from feel321.analysis.power.simulate import Scenario

    Make = Callable[..., Scenario]

TRY = {"participants": (8, 12, 24, 48), "recordings": (6, 12), "reducers": (6,), "repeats": (1, 2)}
ONE = {"participants": (8,), "recordings": (6,), "reducers": (6,), "repeats": (1,)}


def plan(case: Scenario, **more: Any) -> PowerPlan:
    return analysis.plan_power(case.design, case.truth, **{"studies": 0, **more})


def test_the_recommended_design_is_the_cheapest_that_is_enough(make_scenario: Make) -> None:
    case = make_scenario(participants=12, slopes={"spectral": 45.0}, recording_slope_points=0.5)
    found = plan(case, **{name: TRY[name] for name in SIZES[1:]})
    table = found.table
    assert found.hypothesis == ("rating", "spectral")
    assert (table["enough"] == (table["power"] >= 0.8)).all()
    tried = table[table["kind"] != "smallest"]
    assert not tried.duplicated(list(SIZES)).any()
    assert tried.iloc[0]["kind"] == "given"
    # The study's own stimuli are enough, so no others are recommended, whatever they would save.
    own = (table[list(SIZES[1:])] == [getattr(case.design, name) for name in SIZES[1:]]).all(axis=1)
    cost = (table["trials"] * table["participants"])[table["enough"] & own]
    assert table.index[table["recommended"]].tolist() == [cost.idxmin()]
    assert table.loc[cost.idxmin(), list(SIZES)].to_dict() == found.recommended.sizes
    # One person fewer would not be enough, and the numbers are those of `find_power`.
    fewer = replace(found.recommended, participants=found.recommended.participants - 1)
    powers = [
        find_power(one, case.truth, studies=0).table.loc[0, "power"]
        for one in (found.recommended, fewer)
    ]
    assert powers[0] == pytest.approx(table.loc[cost.idxmin(), "power"])
    assert powers[0] >= 0.8 > powers[1]
    assert found.summary().splitlines()[0] == found.answer
    named = plan(case, recordings=(6,), participants=(5, 9, 31))
    assert named.recommended.participants in {9, 31}


def test_other_stimuli_are_recommended_where_the_own_are_too_few(make_scenario: Make) -> None:
    case = make_scenario(slopes={"spectral": 8.0}, recording_slope_points=1.0)
    found = plan(case, recordings=(6, 120, 240))
    assert not found.table["enough"][found.table["recordings"] == case.design.recordings].any()
    assert found.recommended.recordings in {120, 240}


def test_every_reason_why_no_design_is_enough(make_scenario: Make) -> None:
    weak = plan(make_scenario(slopes={"spectral": 8.0}), **TRY | {"recordings": (6,)})
    assert (weak.verdict, weak.recommended) == ("ceiling", None)
    assert weak.table["ceiling"].max() < 0.8
    few = plan(make_scenario(own=(2, 6), slopes={"spectral": 60.0}), **ONE | {"recordings": (2,)})
    assert few.verdict == "not estimable"
    assert "number 2, where 3 are needed" in few.answer
    nothing = plan(make_scenario(slopes={}), hypothesis=("rating", "spectral"), **ONE)
    assert nothing.verdict == "nothing planted"
    # Half of the people click at random, which the closed form does not know: the simulation is believed.
    clickers = make_scenario(participants=8, slopes={"spectral": 70.0}, random_clickers=0.5)
    refuted = plan(clickers, studies=8, **ONE)
    assert (refuted.verdict, refuted.recommended) == ("refuted", None)
    assert refuted.table["refuted"].tolist() == (refuted.table["simulated_high"] < 0.8).tolist()
    assert any("Simulation contradicts the closed form" in note for note in refuted.notes)
    # A simulation without tests confirms nothing.
    asleep = plan(make_scenario(own=(3, 2), slopes={"spectral": 90.0}), studies=1, **ONE)
    assert asleep.recommended is None


def test_metrics_that_cannot_be_tested_are_named(make_scenario: Make) -> None:
    case = make_scenario(slopes={"spectral": 40.0, "temporal": 40.0})
    items = case.design.items
    level = items.assign(temporal=items["recording"].factorize()[0] * 1.0)
    found = analysis.plan_power(replace(case.design, items=level), case.truth, studies=0, **TRY)
    assert found.hypothesis == ("rating", "spectral")
    assert "slope of temporal on rating cannot be tested" in " ".join(found.notes)
    twin = replace(case.design, items=items.assign(temporal=2 * items["spectral"] + 1))
    assert "cannot be told apart" in analysis.plan_power(twin, case.truth, studies=0, **TRY).lack


def test_after_a_refusal_clearly_larger_designs_are_simulated(make_scenario: Make) -> None:
    """Neighbours of a refuted design would be refuted too; far more people are enough in spite of the clickers."""
    case = make_scenario(participants=8, slopes={"spectral": 60.0}, random_clickers=0.4)
    people = (*range(8, 15), 60)
    found = plan(case, studies=10, **ONE | {"recordings": (12,), "participants": people})
    table = found.table
    assert (table["enough"] & table["refuted"]).any()
    assert table[table["recommended"]].iloc[0]["simulated_high"] >= 0.8


def test_what_cannot_be_planned_is_refused(make_scenario: Make) -> None:
    case = make_scenario()
    with pytest.raises(ValueError, match="rating/spectral, rating/temporal; got rating/other"):
        plan(case, hypothesis=("rating", "other"))
    with pytest.raises(ValueError, match="plant one"):
        analysis.plan_power(case.design, analysis.Truth())
    with pytest.raises(ValueError, match="studies must be 0 or more"):
        plan(case, studies=-1)


def test_results_are_kept_by_pickle_and_json(make_scenario: Make) -> None:
    case = make_scenario(own=(4, 4), participants=5)
    sizes = {"participants": (5,), "recordings": (4,), "reducers": (4,), "repeats": (1,)}
    found = plan(case, studies=1, **sizes)
    assert pickle.loads(pickle.dumps(found)) == found  # noqa: S301 - what was just written
    fields = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert fields["verdict"] == found.verdict
    assert fields["powers"][0]["truth"]["slopes"] == {"spectral": 25.0}
    assert len(fields["table"]) == len(found.to_frame())
