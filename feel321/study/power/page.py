"""The power of a study: what was found, its tables, figure and page."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321 import __version__
from feel321.analysis.figures import style
from feel321.analysis.power import plan as planning
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff import results
from feel321.analysis.words import ABSENT, format_count, format_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.power.plan import PowerPlan

HEIGHT_CM = 7.5
END_CM = 0.42
"""Least distance between two names at the ends of curves."""

LINE: dict[str, Any] = {"color": style.GREY, "linewidth": style.THIN}

TICK = 0.06
"""Least distance of two labelled numbers of participants, as a share of the axis."""

WALKS = ("-", (0, (5, 1.2)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 1.5)))
"""Line styles, for curves besides that of the study's own number."""

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
class StudyPower(results.PageResult):
    """The power of a study, planned from its own settings and stimuli.

    Parameters
    ----------
    plan : PowerPlan
        Power of all designs; its participants are those who rate each attribute.
    name : str
        The study.
    effects : DataFrame
        What is planted, a row per hypothesis: attribute, metric, points, per (the step of the metric), size (of the
        step), source.
    share : int
        Groups among which the attributes are divided: as many times the participants of the plan take part.
    notes : tuple of str
        What was assumed and what is unusual, one sentence each.
    """

    plan: PowerPlan
    name: str
    effects: DataFrame
    share: int
    notes: tuple[str, ...] = ()

    @property
    def answer(self) -> str:
        """Which design is enough, its power and interval, in one sentence; or why none is."""
        row = self._find_row(self.plan.hypothesis)
        return planning.describe_plan(self.plan, share=self.share, size=row["size"], per=row["per"])

    def to_frame(self) -> DataFrame:
        """Return the power of all designs.

        Returns
        -------
        DataFrame
            The columns of `PowerPlan.table`, and people: all who take part.
        """
        return self.plan.table.assign(people=self.plan.table["participants"] * self.share)

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the numbers as tables.

        Returns
        -------
        dict of str to DataFrame
            `designs`: the grid; `hypotheses` and `fits`: of every simulated design; `planted`: the slopes.
        """
        import pandas as pd

        frames = {"designs": self.to_frame(), "planted": self.effects}
        for name, column in (("hypotheses", "table"), ("fits", "counts")):
            parts = [
                getattr(one, column).assign(**planning.find_sizes(one.design))
                for one in self.plan.powers
            ]
            frames[name] = pd.concat(parts, ignore_index=True)
        return {name: frame for name, frame in frames.items() if len(frame)}

    def summary(self) -> str:
        """Write the answer for reading.

        Returns
        -------
        str
            The answer, a line per hypothesis, and the notes.
        """
        lines = [
            "; ".join(f"{name}: {value}" for name, value in row.items())
            for row in self._list_hypotheses()
        ]
        return "\n".join([self.answer, *lines, *self.notes])

    def _find_row(self, hypothesis: tuple[str, str]) -> dict[str, Any]:
        """Find what is known of a hypothesis in the design that is shown, and what was planted."""
        attribute, metric = hypothesis
        effects = self.effects
        chosen = effects[(effects["attribute"] == attribute) & (effects["metric"] == metric)]
        planted = {str(name): value for name, value in chosen.iloc[0].to_dict().items()}
        return planning.find_row(self.plan, hypothesis) | planted

    def _list_hypotheses(self) -> list[dict[str, str]]:
        """List what is said of each hypothesis in the design that is shown."""
        rows = []
        for hypothesis in self.plan.shown.design.hypotheses:
            row = self._find_row(hypothesis)
            size, per = row["size"], row["per"]
            unit = f" points per {per}"
            rows.append({
                "Hypothesis": f"{format_name(row['metric'])} on {format_name(row['attribute'])}",
                "Planted": f"{row['points']:.2g} points per {per} ({row['source']})",
                "Power": _format_power(row), "Detectable": _write(row["detectable"] * size, unit),
                "Interval": "± " + _write(row["width"] * size / 2, unit),
            })  # fmt: skip
        return rows

    def _list_designs(self, step: Mapping[str, Any]) -> list[dict[str, str]]:
        return [
            {
                "Participants": str(row["people"]), "Recordings": str(row["recordings"]),
                "Reducers": str(row["reducers"]), "Repeats": str(row["repeats"]), "Trials": str(row["trials"]),
                "Power": _format_power(row), "At most": planning.format_power(row["ceiling"]),
                f"Detectable, points per {step['per']}": _write(step["size"] * row["detectable"]),
                "Enough": "recommended" if row["recommended"] else "yes" if row["enough"] else "no",
            }
            for row in _list_rows(self.to_frame())
        ]  # fmt: skip

    def _list_spreads(self) -> list[dict[str, str]]:
        truth = self.plan.shown.truth
        found = {name: getattr(truth, key) for key, name in SPREADS.items()}
        for whose, given, usual in (
            ("People's", truth.slope_sds, truth.slope_points),
            ("Recordings'", truth.recording_slope_sds, truth.recording_slope_points),
        ):
            found |= {
                f"{whose} slopes on {format_name(n)}, per unit": sd for n, sd in given.items()
            }
            if not given:
                found[f"{whose} slopes, per standard deviation of the metric"] = usual
        return [{"What differs": name, "SD in points": f"{sd:.3g}"} for name, sd in found.items()]

    def _make_page(self, tables: Mapping[str, DataFrame]) -> results.PageParts:
        plan, shown, step = self.plan, self.plan.shown, self._find_row(self.plan.hypothesis)
        design = shown.design
        sizes = [planning.find_sizes(one.design) for one in plan.powers]
        chosen = plan.recommended and planning.find_sizes(plan.recommended)
        powers = [
            size
            | {"studies": one.studies, "hypotheses": one.table.to_dict("records")}
            | {"fits": one.counts.to_dict("records")}
            for size, one in zip(sizes, plan.powers, strict=True)
        ]  # fmt: skip
        content = {
            "version": __version__, "study": self.name, "answer": self.answer, "verdict": plan.verdict,
            "wanted": plan.wanted, "hypothesis": list(plan.hypothesis), "share": self.share, "recommended": chosen,
            "designs": tables["designs"].to_dict("records"), "powers": powers,
            "planted": self.effects.to_dict("records"), "truth": asdict(shown.truth), "seed": shown.seed,
            "notes": list(dict.fromkeys([*self.notes, *plan.notes])),
        }  # fmt: skip
        own = plan.powers[0].design
        grid = self.to_frame()
        # Of the smallest designs that are enough, which may need hundreds of people, only the recommended one is drawn.
        grid = grid[(grid["kind"] != "smallest") | grid["recommended"].astype(bool)]
        grid = grid[(grid["reducers"] == own.reducers) & (grid["repeats"] == own.repeats)]
        grid = grid.drop_duplicates(["participants", "recordings"])
        drawing = partial(draw_power, grid, own.recordings, wanted=plan.wanted)
        fits = _list_rows(tables["fits"]) if "fits" in tables else []
        grids: dict[str, list[dict[str, Any]]] = {
            "hypotheses": [*self._list_hypotheses()], "designs": [*self._list_designs(step)],
            "spreads": [*self._list_spreads()], "fits": fits,
        }  # fmt: skip
        values = {
            "result": self, "content": content, "own": own.recordings,
            "shown": f"{format_count(design.participants * self.share, 'participant')}, "
            + planning.describe_units(design.recordings, design.reducers),
            "grids": {
                name: {"head": [*rows[0]], "rows": [[*row.values()] for row in rows]}
                for name, rows in grids.items() if rows
            },
        }  # fmt: skip
        picture = Picture("power", "Power against participants", drawing)
        return results.PageParts("power.html", content, [picture], values)


def _format_power(row: Mapping[str, Any]) -> str:
    """Write a power in closed form, and what was simulated with its interval."""
    power = planning.format_power(row["power"])
    if not isfinite(row["simulated"]):
        return power
    ends = "{simulated_low:.2f} to {simulated_high:.2f}".format(**row)
    return f"{power}, simulated {planning.format_power(row['simulated'])} ({ends})"


def _list_rows(frame: DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


def _write(value: float, unit: str = "") -> str:
    return f"{value:.2g}{unit}" if isfinite(value) else ABSENT


def draw_power(table: DataFrame, own: int, *, wanted: float) -> Figure:
    """Draw power against participants, a curve for each number of recordings; own: that of the study."""
    people = sorted(table["people"].unique())
    endless = people[-1] + 0.1 * max(people[-1] - people[0], 1)
    with style.print_style():
        figure, axes = style.new_figure(HEIGHT_CM)
        ends = {}
        for place, number in enumerate(sorted(table["recordings"].unique())):
            rows = table[table["recordings"] == number].sort_values("people")
            look: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.6, "linestyle": "-"}
            if number != own:
                look = {
                    "color": style.GREY,
                    "linewidth": 1.0,
                    "linestyle": WALKS[(place + 1) % len(WALKS)],
                }
            axes.plot(rows["people"], rows["power"], **look, zorder=3)
            seen = rows[rows["simulated"].notna()]
            style_of = {"colors": look["color"], "linewidths": 1.4, "zorder": 4}
            axes.vlines(seen["people"], seen["simulated_low"], seen["simulated_high"], **style_of)
            axes.plot(
                seen["people"], seen["simulated"], linestyle="none", marker="o", markersize=5, color="white",
                markeredgecolor=look["color"], markeredgewidth=1.2, zorder=5,
            )  # fmt: skip
            ends[number] = float(rows["ceiling"].iloc[-1])
            last = [rows["people"].iloc[-1], endless], [rows["power"].iloc[-1], ends[number]]
            axes.plot(*last, color=look["color"], linestyle=(0, (2, 2)), linewidth=0.8)
        axes.axhline(wanted, color=style.GREY, linewidth=style.THIN, zorder=1)
        axes.set(
            xlabel="Participants",
            ylabel="Power",
            ylim=(-0.02, 1.04),
            yticks=np.arange(0, 1.01, 0.2),
        )
        axes.set_xlim(right=endless)
        axes.grid(axis="y", color=style.PALE, linewidth=style.THIN)
        axes.set_axisbelow(True)
        ticks: list[int] = []
        for count in reversed(people):  # whose labels do not touch, from the largest down
            if not ticks or ticks[0] - count >= TICK * (people[-1] - people[0]):
                ticks.insert(0, count)
        axes.set_xticks([*ticks, endless], [*map(str, ticks), "\N{INFINITY}"])
        _name_ends(axes, ends, own)
    return figure


def _name_ends(axes: Axes, ends: Mapping[int, float], own: int) -> None:
    """Name curves at their right ends, each at its own height, from the highest down."""
    order = sorted(ends, key=lambda number: -ends[number])
    apart = 1.06 * END_CM / HEIGHT_CM
    heights = style.spread([ends[number] for number in order], apart, low=-0.02)
    stroke: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "clip_on": False}
    for number, height in zip(order, heights, strict=True):
        axes.plot([1.0, 1.02], [ends[number], height], **stroke | LINE)
        weight = "bold" if number == own else "normal"
        axes.text(1.03, height, f"{number} recordings", va="center", fontweight=weight, **stroke)
