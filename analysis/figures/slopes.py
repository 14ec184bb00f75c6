"""Forest plot: slopes of the primary model, and what other choices make of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.figures.legend import add_legend, make_handles
from analysis.figures.rows import AXIS_CM, Mark, Row, draw_rows, find_height, find_limits, fit_rows
from analysis.figures.style import GREY, Look, assign_looks, new_canvas, print_style
from analysis.figures.text import add_title, fit_text
from analysis.words import tell_name, tell_span

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from analysis.primary.model import Primary

MOST = 3
"""Attributes whose variants fit side by side."""

PANEL_CM = 4.3
"""What labels leave of the column."""

STANDARDISED = "SD of ratings per SD of metric"

LEFT_OUT = ("without recording", "without source", "without reducer")
RESCALED = "ratings rescaled"
"""Headings: of variants that come once per name, and of those that follow them."""


def draw_slopes(models: Mapping[str, Primary], *, variants: Mapping[str, DataFrame] | None = None) -> Figure:
    """Draw the slopes of the primary model per attribute and metric.

    Parameters
    ----------
    models : Mapping of str to Primary
        Attribute -> its model, as of `fit_attributes`.
    variants : Mapping of str to DataFrame, optional
        Attribute -> what `vary_primary` returns, of three attributes at most: a second panel of standardised
        slopes, which alone compare across units.

    Returns
    -------
    Figure
        Points per +0.1 of the metric with 95 % Satterthwaite intervals; hollow where the fit is singular.

    Raises
    ------
    ValueError
        If there are no models, or variants of too many attributes.
    """
    if not models:
        raise ValueError("models: got none, allowed is one or more attributes with their models")
    varied = dict(variants or {})
    if len(varied) > MOST:
        raise ValueError(f"variants: got {len(varied)} attributes, allowed are {MOST}; draw several figures")
    metrics = [*(str(name) for model in models.values() for name in model.slopes.index)]
    metrics += [str(name) for table in varied.values() for name in table["metric"]]
    looks = assign_looks(list(dict.fromkeys(metrics)))
    with print_style():
        rows = fit_rows(_list_slopes(models, looks))
        below = {name: fit_rows(_list_variants(table, looks)) for name, table in varied.items()}
        heights = [find_height(rows), max(map(find_height, below.values()), default=0.0)]
        figure = new_canvas(sum(heights) + AXIS_CM * (2 + bool(below)))
        grid = figure.add_gridspec(1 + bool(below), max(1, len(below)), height_ratios=heights[: 1 + bool(below)])
        _draw_primary(figure.add_subplot(grid[0, :]), rows)
        _draw_variants([figure.add_subplot(grid[1, place]) for place in range(len(below))], below)
        add_title(figure, _tell(models, varied))
        add_legend(figure, make_handles({tell_name(name): look for name, look in looks.items()}))
    return figure


def _list_slopes(models: Mapping[str, Primary], looks: Mapping[str, Look]) -> Iterator[Row]:
    for attribute, model in models.items():
        yield Row(tell_name(attribute))
        for metric, row in zip(model.slopes.index, model.slopes.to_dict("records"), strict=True):
            ends = row["tenth"], row["tenth_low"], row["tenth_high"]
            yield Row(tell_name(metric), (Mark(*ends, looks[metric], filled=not model.fit.singular),))


def _list_variants(table: DataFrame, looks: Mapping[str, Look]) -> Iterator[Row]:
    headed = ""
    for variant, part in table.groupby("variant", sort=False):
        name = str(variant)
        heading = next((lead for lead in LEFT_OUT if name.startswith(f"{lead} ")), "")
        if heading != headed:
            yield Row(heading or RESCALED)
        headed = heading
        yield Row(name.removeprefix(heading).strip(), tuple(_mark(row, looks) for row in part.to_dict("records")))


def _mark(row: Mapping[Hashable, object], looks: Mapping[str, Look]) -> Mark:
    value, low, high = (float(str(row[f"standardised{end}"])) for end in ("", "_low", "_high"))
    return Mark(value, low, high, looks[str(row["metric"])], filled=not row["singular"])


def _draw_primary(axes: Axes, rows: list[Row]) -> None:
    axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
    draw_rows(axes, rows, limits=find_limits(rows, 0))
    axes.set_xlabel("Points of rating per +0.1 of metric")


def _draw_variants(panels: list[Axes], below: Mapping[str, list[Row]]) -> None:
    limits = find_limits([row for rows in below.values() for row in rows], 0)
    for place, (axes, (attribute, rows)) in enumerate(zip(panels, below.items(), strict=True)):
        axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
        draw_rows(axes, rows, limits=limits)
        axes.locator_params(axis="x", nbins=5 - len(below))
        axes.set_title(fit_text(tell_name(attribute), PANEL_CM / len(below)))
        axes.set_xlabel(fit_text(STANDARDISED, PANEL_CM / len(below), lines=4))
        if place:
            axes.tick_params(axis="y", labelleft=False)


def _tell(models: Mapping[str, Primary], varied: Mapping[str, DataFrame]) -> str:
    def span(what: str) -> str:
        return f"{tell_span(getattr(model, f'n_{what}') for model in models.values())} {what}"

    shared = any(model.n_sources < model.n_recordings for model in models.values())
    scenes = f"{span('recordings')} of {span('sources')}" if shared else span("recordings")
    items = tell_span(model.n_items for model in models.values())
    singular = any(model.fit.singular for model in models.values()) or any(
        table["singular"].any() for table in varied.values()
    )
    hollow = " Hollow: singular fit (a spread estimated as zero)." if singular else ""
    second = "\nBelow: the same slopes, standardised, under other choices." if varied else ""
    return (
        f"Slopes within recordings, mixed model; bars: 95 % Satterthwaite intervals. "
        f"n = {span('participants')}, {scenes}, {items} stimuli.{hollow}{second}"
    )
