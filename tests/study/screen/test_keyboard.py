from __future__ import annotations

from typing import Any

import pytest

from feel321.protocols.texts import read_scales
from feel321.study.screen.drawing import Box, Target
from feel321.study.screen.input import (
    COARSE_SPEEDS,
    Answer,
    Digits,
    Held,
    InputEvent,
    Markers,
    Twice,
    count_repeats,
    drop_repeats,
    name_key,
)


def test_held_keys_cross_the_scale_in_three_seconds() -> None:
    counts = [count_repeats(tenths / 10) for tenths in range(40)]
    assert counts[:5] == [0, 0, 0, 0, 0]
    assert counts == sorted(counts)
    assert counts[30] >= 100
    assert count_repeats(2.0, COARSE_SPEEDS) == 9


def test_only_the_last_key_repeats_and_none_when_released() -> None:
    held = Held()
    held.press("left", 0.0)
    held.press("right", 0.1)
    assert held.list_due(0.7, frozenset()) == ["right"] * 5
    assert held.list_due(0.7, frozenset()) == []
    held.release("right")
    assert held.list_due(2.0, frozenset()) == []


@pytest.mark.parametrize(
    ("keys", "values"),
    [("75", [None, 75.0]), ("100", [None, None, 100.0]), ("10", [None, None]), ("00", [None, 0.0])],
)
def test_digits(keys: str, values: list[float | None]) -> None:
    digits = Digits()
    assert [digits.type(key, 0.0) for key in keys] == values


def test_digits_wait_for_the_next_one() -> None:
    digits = Digits()
    digits.type("9", 1.0)
    assert digits.take_if_due(1.5) is None
    assert digits.take_if_due(1.9) == 9.0
    assert digits.take_if_due(9.0) is None


def test_twice_means_within_a_second() -> None:
    twice = Twice()
    assert [twice.press(time_s) for time_s in (0.0, 1.5, 2.0, 2.1, 2.2)] == [
        False,
        False,
        True,
        False,
        True,
    ]


def test_keys_have_one_name_on_the_main_block_and_on_the_number_block() -> None:
    symbols = ("RETURN", "NUM_7", "_7", "PAGEUP", "NUM_PAGE_UP", "R")
    assert [name_key(symbol) for symbol in symbols] == ["enter", "7", "7", "pageup", "pageup", "r"]


def test_what_a_held_key_makes_up_is_dropped() -> None:
    made_up = [InputEvent("release", 1.0, "left"), InputEvent("press", 1.001, "left")]
    real = InputEvent("press", 1.002, "r")
    assert drop_repeats([*made_up, real]) == [real]


def test_a_real_second_press_is_no_repeat() -> None:
    kinds = ("press", "release", "press")
    events = [InputEvent(kind, n / 100, "escape") for n, kind in enumerate(kinds)]
    assert drop_repeats(events) == events


def test_markers_report_where_they_rest() -> None:
    markers = Markers()
    markers.put("1", 40.0, 0.0)
    markers.put("1", 140.0, 0.1)
    assert markers.settle(0.2) == []
    (move,) = markers.settle(0.4)
    assert (move.part, move.value, move.time_s) == ("1", 100.0, 0.1)
    assert markers.settle(9.0) == []


def make_answer(gallery: dict[str, Any]) -> Answer:
    trial = gallery["make_trial"]("realism")
    return Answer(trial, read_scales()[trial.scale])


@pytest.mark.parametrize(("key", "value"), [("left", 43.0), ("pagedown", 40.0)])
def test_keys_that_move_far_repeat_slowly(gallery: dict[str, Any], key: str, value: float) -> None:
    answer = make_answer(gallery)
    answer.take(InputEvent("press", 0.0, key), None, can_answer=True)
    answer.tick(0.7, can_answer=True)
    assert answer.values == {"test": value}


def test_what_was_typed_does_not_take_a_click_back(gallery: dict[str, Any]) -> None:
    answer, track = make_answer(gallery), Box(0.0, 0.0, 200.0, 10.0)
    answer.take(InputEvent("press", 0.0, "8"), None, can_answer=True)
    target = Target(track, "mark", "test", track)
    answer.take(InputEvent("click", 0.1, x=50.0, y=5.0), target, can_answer=True)
    answer.tick(2.0, can_answer=True)
    assert answer.values == {"test": 25.0}
