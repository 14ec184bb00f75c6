"""What a larger study would know: the participants or recordings that a slope needs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from feel321.analysis.primary.plan import REDUCER, SOURCE, make_cells
from feel321.analysis.primary.sensitivity import ENOUGH, SlopePrecision, find_own, find_variances
from feel321.analysis.report.parts import ITEM, SIGNIFICANCE
from feel321.analysis.report.section import METRIC, RATINGS, Column, TableForm
from feel321.analysis.words import COUNT, format_name, format_number

if TYPE_CHECKING:
    from feel321.analysis.primary.model import Primary
    from feel321.analysis.report.parts import RatingsPart

    Row = dict[Any, Any]

NEEDS = {
    "detectable": ("Detectable", "slope", "slope per +0.1 found with 80 % power"),
    "participants": ("Participants", COUNT, "participants for 80 % power"),
    "recordings": ("Recordings", COUNT, "recordings for 80 % power"),
    "infinite": ("Power at infinity", "correlation", "power of infinitely many participants"),
}
NEEDED = TableForm(
    f"Sample size. Detectable: the smallest slope, in points per +0.1, detectable with {100 * ENOUGH:.0f} % power. "
    "Then, if the slope is what was estimated here: participants needed with these recordings, recordings needed with "
    "these participants (sources, where several recordings come from one), and the power of infinitely many "
    "participants with these recordings; at 5 % over the number of slopes. A dash: more than 10 000, or a slope from "
    "which nothing can be planned.",
    (
        RATINGS, METRIC, *(Column(head, f"_{key}", kind, key, how) for key, (head, kind, how) in NEEDS.items())
    ),
    path="precision.{scale}.{level}.{metric}",
)  # fmt: skip


def find_needs(row: Row, part: RatingsPart, model: Primary, *, n_tests: int) -> dict[str, float]:
    """Find what would settle a slope; NaN where nothing can be planned."""
    if not is_sound(row):
        return dict.fromkeys((f"_{key}" for key in NEEDS), math.nan)
    study, slope = find_precision(row["metric"], part, model, n_tests=n_tests), row["estimate"]
    return {
        "_detectable": study.find_slope() / 10,
        "_participants": study.find_participants(slope),
        "_recordings": study.find_recordings(slope),
        "_infinite": study.enlarge(participants=10**9).find_power(slope),
    }


def is_sound(row: Row) -> bool:
    """Tell whether a study may be planned from a slope: it is estimable, and nothing single turns it."""
    return bool(row["estimable"]) and not row.get("turns", False)


def describe_need(row: Row, *, scenes: str = "recordings") -> str:
    """Say what would settle an inconclusive slope."""
    if row["p_holm"] < SIGNIFICANCE or not is_sound(row):
        return ""
    metric = format_name(row["metric"])
    if_so = f"If the true slope on {metric} is the one estimated here,"
    if math.isfinite(row["_participants"]):
        people = format_number(row["_participants"], kind=COUNT)
        return f"{if_so} {people} participants with these recordings would give 80 % power."
    if math.isfinite(row["_recordings"]):
        more, most = format_number(row["_recordings"], kind=COUNT), format_number(row["_infinite"])
        alone = f"adding participants alone would not settle it (power at most {most})"
        return f"{if_so} {alone}; {more} {scenes} with as many participants would give 80 % power."
    return f"A slope on {metric} as small as the one estimated here is out of reach of any study of this kind."


def find_precision(
    metric: str, part: RatingsPart, model: Primary, *, n_tests: int = 1
) -> SlopePrecision:
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
    study = SlopePrecision(
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
