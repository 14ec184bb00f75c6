from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import pytest

from feel321.analysis.contrasts.compare import equivalence
from feel321.analysis.figures.estimates import draw_equivalence

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def test_intervals_stand_against_the_margin(said: Callable[[Figure], str]) -> None:
    tests = {
        "a − b": equivalence(1.0, 1.2, 11, low=-5, high=5),
        "a − c": equivalence(4.0, 1.2, 11, low=-5, high=5),
    }
    figure = draw_equivalence(tests, n_participants=12, n_recordings=8, n_sources=8)
    (axes,) = figure.axes
    assert axes.patches[0].get_x() == -5
    assert axes.patches[0].get_width() == 10
    bars = [tuple(line.get_xdata()) for line in axes.lines[1:] if len(line.get_xdata()) == 2]
    assert bars == [(test.low90, test.high90) for test in tests.values()]
    marks = {line.get_xdata()[0]: line for line in axes.lines if line.get_marker() in {"o", "D"}}
    assert marks[1.0].get_marker() != marks[4.0].get_marker()
    assert marks[4.0].get_markerfacecolor() == "white"
    words = said(figure)
    for part in (
        "90 % intervals",
        "margin, −5.0 to 5.0 points of rating",
        "equivalent, 1 of 2",
        "not shown. 12 participants, ",
    ):
        assert part in words
    assert axes.get_xlabel() == "Difference (points of rating)"


def test_long_names_stay_inside_and_apart(
    names: list[str], faults: Callable[[Figure], list[str]]
) -> None:
    tests = {
        f"{one} − {other}": equivalence(number / 5 - 5, 1, 11, low=-5, high=5)
        for number, (one, other) in enumerate(combinations(names, 2))
    }
    figure = draw_equivalence(tests, n_participants=20, n_recordings=10, n_sources=10)
    assert len(figure.axes[0].get_yticks()) == 66
    assert faults(figure) == []


@pytest.mark.parametrize("margins", [(), (5, 6)])
def test_no_common_margin_is_refused(margins: tuple[float, ...]) -> None:
    tests = {str(high): equivalence(0, 1, 11, low=-5, high=high) for high in margins}
    with pytest.raises(
        ValueError, match=f"contrasts must have one margin for all, got {len(margins)}"
    ):
        draw_equivalence(tests, n_participants=12, n_recordings=8, n_sources=8)
