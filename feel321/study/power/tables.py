"""Tables on the page of a power analysis: designs, what was planted, how often the analysis is wrong."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from feel321.analysis.report.section import PageTable
from feel321.analysis.words import ABSENT, format_name
from feel321.study.power.words import name_hypothesis

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pandas import DataFrame

    from feel321.study.power.record import Planned

SPREADS = {
    "person_sd": "People, in their mean rating",
    "recording_sd": "Recordings",
    "item_sd": "Stimuli of a recording",
    "reducer_sd": "Reducers",
    "person_recording_sd": "One person's recordings",
    "person_reducer_sd": "One person's reducers",
    "person_item_sd": "One person's stimuli",
    "rating_sd": "Ratings repeated by one person",
}
"""Standard deviation of a truth -> what differs by it."""

DESIGNS = (
    "All designs, for {}. Power: closed form. Simulated: with its 95 % Monte Carlo interval. At most: with "
    "infinitely many participants. Found: smallest slope found with the target power. Trials: of one participant."
)
FITS = (
    "What became of the simulated models. Singular fits (a spread estimated as zero) count in every share; those "
    "that failed or were not estimable are in none, and are never counted as non-significant."
)
ERRORS = (
    "How often the analysis is wrong: share of studies without any slope in which p is below 0.05 (nominal 0.05), and "
    "share of 95 % intervals that hold the slope that the ends of the scale leave (nominal 0.95), with 95 % Monte "
    "Carlo intervals."
)
PLANTED = (
    "Planted slopes, within recordings. Left by the scale: what its ends, and people who lapse, leave of them in the "
    "simulation."
)


def tabulate(result: Planned, frames: Mapping[str, DataFrame]) -> dict[str, PageTable]:
    """Build the tables of the page, those that have rows."""
    hypothesis = dict(zip(("attribute", "metric"), result.plan.hypothesis, strict=True))
    size, per = (result.find_row(result.shown, result.plan.hypothesis)[n] for n in ("size", "per"))
    made = {
        "designs": (DESIGNS.format(name_hypothesis(hypothesis)), _list_designs(result.to_frame(), size, per)),
        "planted": (PLANTED, _list_planted(result)),
        "spreads": (f"Standard deviations assumed, from {result.shown.truth.source}.", _list_spreads(result)),
        "errors": (ERRORS, _list_errors(result)),
        "fits": (FITS, _list_fits(frames["fits"]) if "fits" in frames else []),
    }  # fmt: skip
    grids = {name: _build(caption, rows) for name, (caption, rows) in made.items()}
    return {name: grid for name, grid in grids.items() if grid.rows}


def _build(caption: str, rows: Iterable[Mapping[str, str]]) -> PageTable:
    """Build a table of rows whose keys are its head."""
    listed = list(rows)
    head = tuple(listed[0]) if listed else ()
    return PageTable(caption, head, tuple(tuple(row.values()) for row in listed))


def _list(frame: DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


def _list_designs(frame: DataFrame, size: float, per: str) -> list[dict[str, str]]:
    return [
        {
            "Participants": str(row["people"]), "Recordings": str(row["recordings"]),
            "Reducers": str(row["reducers"]), "Repeats": str(row["repeats"]), "Trials": str(row["trials"]),
            "Power": _write(row["power"]), "Simulated": _write(row["simulated"]), "Interval": _span(row, "simulated"),
            "At most": _write(row["ceiling"]), f"Found, points per {per}": _write(size * row["detectable"], ".2g"),
            "Enough": "recommended" if row["recommended"] else "yes" if row["enough"] else "no",
        }
        for row in _list(frame)
    ]  # fmt: skip


def _list_planted(result: Planned) -> list[dict[str, str]]:
    rows = (result.find_row(result.shown, one) for one in result.shown.design.hypotheses)
    return [
        {
            "Hypothesis": name_hypothesis(row), "Slope": f"{row['points']:.3g} points per {row['per']}",
            "Left by the scale": _write(row["kept"] * row["size"], ".3g"), "From": row["source"],
        }
        for row in rows
    ]  # fmt: skip


def _list_spreads(result: Planned) -> list[dict[str, str]]:
    truth = result.shown.truth
    found = {name: getattr(truth, key) for key, name in SPREADS.items()}
    for whose, given, usual in (
        ("People's", truth.slope_sds, truth.slope_points),
        ("Recordings'", truth.recording_slope_sds, truth.recording_slope_points),
    ):
        found |= {f"{whose} slopes on {format_name(n)}, per unit": sd for n, sd in given.items()}
        if not given:
            found[f"{whose} slopes, per standard deviation of the metric"] = usual
    return [{"What differs": name, "SD in points": f"{sd:.3g}"} for name, sd in found.items()]


def _list_errors(result: Planned) -> list[dict[str, str]]:
    return [
        {
            "Hypothesis": name_hypothesis(row), "Participants": str(one.design.participants * result.share),
            "Recordings": str(one.design.recordings), "False positives": _write(row["false_positives"], ".3f"),
            "Interval": _span(row, "false", ".3f"), "Coverage": _write(row["coverage"], ".3f"),
            "Interval ": _span(row, "coverage", ".3f"),
        }
        for one in result.plan.powers
        if one.studies
        for row in _list(one.table)
    ]  # fmt: skip


def _list_fits(fits: DataFrame) -> list[dict[str, str]]:
    arms = {"planted": "with slopes", "null": "without slopes"}
    return [
        {
            "Studies": arms[row["arm"]], "Participants": str(row["participants"]),
            "Recordings": str(row["recordings"]), "Models": str(row["models"]), "Outcome": row["outcome"],
            "Reason": row["reason"],
        }
        for row in _list(fits)
    ]  # fmt: skip


def _write(value: float, form: str = ".2f") -> str:
    return f"{value:{form}}" if isfinite(value) else ABSENT


def _span(row: Mapping[str, Any], name: str, form: str = ".2f") -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    return f"{low:{form}} to {high:{form}}" if isfinite(low) else ABSENT
