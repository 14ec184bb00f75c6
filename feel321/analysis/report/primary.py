"""Section: the primary model's slopes, and which study would settle what is open."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.figures.scatter import draw_residuals
from feel321.analysis.primary.influence import measure_influence
from feel321.analysis.primary.model import fit_primary, tabulate_slopes
from feel321.analysis.primary.plan import REDUCER, SOURCE, make_cells
from feel321.analysis.primary.sensitivity import ENOUGH, Precision, find_own, find_variances
from feel321.analysis.report._old import Cell, Grid, lay_estimate, name_estimate, name_tests
from feel321.analysis.report.answer import (
    INFLUENCE,
    Finding,
    Lost,
    lay_exceptions,
    lay_influence,
    tabulate_influence,
    tell_findings,
)
from feel321.analysis.report.association import lay_paper
from feel321.analysis.report.parts import ITEM, SIGNIFICANCE, thin_parts
from feel321.analysis.report.section import Picture, Section, make_slug
from feel321.analysis.words import (
    COUNT,
    count_number,
    make_number,
    name_path,
    tell_name,
    tell_number,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from feel321.analysis.primary.model import Primary
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.table.reading import Table
    from feel321.analysis.words import Number

    Row = dict[Hashable, Any]
    Fits = dict[str, tuple[Part, Primary]]

# What would settle it: how many participants or recordings a slope needs.

SETTLING = (
    "What a larger study would know: SE² = σ_S²/P + 1/(SS_w/v + SS_r/(v + m v_r)) for P participants, v = σ_I² + "
    "(σ_PI² + σ_e²/K)/P for K repeats, v_r = σ_R² + σ_PR²/P, m stimuli per reducer, SS_r the sum over stimuli of the "
    "metric's squared deviations, of those that it does not share with the other metrics, that are the same for a "
    "reducer in every recording, and SS_w of the others; noncentral t, at 0.05 over the number of slopes tested "
    "(Holm's first step); never fewer than 6 participants or 4 recordings. Where several recordings come from one "
    "source, its stimuli reduced alike count as one and further recordings are further sources. This study's spreads "
    "are taken for the true ones, which they are not; numbers that rest on the slope estimated here are optimistic if "
    "it was overestimated. Nothing is planned from a slope that is not estimable, or that one stimulus, recording or "
    "reducer turns."
)
IF_SO = "If the true slope on {} is the one estimated here,"


def name_precision(row: Row, part: Part, model: Primary, *, n_tests: int = 1) -> tuple[Number, ...]:
    """Name what would settle a slope.

    Returns naN where nothing can be planned.
    """
    name, n = name_path("precision", *part.place, row["metric"]), model.n_rows
    values: tuple[float, ...] = (math.nan,) * 4
    if _is_sound(row):
        values = _find_needs(
            find_precision(row["metric"], part, model, n_tests=n_tests), row["estimate"]
        )
    told = {
        "detectable": "slope per +0.1 found with 80 % power", "participants": "participants for 80 % power",
        "recordings": "recordings for 80 % power", "infinite": "power of infinitely many participants",
    }  # fmt: skip
    return tuple(
        make_number(f"{name}.{key}", value, method, n=n)
        for (key, method), value in zip(told.items(), values, strict=True)
    )


def _is_sound(row: Row) -> bool:
    """Tell whether a study may be planned from a slope: it is estimable, and nothing single turns it."""
    return bool(row["estimable"]) and not row.get("turns", False)


def _find_needs(study: Precision, slope: float) -> tuple[float, ...]:
    infinite = study.enlarge(participants=10**9).find_power(slope)
    return (
        study.find_slope() / 10,
        study.find_participants(slope),
        study.find_recordings(slope),
        infinite,
    )


def find_precision(metric: str, part: Part, model: Primary, *, n_tests: int = 1) -> Precision:
    """Take the standard error of a slope apart, by the spreads that were estimated."""
    cells = make_cells(part.rows, list(model.slopes.index))
    within = [f"{name}_w" for name in model.slopes.index]
    spreads = {
        (row["group"], row["term"]): float(row["sd"])
        for row in model.fit.variances.to_dict("records")
    }
    found = {group: sd for (group, term), sd in spreads.items() if term == "(Intercept)"}
    repeats = (
        1
        if model.averaged
        else len(part.rows) / len(part.rows.groupby(["participant", ITEM], observed=True))
    )
    items = cells.table.drop_duplicates(ITEM)
    known = REDUCER in found or f"participant:{REDUCER}" in found
    codes = items[REDUCER].factorize()[0] if known else None
    study = Precision(
        slope_sd=spreads.get(("participant", f"{metric}_w"), 0.0), item_sd=found.get(ITEM, 0.0),
        noise_sd=math.hypot(found.get("participant:item", 0.0), model.fit.residual_sd / math.sqrt(repeats)), square=1.0,
        n_participants=model.n_participants, n_recordings=model.n_sources, n_items=len(items), n_slopes=len(within),
        reducer_sd=found.get(REDUCER, 0.0), rater_reducer_sd=found.get(f"participant:{REDUCER}", 0.0),
        n_reducers=model.n_reducers if known else 0, n_alike=len(items) / model.n_reducers if known else 1.0,
        level=SIGNIFICANCE / n_tests,
    )  # fmt: skip
    place, values = within.index(f"{metric}_w"), items[within].to_numpy()
    own, alike = find_own(values, place, codes, variances=find_variances(study))
    study = replace(study, square=float((own**2).sum()), reducer_square=float((alike**2).sum()))
    if not cells.shared:
        return study
    # Of stimuli that share a residual, metrics that they share too add up before they are squared.
    groups = [SOURCE, REDUCER]
    together = (
        float((items.assign(own=own).groupby(groups, observed=True)["own"].sum() ** 2).sum())
        / study.square
    )
    shared = found.get(":".join(groups), 0.0) ** 2 * together
    return replace(
        study, item_sd=math.sqrt(study.item_sd**2 + shared), n_items=cells.count(*groups)
    )


def tell_need(row: Row, settled: tuple[Number, ...], *, scenes: str = "recordings") -> str:
    """Say what would settle an undecided slope."""
    if row["p_holm"] < SIGNIFICANCE or not _is_sound(row):
        return ""
    _, participants, recordings, infinite = (number.value for number in settled)
    metric = tell_name(row["metric"])
    if_so = IF_SO.format(metric)
    if math.isfinite(participants):
        told = tell_number(participants, kind=COUNT)
        return f" {if_so} {told} participants with these recordings would give 80 % power."
    if math.isfinite(recordings):
        told = tell_number(recordings, kind=COUNT)
        none = (
            f"adding participants alone would not settle it (power at most {tell_number(infinite)})"
        )
        return f" {if_so} {none}; {told} {scenes} with as many participants would give 80 % power."
    return f" A slope on {metric} as small as the one estimated here is out of reach of any study of this kind."


def lay_precision(rows: list[Row], numbers: list[tuple[Number, ...]]) -> Grid:
    """Lay out what would settle the slopes."""
    caption = (
        f"What would settle it. Detectable: the slope, in points per +0.1, that it would find with {ENOUGH:.0%} "
        "power. Then, if the slope is what was estimated here: participants needed with these recordings, recordings "
        "needed with these participants (sources, where several recordings come from one), and the power of "
        "infinitely many participants with these recordings; at 5 % over the number of slopes. A dash: more than "
        "10 000, or a slope from which nothing can be planned."
    ).replace("80%", "80 %")
    head = ("Ratings", "Metric", "Detectable", "Participants", "Recordings", "Power at infinity")
    kinds = ("slope", COUNT, COUNT, "correlation")
    laid: list[tuple[str | Cell, ...]] = [
        (
            tell_name(row["attribute"]),
            tell_name(row["metric"]),
            *(Cell(one, kind) for one, kind in zip(of_row, kinds, strict=True)),
        )
        for row, of_row in zip(rows, numbers, strict=True)
    ]
    return Grid(caption, head, tuple(laid))


# The primary analysis: slopes of ratings on metrics within recordings, and what a larger study would add.

KEY, TITLE = "primary", "Change in rating with each metric, within recordings"
IN_SD = "slope in this study's standard deviations"
QUARTILES = (
    "mixed model, points of rating from the metric's lower to its upper quartile within recordings"
)
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
    """Fit the primary model of every scale and level."""
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
        influence = measure_influence(
            part.rows, table.metrics, model, others=slopes.loc[~own, "p"].tolist()
        )
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

    Returns fits: part's lead -> part and model.
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
    yield Picture("slopes", caption, draw_slopes(models))
    for part, model in fits.values():
        caption = (
            f"Residuals of the primary model of {part.subject}: left against normal quantiles with a pointwise 95 % "
            "band, right against fitted values."
        )
        yield Picture(
            make_slug("residuals", *part.place), caption, draw_residuals(model.fit), detail=True
        )


def _name_slope(row: Row, fit: tuple[Part, Primary]) -> tuple[Number, ...]:
    part, model = fit
    name, n = name_path("slope", *part.place, row["metric"]), model.n_rows
    quartile: Row = {
        "estimate": row["quartile_effect"],
        "low": row["quartile_low"],
        "high": row["quartile_high"],
    }
    centred: Row = {
        "estimate": row["centred"] / 10,
        "low": row["centred_low"] / 10,
        "high": row["centred_high"] / 10,
    }
    return (
        name_estimate(
            name, row, "mixed model, points of rating per +0.1 of the metric", n=n, prefix="tenth"
        ),
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
        (
            tell_name(row["attribute"]),
            tell_name(row["metric"]),
            *lay_estimate(quartile, "slope"),
            *lay_estimate(tenth, "slope"),
            *lay_estimate(centred, "slope"),
            Cell(df, "df"),
            Cell(holm, "p"),
        )
        for row, (tenth, _, df, _, holm, quartile, centred) in zip(rows, numbers, strict=True)
    ]
    return Grid(caption, head, tuple(laid), detail=False)


def _lay_standardised(rows: list[Row], numbers: list[tuple[Number, ...]]) -> Grid:
    caption = (
        "The same slopes in this study's standard deviations, which differ from other studies'. 95 % intervals; p not "
        "adjusted."
    )
    laid = [
        (
            tell_name(row["attribute"]),
            tell_name(row["metric"]),
            *lay_estimate(standard, "slope"),
            Cell(p, "p"),
        )
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
        name, n = (
            name_path("slope_difference", *part.place, row["first"], row["second"]),
            model.n_rows,
        )
        ends: Row = {key: row[f"standardised_{key}"] for key in ("estimate", "low", "high")}
        value = name_estimate(
            name, ends, "difference of slopes in this study's standard deviations", n=n
        )
        df = make_number(
            f"{name}.df", row["standardised_df"], "Satterthwaite's degrees of freedom", n=n
        )
        p = make_number(f"{name}.p", row["standardised_p"], "two-sided t test", n=n)
        names = tell_name(row["first"]), tell_name(row["second"])
        laid.append((
            tell_name(row["lead"]),
            *names,
            *lay_estimate(value, "slope"),
            Cell(df, "df"),
            Cell(p, "p"),
        ))
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
    values = [
        Cell(make_number(f"{name}.{key}", getattr(model, key), how, n=n))
        for key, how in shares.items()
    ]
    counts = [
        Cell(count_number(f"{name}.n_{what}", getattr(model, f"n_{what}"), n=n), COUNT)
        for what in ("rows", "participants", "recordings", "sources", "items")
    ]
    return (tell_name(part.lead), "singular" if model.fit.singular else "regular", *values, *counts)


def _make_tables(fits: Fits, slopes: DataFrame) -> dict[str, DataFrame]:
    import pandas as pd

    def stack(name: str) -> DataFrame:
        parts: list[DataFrame] = [getattr(model, name).reset_index() for _, model in fits.values()]
        return pd.concat(
            [one.assign(ratings=lead) for lead, one in zip(fits, parts, strict=True)],
            ignore_index=True,
        )

    spreads = [model.fit.variances.assign(ratings=lead) for lead, (_, model) in fits.items()]
    tables = {
        "slopes": slopes, "slopes_between": stack("between"), "slope_differences": stack("differences"),
        "spreads": pd.concat(spreads, ignore_index=True),
    }  # fmt: skip
    return {name: rows for name, rows in tables.items() if len(rows)}


def _note_models(fits: Fits) -> Iterator[str]:
    for lead, (_, model) in fits.items():
        yield from (f"{lead}, primary model: {note}" for note in (*model.reductions, *model.notes))
