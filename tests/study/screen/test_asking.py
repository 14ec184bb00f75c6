"""The answer to a question page while it is given, by keys and by mouse."""

from __future__ import annotations

import pytest

from feel321.protocols.texts import MOST_LETTERS, Question
from feel321.study.keys import USUAL, KeysTable
from feel321.study.screen.input import Form, InputEvent
from feel321.study.screen.sheet import Box, Target

HAND = Question("hand", "choice", "Which?", ("left", "right", "both"))
TIRED = Question("tired", "likert", "How tired?", ("not", *[""] * 5, "very"))
AGE = Question("age", "number", "How old?", low=18, high=99)
LAST = Question("last", "text", "Anything?", required=False)


def press(form: Form, *keys: str) -> None:
    for key in keys:
        form.take(InputEvent("press", 0.0, key), None)
        if len(key) == 1:  # which X11 sends as a letter too
            form.take(InputEvent("text", 0.0, key), None)
        elif key == "backspace":
            form.take(InputEvent("text", 0.0, "backspace"), None)


@pytest.mark.parametrize(
    ("question", "keys", "answer"),
    [
        (HAND, [], None),
        (HAND, ["2"], "right"),
        (HAND, ["4"], None),
        (HAND, ["0"], None),
        (HAND, ["down"], "left"),
        (HAND, ["up"], "both"),
        (HAND, ["down", "down", "down", "down"], "both"),
        (HAND, ["3", "up", "up", "up"], "left"),
        (TIRED, ["right", "right"], 2.0),
        (TIRED, ["7"], 7.0),
        (TIRED, ["8"], None),
        (TIRED, ["left"], 7.0),
        (AGE, [], None),
        (AGE, ["4", "x", "1"], 41.0),
        (AGE, ["4", "1", "backspace"], 4.0),
        (AGE, ["4", ",", "5"], 4.5),
        (AGE, ["-", "-"], "--"),
        (LAST, [*"so so", "backspace"], "so s"),
        (LAST, [" "], None),
    ],
)
def test_keys(question: Question, keys: list[str], answer: float | str | None) -> None:
    form = Form(question, USUAL)
    press(form, *keys)
    assert form.answer == answer


def test_a_click_chooses() -> None:
    form = Form(HAND, USUAL)
    form.take(InputEvent("click", 0.0), Target(Box(0, 0, 1, 1), "choose", "1"))
    assert form.answer == "right"
    form.take(InputEvent("click", 0.0), None)
    assert form.answer == "right"


def test_a_text_has_an_end() -> None:
    form = Form(LAST, USUAL)
    form.take(InputEvent("text", 0.0, "ä" * 2 * MOST_LETTERS), None)
    assert form.typed == "ä" * MOST_LETTERS
    assert LAST.find_fault(form.answer) == ""


def test_keys_that_write_do_nothing_else_where_an_answer_is_typed() -> None:
    own = KeysTable(next=("space", "n"), stop=("s",), up=("1",), down=("2",), type_values=False)
    typing, choosing = Form(LAST, own), Form(HAND, own)
    assert [typing.name_action(key) for key in ("n", "space", "enter", "escape")] == [
        "",
        "",
        "next",
        "pause",
    ]
    assert choosing.name_action("n") == "next"
    press(choosing, "2", "2")
    assert choosing.answer == "right"  # two steps down, not the second option twice


@pytest.mark.parametrize(
    ("question", "answer", "fault"),
    [
        (AGE, 17.9, "out_of_range"),
        (AGE, 18, ""),
        (AGE, "old", "out_of_range"),
        (AGE, True, "out_of_range"),
        (AGE, float("nan"), "out_of_range"),
        (AGE, None, "unanswered"),
        (LAST, None, ""),
        (LAST, "a\nb", "too_long"),
        (LAST, "x" * 501, "too_long"),
        (HAND, "none", "not_offered"),
        (TIRED, 7.0, ""),
        (TIRED, 8.0, "not_offered"),
        (TIRED, 1.5, "not_offered"),
    ],
)
def test_what_counts_as_an_answer(
    question: Question, answer: float | str | None, fault: str
) -> None:
    assert question.find_fault(answer) == fault
