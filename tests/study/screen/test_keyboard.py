"""What keys, clicks and signals do to the answer to a trial or a question."""

import os
import signal
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from feel321.protocols.texts import MOST_LETTERS, Question, read_scales
from feel321.study.keys import USUAL, KeysTable
from feel321.study.screen.input import Answer, Form, InputEvent
from feel321.study.screen.sheet import Box, Target
from feel321.study.screen.window import HELD, Window, drop_repeats, hold_signals, name_key

TRACK = Target(Box(0.0, 0.0, 200.0, 10.0), "mark", "test", Box(0.0, 0.0, 200.0, 10.0))


@pytest.fixture
def answer(gallery: dict[str, Any]) -> Answer:
    trial = gallery["make_trial"]("realism")
    return Answer(trial, read_scales()[trial.scale])


@pytest.fixture
def do(answer: Answer) -> Callable[..., None]:
    def act(
        kind: Any, time_s: float, key: str = "", target: Target | None = None, **at: float
    ) -> None:
        answer.take(InputEvent(kind, time_s, key, **at), target, can_answer=True)

    return act


def test_held_keys_cross_the_scale_in_three_seconds(
    answer: Answer, do: Callable[..., None]
) -> None:
    do("click", 0.0, target=TRACK, x=0.0)
    do("press", 0.0, "right")
    places = []
    for tenths in range(31):
        answer.tick(tenths / 10, can_answer=True)
        places.append(answer.values["test"])
    assert places[:5] == [1.0] * 5
    assert places == sorted(places)
    assert places[-1] == 100.0


@pytest.mark.parametrize(("key", "value"), [("left", 43.0), ("pagedown", 40.0)])
def test_keys_that_move_far_repeat_slowly(
    answer: Answer, do: Callable[..., None], key: str, value: float
) -> None:
    do("press", 0.0, key)
    answer.tick(0.7, can_answer=True)
    assert answer.values == {"test": value}


def test_only_the_last_key_repeats_and_none_when_released(
    answer: Answer, do: Callable[..., None]
) -> None:
    do("press", 0.0, "left")
    do("press", 0.1, "right")
    answer.tick(0.7, can_answer=True)
    answer.tick(0.7, can_answer=True)
    assert answer.values == {"test": 51.0 + 5}
    do("release", 0.8, "left")
    do("release", 0.8, "right")
    answer.tick(2.0, can_answer=True)
    assert answer.values == {"test": 56.0}


@pytest.mark.parametrize(
    ("keys", "at_once", "later"),
    [
        ("75", 75.0, 75.0),
        ("100", 100.0, 100.0),
        ("10", None, 10.0),
        ("00", 0.0, 0.0),
        ("9", None, 9.0),
    ],
)
def test_digits_become_a_value_when_none_can_follow_or_none_has(
    answer: Answer, do: Callable[..., None], keys: str, at_once: float | None, later: float
) -> None:
    for key in keys:
        do("press", 1.0, key)
    answer.tick(1.7, can_answer=True)
    assert answer.markers.get("test") == at_once
    answer.tick(1.9, can_answer=True)
    assert (answer.markers["test"], answer.typed) == (later, "")


def test_what_was_typed_does_not_take_a_click_back(answer: Answer, do: Callable[..., None]) -> None:
    do("press", 0.0, "8")
    do("click", 0.1, target=TRACK, x=50.0, y=5.0)
    answer.tick(2.0, can_answer=True)
    assert answer.values == {"test": 25.0}


def test_markers_report_where_they_rest(answer: Answer, do: Callable[..., None]) -> None:
    do("click", 0.0, target=TRACK, x=80.0)
    do("drag", 0.1, x=300.0)
    assert answer.settle(0.2) == []
    (move,) = answer.settle(0.4)
    assert (move.part, move.value, move.time_s) == ("test", 100.0, 0.1)
    assert answer.settle(9.0) == []


def test_keys_have_one_name_on_the_main_block_and_on_the_number_block() -> None:
    symbols = ("RETURN", "NUM_7", "_7", "PAGEUP", "NUM_PAGE_UP", "R")
    assert [name_key(symbol) for symbol in symbols] == ["enter", "7", "7", "pageup", "pageup", "r"]


def test_a_key_without_a_symbol_is_pressed_and_means_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As ä and ß on macOS, of which pyglet cannot name the symbol."""
    given: dict[str, Any] = {}
    key = SimpleNamespace(symbol_string="key{:d}".format)
    monkeypatch.setitem(sys.modules, "pyglet.window", SimpleNamespace(key=key))
    inner = SimpleNamespace(push_handlers=given.update)
    window = Window(SimpleNamespace(winHandle=inner), lambda: 1.0, lambda: None)
    window.listen()
    assert given["on_key_press"](None, 0)
    assert given["on_key_release"](None, 0)
    assert window._events == [InputEvent("press", 1.0), InputEvent("release", 1.0)]


def test_what_a_held_key_makes_up_is_dropped_and_a_real_second_press_is_not() -> None:
    made_up = [InputEvent("release", 1.0, "left"), InputEvent("press", 1.001, "left")]
    real = InputEvent("press", 1.002, "r")
    assert drop_repeats([*made_up, real]) == [real]
    kinds = ("press", "release", "press")
    events = [InputEvent(kind, n / 100, "escape") for n, kind in enumerate(kinds)]
    assert drop_repeats(events) == events


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


@pytest.mark.parametrize("is_over", [True, False])
def test_the_first_signal_waits_for_a_frame_and_the_second_does_not(is_over: bool) -> None:
    before = [signal.getsignal(number) for number in HELD]
    with hold_signals() as deliver:
        deliver()
        os.kill(os.getpid(), signal.SIGINT)  # nothing is raised here
        if is_over:
            with pytest.raises(KeyboardInterrupt):
                deliver()
            deliver()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert [signal.getsignal(number) for number in HELD] == before
