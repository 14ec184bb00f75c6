from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from study.plan import Plan, create_plan, find_differences, make_plan, require_plan

if TYPE_CHECKING:
    from pathlib import Path

    from stimuli.manifest import StimulusSet


def test_a_plan_holds_every_stimulus_once_per_protocol(plan: Plan, stimuli: StimulusSet) -> None:
    ids = sorted(stimulus.stimulus_id for stimulus in stimuli.stimuli)
    for protocol in ("realism", "similarity"):
        assert sorted(t.stimulus_id for t in plan.trials if t.protocol == protocol) == ids
    assert {t.reference_id for t in plan.trials if t.protocol == "similarity"} == {"bumps-original", "taps-original"}


def test_same_arguments_give_the_same_digest_and_any_other_another(plan: Plan, stimuli: StimulusSet) -> None:
    usual = {"number": 1, "seed": 7, "protocols": ("realism", "similarity"), "repeats": 1}
    assert make_plan(stimuli, "p01", **usual).sha256 == plan.sha256
    changes = {"number": 2, "seed": 8, "protocols": ("similarity", "realism"), "repeats": 2}
    others = {make_plan(stimuli, "p01", **usual | {name: value}).sha256 for name, value in changes.items()}
    others.add(make_plan(stimuli, "p02", **usual).sha256)
    others.add(make_plan(replace(stimuli, sha256="6"), "p01", **usual).sha256)
    assert len(others - {plan.sha256}) == 6


@pytest.mark.parametrize("name", ["", "a b", "../a", "-a", "ä"])
def test_participants_are_called_what_a_folder_can_be_called(stimuli: StimulusSet, name: str) -> None:
    with pytest.raises(ValueError, match=r"participant: got .*, allowed are letters, digits, - and _"):
        make_plan(stimuli, name, number=1, seed=1, protocols=("realism",), repeats=1)


def test_unknown_protocols_are_refused_with_the_list(stimuli: StimulusSet) -> None:
    with pytest.raises(ValueError, match="protocols: got 'realsim', allowed: realism, similarity"):
        make_plan(stimuli, "p01", number=1, seed=1, protocols=("realsim",), repeats=1)


def test_a_stored_plan_is_read_back_and_never_overwritten(plan: Plan, tmp_path: Path) -> None:
    create_plan(tmp_path / "plan.json", plan)
    assert require_plan(tmp_path / "plan.json") == plan
    with pytest.raises(FileExistsError, match="is there already, nothing is overwritten"):
        create_plan(tmp_path / "plan.json", plan)


def test_a_changed_plan_is_refused(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    entry = json.loads(path.read_text(encoding="utf-8"))
    entry["trials"][0], entry["trials"][1] = entry["trials"][1], entry["trials"][0]
    path.write_text(json.dumps(entry), encoding="utf-8")
    with pytest.raises(ValueError, match=r"plan\.json: was changed after it was stored"):
        require_plan(path)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"sha256": "", "trials": [1]}'])
def test_what_is_no_plan_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "plan.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match="got no plan"):
        require_plan(tmp_path / "plan.json")


def test_differences_are_named(plan: Plan, stimuli: StimulusSet) -> None:
    assert find_differences(plan, plan) == []
    other = make_plan(stimuli, "p01", number=1, seed=8, protocols=("realism",), repeats=1)
    assert find_differences(plan, other) == [
        "seed 7 -> 8",
        "protocols ('realism', 'similarity') -> ('realism',)",
        "20 trials -> 10",
        "order of trials, first at trial 1",
    ]
