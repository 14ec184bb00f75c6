"""What would settle it: how many participants or recordings a slope needs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from analysis.numbers import COUNT, make_number, name_path
from analysis.primary.cells import REDUCER, SOURCE, make_cells
from analysis.primary.precision import ENOUGH, Precision, find_own
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
    "What a larger study would know: SE² = σ_S²/P + σ_I²/SS + (σ_PI² + σ_e²/K)/(P SS) for P participants, K repeats, "
    "and SS the sum over stimuli of the metric's squared deviations that it does not share with the other metrics; "
    "noncentral t. Where several recordings come from one source, its stimuli reduced alike count as one and further "
    "recordings are further sources. This study's spreads are taken for the true ones, which they are not; numbers "
    "that rest on the slope estimated here are hopeful where that was large by luck."
)
IF_SO = "If the slope on {} is what was estimated here,"


def name_precision(row: Row, part: Part, model: Primary) -> tuple[Number, ...]:
    """Name what would settle a slope.

    Parameters
    ----------
    row : dict
        The slope: metric, estimate.
    part : Part
        Its ratings.
    model : Primary
        Its model.

    Returns
    -------
    tuple of Number
        Detectable slope, participants needed, recordings needed, power at infinity.
    """
    name, n = name_path("precision", *part.place, row["metric"]), model.n_rows
    values = _find_needs(_find_precision(row["metric"], part, model), row["estimate"])
    told = {
        "detectable": "slope per +0.1 found with 80 % power", "participants": "participants for 80 % power",
        "recordings": "recordings for 80 % power", "infinite": "power of infinitely many participants",
    }  # fmt: skip
    return tuple(
        make_number(f"{name}.{key}", value, method, n=n)
        for (key, method), value in zip(told.items(), values, strict=True)
    )


def _find_needs(study: Precision, slope: float) -> tuple[float, ...]:
    """Find what would settle a slope; one participant or recording does not tell how others differ."""
    if min(study.n_participants, study.n_recordings) == 1:
        return (math.nan,) * 4
    infinite = study.enlarge(participants=10**9).find_power(slope)
    return study.find_slope() / 10, study.find_participants(slope), study.find_recordings(slope), infinite


def _find_precision(metric: str, part: Part, model: Primary) -> Precision:
    cells = make_cells(part.rows, list(model.slopes.index))
    within = [f"{name}_w" for name in model.slopes.index]
    spreads = {(row["group"], row["term"]): float(row["sd"]) for row in model.fit.variances.to_dict("records")}
    repeats = 1 if model.averaged else len(part.rows) / len(part.rows.groupby(["participant", ITEM], observed=True))
    noise = spreads.get(("participant:item", "(Intercept)"), 0.0)
    items = cells.table.drop_duplicates(ITEM)
    own = find_own(items[within].to_numpy(), within.index(f"{metric}_w"))
    square, alike = float((own**2).sum()), [SOURCE, REDUCER] if cells.shared else [ITEM]
    # Of stimuli that share a residual, metrics that they share too add up before they are squared.
    together = float((items.assign(own=own).groupby(alike, observed=True)["own"].sum() ** 2).sum()) / square
    spread = spreads.get((ITEM, "(Intercept)"), 0.0) ** 2
    shared = spreads.get((":".join(alike), "(Intercept)"), 0.0) ** 2 if cells.shared else 0.0
    return Precision(
        slope_sd=spreads.get(("participant", f"{metric}_w"), 0.0), item_sd=math.sqrt(spread + shared * together),
        noise_sd=math.sqrt(noise**2 + model.fit.residual_sd**2 / repeats), square=square,
        n_participants=model.n_participants, n_recordings=model.n_sources, n_items=cells.count(*alike),
        n_slopes=len(within),
    )  # fmt: skip


def tell_need(row: Row, settled: tuple[Number, ...], *, scenes: str = "recordings") -> str:
    """Say what would settle an undecided slope.

    Parameters
    ----------
    row : dict
        The slope: p_holm.
    settled : tuple of Number
        As `name_precision` gives them.
    scenes : str
        What to call further recordings.

    Returns
    -------
    str
        A sentence after a blank; empty where nothing is open.
    """
    if row["p_holm"] < SIGNIFICANCE:
        return ""
    _, participants, recordings, infinite = (number.value for number in settled)
    metric = tell_name(row["metric"])
    if_so = IF_SO.format(metric)
    if math.isnan(infinite):
        return f" What would settle {metric} cannot be told: it takes two participants and two {scenes}."
    if math.isfinite(participants):
        told = tell_number(participants, kind=COUNT)
        return f" {if_so} {told} participants with these recordings would find it in 80 % of studies."
    if math.isfinite(recordings):
        told = tell_number(recordings, kind=COUNT)
        none = f"no number of participants settles it with these recordings (power at most {tell_number(infinite)})"
        return f" {if_so} {none}; {told} {scenes} with as many participants would find it in 80 % of studies."
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
        "infinitely many participants with these recordings. A dash: more than 10 000, or unknown."
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
