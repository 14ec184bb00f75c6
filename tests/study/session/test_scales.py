"""Several scales after one vibration: the session, its journal and its table; and plans without them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import make_scales, read_texts
from feel321.study.auditing.replay import audit_steps
from feel321.study.session.plan import make_plan
from feel321.study.session.ports import Confirm, Feel, Move

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Scale
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.plan import Design, Plan

KEYS = ["test", "test:roughness", "test:hardness"]


@pytest.fixture(scope="module")
def scales() -> dict[str, Scale]:
    texts = read_texts()
    for name in ("roughness", "hardness"):
        texts["scales"][name] = {"question": name, "low_label": "low", "high_label": "high"}
    return make_scales(texts)


@pytest.fixture
def threefold(design: Design, stimuli: StimulusSet) -> Plan:
    """Realism on three scales, then similarity on its own."""
    asked = make_task("realism", scales=["realism", "roughness", "hardness"])
    changed = replace(design, tasks=(asked, make_task("similarity")))
    return make_plan(changed, stimuli, "p01", number=1, simulated=True)


def test_one_answer_holds_every_scale(
    present: Callable[..., list[Any]], scripted: type, threefold: Plan, scales: dict[str, Scale]
) -> None:
    records = present(scripted(), plan=threefold, scales=scales)
    rated = [record.data for record in records if record.event == "rated"]
    assert {tuple(data["values"]) for data in rated} == {tuple(KEYS), ("test",)}
    assert list(audit_steps(records, threefold)) == []
    assert threefold.to_frame()["scale"].value_counts().to_dict() == {
        "realism": 10,
        "roughness": 10,
        "hardness": 10,
        "similarity": 10,
    }


def test_markers_move_by_scale_and_what_is_open_is_refused(
    present: Callable[..., list[Any]], scripted: type, threefold: Plan, scales: dict[str, Scale]
) -> None:
    whole = dict.fromkeys(KEYS, 5.0)
    acts = [
        Move(0.0, KEYS[1], 12.0),
        Move(0.0, "test:sharpness", 12.0),
        Confirm(0.0, {KEYS[0]: 1.0, KEYS[1]: 101.0}, 1.0),
        Feel(0.0, "test"),
        Confirm(0.0, whole, 1.0),
    ]
    presenter = scripted(acts={(threefold.trials[0].number, 1): acts})
    records = present(presenter, plan=threefold, scales=scales)
    moved = [record.data for record in records if record.event == "moved"]
    assert [(data["part"], data["value"]) for data in moved] == [(KEYS[1], 12.0)]
    refused = [line for line in presenter.log if line.startswith("refuse")]
    assert refused == [
        "refuse unknown_part test:sharpness",
        f"refuse not_answered {KEYS[1]} {KEYS[2]}",
    ]
    assert next(r.data["values"] for r in records if r.event == "rated") == whole
    assert list(audit_steps(records, threefold)) == []


@pytest.mark.parametrize(
    "values",
    [
        dict.fromkeys(KEYS[:2], 5.0),
        dict.fromkeys([*KEYS, "test:x"], 5.0),
        dict.fromkeys(KEYS, 500.0),
    ],
)
def test_the_audit_finds_a_forged_rating(
    present: Callable[..., list[Any]],
    scripted: type,
    threefold: Plan,
    scales: dict[str, Scale],
    values: dict[str, float],
) -> None:
    records = present(scripted(), plan=threefold, scales=scales)
    place = next(n for n, record in enumerate(records) if record.event == "rated")
    records[place] = replace(records[place], data={**records[place].data, "values": values})
    assert next(audit_steps(records, threefold), "").startswith(f", line {place + 1}: ")
