from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.figures.scatter import draw_space
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.space import Ellipses, Space

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def make_ellipses(n: int = 12, *, ordinal: bool = False) -> Ellipses:
    rng = np.random.default_rng(0)
    half = np.sort(rng.uniform(1, 8, (n, 2)))[:, ::-1]
    return Ellipses(
        Space(rng.normal(0, 20, (n, 2)), 0.12, ordinal), half, rng.uniform(0, 180, n), 200, 14
    )


def test_stimuli_and_ellipses_stand_where_the_numbers_say(said: Callable[[Figure], str]) -> None:
    found, names = make_ellipses(4), ["a", "original", "b", "c"]
    looks = assign_looks(["a", "b", "c"])
    figure = draw_space(found, names)
    (axes,) = figure.axes
    np.testing.assert_array_equal(
        [line.get_xydata()[0] for line in axes.lines], found.space.positions
    )
    np.testing.assert_array_equal([patch.center for patch in axes.patches], found.space.positions)
    np.testing.assert_allclose([(p.width / 2, p.height / 2) for p in axes.patches], found.half_axes)
    np.testing.assert_array_equal([patch.angle for patch in axes.patches], found.angle)
    assert [line.get_marker() for line in axes.lines] == [
        looks["a"].marker,
        "*",
        looks["b"].marker,
        looks["c"].marker,
    ]
    assert axes.get_aspect() == 1
    for part in (
        "stress-1 = 0.12",
        "95 % bootstrap",
        "n = 14 participants (200 draws)",
        "unit of dissimilarity",
        "Star",
    ):
        assert part in said(figure)


def test_every_ellipse_is_seen_whole() -> None:
    figure = draw_space(make_ellipses(), [str(number) for number in range(12)])
    figure.draw_without_rendering()
    (axes,) = figure.axes
    for patch in axes.patches:
        box = patch.get_window_extent()
        assert axes.bbox.x0 <= box.x0 < box.x1 <= axes.bbox.x1
        assert axes.bbox.y0 <= box.y0 < box.y1 <= axes.bbox.y1


def test_stress_has_a_panel_of_its_own(said: Callable[[Figure], str]) -> None:
    figure = draw_space(make_ellipses(3, ordinal=True), ["a", "b", "c"], stress=[0.3, 0.1, 0.05])
    lower = figure.axes[1]
    np.testing.assert_array_equal(lower.lines[0].get_xydata(), [[1, 0.3], [2, 0.1], [3, 0.05]])
    assert lower.get_ylim()[0] == 0
    assert "rank order only" in said(figure)
    assert "Star" not in said(figure)


@pytest.mark.parametrize("names", [["a", "b"], ["a", "b", "b"]])
def test_names_must_be_one_each(names: list[str]) -> None:
    with pytest.raises(ValueError, match="names must be one for each of 3 stimuli, got 2"):
        draw_space(make_ellipses(3), names)


def test_long_names_stay_inside_and_apart(
    names: list[str], faults: Callable[[Figure], list[str]]
) -> None:
    assert (
        faults(
            draw_space(
                make_ellipses(), [*names[:3], "original", *names[4:]], stress=[0.4, 0.2, 0.1, 0.0]
            )
        )
        == []
    )
