"""The primary analysis: slopes of ratings on metrics within recordings, and what a larger study would add."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.figures.residuals import draw_residuals
from analysis.figures.slopes import draw_slopes
from analysis.numbers import COUNT, count_number, make_number, name_path
from analysis.primary.influence import measure_influence
from analysis.primary.model import fit_primary, tabulate_slopes
from analysis.report.pictures import Picture, make_slug
from analysis.report.sections.answer import Finding, Lost, tell_findings
from analysis.report.sections.effects import lay_estimate, name_estimate, name_tests
from analysis.report.sections.influence import INFLUENCE, lay_exceptions, lay_influence, tabulate_influence
from analysis.report.sections.paper import lay_paper
from analysis.report.sections.section import Cell, Grid, Section
from analysis.report.sections.settling import SETTLING, lay_precision, name_precision, tell_need
from analysis.report.sections.thinning import thin_parts
from analysis.words import tell_name

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

KEY, TITLE = "primary", "Change in rating with each metric, within recordings"
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
    fits, notes, lost = fit_parts(table, choices)
    if not fits:
        return Section(KEY, TITLE, notes=notes, verdict=lost.lines, claims=lost.claims)
    slopes = tabulate_slopes({lead: model for lead, (_, model) in fits.items()})
    findings = _list_findings(table, fits, slopes)
    rows = [one.row for one in findings]
    numbers = [_name_slope(one.row, (one.part, one.model)) for one in findings]
    tests = sum(row["estimable"] for row in rows)
    precisions = [name_precision(one.row, one.part, one.model, n_tests=tests) for one in findings]
    verdict = [
        line
        for lead in fits
        for line in tell_findings(*zip(*_list_needs(findings, precisions, lead=lead), strict=True))
    ]
    grids = [_lay_slopes(rows, numbers), _lay_standardised(rows, numbers), _lay_models(fits)]
    grids.append(lay_precision(rows, precisions))
    differences = list(_list_differences(fits))
    influences = {one.part.lead: one for one in findings}
    beside = [*lay_influence(influences.values()), *lay_exceptions(influences.values())]
    beside += lay_paper(table, fits, choices)
    return Section(
        key=KEY, title=TITLE, answers=tuple(map(str, verdict)), verdict=(*verdict, *lost.lines),
        claims=(*(one.make_claim(name_path("slope", *one.part.place, one.metric)) for one in findings), *lost.claims),
        grids=(*grids[:1], *([_lay_differences(fits, differences)] if differences else []), *beside, *grids[1:]),
        tables=_make_tables(fits, slopes) | tabulate_influence(influences.values()), pictures=tuple(_draw_models(fits)),
        notes=(*notes, *_note_models(fits)), how=(*HOW, INFLUENCE, SETTLING),
    )  # fmt: skip


def _list_findings(table: Table, fits: Fits, slopes: DataFrame) -> list[Finding]:
    """Put every slope together with what single stimuli, recordings and reducers do to it."""
    found: list[Finding] = []
    for lead, (part, model) in fits.items():
        own = slopes["attribute"] == lead
        influence = measure_influence(part.rows, table.metrics, model, others=slopes.loc[~own, "p"].tolist())
        for row in slopes[own].to_dict("records"):
            moved = not influence.find_moves(row["metric"]).empty
            found.append(Finding({"turns": moved, **row}, part, model, influence))
    return found


def _list_needs(
    findings: list[Finding], precisions: list[tuple[Number, ...]], *, lead: str
) -> Iterator[tuple[Finding, str]]:
    for one, known in zip(findings, precisions, strict=True):
        if one.part.lead == lead:
            scenes = "sources" if one.model.n_sources < one.model.n_recordings else "recordings"
            yield one, tell_need(one.row, known, scenes=scenes).strip()


def fit_parts(table: Table, choices: Choices) -> tuple[Fits, tuple[str, ...], Lost]:
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
    lost : Lost
        The same as sentences and claims.
    """
    fits, notes, lost = {}, [], Lost()
    for part in thin_parts(table, choices):
        notes += [part.thinned] if part.thinned else []
        try:
            fits[part.lead] = part, fit_primary(part.rows, table.metrics)
        except ValueError as error:
            notes.append(f"{part.lead}: no primary model. {error}")
            lost = lost.add(part, table.metrics, str(error))
    return fits, tuple(notes), lost


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
