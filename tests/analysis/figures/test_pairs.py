from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.contrasts.bradley_terry import bradley_terry
from feel321.analysis.contrasts.discrimination import discriminate
from feel321.analysis.figures.maps import draw_abilities, draw_discrimination
from feel321.analysis.figures.style import assign_looks

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def compare(names: list[str]) -> pd.DataFrame:
    """Let each win 6 + its lead over the other of 12, presented first and second by turns."""
    pairs = [
        (one, other, 6 + min(5, rank)) for rank, (one, other) in enumerate(combinations(names, 2))
    ]
    pairs += [(other, one, 12 - wins) for one, other, wins in pairs]
    return pd.DataFrame(
        [(one, other, wins, 12 - wins) for one, other, wins in pairs], columns=list("abcd")
    )


def test_abilities_are_drawn_from_the_ablest_down(said: Callable[[Figure], str]) -> None:
    result = bradley_terry(compare(["one", "two", "three"]), reference="two", order_effect=True)
    looks = assign_looks(["one", "two", "three"])
    figure = draw_abilities(result, looks=looks)
    (axes,) = figure.axes
    ordered = result.fixed.drop(index="order").sort_values("estimate", ascending=False)
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == [*ordered.index, "being first", "against an equal"]
    points = [line for line in axes.lines if line.get_marker() in {"o", "s", "^"}]
    assert [line.get_xdata()[0] for line in points] == [
        *ordered["estimate"],
        result.fixed.loc["order", "estimate"],
    ]
    assert [line.get_marker() for line in points[:3]] == [
        looks[name].marker for name in ordered.index
    ]
    hollow = [line.get_markerfacecolor() == "white" for line in points[:3]]
    assert hollow == [name == "two" for name in ordered.index]
    for part in ("95 % Wald interval", "n = 72 comparisons.", "log odds against two"):
        assert part in said(figure)


def test_ties_are_counted(said: Callable[[Figure], str]) -> None:
    trials = pd.DataFrame({
        "first": ["a", "b"] * 5,
        "second": ["b", "a"] * 5,
        "winner": ["a", "b", "b", None, "a"] * 2,
    })
    assert "10 comparisons, 2 of them ties" in said(
        draw_abilities(bradley_terry(trials, ties="half"))
    )


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


def test_the_other_observer_has_other_numbers() -> None:
    result = discriminate(18, 24)
    (axes,) = draw_discrimination({"x − y": result}, observer="differencing").axes
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"] == [
        result.d_differencing
    ]


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(ValueError, match="results: got none, allowed is one pair or more"):
        draw_discrimination({})
    with pytest.raises(
        ValueError, match="observer: got 'ideal', allowed are independent, differencing"
    ):
        draw_discrimination({"x": discriminate(1, 2)}, observer="ideal")


def test_long_names_stay_inside_and_apart(
    names: list[str], faults: Callable[[Figure], list[str]]
) -> None:
    result = bradley_terry(compare(names), order_effect=True)
    assert faults(draw_abilities(result)) == []
    assert (
        faults(draw_discrimination({f"{name} − {name}": discriminate(18, 24) for name in names}))
        == []
    )
