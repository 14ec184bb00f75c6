"""Figures: how they look, and their kinds: forest, scatter, profile and map, which every section and `plot_...` use.

Conventions: one and a half columns wide (14 cm), which fills a page of 700 pixels with text of its body's size (8
points); every figure names its unit, its interval and n. Every reducer has a colour and a marker of its own, safe for
the colour-blind and the same in all figures, and nothing else has a colour: metrics, scales and verdicts are told apart
by ink, grey, fill and line style. Files are for print; on a page `PAGE_COLOURS` follow the reader's choice of light or
dark. Nothing is computed here that a result does not hold, but for what an eye needs. `plot_` functions draw on axes
that are given; `draw_` functions make a figure of a report.
"""

from __future__ import annotations

import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.schema import HIGHEST, LOWEST, ROLES
from feel321.analysis.words import (
    format_axis,
    format_interval,
    format_measure,
    format_name,
    format_number,
)

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import ArrayLike
    from pandas import DataFrame

    from feel321.records import Statistic

WIDTH_CM, CM_PER_INCH = 14.0, 2.54
THIN, GREY, BLACK, PALE = 0.5, "#757575", "#000000", "#DEDEDE"
# What ink, grey, fill and paper are on a page: names of its style sheet's variables
PAGE_COLOURS: Mapping[str, str] = MappingProxyType({
    BLACK: "ink", GREY: "faint", PALE: "line", "#FFFFFF": "paper",
})  # fmt: skip
# Colour-blind safe; its yellow is left out because it fades on white paper
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# As many as can be told apart in print; a pair of colour and marker comes again only after 77 reducers
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "p")
PRINT: Any = {
    "font.family": "DejaVu Sans", "font.size": 8, "axes.labelsize": 8, "axes.titlesize": 8,
    "figure.titlesize": 8.5, "figure.labelsize": 8,
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "axes.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.titlelocation": "left",
    "lines.markersize": 4, "lines.linewidth": 0.8, "text.parse_math": False,
    "svg.fonttype": "none", "svg.hashsalt": "feel321",
}  # fmt: skip
# Letters of 8 points beside each other, on average, and the height of their line
LETTERS_PER_CM, LINE_CM = 6.2, 0.36


@dataclass(frozen=True, slots=True)
class Look:
    """Colour and marker of a reducer."""

    colour: str
    marker: str


def assign_looks(reducers: Sequence[str]) -> dict[str, Look]:
    """Give every reducer a look."""
    pairs = zip(cycle(OKABE_ITO), cycle(MARKERS), strict=False)
    return {name: Look(*pair) for name, pair in zip(reducers, pairs, strict=False)}


@contextmanager
def print_style() -> Iterator[None]:
    """Set fonts and lines for print while figures are drawn or saved."""
    from matplotlib import rc_context, rcParamsDefault

    # All settings but the window's start from the library's own: a matplotlibrc in the working folder must not
    # change a byte.
    apart = ("backend", "_")
    plain = {name: one for name, one in rcParamsDefault.items() if not name.startswith(apart)}
    with rc_context({**plain, **PRINT}), warnings.catch_warnings():
        # `list_undrawable` lists them once.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def list_undrawable(names: Iterable[str]) -> str:
    """List the characters that the figures' font does not have."""
    from matplotlib.font_manager import findfont, get_font

    known = get_font(findfont(PRINT["font.family"])).get_charmap()
    return "".join(sorted({one for name in names for one in name if ord(one) not in known}))


def new_canvas(height_cm: float) -> Figure:
    """Make a figure without axes."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_CM / CM_PER_INCH, height_cm / CM_PER_INCH), layout="constrained")


def new_figure(height_cm: float) -> tuple[Figure, Axes]:
    """Make a figure with one pair of axes."""
    figure = new_canvas(height_cm)
    return figure, figure.add_subplot()


def plot_marks(
    axes: Axes,
    x: ArrayLike,
    y: ArrayLike,
    *,
    look: Look,
    size: float = 4.0,
    filled: bool = True,
    **style: Any,  # noqa: ANN401 - whatever a line takes
) -> Line2D:
    """Draw points, with a white rim that keeps neighbours apart, or hollow."""
    rim, face = ("white", look.colour) if filled else (look.colour, "white")
    return axes.plot(x, y, **{
        "marker": look.marker, "markersize": size, "linestyle": "none", "color": look.colour, "markerfacecolor": face,
        "markeredgecolor": rim, "markeredgewidth": THIN if filled else 0.8, "zorder": 3, **style,
    })[0]  # fmt: skip


# Words in figures: broken by the number of letters, so that no name runs off or into another.


def fit_text(text: str, width_cm: float, *, lines: int = 2) -> str:
    """Break a text into lines that are about as wide as their place; what does not fit loses its middle."""
    room = max(4, int(width_cm * LETTERS_PER_CM))
    parts = (textwrap.wrap(part.replace("_", "_ "), room) or [""] for part in text.split("\n"))
    found = [line.replace("_ ", "_") for part in parts for line in part]
    if len(found) > lines:
        parted = (line if line.endswith("_") else f"{line} " for line in found[lines - 1 :])
        rest = "".join(parted).rstrip()
        kept, tail = (room - 1) // 2, room // 2
        found[lines - 1 :] = [f"{rest[:kept].rstrip()}…{rest[-tail:].lstrip()}"]
    return "\n".join(found)


def label_scale(scale: str, length_cm: float = 6.0, *, level: str = "") -> str:
    """Label an axis of that length by the scale that was rated, and by the level where there are several."""
    of = f", level {format_name(level)}" if level else ""
    text = f"Mean {format_measure(scale)}{of} ({LOWEST:.0f}–{HIGHEST:.0f})"
    return fit_text(text, length_cm, lines=3)


def add_title(figure: Figure, text: str) -> None:
    """Write above a figure what it shows, and give it the height that this takes."""
    fitted = fit_text(text, WIDTH_CM - 1.0, lines=8)
    figure.suptitle(fitted, x=0.2 / WIDTH_CM, ha="left")
    grow(figure, LINE_CM * (1 + fitted.count("\n")))


def add_legend(figure: Figure, shown: Mapping[str, Artist]) -> None:
    """Put the legend of names below, in as many columns as there is room for."""
    labels = [fit_text(name, WIDTH_CM / 2, lines=1) for name in shown]
    columns = max(1, int(WIDTH_CM / (max(map(len, labels)) / LETTERS_PER_CM + 0.9)))
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "frameon": False}
    figure.legend(list(shown.values()), labels, handletextpad=0, columnspacing=0.8, **place)
    grow(figure, 0.45 * -(-len(labels) // columns))


def grow(figure: Figure, height_cm: float) -> None:
    """Make a figure higher."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + height_cm / CM_PER_INCH)


def make_handles(looks: Mapping[str, Look]) -> dict[str, Artist]:
    """Make what stands for each name in a legend."""
    from matplotlib.lines import Line2D

    rim: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markeredgewidth": THIN}
    pairs = looks.items()
    return {name: Line2D([], [], color=one.colour, marker=one.marker, **rim) for name, one in pairs}


# How figures are saved: as vector and as bitmap, the same bytes for the same data.

PNG_DPI = 200
# Format -> what matplotlib writes into its files beside the drawing: its version and the hour, which differ
STAMPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "svg": ("Date", "Creator", "Format", "Type"), "png": ("Software",),
})  # fmt: skip


def save_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as vector and as bitmap."""
    with print_style():
        if engine := figure.get_layout_engine():
            # Everything gets its place once, for every format, and nothing is drawn for that.
            engine.execute(figure)
            figure.set_layout_engine(None)
        for name, stamps in STAMPS.items():
            # A name may end in what looks like a suffix: dft_v1.5.
            path = stem.with_name(f"{stem.name}.{name}")
            figure.savefig(path, dpi=PNG_DPI, metadata=dict.fromkeys(stamps))


PLAIN = Look(BLACK, "o")
AXIS_CM, LABEL_CM = 1.5, 4.4  # Room for an axis's numbers and its label, and for a row's name

# Forest: estimates with intervals, one row each.

ROW_CM, MARK_CM = 0.46, 0.24  # Height of a row, and of each further mark in it
# An interval is cut, with an arrow, where it is this many times as wide as the range of the estimates and of half of
# all intervals: one that is uninformative must not squeeze all others
FARTHEST = 6.0


def plot_forest(  # noqa: PLR0913 - what a forest may have, by name
    axes: Axes,
    frame: DataFrame,
    *,
    columns: str = "value low high",
    looks: Mapping[str, Look] = MappingProxyType({}),
    series: str = "",
    heading: str = "",
    include: Iterable[float] = (0.0,),
) -> None:
    """Plot estimates with their intervals, the first on top: a row per name, in it a mark per series.

    frame: the column `name`, those of value, low and high, and `filled` where some are hollow. looks: of each series.
    heading: column of what rows are headed by. include: values that the axis must hold; at 0 it has a line.
    """
    held = list(include)
    limits = _find_limits(frame[columns.split()].astype(float), held)
    labels, weights, last = list[str](), list[str](), ""
    for keys, part in frame.groupby([heading or "name", "name"], sort=False):
        head, name = map(str, keys)
        if heading and head != last:
            last = head
            labels.append(fit_text(head, LABEL_CM + 1, lines=1))
            weights.append("bold")
        for number, row in enumerate(part.to_dict("records")):
            look = looks.get(str(row[series]), PLAIN) if series else PLAIN
            height = len(labels) + (number - (len(part) - 1) / 2) * MARK_CM / ROW_CM
            ends, filled = [row[one] for one in columns.split()], bool(row.get("filled", True))
            _plot_mark(axes, ends, height, limits=limits, look=look, filled=filled)
        labels.append(fit_text(name, LABEL_CM))
        weights.append("normal")
    if 0.0 in held:
        axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
    axes.set(xlim=limits, ylim=(len(labels) - 0.4, -0.6))
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(axis="y", length=0)
    for label, weight in zip(axes.get_yticklabels(), weights, strict=True):
        label.set_fontweight(weight)
    axes.locator_params(axis="x", nbins=5)


def _find_limits(estimates: DataFrame, include: Sequence[float]) -> tuple[float, float]:
    """Find the part of the axis that holds all estimates, and all intervals that are not endless."""
    values, ends = np.array([*estimates.iloc[:, 0], *include]), estimates.iloc[:, 1:].to_numpy()
    values, ends = values[np.isfinite(values)], ends[np.isfinite(ends).all(axis=1)]
    if not len(values):
        return -1.0, 1.0
    least, most = values.min(), values.max()
    usual = float(np.median(ends[:, 1] - ends[:, 0])) if len(ends) else 0.0
    room = FARTHEST * max(most - least, usual, np.finfo(float).tiny)
    low = max(min(least, ends[:, 0].min(initial=least)), least - room)
    high = min(max(most, ends[:, 1].max(initial=most)), most + room)
    pad = 0.06 * (high - low) or 1.0
    return float(low - pad), float(high + pad)


def _plot_mark(
    axes: Axes, ends: Sequence[float], height: float, *, limits: tuple[float, float], look: Look, filled: bool
) -> None:  # fmt: skip
    value, low, high = ends
    if np.isnan(value):
        place: dict[str, Any] = {"ha": "center", "va": "center", "color": GREY}
        axes.text(sum(limits) / 2, height, "no estimate", **place)
        return
    strokes: dict[str, Any] = {"color": look.colour, "zorder": 3, "clip_on": False}
    axes.plot(np.clip((low, high), *limits), [height, height], linewidth=1.0, **strokes)
    arrows = (low < limits[0], limits[0], "<"), (high > limits[1], limits[1], ">")
    for edge, arrow in ((edge, arrow) for beyond, edge, arrow in arrows if beyond):
        axes.plot(edge, height, marker=arrow, markersize=3, markeredgewidth=0, **strokes)
    plot_marks(axes, value, height, look=look, filled=filled, clip_on=False)


def look_up(names: Iterable[str]) -> dict[str, Look]:
    """Give every metric or scale a grey and a marker."""
    return {
        name: Look((BLACK, GREY)[i % 2], MARKERS[i % len(MARKERS)])
        for i, name in enumerate(dict.fromkeys(map(str, names)))
    }


def draw_estimates(  # noqa: PLR0913 - what a forest may have, by name
    frame: DataFrame,
    label: str,
    *,
    columns: str = "value low high",
    series: str = "",
    heading: str = "",
    lines: Mapping[str, float] = MappingProxyType({"-": 0.0}),
    band: tuple[float, float] = (np.nan, np.nan),
) -> Figure:
    """Draw a forest as a figure of its own, as `plot_forest` takes its frame.

    lines: line style -> place of a vertical line; band: places between which it is shaded.
    """
    looks = look_up(frame[series]) if series else {}
    include = [place for place in (*lines.values(), *band) if np.isfinite(place)]
    with print_style():
        figure, axes = new_figure(AXIS_CM)
        forest: dict[str, Any] = {"columns": columns, "series": series, "heading": heading}
        plot_forest(axes, frame, include=include, looks=looks, **forest)
        # A row is as high as its marks, or as the name that takes most lines.
        marks = int(frame.groupby([heading or "name", "name"]).size().max())
        names = [name.get_text() for name in axes.get_yticklabels()]
        text_cm = LINE_CM * (1.3 + max(name.count("\n") for name in names))
        grow(figure, len(names) * max(ROW_CM + MARK_CM * (marks - 1), text_cm))
        axes.set_xlabel(label)
        for line, place in lines.items():
            if place and np.isfinite(place):
                colour, width = (GREY, 0.6) if line == "-" else (BLACK, 1.0)
                axes.axvline(place, linestyle=line, color=colour, linewidth=width, zorder=1)
        if np.isfinite(band).all():
            axes.axvspan(*band, color=PALE, linewidth=0, zorder=0)
        if len(looks) > 1 and not heading:
            named = {format_name(name): look for name, look in looks.items()}
            add_legend(figure, make_handles(named))
    return figure


# Scatter: stimuli as points, their ratings against a metric; residuals.

# Values of eq. 1 below this are drawn at the edge: one spectral match of -30 would squeeze all others together.
CUT = -1.0
CELL_CM = 4.2


def find_cut(metric: str) -> float:
    """Find below what values of a metric are drawn at the edge: those of eq. 1, which has no lower bound, only."""
    return CUT if metric.startswith("spectral_match") and "bounded" not in metric else -np.inf


def plot_stimuli(
    axes: Axes, stimuli: DataFrame, metric: str, *, looks: Mapping[str, Look], size: float = 4.0
) -> dict[str, Any]:
    """Plot the mean rating of each stimulus against a metric, bars over participants; return the marks by reducer."""
    cut = find_cut(metric)
    at, inside = stimuli[metric].clip(lower=cut), stimuli[metric] >= cut
    bars: dict[str, Any] = {"colors": GREY, "linewidths": 0.35, "alpha": 0.6, "zorder": 1}
    axes.vlines(at, stimuli["low"], stimuli["high"], **bars)
    shown: dict[str, Any] = {}
    for reducer in order_reducers(stimuli["reducer"]):
        own = stimuli["reducer"] == reducer
        for filled, chosen in ((False, own & ~inside), (True, own & inside)):
            if chosen.any():
                look: dict[str, Any] = {"look": looks[reducer], "size": size, "filled": filled}
                marks = plot_marks(axes, at[chosen], stimuli.loc[chosen, "mean"], **look)
                shown[reducer] = marks
    axes.set_xlabel(format_axis(metric))
    return shown


def draw_scatters(
    panels: Sequence[Statistic], metrics: Sequence[str], *, method: str, looks: Mapping[str, Look]
) -> Figure:
    """Draw mean ratings against metrics: a row per scale and level, a column per metric."""
    several = len({panel.level for panel in panels}) > 1
    shown: dict[str, Any] = {}
    with print_style():
        figure = new_canvas(CELL_CM * len(panels) + AXIS_CM)
        grid = figure.subplots(len(panels), len(metrics), sharex="col", sharey=True, squeeze=False)
        for line, panel in zip(grid, panels, strict=True):
            level = panel.level * several
            line[0].set_ylabel(label_scale(panel.scale, CELL_CM - 0.4, level=level))
            found = {one.metric: one for one in panel.associations if one.method == method}
            for axes, metric in zip(line, metrics, strict=True):
                shown |= plot_stimuli(axes, panel.stimuli, metric, looks=looks, size=4.2)
                axes.set(ylim=(LOWEST - 3, HIGHEST + 3), yticks=np.linspace(LOWEST, HIGHEST, 5))
                ends = format_interval(found[metric].low, found[metric].high)
                axes.set_title(f"r = {format_number(found[metric].value)} ({ends})")
                axes.locator_params(axis="x", nbins=5)
                axes.label_outer()
        for axes in grid[-1]:
            axes.set_xlabel(fit_text(axes.get_xlabel(), WIDTH_CM / len(metrics) - 1))
        add_legend(figure, {name: shown[name] for name in looks if name in shown})
    return figure


# Points that an eye can use; of more rows this many are drawn, evenly through their order
MOST = 2000


def draw_residuals(models: Mapping[str, Statistic]) -> Figure:
    """Draw a normal quantile plot of each model's residuals, and the residuals against the fitted values."""
    from scipy.special import ndtri

    points: dict[str, Any] = {"linestyle": "none", "markersize": 2, "markeredgewidth": 0}
    with print_style():
        figure = new_canvas(CELL_CM * len(models))
        grid = figure.subplots(len(models), 2, squeeze=False)
        for (left, right), (name, model) in zip(grid, models.items(), strict=True):
            residuals, fitted = model.fit.residuals, model.fit.fitted
            n = len(residuals)
            chosen = np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(np.intp))
            ordered = np.sort(residuals) / (residuals.std(ddof=1) or 1.0)
            left.axline((0, 0), slope=1, color=GREY, linewidth=0.6, zorder=1)
            at = ndtri((chosen + 0.5) / n)
            left.plot(at, ordered[chosen], "o", color=BLACK, **points)
            right.axhline(0, color=GREY, linewidth=0.6, zorder=1)
            place = fitted[chosen], residuals[chosen]
            right.plot(*place, "o", color=BLACK, alpha=0.4, **points)
            title = fit_text(name, 6.0)
            left.set(xlabel="Normal quantile (SD)", ylabel="Residual (SD)", title=title)
            right.set(xlabel="Fitted (points)", ylabel="Residual (points)")
    return figure


# Profile: ratings per reducer, every participant, the mean and its interval.


def draw_profiles(
    parts: Sequence[tuple[str, DataFrame, DataFrame]], looks: Mapping[str, Look]
) -> Figure:
    """Draw the profiles of scales and levels, by name: rows per reducer, and means per participant."""
    columns = min(2, len(parts))
    rows = max(len(profile) for _, profile, _ in parts)
    with print_style():
        lines = -(-len(parts) // columns)
        figure = new_canvas((0.72 * rows + 1.6) * lines)
        grid = figure.subplots(lines, columns, squeeze=False)
        for axes, (name, profile, people) in zip(grid.flat, parts, strict=False):
            plot_profile(axes, profile, people, looks=looks, label_cm=LABEL_CM / columns**0.5)
            axes.set_title(fit_text(name, 4.5))
            scale = str(profile["scale"].iloc[0])
            axes.set_xlabel(label_scale(scale, WIDTH_CM / columns - 3))
        for axes in grid.flat[len(parts) :]:
            axes.remove()
    return figure


def plot_profile(
    axes: Axes,
    profile: DataFrame,
    people: DataFrame,
    *,
    looks: Mapping[str, Look],
    label_cm: float = LABEL_CM,
) -> None:
    """Plot the ratings of one scale and level: tests from the highest mean down, then reference and anchors."""
    tested = profile["role"] == ROLES[0]
    fall = -profile["mean"].where(tested, 0.0)
    order = profile.assign(rank=profile["role"].map(ROLES.index), fall=fall)
    rows = order.sort_values(["rank", "fall"], kind="stable").to_dict("records")
    n_tests, places = int(tested.sum()), dict[tuple[Any, Any], float]()
    if 0 < n_tests < len(rows):
        axes.axhline(n_tests - 0.25, color=GREY, linewidth=THIN, linestyle=":")
    labels = []
    for place, row in enumerate(rows):
        height, role, reducer = place + 0.5 * (place >= n_tests), row["role"], row["reducer"]
        places[role, reducer], look = height, looks.get(reducer, PLAIN)
        if np.isfinite(row["low"]):
            bar: dict[str, Any] = {"color": look.colour, "linewidth": 1.2, "zorder": 3}
            axes.plot([row["low"], row["high"]], [height, height], **bar)
        plot_marks(axes, row["mean"], height, look=look, size=4.5)
        name = reducer if place < n_tests else f"{reducer} ({role})"
        labels.append(fit_text(name, label_cm))
    pale: dict[str, Any] = {"color": GREY, "alpha": 0.6, "marker": ".", "markersize": 2}
    for (joined, _), part in people.groupby([people["role"] == ROLES[0], "participant"]):
        keys = zip(part["role"], part["reducer"], strict=True)
        own = part.assign(height=[places[key] for key in keys]).sort_values("height")
        line = "-" if joined else "none"
        axes.plot(own["rating"], own["height"], linestyle=line, linewidth=0.4, **pale)
    axes.set_yticks(list(places.values()), labels)
    axes.set(xlim=(LOWEST - 2, HIGHEST + 2), ylim=(max(places.values()) + 0.6, -0.8))


# Map of stimuli: what people tell apart, and how sure each place is.

MAP_CM = 8.0
ORIGINAL, STAR = "original", Look(BLACK, "*")  # The hidden reference, and how it is drawn


def draw_space(space: Statistic, names: Sequence[str]) -> Figure:
    """Draw the group's map with an ellipse per stimulus; a star is the original."""
    from matplotlib.patches import Ellipse

    ellipses = space.ellipses
    looks = assign_looks([name for name in names if name != ORIGINAL]) | {ORIGINAL: STAR}
    with print_style():
        figure, axes = new_figure(MAP_CM)
        shapes = (names, space.positions, ellipses.half_axes, ellipses.angle)
        for name, place, half, angle in zip(*shapes, strict=True):
            look = looks[name]
            fill: dict[str, Any] = {"facecolor": look.colour, "alpha": 0.15, "linewidth": 0}
            axes.add_patch(Ellipse(tuple(place), *(2 * half), angle=float(angle), **fill))
            plot_marks(axes, place[0], place[1], look=look, size=9.0 if look == STAR else 4.5)
        axes.set_xlabel("Dimension 1 (unit of dissimilarity)")
        axes.set_ylabel("Dimension 2 (unit of dissimilarity)")
        axes.autoscale_view()
        axes.set_aspect("equal", adjustable="datalim")
        drawn = f"n = {ellipses.n_participants} participants, {ellipses.draws} draws"
        add_title(figure, f"Stress-1 = {space.stress:.2f}; ellipses: {drawn}.")
        add_legend(figure, make_handles({name: looks[name] for name in names}))
    return figure


# Of a drawing's file: its head, who made it, and a style sheet that would style the whole page
UNWANTED = re.compile(
    r"^.*?(?=<svg)|<metadata>.*?</metadata>|<defs>\s*<style[^>]*>.*?</style>\s*</defs>", re.DOTALL
)


def inline_svg(name: str, caption: str, path: Path) -> Markup:
    """Make a figure's SVG file part of a page, in the page's colours; its ids begin with the figure's name."""
    from markupsafe import Markup, escape

    body = UNWANTED.sub("", path.read_text(encoding="utf-8"))
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", body)
    body = re.sub(r"(\d+\.\d\d)\d+", r"\1", body)
    body = body.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    for size in ("width", "height"):
        body = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", body, count=1)
    for colour, variable in PAGE_COLOURS.items():
        body = re.sub(rf"(?<=[:\" ]){colour}\b", f"var(--{variable})", body, flags=re.IGNORECASE)
    label = f'<svg role="img" aria-label="{escape(caption)}" fill="currentColor" stroke-linejoin="round"'
    return Markup(body.replace("<svg", label, 1))  # noqa: S704 - our own drawing, its caption escaped
