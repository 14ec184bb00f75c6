"""Estimates with intervals, one row each: slopes, contrasts, profiles.

Conventions: heights are in cm, the first row ends at 0 and the others lie below, so that a row with a label of two
lines, or with several marks, has the room that it needs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.figures import style
from feel321.analysis.figures.style import Look
from feel321.analysis.table.items import format_recordings
from feel321.analysis.table.metrics import TENTH, Step
from feel321.analysis.table.schema import ANSWERED, HIGHEST, LOWEST, PAIRED, ROLES
from feel321.analysis.words import (
    capitalise,
    format_count,
    format_level,
    format_name,
    format_number,
    format_span,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame, Series

    from feel321.analysis.contrasts.compare import Equivalence
    from feel321.analysis.primary.model import Primary

# Estimates with intervals, one row each: what forest plots, abilities and equivalence tests have in common.

LABEL_CM = 4.2
LINE_CM, GAP_CM, MARK_CM = 0.33, 0.12, 0.22
"""Height of a line of text, between rows, and of a mark."""

AXIS_CM = 1.5
"""Room for an axis's numbers and its label."""

PAD = 0.06
FARTHEST = 6.0
"""An interval is cut, with an arrow, where it is this many times as wide as the range of the estimates and of half
of all intervals: one that is uninformative must not squeeze all others."""

PLAIN = Look(style.BLACK, "o")
UNKNOWN = "no estimate"


@dataclass(frozen=True, slots=True)
class Mark:
    """An estimate to be drawn; NaN where there is none, infinite ends get an arrow."""

    value: float
    low: float = float("nan")
    high: float = float("nan")
    look: Look = PLAIN
    filled: bool = True


@dataclass(frozen=True, slots=True)
class ForestRow:
    """A row of a forest plot, with its marks below each other."""

    label: str
    marks: tuple[Mark, ...] = ()

    @property
    def height_cm(self) -> float:
        """Room that it takes."""
        return GAP_CM + max(LINE_CM * (1 + self.label.count("\n")), MARK_CM * len(self.marks))


def fit_rows(rows: Iterable[ForestRow]) -> list[ForestRow]:
    """Break the labels of rows to two lines at most that fit their place."""
    return [replace(row, label=style.fit_text(row.label, LABEL_CM)) for row in rows]


def find_height(rows: Iterable[ForestRow]) -> float:
    """Add the heights of rows, in cm."""
    return sum(row.height_cm for row in rows)


def find_limits(rows: Iterable[ForestRow], *include: float) -> tuple[float, float]:
    """Find the part of the axis that holds all estimates, and all intervals that are not endless."""
    marks = [mark for row in rows for mark in row.marks]
    values = np.array([*(mark.value for mark in marks), *include], dtype=np.float64)
    ends = np.array([(mark.low, mark.high) for mark in marks], dtype=np.float64).reshape(-1, 2)
    values, ends = values[np.isfinite(values)], ends[np.isfinite(ends).all(axis=1)]
    if not len(values):
        return -1.0, 1.0
    least, most = values.min(), values.max()
    usual = float(np.median(ends[:, 1] - ends[:, 0])) if len(ends) else 0.0
    room = FARTHEST * max(most - least, usual, np.finfo(float).tiny)
    low = max(min(least, ends[:, 0].min(initial=least)), least - room)
    high = min(max(most, ends[:, 1].max(initial=most)), most + room)
    pad = PAD * (high - low) or 1.0
    return float(low - pad), float(high + pad)


def draw_rows(
    axes: Axes, rows: Sequence[ForestRow], *, limits: tuple[float, float], zero: bool = False
) -> None:
    """Draw rows and label them; zero: with a line at zero."""
    heights = np.array([row.height_cm for row in rows])
    middles = heights / 2 - np.cumsum(heights)
    axes.set(xlim=limits, ylim=(-find_height(rows), 0))
    if zero:
        axes.axvline(0, color=style.GREY, linewidth=0.6, zorder=1)
    for row, middle in zip(rows, middles.tolist(), strict=True):
        for place, mark in enumerate(row.marks):
            height = middle + MARK_CM * ((len(row.marks) - 1) / 2 - place)
            _draw_mark(axes, mark, height=height, limits=limits)
    axes.set_yticks(middles, [row.label for row in rows])
    axes.tick_params(axis="y", length=0)
    for label, row in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_fontweight("normal" if row.marks else "bold")
    axes.locator_params(axis="x", nbins=5)


def _draw_mark(axes: Axes, mark: Mark, *, height: float, limits: tuple[float, float]) -> None:
    if np.isnan(mark.value):
        axes.text(sum(limits) / 2, height, UNKNOWN, ha="center", va="center", color=style.GREY)
        return
    strokes: dict[str, Any] = {"color": mark.look.colour, "zorder": 3, "clip_on": False}
    low, high = np.clip((mark.low, mark.high), *limits)
    axes.plot([low, high], [height, height], linewidth=1.0, solid_capstyle="butt", **strokes)
    for beyond, edge, arrow in (
        (mark.low < limits[0], limits[0], "<"),
        (mark.high > limits[1], limits[1], ">"),
    ):
        if beyond:
            axes.plot(edge, height, marker=arrow, markersize=3, markeredgewidth=0, **strokes)
    if np.isfinite(mark.value):
        style.plot_marks(
            axes, mark.value, height, look=mark.look, filled=mark.filled, clip_on=False
        )


# Forest plot: slopes of the primary model, and what other choices make of them.

STANDARDISED = "SD of ratings per SD of metric"

LEFT_OUT = ("without recording", "without source", "without reducer")
RESCALED = "ratings rescaled"
"""Headings: of variants that come once per name, and of those that follow them."""


def draw_slopes(
    models: Mapping[str, Primary],
    *,
    variants: DataFrame | None = None,
    steps: Mapping[str, Step] | None = None,
    title: str = "",
) -> Figure:
    """Draw the slopes of the primary model per attribute and metric, points per step with Satterthwaite intervals.

    steps: of the metrics, +0.1 if left out. title: the verdicts, which intervals that are not adjusted do not tell.
    variants: what `vary_primary` returns of a single attribute: a second panel of standardised slopes, which alone
    compare across units.
    """
    if not models:
        raise ValueError("models must hold one or more attributes with their models, got none")
    metrics = [str(name) for model in models.values() for name in model.slopes.index]
    metrics += [] if variants is None else list(map(str, variants["metric"]))
    looks = {
        name: Look((style.BLACK, style.GREY)[i % 2], style.MARKERS[i % len(style.MARKERS)])
        for i, name in enumerate(dict.fromkeys(metrics))
    }
    steps = {name: (steps or {}).get(name, Step()) for name in looks}
    with style.print_style():
        panels = [fit_rows(_list_slopes(models, looks, steps))]
        panels += [] if variants is None else [fit_rows(_list_variants(variants, looks))]
        heights = list(map(find_height, panels))
        figure = style.new_canvas(sum(heights) + AXIS_CM * (1 + len(panels)))
        both = figure.subplots(len(panels), 1, height_ratios=heights, squeeze=False)[:, 0]
        told = {step.per for step in steps.values()}
        per = told.pop() if len(told) == 1 else "step"
        labels = (f"Points of rating per {per} of metric", STANDARDISED)
        for axes, rows, label in zip(both, panels, labels, strict=False):
            draw_rows(axes, rows, limits=find_limits(rows, 0), zero=True)
            axes.set_xlabel(label)
        style.add_title(figure, f"{title}\n{_describe_slopes(models, variants)}".strip())
        style.add_legend(
            figure, style.make_handles({format_name(name): look for name, look in looks.items()})
        )
    return figure


def _list_slopes(
    models: Mapping[str, Primary], looks: Mapping[str, Look], steps: Mapping[str, Step]
) -> Iterator[ForestRow]:
    several = len({step.per for step in steps.values()}) > 1
    for attribute, model in models.items():
        yield ForestRow(format_name(attribute))
        for metric, row in zip(model.slopes.index, model.slopes.to_dict("records"), strict=True):
            share = steps[metric].size / TENTH
            value, low, high = (row[f"tenth{end}"] * share for end in ("", "_low", "_high"))
            name = format_name(metric) + f", per {steps[metric].per}" * several
            yield ForestRow(
                name, (Mark(value, low, high, looks[metric], filled=not model.fit.singular),)
            )


def _list_variants(table: DataFrame, looks: Mapping[str, Look]) -> Iterator[ForestRow]:
    headed = ""
    for variant, part in table.groupby("variant", sort=False):
        name = str(variant)
        heading = next((lead for lead in LEFT_OUT if name.startswith(f"{lead} ")), "")
        if heading != headed:
            yield ForestRow(heading or RESCALED)
        headed = heading
        yield ForestRow(
            name.removeprefix(heading).strip(),
            tuple(_mark_slopes(row, looks) for row in part.to_dict("records")),
        )


def _mark_slopes(row: Mapping[Hashable, object], looks: Mapping[str, Look]) -> Mark:
    value, low, high = (float(str(row[f"standardised{end}"])) for end in ("", "_low", "_high"))
    return Mark(value, low, high, looks[str(row["metric"])], filled=not row["singular"])


def _describe_slopes(models: Mapping[str, Primary], variants: DataFrame | None) -> str:
    def span(what: str) -> str:
        return f"{format_span(getattr(model, f'n_{what}') for model in models.values())} {what}"

    shared = any(model.n_sources < model.n_recordings for model in models.values())
    scenes = f"{span('recordings')} of {span('sources')}" if shared else span("recordings")
    items = format_span(model.n_items for model in models.values())
    singular = any(model.fit.singular for model in models.values()) or (
        variants is not None and variants["singular"].any()
    )
    hollow = " Hollow: singular fit (a spread estimated as zero)." if singular else ""
    below = "\nBelow: the same slopes, standardised, under other choices." * (variants is not None)
    return (
        "Slopes within recordings, mixed model; bars: 95 % Satterthwaite intervals, not adjusted. "
        f"n = {span('participants')}, {scenes}, {items} stimuli.{hollow}{below}"
    )


# Equivalence plot: differences between reducers against the margin within which they would not matter.

EQUIVALENT, OPEN = Look(style.BLACK, "o"), Look(style.BLACK, "D")


def draw_equivalence(
    contrasts: Mapping[str, Equivalence], *, n_participants: int, n_recordings: int, n_sources: int
) -> Figure:
    """Draw 90 % intervals of differences, such as ``dft321 − mag321``, against the margin of equivalence."""
    margins = {(test.low, test.high) for test in contrasts.values()}
    if len(margins) != 1:
        raise ValueError(
            f"contrasts must have one margin for all, got {len(margins)}; draw a figure for each"
        )
    ((low, high),) = margins
    with style.print_style():
        rows = fit_rows(ForestRow(name, (_mark(test),)) for name, test in contrasts.items())
        figure, axes = style.new_figure(find_height(rows) + AXIS_CM)
        axes.axvspan(low, high, color=style.PALE, linewidth=0, zorder=0)
        draw_rows(axes, rows, limits=find_limits(rows, 0, low, high), zero=True)
        axes.set_xlabel("Difference (points of rating)")
        shown = sum(test.equivalent for test in contrasts.values())
        margin = f"{format_number(low, kind='rating')} to {format_number(high, kind='rating')}"
        style.add_title(
            figure,
            f"Bars: 90 % intervals, of two one-sided tests at 5 %. Shaded: margin, {margin} points of rating. "
            f"Filled: equivalent, {shown} of {len(contrasts)}; hollow: not shown. "
            f"{format_count(n_participants, 'participant')}, {format_recordings(n_recordings, n_sources)}.",
        )
    return figure


def _mark(test: Equivalence) -> Mark:
    look = EQUIVALENT if test.equivalent else OPEN
    return Mark(test.estimate, test.low90, test.high90, look, filled=test.equivalent)


# Ratings per reducer: every participant, their distribution, the mean and its interval.

ROW_CM = 0.8
TWO_LINES, APART = 1.4, 0.8
"""Rows that a label of two lines takes, and that part references and anchors from tests."""

CLOUD, CLOUD_POINTS = 3, 81
"""Participants that a distribution needs, and points of its outline."""

CLOUD_OFF, CLOUD_ROWS, CLOUD_EDGE = 0.14, 0.5, 0.01
"""Where a distribution starts above its row and how high it is, in rows; where it ends, as share of its height."""


HEAD_CM, MOST_NAMED = 2.4, 2
"""Height of a profile's title and axis, and names that a title lists."""

EXTREMES = {
    PAIRED: ("least like the reference", "most like it"), ANSWERED: ("told apart most", "least"),
}  # fmt: skip
"""Scales on which more is not better -> what their highest and lowest mean say of a reducer."""

Profile = tuple["DataFrame", "DataFrame"]
"""Rows per reducer, and means per participant."""


def draw_profiles(parts: Sequence[Profile], *, looks: Mapping[str, Look]) -> Figure:
    """Draw rainclouds of several scales and levels beside each other, in each the reducer rated highest on top."""
    columns, several = min(2, len(parts)), len({own["level"].iloc[0] for own, _ in parts}) > 1
    with style.print_style():
        labels = [_label_rows(part, list(looks), LABEL_CM / columns**0.5) for part, _ in parts]
        places = list(map(_place_rows, labels))
        lowest = [min(own.values()) for own in places]
        lowest = [min(lowest[at - at % columns :][:columns]) for at in range(len(parts))]
        heights = [HEAD_CM - ROW_CM * low for low in lowest[::columns]]
        figure = style.new_canvas(sum(heights))
        grid = figure.subplots(len(heights), columns, height_ratios=heights, squeeze=False)
        for at, (axes, own) in enumerate(zip(grid.flat, parts, strict=False)):
            _draw_profile(axes, own, labels=labels[at], places=places[at], looks=looks)
            axes.set_ylim(lowest[at] - 0.6, 0.8)
            room = style.WIDTH_CM / columns - LABEL_CM / columns**0.5 - 1.0
            scale, level = own[0]["scale"].iloc[0], own[0]["level"].iloc[0] if several else ""
            axes.set_xlabel(style.label_scale(scale, room, level=level))
            name = f"{capitalise(format_name(scale))}{format_level(level)}"
            said = f"{name}: {describe_extremes(own[0])}".removesuffix(": ")
            axes.set_title(style.fit_text(said, room, lines=4))
        for axes in grid.flat[len(parts) :]:
            axes.remove()
        style.add_title(figure, _describe_people([part["n_participants"] for part, _ in parts]))
    return figure


def _draw_profile(
    axes: Axes,
    part: Profile,
    *,
    labels: Mapping[tuple[str, str], str],
    places: Mapping[tuple[str, str], float],
    looks: Mapping[str, Look],
) -> None:
    profile, participants = part
    _draw_people(axes, participants, places=places)
    for (role, name), height in places.items():
        chosen = (participants["role"] == role) & (participants["reducer"] == name)
        ratings = participants.loc[chosen, "rating"].to_numpy()
        _draw_cloud(axes, ratings, height=height, look=looks[name])
    for row in profile.to_dict("records"):
        height, look = places[row["role"], row["reducer"]], looks[row["reducer"]]
        _draw_mean(axes, row, height=height, look=look)
    axes.set_yticks(list(places.values()), list(labels.values()))
    axes.set(xlim=(LOWEST - 2, HIGHEST + 2), xticks=np.linspace(LOWEST, HIGHEST, 5))
    if apart := [height for (role, _), height in places.items() if role != ROLES[0]]:
        line = max(apart) + (TWO_LINES + APART) / 2
        axes.axhline(line, color=style.GREY, linewidth=style.THIN, linestyle=":")


def describe_extremes(profile: DataFrame) -> str:
    """Say which reducers are at either end where their intervals are apart; more than two alike are counted."""
    tests, means = (own := profile[profile["role"] == ROLES[0]]), own["mean"]
    high, low = (tests[means == end] for end in (means.max(), means.min()))
    if means.nunique() < MOST_NAMED or tests[["low", "high"]].isna().any(axis=None):
        return ""
    if high["low"].min() <= low["high"].max():
        return "highest and lowest do not differ clearly"
    names = (
        " and ".join(end["reducer"]) if len(end) <= MOST_NAMED else f"{len(end)} reducers"
        for end in (high, low)
    )
    ways = EXTREMES.get(profile["scale"].iloc[0], ("highest", "lowest"))
    return ", ".join(f"{name} {way}" for name, way in zip(names, ways, strict=True))


def _describe_people(columns: Sequence[Series]) -> str:
    counts = [int(count) for column in columns for count in column]
    people = "grey: each participant's mean; clouds: their distribution"
    if max(counts) < SMALLEST:
        return f"Mean of 1 participant, no interval; {people}"
    return f"Mean and 95 % t interval over {format_span(counts)} participants; {people}"


def _label_rows(
    profile: DataFrame, order: list[str], width_cm: float
) -> dict[tuple[str, str], str]:
    """Label of each (role, reducer), from top to bottom: tests from the highest mean down, reference, anchors."""
    means = dict(
        zip(zip(profile["role"], profile["reducer"], strict=True), profile["mean"], strict=True)
    )
    keys = [(role, name) for role in ROLES for name in order if (role, name) in means]
    keys.sort(key=lambda key: (ROLES.index(key[0]), -means[key] if key[0] == ROLES[0] else 0))
    return {
        (role, name): style.fit_text(name, width_cm)
        if role == ROLES[0]
        else f"{style.fit_text(name, width_cm, lines=1)}\n({role})"
        for role, name in keys
    }


def _place_rows(labels: Mapping[tuple[str, str], str]) -> dict[tuple[str, str], float]:
    """Height of each row's middle, the first at 0; rows of two lines take more room."""
    room = np.array([TWO_LINES if "\n" in label else 1.0 for label in labels.values()])
    below = np.array([APART * (role != ROLES[0]) for role, _ in labels])
    middles = np.cumsum(room) - room / 2 + below
    return dict(zip(labels, (middles[0] - middles).tolist(), strict=True))


def _draw_people(
    axes: Axes, participants: DataFrame, *, places: Mapping[tuple[str, str], float]
) -> None:
    strokes: dict[str, Any] = {"color": style.GREY, "linewidth": 0.4, "alpha": 0.6}
    strokes |= {"marker": ".", "markersize": 2}
    is_test = participants["role"] == ROLES[0]
    for (joined, _), part in participants.groupby([is_test, "participant"]):
        height = np.array([places[key] for key in zip(part["role"], part["reducer"], strict=True)])
        down, rating = np.argsort(-height), part["rating"].to_numpy(np.float64)
        axes.plot(rating[down], height[down], linestyle="-" if joined else "none", **strokes)


def _draw_cloud(axes: Axes, ratings: NDArray[np.float64], *, height: float, look: Look) -> None:
    """Draw how the participants' means are distributed, above their row."""
    if len(np.unique(ratings)) < CLOUD:
        return
    place = np.linspace(LOWEST, HIGHEST, CLOUD_POINTS)
    width = ratings.std(ddof=1) * len(ratings) ** -0.2  # Scott's rule
    density = np.exp(-0.5 * np.square((place[:, None] - ratings) / width)).sum(axis=1)
    seen, base = density > CLOUD_EDGE * density.max(), height + CLOUD_OFF
    top = base + CLOUD_ROWS * density / density.max()
    strokes: dict[str, Any] = {"color": look.colour, "alpha": 0.3, "linewidth": 0, "zorder": 2}
    around = np.concatenate([place[seen], place[seen][::-1]])
    axes.fill(around, np.concatenate([top[seen], np.full(seen.sum(), base)]), **strokes)


def _draw_mean(axes: Axes, row: Mapping[Hashable, Any], *, height: float, look: Look) -> None:
    spread = np.array([[row["mean"] - row["low"]], [row["high"] - row["mean"]]])
    strokes: dict[str, Any] = {"color": look.colour, "fmt": look.marker, "markersize": 4.5}
    strokes |= {"markeredgecolor": "white", "markeredgewidth": style.THIN, "elinewidth": 1.2}
    error = None if np.isnan(spread).any() else spread
    axes.errorbar(row["mean"], height, xerr=error, capsize=2.5, zorder=3, **strokes)


# Metrics ranked by how well they predict.


def draw_ranking(table: DataFrame, *, ceiling: float, level: float, size: str) -> Figure:
    """Draw the out-of-fold correlation of every metric, the best first, with the noise ceiling and level alone.

    table: of a `Ranking`; size: of the data, in words. Ceiling and level are NaN where there is none.
    """
    look = PLAIN
    rows = fit_rows(
        ForestRow(
            format_name(str(row["metric"])),
            (Mark(row["value"], row["low"], row["high"], look, filled=bool(row["may_be_best"])),),
        )
        for row in table.reset_index().to_dict("records")
    )
    with style.print_style():
        figure = style.new_canvas(find_height(rows) + AXIS_CM)
        axes = figure.subplots()
        limits = find_limits(rows, 0.0, *filter(np.isfinite, [ceiling, level]))
        draw_rows(axes, rows, limits=limits, zero=True)
        if np.isfinite(ceiling):
            axes.axvline(ceiling, color=style.BLACK, linestyle="--", linewidth=1.0, zorder=1)
        if np.isfinite(level):
            axes.axvline(level, color=style.GREY, linestyle=":", linewidth=1.0, zorder=1)
        axes.set_xlabel("Correlation within recordings, out of fold")
        style.add_title(
            figure,
            f"{len(rows)} metrics, {size}.\n"
            "Bars: 95 % intervals that hold for all metrics together. Dashed: noise ceiling.",
        )
    return figure
