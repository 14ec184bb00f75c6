"""Question pages in a session: when they come, what is recorded, and that nothing is lost or asked twice."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.texts import Question
from feel321.study.auditing.replay import audit_steps
from feel321.study.persons import answers
from feel321.study.session.plan import make_plan, read_dossier
from feel321.study.session.ports import Abort, Confirm, Pause

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.plan import Design, Plan

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
