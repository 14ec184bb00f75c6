import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.session.journal import digest
from feel321.study.session.plan import (
    Design,
    Plan,
    create_plan,
    list_by_code,
    make_plan,
    require_plan,
)


def remake(design: Design, stimuli: StimulusSet, name: str = "p01", *, number: int = 1) -> Plan:
    return make_plan(design, stimuli, name, number=number, simulated=True)


def list_judged(plan: Plan, protocol: str) -> list[str]:
    return sorted(t.judgements[0].stimulus_id for t in plan.trials if t.protocol == protocol)


def test_a_plan_holds_every_stimulus_once_per_task(plan: Plan, stimuli: StimulusSet) -> None:
    codes = {row.stimulus_id: code for code, row in list_by_code(stimuli, seed=7).items()}
    assert list_judged(plan, "realism") == list_judged(plan, "similarity") == sorted(codes.values())
    references = {t.judgements[0].reference_id for t in plan.trials if t.protocol == "similarity"}
    assert references == {codes["bumps-original"], codes["taps-original"]}


def test_no_plan_tells_what_a_stimulus_was_made_by(
    plan: Plan, stimuli: StimulusSet, tmp_path: Path
) -> None:
    create_plan(tmp_path / "plan.json", plan)
    text = (tmp_path / "plan.json").read_text(encoding="utf-8")
    assert not [
        stimulus.reducer
        for stimulus in stimuli.stimuli
        if stimulus.reducer in text.replace('"original"', "")
    ]
    assert not [
        stimulus.stimulus_id for stimulus in stimuli.stimuli if stimulus.stimulus_id in text
    ]


def test_groups_take_turns_and_feel_what_is_theirs(design: Design, stimuli: StimulusSet) -> None:
    between = {"protocol": ("realism", "similarity"), "grip": ("pen", "power")}
    plans = [
        remake(replace(design, between=between), stimuli, number=number)
        for number in (1, 2, 3, 4, 5)
    ]
    assert [plan.groups for plan in plans[:4]] == [
        {"protocol": "realism", "grip": "pen"},
        {"protocol": "realism", "grip": "power"},
        {"protocol": "similarity", "grip": "pen"},
        {"protocol": "similarity", "grip": "power"},
    ]
    assert [{t.protocol for t in plan.trials} for plan in plans] == [
        {plan.groups["protocol"]} for plan in plans
    ]
    # Within a group the next participant takes the next row, not the next but three.
    alone = replace(design, tasks=design.tasks[:1])
    assert [t.judgements for t in plans[4].trials] == [
        t.judgements for t in remake(alone, stimuli, number=2).trials
    ]


def test_a_stored_plan_survives_a_power_cut(plan: Plan, tmp_path: Path, synced: list[int]) -> None:
    create_plan(tmp_path / "plan.json", plan)
    assert synced == [(tmp_path / "plan.json").stat().st_ino, tmp_path.stat().st_ino]


def test_a_plan_with_what_this_version_does_not_know_is_refused(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    stored = path.read_text(encoding="utf-8").partition(',\n "sha256": ')[0]
    body = stored.replace('"seed": 7', '"seed": 7, "mood": 1') + "\n}"
    path.write_text(f'{body[:-2]},\n "sha256": "{digest(body)}"\n}}\n', encoding="utf-8")
    with pytest.raises(
        ValueError,
        match=r"plan\.json: not a plan as this version writes it \(mood: .*\); use the feel321",
    ):
        require_plan(path)


def test_a_changed_plan_is_refused(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    create_plan(path, plan)
    entry = json.loads(path.read_text(encoding="utf-8"))
    entry["trials"][0], entry["trials"][1] = entry["trials"][1], entry["trials"][0]
    path.write_text(json.dumps(entry), encoding="utf-8")
    with pytest.raises(
        ValueError, match="not a plan, or changed after it was stored; restore the file"
    ):
        require_plan(path)


@pytest.mark.parametrize("content", ["", "null", "[]", "{}", '{"sha256": "", "trials": [1]}'])
def test_what_is_no_plan_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "plan.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match="not a plan"):
        require_plan(tmp_path / "plan.json")


@pytest.mark.parametrize("entry", [{}, {"format": 3}, {"format": 2, "flow": None}])
def test_a_plan_of_another_make_is_refused_though_its_digest_is_right(
    entry: object, tmp_path: Path
) -> None:
    body = json.dumps(entry, indent=1).encode().removesuffix(b"}").rstrip(b"\n") + b"\n}"
    seal = b',\n "sha256": "' + digest(body).encode() + b'"\n}\n'
    path = tmp_path / "plan.json"
    path.write_bytes(body.removesuffix(b"\n}") + seal)
    with pytest.raises(ValueError, match=r"plan\.json: not a plan as this version writes it"):
        require_plan(path)


def test_codes_are_the_names_and_keys_own_and_grow_where_short_ones_would_be_the_same() -> None:
    def code(*names: str, key: str = "study") -> dict[str, str]:
        rows = [SimpleNamespace(stimulus_id=name) for name in names]
        stimuli: Any = SimpleNamespace(sha256=key, stimuli=rows)
        return {row.stimulus_id: one for one, row in list_by_code(stimuli, seed=321).items()}

    assert code("oak")["oak"] == code("elm", "oak")["oak"] != code("oak", key="b")["oak"]
    # Of 200 000 numbers, the first two that share six letters.
    codes = code("214", "38803", "7")
    assert len(set(codes.values())) == 3
    assert {len(one) for one in codes.values()} == {7}
