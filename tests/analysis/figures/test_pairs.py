from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.analysis.contrasts.discrimination import discriminate
from feel321.analysis.figures.scatter import draw_discrimination

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def test_d_prime_is_drawn_with_what_it_rests_on(said: Callable[[Figure], str]) -> None:
    results = {"x − y": discriminate(18, 24), "x − z": discriminate(24, 24)}
    figure = draw_discrimination(results)
    (axes,) = figure.axes
    points = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"]
    assert points == [results["x − y"].d_independent]
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == ">"] == [
        axes.get_xlim()[1]
    ]
    for part in (
        "x − y (18/24)",
        "n = 24 trials per pair",
        "95 % Wilson",
        "independent observations",
        "d′",
    ):
        assert part in said(figure)


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(ValueError, match="results must hold one pair or more, got none"):
        draw_discrimination({})


def test_long_names_stay_inside_and_apart(
    names: list[str], faults: Callable[[Figure], list[str]]
) -> None:
    assert (
        faults(draw_discrimination({f"{name} − {name}": discriminate(18, 24) for name in names}))
        == []
    )
