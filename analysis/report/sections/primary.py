"""The primary analysis: slopes of ratings on metrics within recordings, and what a larger study would add."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.figures.residuals import draw_residuals
from analysis.figures.slopes import draw_slopes
from analysis.numbers import COUNT, count_number, make_number, name_path
from analysis.primary.model import fit_primary, tabulate_slopes
from analysis.report.lines import Line
from analysis.report.pictures import Picture, make_slug
from analysis.report.sections.effects import (
    SIGNIFICANCE,
    lay_estimate,
    name_estimate,
    name_tests,
    tell_estimate,
    tell_p,
    tell_reach,
)
from analysis.report.sections.section import Cell, Grid, Section
from analysis.report.sections.settling import SETTLING, lay_precision, name_precision, tell_need
from analysis.report.sections.thinning import thin_parts
from analysis.table.sources import tell_recordings
from analysis.words import start, tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from analysis.numbers import Number
    from analysis.primary.model import Primary
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Row = dict[Hashable, Any]
    Fits = dict[str, tuple[Part, Primary]]

KEY, TITLE = "primary", "What +0.1 of a metric goes with"
IN_SD = "slope in this study's standard deviations"
QUARTILES = "mixed model, points of rating from the metric's lower to its upper quartile within recordings"
CENTRED = "mixed model with reducers fixed, points of rating per +0.1 of the metric centred on recordings and reducers"
HOW = (
    "Primary analysis: a linear mixed model per scale and level, on means over repeats, of ratings on each metric's "
    "deviation from its recording's mean and on that mean, with spreads between participants (of level and of slopes), "
    "recordings, stimuli, participants' recordings, reducers and participants' reducers (and, where several recordings "
    "come from one source, between sources and between what was reduced alike from one source); restricted maximum "
    "likelihood, Satterthwaite's degrees of freedom (Barr et al. 2013, doi 10.1016/j.jml.2012.11.001). With fewer than "
    "8 reducers their spread is kept from zero (Chung et al. 2013, doi 10.1007/s11336-013-9328-2). The claim is the "
    "slope within recordings; beside it the slope with reducers as fixed effects, on the metric centred on recordings "
    "and on reducers. Below 3 participants, 3 recordings (or sources) or 2 degrees of freedom: not estimable. "
    "Spreads estimated as zero stay in the model. p are adjusted by Holm over all slopes of the table.",
)


def compute(table: Table, choices: Choices) -> Section:
    """Fit the primary model of every scale and level.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Seed, for what is too large to be fitted as a whole.

    Returns
    -------
    Section
        Slopes, their differences, explained variance, precision.
    """
    fits, notes = fit_parts(table, choices)
    if not fits:
        return Section(KEY, TITLE, notes=notes)
    slopes = tabulate_slopes({lead: model for lead, (_, model) in fits.items()})
    rows = list(slopes.to_dict("records"))
    numbers = [_name_slope(row, fits[row["attribute"]]) for row in rows]
    tests = sum(row["estimable"] for row in rows)
    precisions = [name_precision(row, *fits[row["attribute"]], n_tests=tests) for row in rows]
    told = list(zip(rows, numbers, precisions, strict=True))
    answers = [_judge_slope(row, number[0], *fits[row["attribute"]]) for row, number, _ in told]
    verdict = [_sum_up([one for one in told if one[0]["attribute"] == lead], *fit) for lead, fit in fits.items()]
    grids = [_lay_slopes(rows, numbers), _lay_standardised(rows, numbers), _lay_models(fits)]
    grids.append(lay_precision(rows, precisions))
    differences = list(_list_differences(fits))
    return Section(
        key=KEY, title=TITLE, answers=tuple(answers), verdict=tuple(verdict),
        grids=(*grids[:1], *([_lay_differences(fits, differences)] if differences else []), *grids[1:]),
        tables=_make_tables(fits, slopes), pictures=tuple(_draw_models(fits)),
        notes=(*notes, *_note_models(fits)), how=(*HOW, SETTLING),
    )  # fmt: skip


def fit_parts(table: Table, choices: Choices) -> tuple[Fits, tuple[str, ...]]:
    """Fit every part that can be fitted.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Seed.

    Returns
    -------
    fits : dict
        Part's lead -> part and model.
    notes : tuple of str
        Why a part has no model.
    """
    fits, notes = {}, []
    for part in thin_parts(table, choices):
        notes += [part.thinned] if part.thinned else []
        try:
            fits[part.lead] = part, fit_primary(part.rows, table.metrics)
        except ValueError as error:
            notes.append(f"{part.lead}: no primary model. {error}")
    return fits, tuple(notes)


def _draw_models(fits: Fits) -> Iterator[Picture]:
    models = {lead: model for lead, (_, model) in fits.items()}
    bars = "bars are 95 % Satterthwaite intervals; hollow: singular fit."
    caption = f"Slope within recordings of ratings on each metric, points per +0.1 of it, mixed model; {bars}"
    yield Picture("slopes", "forest", caption, draw_slopes(models))
    for part, model in fits.values():
        caption = (
            f"Residuals of the primary model of {part.subject}: left against normal quantiles with a pointwise 95 % "
            "band, right against fitted values."
        )
        yield Picture(make_slug("residuals", *part.place), "residuals", caption, draw_residuals(model.fit), detail=True)


def _name_slope(row: Row, fit: tuple[Part, Primary]) -> tuple[Number, ...]:
    part, model = fit
    name, n = name_path("slope", *part.place, row["metric"]), model.n_rows
    quartile: Row = {"estimate": row["quartile_effect"], "low": row["quartile_low"], "high": row["quartile_high"]}
    centred: Row = {
        "estimate": row["centred"] / 10, "low": row["centred_low"] / 10, "high": row["centred_high"] / 10
    }  # fmt: skip
    return (
        name_estimate(name, row, "mixed model, points of rating per +0.1 of the metric", n=n, prefix="tenth"),
        name_estimate(f"{name}.standardised", row, IN_SD, n=n, prefix="standardised"),
        *name_tests(name, row, n=n),
        name_estimate(f"{name}.quartile_effect", quartile, QUARTILES, n=n),
        name_estimate(f"{name}.centred", centred, CENTRED, n=n),
    )


def _judge_slope(row: Row, slope: Number, part: Part, model: Primary) -> str:  # noqa: PLR0917 - as they are kept
    metric = tell_name(row["metric"])
    if not row["estimable"]:
        return f"The slope of {part.ratings} on {metric} within recordings is not estimable ({_tell_size(model)})."
    evidence = f"per +0.1: {tell_estimate(slope, kind='slope')}; {tell_p(row['p_holm'])}; {_tell_size(model)}"
    if not row["p_holm"] < SIGNIFICANCE:
        return f"Whether {part.ratings} follow {metric} within recordings is undecided ({evidence})."
    way = "higher" if slope.value > 0 else "lower"
    claim = f"Within recordings, stimuli with a higher {metric} got {way} {part.ratings}"
    return f"{claim} ({evidence}){_tell_reach(model)}."


def _sum_up(told: list[tuple[Row, tuple[Number, ...], tuple[Number, ...]]], part: Part, model: Primary) -> Line:
    """Say in one line what the model of a part shows, and what would settle what it leaves open."""
    found = "; ".join(_tell_slope(row, numbers[0]) for row, numbers, _ in told)
    scenes = "sources" if model.n_sources < model.n_recordings else "recordings"
    needs = "".join(tell_need(row, settled, scenes=scenes) for row, _, settled in told)
    together = ", the metrics in one model" if len(told) > 1 else ""
    lead = f"within recordings{together} ({_tell_size(model)})"
    claimed = any(row["p_holm"] < SIGNIFICANCE for row, _, _ in told)
    reach = _tell_reach(model, claimed=claimed).removeprefix(",")
    return Line(f"{found}.{f' This is{reach}.' if reach else ''}{needs}", start(part.subject), lead)


def _tell_slope(row: Row, slope: Number) -> str:
    metric = tell_name(row["metric"])
    if not row["estimable"]:
        return f"the slope on {metric} is not estimable"
    evidence = f"{tell_estimate(slope, kind='slope')}; {tell_p(row['p_holm'])}"
    if row["p_holm"] < SIGNIFICANCE:
        return f"+0.1 of {metric} goes with {'higher' if slope.value > 0 else 'lower'} ratings ({evidence})"
    return f"what +0.1 of {metric} goes with is undecided ({evidence})"


def _tell_size(model: Primary) -> str:
    people = f"{model.n_participants} participant{'s' if model.n_participants > 1 else ''}"
    return f"{people}, {tell_recordings(model.n_recordings, model.n_sources)}"


def _tell_reach(model: Primary, *, claimed: bool = True) -> str:
    scene = "source" if model.n_sources < model.n_recordings else "recording"
    return tell_reach({"participant": model.n_participants, scene: model.n_sources}, claimed=claimed)


def _lay_slopes(rows: list[Row], numbers: list[tuple[Number, ...]]) -> Grid:
    caption = (
        "Slope of ratings on each metric within recordings, from a mixed model that holds all metrics, so at the same "
        "values of the others: points from the lower to the upper quartile of the metric within recordings, and per "
        "+0.1 of it; then per +0.1 with reducers as fixed effects, the metric centred on recordings and on reducers. "
        f"95 % t intervals with Satterthwaite's df; p adjusted by Holm over this table's {len(rows)} slopes. A dash: "
        "not estimable."
    )
    head = (
        "Ratings", "Metric", "Quartile to quartile", "Interval", "Points per +0.1", "Interval", "Reducers fixed",
        "Interval", "df", "p (Holm)",
    )  # fmt: skip
    laid = [
        (tell_name(row["attribute"]), tell_name(row["metric"]), *lay_estimate(quartile, "slope"),
         *lay_estimate(tenth, "slope"), *lay_estimate(centred, "slope"), Cell(df, "df"), Cell(holm, "p"))
        for row, (tenth, _, df, _, holm, quartile, centred) in zip(rows, numbers, strict=True)
    ]  # fmt: skip
    return Grid(caption, head, tuple(laid), detail=False)


def _lay_standardised(rows: list[Row], numbers: list[tuple[Number, ...]]) -> Grid:
    caption = (
        "The same slopes in this study's standard deviations, which differ from other studies'. 95 % intervals; p not "
        "adjusted."
    )
    laid = [
        (tell_name(row["attribute"]), tell_name(row["metric"]), *lay_estimate(standard, "slope"), Cell(p, "p"))
        for row, (_, standard, _, p, *_) in zip(rows, numbers, strict=True)
    ]
    return Grid(caption, ("Ratings", "Metric", "Standardised", "Interval", "p"), tuple(laid))


def _list_differences(fits: Fits) -> Iterator[Row]:
    for lead, (_, model) in fits.items():
        yield from ({**row, "lead": lead} for row in model.differences.to_dict("records"))


def _lay_differences(fits: Fits, rows: list[Row]) -> Grid:
    caption = (
        "Slope on the first metric minus slope on the second, in this study's standard deviations: which counts for "
        "more where both are known. 95 % intervals; p not adjusted."
    )
    head = ("Ratings", "First", "Second", "Difference", "Interval", "df", "p")
    laid = []
    for row in rows:
        part, model = fits[row["lead"]]
        name, n = name_path("slope_difference", *part.place, row["first"], row["second"]), model.n_rows
        ends: Row = {key: row[f"standardised_{key}"] for key in ("estimate", "low", "high")}
        value = name_estimate(name, ends, "difference of slopes in this study's standard deviations", n=n)
        df = make_number(f"{name}.df", row["standardised_df"], "Satterthwaite's degrees of freedom", n=n)
        p = make_number(f"{name}.p", row["standardised_p"], "two-sided t test", n=n)
        names = tell_name(row["first"]), tell_name(row["second"])
        laid.append((tell_name(row["lead"]), *names, *lay_estimate(value, "slope"), Cell(df, "df"), Cell(p, "p")))
    return Grid(caption, head, tuple(laid))


def _lay_models(fits: Fits) -> Grid:
    caption = (
        "The models. Marginal R²: explained by metrics; conditional: by everything in the model. Between stimuli: "
        "share of the spread between stimuli of a recording that the metrics account for (negative by chance)."
    )
    head = (
        "Ratings", "Fit", "Marginal R²", "Conditional R²", "Between stimuli", "Rows", "Participants", "Recordings",
        "Sources", "Stimuli",
    )  # fmt: skip
    return Grid(caption, head, tuple(_lay_model(part, model) for part, model in fits.values()))


def _lay_model(part: Part, model: Primary) -> tuple[str | Cell, ...]:
    name, n = name_path("model", *part.place), model.n_rows
    shares = {
        "marginal_r2": "Nakagawa's marginal R²", "conditional_r2": "Nakagawa's conditional R²",
        "item_variance_explained": "share of the variance between stimuli that metrics explain",
    }  # fmt: skip
    values = [Cell(make_number(f"{name}.{key}", getattr(model, key), how, n=n)) for key, how in shares.items()]
    counts = [
        Cell(count_number(f"{name}.n_{what}", getattr(model, f"n_{what}"), n=n), COUNT)
        for what in ("rows", "participants", "recordings", "sources", "items")
    ]
    return (tell_name(part.lead), "singular" if model.fit.singular else "regular", *values, *counts)


def _make_tables(fits: Fits, slopes: DataFrame) -> dict[str, DataFrame]:
    import pandas as pd

    def stack(name: str) -> DataFrame:
        parts: list[DataFrame] = [getattr(model, name).reset_index() for _, model in fits.values()]
        return pd.concat([one.assign(ratings=lead) for lead, one in zip(fits, parts, strict=True)], ignore_index=True)

    spreads = [model.fit.variances.assign(ratings=lead) for lead, (_, model) in fits.items()]
    tables = {
        "slopes": slopes, "slopes_between": stack("between"), "slope_differences": stack("differences"),
        "spreads": pd.concat(spreads, ignore_index=True),
    }  # fmt: skip
    return {name: rows for name, rows in tables.items() if len(rows)}


def _note_models(fits: Fits) -> Iterator[str]:
    for lead, (_, model) in fits.items():
        yield from (f"{lead}, primary model: {note}" for note in (*model.reductions, *model.notes))
