"""Maps of stimuli, and pairs of stimuli that are confused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.estimates import (
    AXIS_CM,
    ForestRow,
    Mark,
    draw_rows,
    find_height,
    find_limits,
    fit_rows,
)
from feel321.analysis.figures.style import (
    BLACK,
    BLUE,
    Look,
    add_legend,
    add_title,
    assign_looks,
    fit_text,
    make_handles,
    new_canvas,
    new_figure,
    plot_marks,
    print_style,
)
from feel321.analysis.words import format_span
from feel321.doors import check_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.contrasts.discrimination import Discrimination
    from feel321.analysis.space import Ellipses

# Map of stimuli: what people tell apart, how sure each place is, and how many dimensions are enough.

MAP_CM, STRESS_CM, MAP_AXIS_CM = 6.2, 2.2, 1.2
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
    """Draw the group's map with an ellipse per stimulus."""
    n = len(ellipses.space.positions)
    if len(names) != n or len(set(names)) != n:
        raise ValueError(
            f"names must be one for each of {n} stimuli, got {len(set(names))} different ones"
        )
    chosen = assign_looks([name for name in names if name != original])
    chosen |= {**(looks or {}), original: ORIGINAL}
    with print_style():
        heights = [MAP_CM, STRESS_CM] if len(stress) else [MAP_CM]
        figure = new_canvas(sum(heights) + MAP_AXIS_CM * len(heights))
        panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_map(panels[0], ellipses, looks=[chosen[name] for name in names])
        if len(stress):
            _draw_stress(panels[1], stress)
        star = " Star: original." if original in names else ""
        add_title(
            figure,
            f"Group map of dissimilarity, stress-1 = {ellipses.space.stress:.2f}. Ellipses: 95 % bootstrap regions "
            f"over n = {ellipses.n_participants} participants ({ellipses.draws} draws).{star}",
        )
        add_legend(figure, make_handles({name: chosen[name] for name in names}))
    return figure


def _draw_map(axes: Axes, ellipses: Ellipses, *, looks: Sequence[Look]) -> None:
    from matplotlib.patches import Ellipse

    places = zip(ellipses.space.positions, ellipses.half_axes, ellipses.angle, looks, strict=True)
    for place, half, angle, look in places:
        style: dict[str, Any] = {
            "facecolor": look.colour,
            "alpha": 0.15,
            "linewidth": 0,
            "zorder": 1,
        }
        axes.add_patch(Ellipse(tuple(place), *(2 * half), angle=float(angle), **style))
        size = LARGE if look == ORIGINAL else 4.5
        plot_marks(axes, place[0], place[1], look=look, size=size, markeredgewidth=0.4)
    unit = "rank order only" if ellipses.space.ordinal else "unit of dissimilarity"
    axes.set(xlabel=f"Dimension 1 ({unit})", ylabel=f"Dimension 2 ({unit})")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)


def _draw_stress(axes: Axes, stress: Sequence[float]) -> None:
    numbers = list(range(1, len(stress) + 1))
    axes.plot(numbers, stress, marker="o", color=BLACK, markersize=3.5, clip_on=False)
    axes.set(xlabel="Number of dimensions", ylabel="Stress-1")
    axes.set(xticks=numbers, ylim=(0, 1.1 * max(*stress, 0.1)))
    axes.locator_params(axis="y", nbins=4)


# Paired judgements: d' of ABX trials.

OBSERVERS = {"independent": "independent observations", "differencing": "differencing"}
"""Model of the observer -> its name in words."""

AXIS_LABEL_CM = 6.5


def draw_discrimination(
    results: Mapping[str, Discrimination], *, observer: str = "independent"
) -> Figure:
    """Draw the d' of each pair of stimuli that was compared in ABX trials, by the pair's name."""
    check_name(observer, OBSERVERS, "observer")
    if not results:
        raise ValueError("results must hold one pair or more, got none")
    rows = []
    for name, found in results.items():
        value, low, high = (
            float(getattr(found, f"d_{observer}{end}")) for end in ("", "_low", "_high")
        )
        label = f"{name} ({found.n_correct}/{found.n_trials})"
        rows.append(ForestRow(label, (Mark(value, low, high, Look(BLUE, "o")),)))
    trials = format_span(found.n_trials for found in results.values())
    text = (
        f"ABX, observer's model: {OBSERVERS[observer]}. Bars: 95 % Wilson intervals of the share correct, as d′. "
        f"n = {trials} trials per pair (correct/trials in brackets). Line: guessing."
    )
    return _draw(rows, "d′", text)


def _draw(labelled: Sequence[ForestRow], label: str, text: str) -> Figure:
    with print_style():
        rows = fit_rows(labelled)
        figure, axes = new_figure(find_height(rows) + AXIS_CM)
        draw_rows(axes, rows, limits=find_limits(rows, 0), zero=True)
        # A label of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel(fit_text(label, AXIS_LABEL_CM))
        add_title(figure, text)
    return figure
