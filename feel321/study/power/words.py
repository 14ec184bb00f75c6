"""The answer of a power analysis in words: its first sentence, and a card for each hypothesis."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from feel321.analysis.words import ABSENT, format_count, format_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

    from feel321.study.power.record import Planned

SURE, HOPELESS = 0.99, 0.01


def describe_plan(result: Planned) -> str:
    """Say which design is enough, with its power and interval; or that none is, and why."""
    row = result.find_row(result.shown, result.plan.hypothesis)
    if result.plan.recommended is None:
        return _explain_none(result, row)
    power = format_power(row["power"])
    if isfinite(row["simulated"]):
        ends = f"{row['simulated_low']:.2f} to {row['simulated_high']:.2f}"
        power = f"{format_power(row['simulated'])} (95 % Monte Carlo interval {ends})"
    return f"Plan {describe_size(result)}: the power to find {describe_slope(row)} is then {power}."


def _explain_none(result: Planned, row: Mapping[str, Any]) -> str:
    plan = result.plan
    if not row["slope"]:
        return f"There is nothing to find: the slope planted for {name_hypothesis(row)} is zero."
    known = plan.table.dropna(subset=["power", "ceiling"])
    if known.empty:
        return (
            f"A slope of {name_hypothesis(row)} is not estimable in any of these designs: plan more recordings or "
            "reducers, or fewer metrics."
        )
    best = known.sort_values("ceiling").iloc[-1]
    if best["ceiling"] < plan.wanted:
        units = describe_units(int(best["recordings"]), int(best["reducers"]))
        ceiling = format_power(float(best["ceiling"]))
        return (
            f"No number of participants is enough: the power to find {describe_slope(row)} is at most {ceiling} "
            f"in closed form with {units}; {_advise(result, row)}."
        )
    return _explain_tried(result, row, known)


def _explain_tried(result: Planned, row: Mapping[str, Any], known: DataFrame) -> str:
    """Say why none of the designs that were tried is enough, although one could be."""
    slope, wanted = describe_slope(row), result.plan.wanted
    enough = known[known["power"] >= wanted]
    if len(below := enough[enough["simulated_high"] < wanted]):
        power = format_power(float(below["simulated"].max()))
        return (
            f"None of these designs is enough: {slope} is found with a power of {power} at most in simulations of "
            f"{format_count(len(below), 'design')} that would be enough in closed form, which knows neither people who "
            "lapse nor the ends of the scale."
        )
    tried = known[known["kind"] != "smallest"]
    most, power = (
        int(tried["participants"].max()) * result.share,
        format_power(tried["power"].max()),
    )
    return (
        f"None of these designs is enough: {slope} is found with a power of {power} at most in closed form, "
        f"with up to {format_count(most, 'participant')}; {_advise(result, row)}."
    )


def _advise(result: Planned, row: Mapping[str, Any]) -> str:
    """Say what would be enough instead: more recordings, or a larger slope."""
    people = format_count(int(row["participants"]) * result.share, "participant")
    if isfinite(row["recordings_needed"]):
        return f"{format_count(int(row['recordings_needed']), 'recording')} would be enough with {people}"
    found = row["detectable"] * row["size"]
    if not isfinite(found):
        return "plan more recordings or reducers"
    return f"{people} can find slopes of {found:.2g} points per {row['per']} or more"


def describe_units(recordings: int, reducers: int) -> str:
    """Describe how many stimuli a design has.

    Examples
    --------
    >>> describe_units(6, 9)
    '6 recordings × 9 reducers'
    """
    return f"{format_count(recordings, 'recording')} × {format_count(reducers, 'reducer')}"


def describe_size(result: Planned) -> str:
    """Describe the design that is shown."""
    design = result.shown.design
    often = {1: "once", 2: "twice"}.get(design.repeats, f"{design.repeats} times")
    people = format_count(design.participants * result.share, "participant")
    return f"{people}, {describe_units(design.recordings, design.reducers)}, each rated {often}"


def describe_slope(row: Mapping[str, Any]) -> str:
    """Describe a planted slope."""
    of, on = format_name(row["metric"]), format_name(row["attribute"])
    return f"a slope of {row['points']:.2g} points per {row['per']} of {of} on {on}"


def name_hypothesis(row: Mapping[str, Any]) -> str:
    """Name a hypothesis by metric and attribute."""
    return f"{format_name(row['metric'])} on {format_name(row['attribute'])}"


def format_power(power: float) -> str:
    """Write a power without claiming certainty.

    Examples
    --------
    >>> format_power(0.812), format_power(0.998), format_power(0.004), format_power(float("nan"))
    ('0.81', '> 0.99', '< 0.01', 'not estimable')
    """
    if not isfinite(power):
        return "not estimable"
    if power > SURE:
        return f"> {SURE}"
    return f"{power:.2f}" if power >= HOPELESS else f"< {HOPELESS}"


def list_cards(result: Planned) -> list[dict[str, Any]]:
    """List what is said of each hypothesis in the design that is shown."""
    hypotheses = result.shown.design.hypotheses
    rows = [result.find_row(result.shown, one) for one in hypotheses]
    return [_make_card(row, wanted=result.plan.wanted) for row in rows]


def _make_card(row: Mapping[str, Any], *, wanted: float) -> dict[str, Any]:
    known = isfinite(row["simulated"])
    power = row["simulated"] if known else row["power"]
    ends = f"{row['simulated_low']:.2f} to {row['simulated_high']:.2f}" if known else "closed form"
    per, size = row["per"], row["size"]
    card: dict[str, Any] = {
        "name": name_hypothesis(row), "power": format_power(power), "ends": ends, "enough": bool(power >= wanted),
        "slope": f"{row['points']:.2g} points per {per}",
        "detectable": _write_points(row["detectable"] * size, per),
        "width": _write_points(row["width"] * size / 2, per, "± "),
    }  # fmt: skip
    card["line"] = (
        f"{card['name']}: planted {card['slope']}, power {card['power']} ({ends}), smallest slope found "
        f"{card['detectable']}, interval {card['width']}"
    )
    return card


def _write_points(points: float, per: str, sign: str = "") -> str:
    return f"{sign}{points:.2g} points per {per}" if isfinite(points) else ABSENT
