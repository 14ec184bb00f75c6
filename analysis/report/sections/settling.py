"""What would settle it: how many participants or recordings a slope needs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from analysis.numbers import COUNT, make_number, name_path
from analysis.primary.cells import REDUCER, SOURCE, make_cells
from analysis.primary.precision import ENOUGH, Precision, find_own, find_variances
from analysis.report.sections.effects import SIGNIFICANCE
from analysis.report.sections.parts import ITEM
from analysis.report.sections.section import Cell, Grid
from analysis.words import tell_name, tell_number

if TYPE_CHECKING:
    from collections.abc import Hashable

    from analysis.numbers import Number
    from analysis.primary.model import Primary
    from analysis.report.sections.parts import Part

    Row = dict[Hashable, Any]

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

    Parameters
    ----------
    row : dict
        The slope: metric, estimate, estimable, and turns where its influence is known.
    part : Part
        Its ratings.
    model : Primary
        Its model.
    n_tests : int
        Slopes that are tested together.

    Returns
    -------
    tuple of Number
        Detectable slope, participants needed, recordings needed, power at infinity; NaN where nothing can be planned.
    """
    name, n = name_path("precision", *part.place, row["metric"]), model.n_rows
    values: tuple[float, ...] = (math.nan,) * 4
    if _is_sound(row):
        values = _find_needs(find_precision(row["metric"], part, model, n_tests=n_tests), row["estimate"])
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
    return study.find_slope() / 10, study.find_participants(slope), study.find_recordings(slope), infinite


def find_precision(metric: str, part: Part, model: Primary, *, n_tests: int = 1) -> Precision:
    """Take the standard error of a slope apart, by the spreads that were estimated.

    Parameters
    ----------
    metric : str
        Whose slope.
    part : Part
        The ratings.
    model : Primary
        Their model.
    n_tests : int
        Slopes that are tested together.

    Returns
    -------
    Precision
        Of this study.
    """
    cells = make_cells(part.rows, list(model.slopes.index))
    within = [f"{name}_w" for name in model.slopes.index]
    spreads = {(row["group"], row["term"]): float(row["sd"]) for row in model.fit.variances.to_dict("records")}
    found = {group: sd for (group, term), sd in spreads.items() if term == "(Intercept)"}
    repeats = 1 if model.averaged else len(part.rows) / len(part.rows.groupby(["participant", ITEM], observed=True))
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
    together = float((items.assign(own=own).groupby(groups, observed=True)["own"].sum() ** 2).sum()) / study.square
    shared = found.get(":".join(groups), 0.0) ** 2 * together
    return replace(study, item_sd=math.sqrt(study.item_sd**2 + shared), n_items=cells.count(*groups))


def tell_need(row: Row, settled: tuple[Number, ...], *, scenes: str = "recordings") -> str:
    """Say what would settle an undecided slope.

    Parameters
    ----------
    row : dict
        The slope: p_holm, estimable, and turns where its influence is known.
    settled : tuple of Number
        As `name_precision` gives them.
    scenes : str
        What to call further recordings.

    Returns
    -------
    str
        A sentence after a blank; empty where nothing is open, or nothing can be planned.
    """
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
        none = f"adding participants alone would not settle it (power at most {tell_number(infinite)})"
        return f" {if_so} {none}; {told} {scenes} with as many participants would give 80 % power."
    return f" A slope on {metric} as small as the one estimated here is out of reach of any study of this kind."


def lay_precision(rows: list[Row], numbers: list[tuple[Number, ...]]) -> Grid:
    """Lay out what would settle the slopes.

    Parameters
    ----------
    rows : list of dict
        Slopes: attribute, metric.
    numbers : list of tuple of Number
        As `name_precision` gives them.

    Returns
    -------
    Grid
        One row per slope.
    """
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
