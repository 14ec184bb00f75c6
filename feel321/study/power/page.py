"""The power of a study: the record, its first sentence, its tables and its page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import pandas as pd

from feel321 import __version__
from feel321.analysis import words
from feel321.analysis.report.section import PageTable, Picture
from feel321.analysis.tradeoff.results import PageParts, PageResult
from feel321.study.power import figures

if TYPE_CHECKING:
    from feel321.analysis.power.design import Power, PowerDesign, PowerPlan

CAPTION = (
    "Power against participants, a curve for each number of recordings ({own} in the study: bold). Lines: closed form, at "
    "the first step of Holm's method. Circles: simulated studies with Holm's method, 95 % Monte Carlo intervals. Dashed, "
    "at the right end: what participants without end would reach. Thin line: the power asked for."
)
OTHERS = (
    "Power with other numbers of reducers and of repeated ratings, everything else as in the study. Line: closed form."
)
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


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class StudyPower(PageResult):
    """The power of a study, planned from its own settings and stimuli.

    Parameters
    ----------
    plan : PowerPlan
        Power of all designs; participants are those who rate each attribute.
    name : str
        The study.
    effects : DataFrame
        What is planted, a row per hypothesis: attribute, metric, points, per (the step of the metric), size (of the
        step), source.
    share : int
        Groups among which the attributes are divided: as many times the participants of the plan take part.
    whole : DataFrame
        Whole studies beside the fast simulation, a row per hypothesis; empty if none were run.
    notes : tuple of str
        What was assumed and what is unusual, one sentence each.
    """

    plan: PowerPlan
    name: str
    effects: pd.DataFrame
    share: int
    whole: pd.DataFrame
    notes: tuple[str, ...] = ()

    @property
    def shown(self) -> Power:
        """The design that the page opens with: the recommended one, or the study's own."""
        return next((one for one in self.plan.powers if self._is_recommended(one.design)), self.plan.powers[0])

    @property
    def answer(self) -> str:
        """Which design is enough, its power, interval and minutes, in one sentence; or why none is."""
        return describe_plan(self)

    def _is_recommended(self, design: PowerDesign) -> bool:
        best = self.plan.recommended
        return best is not None and find_sizes(design) == find_sizes(best)

    def to_frame(self) -> pd.DataFrame:
        """Return the power of all designs.

        Returns
        -------
        DataFrame
            The columns of `PowerPlan.table`, and people: all who take part.
        """
        return self.plan.table.assign(people=self.plan.table["participants"] * self.share)

    def to_frames(self) -> dict[str, pd.DataFrame]:
        """Return the numbers as tables.

        Returns
        -------
        dict of str to DataFrame
            `designs`: the grid; `hypotheses`, `differences` and `fits`: of every simulated design; `planted`: slopes and
            standard deviations; `whole`: whole studies, if any were run.
        """
        named = [(find_sizes(one.design), one) for one in self.plan.powers]
        frames = {
            "designs": self.to_frame(),
            "hypotheses": pd.concat([one.table.assign(**sizes) for sizes, one in named]),
            "differences": pd.concat([one.differences.assign(**sizes) for sizes, one in named]),
            "fits": pd.concat([one.counts.assign(**sizes) for sizes, one in named]),
            "planted": self.effects,
            "whole": self.whole,
        }
        return {name: frame for name, frame in frames.items() if len(frame)}

    def summary(self) -> str:
        """Write the answer for reading.

        Returns
        -------
        str
            The answer, a line per hypothesis, and the notes.
        """
        return "\n".join([self.answer, *(card["line"] for card in list_cards(self)), *self.notes])

    def _make_page(self, tables: Mapping[str, pd.DataFrame]) -> PageParts:
        content = build_content(self)
        values = {
            "result": self, "content": content, "cards": list_cards(self), "grids": tabulate(self, tables),
        }  # fmt: skip
        return PageParts("power.html", content, list(_list_pictures(self)), values)


def find_sizes(design: PowerDesign) -> dict[str, int]:
    """Return what identifies a design among those of a plan."""
    names = ("participants", "recordings", "reducers", "repeats")
    return {name: int(getattr(design, name)) for name in names}


# The answer in words.


def describe_plan(result: StudyPower) -> str:
    """Say which design is enough, with its power, interval and minutes; or that none is, and why."""
    row = find_row(result, result.shown)
    what = describe_slope(result, *result.plan.hypothesis)
    size = describe_size(result, result.shown.design)
    if result.plan.recommended is None:
        return _explain_none(result, row, what)
    power = _write_power(row["power"])
    if row["simulated"] == row["simulated"]:
        ends = f"{row['simulated_low']:.2f} to {row['simulated_high']:.2f}"
        power = f"{_write_power(row['simulated'])} (95 % Monte Carlo interval {ends})"
    return f"Plan {size}: {what} is then found with a power of {power}."


def _explain_none(result: StudyPower, row: Mapping[str, Any], what: str) -> str:
    plan = result.plan
    most, best = plan.table["participants"].max() * result.share, plan.table["power"].max()
    if not row["slope"]:
        return f"No design finds what is not there: the slope planted for {_name_hypothesis(plan.hypothesis)} is zero."
    ceiling = float(plan.table["ceiling"].max())
    if ceiling < plan.wanted:
        return (
            f"No number of participants is enough: {what} reaches a power of {_write_power(ceiling)} at most, "
            f"whoever takes part, because {describe_units(plan.table)} differ for reasons that the metric does not know."
        )
    return (
        f"None of the designs is enough: with up to {most} participants {what} is found with a power of "
        f"{_write_power(best)} at most; give larger numbers."
    )


def describe_units(table: pd.DataFrame) -> str:
    """Describe the largest number of recordings and reducers of a plan."""
    scenes, kinds = (int(table[name].max()) for name in ("recordings", "reducers"))
    return f"up to {words.format_count(scenes, 'recording')} and {words.format_count(kinds, 'reducer')}"


def describe_size(result: StudyPower, design: PowerDesign) -> str:
    """Describe a design, and how long a session of it takes."""
    row = find_row(result, result.shown)
    often = {1: "rated once", 2: "rated twice"}.get(design.repeats, f"rated {design.repeats} times")
    people = words.format_count(design.participants * result.share, "participant")
    stimuli = f"{words.format_count(design.recordings, 'recording')} × {words.format_count(design.reducers, 'reducer')}"
    minutes = row["minutes"]
    long = f", sessions of about {minutes:.0f} min" if minutes == minutes else ""
    return f"{people}, {stimuli}, each {often}{long}"


def describe_slope(result: StudyPower, attribute: str, metric: str) -> str:
    """Describe a planted slope."""
    row = result.effects.set_index(["attribute", "metric"]).loc[(attribute, metric)]
    of = words.format_name(metric)
    return f"a slope of {row['points']:.2g} points per {row['per']} of {of} on {words.format_name(attribute)}"


def _name_hypothesis(hypothesis: tuple[str, str]) -> str:
    attribute, metric = map(words.format_name, hypothesis)
    return f"{metric} on {attribute}"


def _write_power(power: float) -> str:
    """Write a power without claiming certainty.

    Examples
    --------
    >>> _write_power(0.812), _write_power(0.998), _write_power(0.004)
    ('0.81', '> 0.99', '< 0.01')
    """
    if power > 0.99:  # noqa: PLR2004 - two digits
        return "> 0.99"
    return f"{power:.2f}" if power >= 0.01 else "< 0.01"  # noqa: PLR2004 - two digits


def find_row(result: StudyPower, power: Power) -> dict[str, Any]:
    """Find a simulated design's hypothesis and its row of the plan in one."""
    attribute, metric = result.plan.hypothesis
    of = power.table[(power.table["attribute"] == attribute) & (power.table["metric"] == metric)]
    table, sizes = result.plan.table, find_sizes(power.design)
    row = table[(table[list(sizes)] == pd.Series(sizes)).all(axis=1)].iloc[0].to_dict()
    found: dict[str, Any] = row | of.iloc[0].to_dict()
    return found


def list_cards(result: StudyPower) -> list[dict[str, Any]]:
    """List what is said of each hypothesis at the design that is shown."""
    return [_make_card(result, row) for row in result.shown.table.to_dict("records")]


def _make_card(result: StudyPower, row: Mapping[str, Any]) -> dict[str, Any]:
    own = result.effects.set_index(["attribute", "metric"]).loc[(row["attribute"], row["metric"])]
    size, per = float(own["size"]), str(own["per"])
    known = row["simulated"] == row["simulated"]
    power = _write_power(row["simulated"] if known else row["power"])
    ends = f"{row['simulated_low']:.2f} to {row['simulated_high']:.2f}" if known else "closed form"
    card = {
        "name": _name_hypothesis((row["attribute"], row["metric"])), "power": power, "ends": ends,
        "enough": bool((row["simulated"] if known else row["power"]) >= result.plan.wanted),
        "slope": f"{own['points']:.2g} points per {per}", "closed": _write_power(row["power"]),
        "detectable": f"{row['detectable'] * size:.2g} points per {per}",
        "width": f"± {row['width'] * size / 2:.2g} points per {per}",
        "ceiling": _write_power(row["ceiling"]),
    }  # fmt: skip
    card["line"] = (
        f"{card['name']}: planted {card['slope']}, power {power} ({ends}), smallest slope found {card['detectable']}, "
        f"interval {card['width']}"
    )
    return card


# What results.json holds, and the page's tables and figures.


def build_content(result: StudyPower) -> dict[str, Any]:
    """Build what results.json holds."""
    shown, plan = result.shown, result.plan
    truth = asdict(shown.truth)
    return {
        "version": __version__, "study": result.name, "answer": result.answer, "wanted": plan.wanted,
        "hypothesis": list(plan.hypothesis), "share": result.share,
        "recommended": find_sizes(plan.recommended) if plan.recommended else None,
        "designs": result.to_frame().to_dict("records"),
        "powers": [_list_power(one) for one in plan.powers],
        "planted": result.effects.to_dict("records"), "truth": truth, "seed": shown.seed,
        "whole": result.whole.to_dict("records"), "cards": list_cards(result), "notes": list_notes(result),
    }  # fmt: skip


def _list_power(one: Power) -> dict[str, Any]:
    return {
        **find_sizes(one.design), "studies": one.studies, "family": list(one.family),
        "hypotheses": one.table.to_dict("records"), "differences": one.differences.to_dict("records"),
        "fits": one.counts.to_dict("records"),
    }  # fmt: skip


def list_notes(result: StudyPower) -> list[str]:
    """List all that was assumed or is unusual, once each."""
    own = (note for one in result.plan.powers for note in one.notes)
    return list(dict.fromkeys([*result.notes, *result.plan.notes, *own]))


def _list_pictures(result: StudyPower) -> list[Picture]:
    table, wanted, own = result.to_frame(), result.plan.wanted, result.plan.powers[0].design
    table = table.assign(participants=table["people"])
    still = (table["reducers"] == own.reducers) & (table["repeats"] == own.repeats)
    grid = table[still].drop_duplicates(["participants", "recordings"])
    others = table[(table["participants"] == own.participants * result.share) & (table["recordings"] == own.recordings)]
    pictures = [
        Picture("power", CAPTION.format(own=own.recordings), partial(figures.draw_power, grid, own.recordings, wanted=wanted))
    ]
    if max(others[name].nunique() for name in figures.OTHERS) > 1:
        pictures.append(Picture("others", OTHERS, partial(figures.draw_others, others, wanted=wanted)))
    return pictures


def tabulate(result: StudyPower, tables: Mapping[str, pd.DataFrame]) -> dict[str, PageTable]:
    """Build the tables of the page."""
    grids = {
        "designs": _tabulate_designs(result), "planted": _tabulate_planted(result),
        "spreads": _tabulate_spreads(result), "fits": _tabulate_fits(tables["fits"]) if "fits" in tables else None,
        "errors": _tabulate_errors(result), "whole": _tabulate_whole(result),
    }  # fmt: skip
    return {name: grid for name, grid in grids.items() if grid is not None and grid.rows}


def _build(caption: str, rows: list[dict[str, str]]) -> PageTable:
    return PageTable(caption, tuple(rows[0]) if rows else (), tuple(tuple(row.values()) for row in rows))


def _tabulate_designs(result: StudyPower) -> PageTable:
    effects = result.effects.set_index(["attribute", "metric"]).loc[result.plan.hypothesis]
    size, per = float(effects["size"]), effects["per"]
    rows = [
        {
            "Participants": str(row["people"]), "Recordings": str(row["recordings"]), "Reducers": str(row["reducers"]),
            "Repeats": str(row["repeats"]), "Minutes": _write(row["minutes"], ".0f"),
            "Power": _write(row["power"]), "Simulated": _write(row["simulated"]),
            "Interval": _write_ends(row["simulated_low"], row["simulated_high"]),
            "At most": _write(row["ceiling"]), f"Found, points per {per}": _write(size * row["detectable"], ".2g"),
            "Enough": "recommended" if row["recommended"] else "yes" if row["enough"] else "no",
        }
        for row in result.to_frame().to_dict("records")
    ]  # fmt: skip
    return _build(
        f"All designs, for {_name_hypothesis(result.plan.hypothesis)}. Power: closed form. Simulated: with its 95 % Monte "
        "Carlo interval. At most: with participants without end. Found: smallest slope found with the power asked for. "
        "Minutes: of one session.", rows,
    )  # fmt: skip


def _tabulate_planted(result: StudyPower) -> PageTable:
    rows = [
        {
            "Hypothesis": _name_hypothesis((row["attribute"], row["metric"])),
            "Slope planted": f"{row['points']:.3g} points per {row['per']}", "Source": row["source"],
        }
        for row in result.effects.to_dict("records")
    ]  # fmt: skip
    return _build("Planted slopes, within recordings.", rows)


def _tabulate_spreads(result: StudyPower) -> PageTable:
    truth = result.shown.truth
    rows = [
        {"What differs": name, "SD, points": f"{getattr(truth, key):.3g}"}
        for key, name in SPREADS.items()
    ]
    rows += [
        {"What differs": f"People's slopes on {words.format_name(metric)}, per unit", "SD, points": f"{sd:.3g}"}
        for metric, sd in truth.slope_sds.items()
    ] or [
        {"What differs": "People's slopes, per standard deviation of a metric", "SD, points": f"{truth.slope_points:.3g}"}
    ]
    return _build(f"Standard deviations assumed, from {truth.source}.", rows)


def _tabulate_fits(fits: pd.DataFrame) -> PageTable:
    rows = [
        {
            "Participants": str(row["participants"]), "Recordings": str(row["recordings"]),
            "Studies": "with planted slopes" if row["arm"] == "planted" else "without any slope",
            "Outcome": str(row["outcome"]), "Models": str(row["models"]), "Reason": str(row["reason"]),
        }
        for row in fits.to_dict("records")
    ]  # fmt: skip
    return _build(
        "What became of the simulated models. Singular fits (a spread estimated as zero) count in every share; what failed "
        "or was not estimable is in none, and is never taken for a slope that was not found.", rows,
    )  # fmt: skip


def _tabulate_errors(result: StudyPower) -> PageTable:
    rows = [
        {
            "Participants": str(one.design.participants * result.share), "Recordings": str(one.design.recordings),
            "Hypothesis": _name_hypothesis((row["attribute"], row["metric"])),
            "False positives": _write(row["false_positives"], ".3f"),
            "Interval": _write_ends(row["false_low"], row["false_high"], ".3f"),
            "Coverage": _write(row["coverage"], ".3f"),
            "Interval ": _write_ends(row["coverage_low"], row["coverage_high"], ".3f"),
        }
        for one in result.plan.powers
        for row in one.table.to_dict("records")
    ]  # fmt: skip
    return _build(
        "How often the analysis is wrong: share of studies without any slope in which p is below 0.05 (nominal 0.05), and "
        "share of 95 % intervals that hold the planted slope (nominal 0.95), with 95 % Monte Carlo intervals.", rows,
    )  # fmt: skip


def _tabulate_whole(result: StudyPower) -> PageTable | None:
    if result.whole.empty:
        return None
    rows = [
        {
            "Hypothesis": _name_hypothesis((row["attribute"], row["metric"])), "Whole studies": str(row["studies"]),
            "Power": _write(row["whole"]), "Interval": _write_ends(row["whole_low"], row["whole_high"]),
            "Fast": _write(row["fast"]), "Interval ": _write_ends(row["fast_low"], row["fast_high"]),
            "Closed form": _write(row["closed"]), "Coverage": _write(row["coverage"], ".3f"),
            "Interval  ": _write_ends(row["coverage_low"], row["coverage_high"], ".3f"),
        }
        for row in result.whole.to_dict("records")
    ]  # fmt: skip
    return _build(
        "Whole studies (plans, session engine, simulated observers, decoding, screening, primary model, Holm) beside the "
        "fast simulation and the closed form of the same observers.", rows,
    )  # fmt: skip


def _write(value: float, form: str = ".2f") -> str:
    return words.ABSENT if value != value else f"{value:{form}}"


def _write_ends(low: float, high: float, form: str = ".2f") -> str:
    return words.ABSENT if low != low else f"{low:{form}} to {high:{form}}"
