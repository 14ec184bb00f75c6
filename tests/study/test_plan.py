from __future__ import annotations

import json
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Any

import pytest

from study.chain import digest
from study.plan import Plan, create_plan, find_differences, make_plan, require_plan

if TYPE_CHECKING:
    from pathlib import Path

    from stimuli.manifest import StimulusSet


def test_a_plan_holds_every_stimulus_once_per_protocol(plan: Plan, stimuli: StimulusSet) -> None:
    ids = sorted(stimulus.stimulus_id for stimulus in stimuli.stimuli)
    for protocol in ("realism", "similarity"):
        assert sorted(t.stimulus_id for t in plan.trials if t.protocol == protocol) == ids
    assert {t.reference_id for t in plan.trials if t.protocol == "similarity"} == {"bumps-original", "taps-original"}


def test_same_arguments_give_the_same_digest_and_any_other_another(stimuli: StimulusSet, tmp_path: Path) -> None:
    def store(stimuli: StimulusSet = stimuli, name: str = "p01", **changes: Any) -> str:
        path = tmp_path / f"{next(numbers)}.json"
        usual: dict[str, Any] = {"number": 1, "seed": 7, "protocols": ("realism", "similarity"), "repeats": 1}
        create_plan(path, make_plan(stimuli, name, **usual | changes))
        return require_plan(path).sha256

    numbers = count()
    assert store() == store()
    changes = {"number": 2, "seed": 8, "protocols": ("similarity", "realism"), "repeats": 2}
    digests = {store(), *(store(**{name: value}) for name, value in changes.items())}
    digests |= {store(name="p02"), store(replace(stimuli, sha256="6"))}
    assert len(digests) == 7


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


def test_a_stored_plan_survives_a_power_cut(plan: Plan, tmp_path: Path, synced: list[int]) -> None:
    create_plan(tmp_path / "plan.json", plan)
    assert synced == [(tmp_path / "plan.json").stat().st_ino, tmp_path.stat().st_ino]


def test_the_digest_is_that_of_the_bytes_before_it(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    body, _, rest = path.read_text(encoding="utf-8").partition(',\n "sha256": ')
    stored = require_plan(path)
    assert rest == f'"{digest(body + chr(10) + "}")}"\n}}\n'
    assert json.loads(path.read_text(encoding="utf-8"))["sha256"] == stored.sha256 == digest(body + "\n}")


def test_a_plan_stored_before_a_field_of_trials_was_added_is_still_good(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    body = path.read_text(encoding="utf-8").partition(',\n "sha256": ')[0] + "\n}"
    # As if `reference_id`, which has a default, had come into `Trial` after this plan was stored.
    old = body.replace(',\n   "reference_id": null', "")
    assert old != body
    path.write_text(f'{old[:-2]},\n "sha256": "{digest(old)}"\n}}\n', encoding="utf-8")
    assert require_plan(path) == plan
    assert require_plan(path).sha256 == digest(old)


def test_a_plan_of_another_format_is_refused(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "plan.json"
    with monkeypatch.context() as later:
        later.setattr("study.plan.FORMAT", 2)
        create_plan(path, plan)
    with pytest.raises(ValueError, match=r"plan\.json: got a plan of format 2, allowed is 1; use the feel321"):
        require_plan(path)


def test_a_changed_plan_is_refused(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    entry = json.loads(path.read_text(encoding="utf-8"))
    entry["trials"][0], entry["trials"][1] = entry["trials"][1], entry["trials"][0]
    path.write_text(json.dumps(entry), encoding="utf-8")
    with pytest.raises(ValueError, match="got no plan, or one that was changed after it was stored; restore the file"):
        require_plan(path)


@pytest.mark.parametrize("content", ["", "null", "[]", "{}", '{"sha256": "", "trials": [1]}'])
def test_what_is_no_plan_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "plan.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match="got no plan"):
        require_plan(tmp_path / "plan.json")


def test_differences_are_named(plan: Plan, stimuli: StimulusSet) -> None:
    assert find_differences(plan, plan) == []
    other = make_plan(stimuli, "p01", number=1, seed=8, protocols=("realism",), repeats=1)
    assert find_differences(plan, other) == ["seed 7 -> 8", "protocols ('realism', 'similarity') -> ('realism',)"]
