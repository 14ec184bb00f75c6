"""Map of stimuli: what people tell apart, how sure each place is, and how many dimensions are enough."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.figures.legend import add_legend, make_handles
from analysis.figures.style import BLACK, Look, assign_looks, new_canvas, print_style
from analysis.figures.text import add_title

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from analysis.space.landmarks import Ellipses

MAP_CM, STRESS_CM, AXIS_CM = 6.2, 2.2, 1.2
ORIGINAL = Look(BLACK, "*")
LARGE = 9


def draw_space(
    ellipses: Ellipses,
    names: Sequence[str],
    *,
    original: str = "original",
    stress: Sequence[float] = (),
    looks: Mapping[str, Look] | None = None,
) -> Figure:
    """Draw the group's map with an ellipse per stimulus.

    Parameters
    ----------
    ellipses : Ellipses
        What `bootstrap_space` returns.
    names : sequence of str
        Of the stimuli, in its order.
    original : str
        The name among them that stands for the unreduced vibration: a black star. It need not be there.
    stress : sequence of float
        What `stress_by_dimension` returns: a second panel; none if empty.
    looks : Mapping of str to Look, optional
        Look per name, where other figures show the same ones.

    Returns
    -------
    Figure
        Both dimensions at the same scale; only distances have a meaning.

    Raises
    ------
    ValueError
        If there is not one name of its own per stimulus.
    """
    n = len(ellipses.space.positions)
    if len(names) != n or len(set(names)) != n:
        raise ValueError(f"names: got {len(set(names))} different ones, allowed is one for each of {n} stimuli")
    chosen = {**assign_looks([name for name in names if name != original]), **(looks or {}), original: ORIGINAL}
    with print_style():
        heights = [MAP_CM, STRESS_CM] if len(stress) else [MAP_CM]
        figure = new_canvas(sum(heights) + AXIS_CM * len(heights))
        panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_map(panels[0], ellipses, looks=[chosen[name] for name in names])
        if len(stress):
            _draw_stress(panels[1], stress)
        add_title(figure, _tell(ellipses, found=original in names))
        add_legend(figure, make_handles({name: chosen[name] for name in names}))
    return figure


def _draw_map(axes: Axes, ellipses: Ellipses, *, looks: Sequence[Look]) -> None:
    from matplotlib.patches import Ellipse

    places = zip(ellipses.space.positions, ellipses.half_axes, ellipses.angle, looks, strict=True)
    for place, half, angle, look in places:
        axes.add_patch(
            Ellipse(
                tuple(place), *(2 * half), angle=float(angle), facecolor=look.colour, alpha=0.15, linewidth=0, zorder=1
            )
        )
        size = LARGE if look == ORIGINAL else 4.5
        axes.plot(*place, marker=look.marker, color=look.colour, markersize=size, markeredgecolor="white",
                  markeredgewidth=0.4, linestyle="none", zorder=3)  # fmt: skip
    unit = "rank order only" if ellipses.space.ordinal else "unit of dissimilarity"
    axes.set(xlabel=f"Dimension 1 ({unit})", ylabel=f"Dimension 2 ({unit})")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)


def _draw_stress(axes: Axes, stress: Sequence[float]) -> None:
    numbers = range(1, len(stress) + 1)
    axes.plot(numbers, stress, marker="o", color=BLACK, markersize=3.5, clip_on=False)
    axes.set(xlabel="Number of dimensions", ylabel="Stress-1", xticks=list(numbers), ylim=(0, 1.1 * max(*stress, 0.1)))
    axes.locator_params(axis="y", nbins=4)


def _tell(ellipses: Ellipses, *, found: bool) -> str:
    star = " Star: original." if found else ""
    return (
        f"Group map of dissimilarity, stress-1 = {ellipses.space.stress:.2f}. Ellipses: 95 % bootstrap regions over "
        f"n = {ellipses.n_participants} participants ({ellipses.draws} draws).{star}"
    )
