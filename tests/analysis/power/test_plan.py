"""Which design is recommended, and what is said where none is enough."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from feel321.analysis.power.design import SIZES, PowerDesign
from feel321.analysis.power.plan import PowerPlan, find_power, plan_power, simulate_studies

Make = Callable[..., PowerDesign]

TRY = {"participants": (8, 12, 24, 48), "recordings": (6, 12), "reducers": (6,), "repeats": (1, 2)}
ONE = {"participants": (8,), "recordings": (6,), "reducers": (6,), "repeats": (1,)}


def plan(case: PowerDesign, studies: int = 0, **sizes: Any) -> PowerPlan:
    simulate = partial(simulate_studies, studies=studies) if studies else None
    return plan_power(case, sizes, simulate=simulate)


def test_the_recommended_design_is_the_cheapest_that_is_enough(make_design: Make) -> None:
    case = make_design(participants=12, slopes={"spectral": 45.0}, recording_slope_points=0.5)
    found = plan(case, **{name: TRY[name] for name in SIZES[1:]})
    table = found.table
    assert found.hypothesis == ("rating", "spectral")
    assert (table["enough"] == (table["power"] >= 0.8)).all()
    tried = table[table["kind"] != "smallest"]
    assert not tried.duplicated(list(SIZES)).any()
    assert tried.iloc[0]["kind"] == "given"
    # The study's own stimuli are enough, so no others are recommended, whatever they would save.
    own = (table[list(SIZES[1:])] == [getattr(case, name) for name in SIZES[1:]]).all(axis=1)
    cost = (table["trials"] * table["participants"])[table["enough"] & own]
    assert table.index[table["recommended"]].tolist() == [cost.idxmin()]
    assert table.loc[cost.idxmin(), list(SIZES)].to_dict() == found.recommended.sizes
    # One person fewer would not be enough, and the numbers are those of `find_power`.
    fewer = replace(found.recommended, participants=found.recommended.participants - 1)
    powers = [find_power(one).table.loc[0, "power"] for one in (found.recommended, fewer)]
    assert powers[0] == table.loc[cost.idxmin(), "power"]
    assert powers[0] >= 0.8 > powers[1]
    named = plan(case, recordings=(6,), participants=(5, 9, 31))
    assert named.recommended.participants in {9, 31}


def test_other_stimuli_are_recommended_where_the_own_are_too_few(make_design: Make) -> None:
    case = make_design(slopes={"spectral": 8.0}, recording_slope_points=1.0)
    found = plan(case, recordings=(6, 120, 240))
    assert not found.table["enough"][found.table["recordings"] == case.recordings].any()
    assert found.recommended.recordings in {120, 240}


def test_every_reason_why_no_design_is_enough(make_design: Make) -> None:
    weak = plan(make_design(slopes={"spectral": 8.0}), **TRY | {"recordings": (6,)})
    assert (weak.verdict, weak.recommended) == ("ceiling", None)
    assert weak.table["ceiling"].max() < 0.8
    few = plan(make_design(own=(2, 6), slopes={"spectral": 60.0}), **ONE | {"recordings": (2,)})
    assert few.verdict == "not estimable"
    assert "number 2, where 3 are needed" in few.lack
    assert plan(make_design(slopes={}), **ONE).verdict == "nothing planted"
    # Most ratings are at the end of the scale, which the closed form does not know: the simulation is believed.
    high = make_design(participants=8, slopes={"spectral": 70.0}, mean=110.0)
    refuted = plan(high, studies=8, **ONE)
    assert (refuted.verdict, refuted.recommended) == ("refuted", None)
    assert refuted.table["refuted"].tolist() == (refuted.table["simulated_high"] < 0.8).tolist()
    assert any("Simulation contradicts the closed form" in note for note in refuted.notes)
    # A simulation without tests confirms nothing.
    asleep = plan(make_design(own=(3, 2), slopes={"spectral": 90.0}), studies=1, **ONE)
    assert asleep.recommended is None


def test_metrics_that_cannot_be_tested_are_named(make_design: Make) -> None:
    case = make_design(slopes={"spectral": 40.0, "temporal": 40.0})
    level = case.items.assign(temporal=case.items["recording"].factorize()[0] * 1.0)
    found = plan_power(replace(case, items=level), TRY, aims=(0, 1))
    assert found.hypothesis == ("rating", "spectral")
    assert "slope of temporal on rating cannot be tested" in " ".join(found.notes)
    twin = replace(case, items=case.items.assign(temporal=2 * case.items["spectral"] + 1))
    assert "cannot be told apart" in plan(twin, **TRY).lack


def test_after_a_refusal_clearly_larger_designs_are_simulated(make_design: Make) -> None:
    """Neighbours of a refuted design would be refuted too; far more people are enough in spite of the scale's end."""
    case = make_design(participants=8, slopes={"spectral": 60.0}, mean=110.0)
    people = (*range(8, 15), 60)
    found = plan(case, studies=10, **ONE | {"recordings": (12,), "participants": people})
    table = found.table
    assert (table["enough"] & table["refuted"]).any()
    assert table[table["recommended"]].iloc[0]["simulated_high"] >= 0.8
