"""Maps of stimuli, and pairs of stimuli that are confused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.contrasts.bradley_terry import ORDER
from feel321.analysis.figures.estimates import (
    AXIS_CM,
    PLAIN,
    Mark,
    Row,
    draw_rows,
    find_height,
    find_limits,
    fit_rows,
)
from feel321.analysis.figures.style import (
    BLACK,
    BLUE,
    GREY,
    Look,
    add_legend,
    add_title,
    assign_looks,
    fit_text,
    make_handles,
    new_canvas,
    new_figure,
    print_style,
)
from feel321.analysis.words import tell_span

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.contrasts.bradley_terry import BradleyTerry
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
            f"names: got {len(set(names))} different ones, allowed is one for each of {n} stimuli"
        )
    chosen = {
        **assign_looks([name for name in names if name != original]),
        **(looks or {}),
        original: ORIGINAL,
    }
    with print_style():
        heights = [MAP_CM, STRESS_CM] if len(stress) else [MAP_CM]
        figure = new_canvas(sum(heights) + MAP_AXIS_CM * len(heights))
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
                tuple(place),
                *(2 * half),
                angle=float(angle),
                facecolor=look.colour,
                alpha=0.15,
                linewidth=0,
                zorder=1,
            )
        )
        size = LARGE if look == ORIGINAL else 4.5
        axes.plot(
            *place,
            marker=look.marker,
            color=look.colour,
            markersize=size,
            markeredgecolor="white",
            markeredgewidth=0.4,
            linestyle="none",
            zorder=3,
        )
    unit = "rank order only" if ellipses.space.ordinal else "unit of dissimilarity"
    axes.set(xlabel=f"Dimension 1 ({unit})", ylabel=f"Dimension 2 ({unit})")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)


def _draw_stress(axes: Axes, stress: Sequence[float]) -> None:
    numbers = range(1, len(stress) + 1)
    axes.plot(numbers, stress, marker="o", color=BLACK, markersize=3.5, clip_on=False)
    axes.set(
        xlabel="Number of dimensions",
        ylabel="Stress-1",
        xticks=list(numbers),
        ylim=(0, 1.1 * max(*stress, 0.1)),
    )
    axes.locator_params(axis="y", nbins=4)


def _tell(ellipses: Ellipses, *, found: bool) -> str:
    star = " Star: original." if found else ""
    return (
        f"Group map of dissimilarity, stress-1 = {ellipses.space.stress:.2f}. Ellipses: 95 % bootstrap regions over "
        f"n = {ellipses.n_participants} participants ({ellipses.draws} draws).{star}"
    )


# Paired judgements: Bradley-Terry abilities, and d' of ABX trials.

OBSERVERS = {"independent": "independent observations", "differencing": "differencing"}
"""Model of the observer -> its name in words."""

AXIS_LABEL_CM = 6.5


def draw_abilities(result: BradleyTerry, *, looks: Mapping[str, Look] | None = None) -> Figure:
    """Draw Bradley-Terry abilities with their intervals."""
    given = looks or {}
    items = result.fixed.drop(index=ORDER, errors="ignore").sort_values(
        "estimate", ascending=False, kind="stable"
    )
    marks = {
        str(name): Mark(
            row["estimate"],
            row["low"],
            row["high"],
            given.get(str(name), PLAIN),
            filled=name != result.reference,
        )
        for name, row in items.iterrows()
    }
    rows = [Row(name, (mark,)) for name, mark in marks.items()]
    for order in result.fixed[result.fixed.index == ORDER].to_dict("records"):
        rows += [
            Row("being first"),
            Row("against an equal", (Mark(order["estimate"], order["low"], order["high"]),)),
        ]
    ties = f", {result.n_ties} of them ties" if result.n_ties else ""
    text = (
        f"Bradley-Terry abilities; bars: {result.uncertainty}. n = {result.n_comparisons:.0f} comparisons{ties}. "
        "Hollow: reference, 0 by definition."
    )
    return _draw(rows, f"Ability (log odds against {result.reference})", text)


def draw_discrimination(
    results: Mapping[str, Discrimination], *, observer: str = "independent"
) -> Figure:
    """Draw the d' of each pair of stimuli that was compared in ABX trials.

    results: name of the pair -> its result.
    """
    if observer not in OBSERVERS:
        raise ValueError(f"observer: got {observer!r}, allowed are {', '.join(OBSERVERS)}")
    if not results:
        raise ValueError("results: got none, allowed is one pair or more")
    rows = []
    for name, found in results.items():
        value, low, high = (
            float(getattr(found, f"d_{observer}{end}")) for end in ("", "_low", "_high")
        )
        label = f"{name} ({found.n_correct}/{found.n_trials})"
        rows.append(Row(label, (Mark(value, low, high, Look(BLUE, "o")),)))
    trials = tell_span(found.n_trials for found in results.values())
    text = (
        f"ABX, observer's model: {OBSERVERS[observer]}. Bars: 95 % Wilson intervals of the share correct, as d′. "
        f"n = {trials} trials per pair (correct/trials in brackets). Line: guessing."
    )
    return _draw(rows, "d′", text)


def _draw(labelled: Sequence[Row], label: str, text: str) -> Figure:
    with print_style():
        rows = fit_rows(labelled)
        figure, axes = new_figure(find_height(rows) + AXIS_CM)
        axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
        draw_rows(axes, rows, limits=find_limits(rows, 0))
        # Told of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel(fit_text(label, AXIS_LABEL_CM))
        add_title(figure, text)
    return figure
