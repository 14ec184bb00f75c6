from __future__ import annotations

import math

import numpy as np
import pytest

from feel321.analysis.figures.estimates import (
    ForestRow,
    Mark,
    draw_rows,
    find_height,
    find_limits,
    fit_rows,
)
from feel321.analysis.figures.style import new_figure

INF, NAN = math.inf, math.nan


def draw(*marks: Mark) -> object:
    rows = [ForestRow(f"row {number}", (mark,)) for number, mark in enumerate(marks)]
    _, axes = new_figure(5.0)
    draw_rows(axes, rows, limits=find_limits(rows, 0))
    return axes


def test_points_and_intervals_stand_where_the_numbers_say() -> None:
    axes = draw(Mark(1, 0.5, 2), Mark(-3, -4, -2.5))
    lines = [tuple(line.get_xdata()) for line in axes.lines]
    assert lines == [(0.5, 2), (1,), (-4, -2.5), (-3,)]
    assert [line.get_ydata()[0] for line in axes.lines[::2]] == list(axes.get_yticks())
    assert axes.get_xlim()[0] < -4 < 2 < axes.get_xlim()[1]


def test_an_endless_interval_ends_in_an_arrow_at_the_edge() -> None:
    axes = draw(Mark(INF, 2, INF), Mark(1, -INF, 2))
    low, high = axes.get_xlim()
    arrows = {
        line.get_marker(): line.get_xdata()[0]
        for line in axes.lines
        if line.get_marker() in {"<", ">"}
    }
    assert arrows == {">": high, "<": low}
    assert np.isfinite([low, high]).all()


def test_one_interval_that_tells_nothing_does_not_squeeze_the_others() -> None:
    marks = [Mark(1, 0.5, 1.5), Mark(2, 1.5, 2.5), Mark(1.5, 1, 2), Mark(1, -4000, 4000)]
    axes = draw(*marks)
    low, high = axes.get_xlim()
    assert high - low < 40
    assert [line.get_marker() for line in axes.lines if line.get_marker() in {"<", ">"}] == [
        "<",
        ">",
    ]


def test_a_missing_estimate_is_said() -> None:
    axes = draw(Mark(NAN, NAN, NAN), Mark(1, NAN, NAN))
    assert [text.get_text() for text in axes.texts] == ["no estimate"]
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"] == [1]


@pytest.mark.parametrize("marks", [(), (Mark(NAN),), (Mark(2.0),)])
def test_limits_are_finite_whatever_is_missing(marks: tuple[Mark, ...]) -> None:
    low, high = find_limits([ForestRow("row", marks)])
    assert low < high
    assert np.isfinite([low, high]).all()


def test_rows_take_the_room_of_their_labels_and_marks() -> None:
    one, two, many = fit_rows([
        ForestRow("a", (Mark(1),)),
        ForestRow("word " * 20, (Mark(1),)),
        ForestRow("b", (Mark(1),) * 4),
    ])
    assert one.height_cm < two.height_cm
    assert one.height_cm < many.height_cm
    assert find_height([one, two]) == one.height_cm + two.height_cm
    assert two.label.count("\n") == 1


def test_a_hollow_mark_is_white_inside() -> None:
    axes = draw(Mark(1, filled=False), Mark(1))
    faces = [line.get_markerfacecolor() for line in axes.lines if line.get_marker() == "o"]
    assert faces == ["white", "#000000"]
