"""Question pages, and several scales after one vibration: what is recorded, and what the audit finds."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import Question, make_scales, read_texts
from feel321.protocols.trial import Scale
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.evidence.replay import audit_steps
from feel321.study.participants import answers
from feel321.study.session.plan import Design, Plan, make_plan, read_dossier
from feel321.study.session.ports import Abort, Confirm, Feel, Move, Pause

QUESTIONS = (
    Question("age", "number", "How old are you?", low=18, high=99, personal=True, required=False),
    Question("hand", "choice", "Which hand?", ("left", "right")),
    Question("tired", "likert", "How tired?", ("not", *[""] * 5, "very"), when="between"),
    Question("last", "text", "Anything else?", when="after"),
)


@pytest.fixture
def asking(design: Design, stimuli: StimulusSet) -> Plan:
    """Two tasks and four questions, of which one comes between."""
    return make_plan(replace(design, questions=QUESTIONS), stimuli, "p01", number=1, simulated=True)


def list_answers(records: list[Any]) -> list[tuple[Any, ...]]:
    names = ("question", "occasion", "value", "personal")
    return [tuple(r.data[name] for name in names) for r in records if r.event == "answered"]


ALL = [
    ("age", 1, 18, True),
    ("hand", 1, "left", False),
    ("tired", 1, 1.0, False),
    ("last", 1, "a word", False),
]


def test_questions_come_at_their_time_and_are_recorded(
    present: Callable[..., list[Any]], scripted: type, asking: Plan
) -> None:
    presenter = scripted()
    records = present(presenter, plan=asking)
    assert list_answers(records) == ALL
    log = [line.rpartition(" ")[0] for line in presenter.log if line.startswith(("page", "ask"))]
    assert log[:4] == ["page welcome", "page consent", "ask age", "ask hand"]
    assert log[log.index("ask tired") + 1] == "page rest"
    assert log[-2:] == ["ask last", "page end"]
    assert list(audit_steps(records, asking)) == []


def test_a_broken_session_goes_on_without_asking_twice(
    present: Callable[..., list[Any]], scripted: type, asking: Plan
) -> None:
    """It ends before every question in turn: by a wish of the participant, and by a kill."""
    present(scripted(pages={"question.age": [Abort(3.0, "had enough")]}), plan=asking)
    present(scripted(pages={"question.hand": [Abort(5.0, "had enough")]}), plan=asking)
    for stop_after in (3, 7):
        with pytest.raises(KeyboardInterrupt):
            present(scripted(stop_after=stop_after), plan=asking)
    present(scripted(pages={"question.last": [Abort(99.0, "had enough")]}), plan=asking)
    records = present(scripted(), plan=asking)
    assert records[-1].event == "finished"
    assert list_answers(records) == ALL
    assert list(audit_steps(records, asking)) == []


def test_what_is_no_answer_is_refused_and_asked_again(
    present: Callable[..., list[Any]], scripted: type, asking: Plan
) -> None:
    wrong = [
        Confirm(1.0, {"hand": "both"}),
        Pause(2.0),
        Confirm(3.0, {}),
        Confirm(4.0, {"hand": ""}),
    ]
    young = [Confirm(1.0, {"age": 17.5}), Confirm(2.0, {"age": ""}, 1.0)]
    presenter = scripted(pages={"question.hand": wrong, "question.age": young})
    records = present(presenter, plan=asking)
    assert list_answers(records) == [("age", 1, None, True), *ALL[1:]]
    refused = [line for line in presenter.log if line.startswith("refuse")]
    assert refused == [
        "refuse out_of_range 18 – 99",
        "refuse not_offered",
        "refuse unanswered",
        "refuse unanswered",
    ]


@pytest.mark.parametrize(
    "forged",
    [
        {"value": 17.0},
        {"personal": False},
        {"occasion": 2},
        {"question": "name"},
        {"question": "hand", "value": "left", "personal": False},
    ],
)
def test_the_audit_finds_a_forged_answer(
    present: Callable[..., list[Any]], scripted: type, asking: Plan, forged: dict[str, Any]
) -> None:
    records = present(scripted(), plan=asking)
    place = next(n for n, record in enumerate(records) if record.event == "answered")
    records[place] = replace(records[place], data={**records[place].data, **forged})
    assert next(audit_steps(records, asking), "").startswith(f", line {place + 1}: ")


def test_the_table_of_answers_says_whose_and_which(
    tmp_path: Path, present: Callable[..., list[Any]], scripted: type, asking: Plan
) -> None:
    present(scripted(), plan=asking)
    rows = answers.list_answers(read_dossier(tmp_path / "sessions" / "p01"))
    assert [(row["question"], row["answer"], row["personal"]) for row in rows] == [
        ("age", "18", "true"),
        ("hand", "left", "false"),
        ("tired", "1", "false"),
        ("last", "a word", "false"),
    ]
    assert {(row["participant"], row["session"], row["rejected"]) for row in rows} == {
        ("p01", 1, "false")
    }


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
