"""The page of the trade-off: one picture first, then a line per recording and a line per reducer.

Every number and verdict comes from the tables of `judge`; here they are drawn and put into words.
"""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321 import __version__
from feel321.analysis import figures
from feel321.analysis.report.folder import PageParts, PageResult
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff.battery import BATTERY
from feel321.analysis.tradeoff.judge import (
    FAILS_DB,
    RATINGS,
    Context,
    choose,
    compare_rated,
    judge_reducers,
    list_rows,
)
from feel321.analysis.tradeoff.measure import MOUNTED
from feel321.analysis.words import capitalise, format_count, format_name, join_words, render_words
from feel321.types import METRIC_INFO

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.table.items import Table

SHOWN = ("spectral_match_bounded", "temporal_match")
"""Metrics that are always drawn; a lab's own follow."""

NOT_DRAWN = frozenset({
    "level_db", "spectrum_db", "motion_db", "envelope_db", "pre_echo_db", "change_db", "spectral_match",
    "temporal_match_windowed",
})  # fmt: skip

GROUPS: Mapping[str, str] = MappingProxyType({
    f"sa{axis}321{form}": f"sax/say/saz321{form}"
    for form in ("", "_matched", "_matched_running") for axis in "xyz"
})  # fmt: skip
"""Single axes -> their one row: over all mountings of the sensor they are equal."""

PANEL_CM = 6.2
TICKS = (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)
CAPTION = (
    "Accuracy against time. Accuracy: mean over mountings of the sensor, median over recordings. Time: relative to the "
    "four FFTs that no transform in the frequency domain can do without. Hollow: fails on at least one of the "
    "recordings. Line: the frontier of those that fail on none; nothing is both faster and more accurate."
)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Tradeoff(PageResult):
    """Speed against accuracy, where reducers fail, and the simplest sufficient one for every recording.

    frame: what was measured. verdicts: every reducer on every recording and scene: what it needs, what it fails by,
    whether it depends on the mounting, how far it is behind the best, and whether it suffices. choices: every
    recording: the simplest sufficient reducer, what is wrong with the best simpler one, and what a better one would
    gain. people: what ratings say of each reducer; empty without ratings or margin.
    """

    frame: DataFrame
    verdicts: DataFrame
    choices: DataFrame
    people: DataFrame
    context: Context
    simulated: bool

    @property
    def common(self) -> tuple[str, ...]:
        """Reducers that suffice for every recording that can be judged, the simplest first."""
        own = self.verdicts[(self.verdicts["kind"] == "recording") & self.verdicts["in_budget"]]
        groups = own.groupby("reducer", sort=False)
        serves = groups["sufficient"].all()
        order = groups["order"].mean().sort_values(kind="stable")
        return tuple(str(name) for name in order.index if serves[name])

    @property
    def headline(self) -> str:
        """Which one reducer suffices for all recordings, in one sentence."""
        judged = [one for one in list_rows(self.choices) if not one["problem"]]
        few = {1: "the recording", 2: "both recordings"}
        where = few.get(len(judged), f"all {len(judged)} recordings")
        if self.common:
            answers = [(one["answer"], *one["ties"].split()) for one in judged]
            simpler = sum(self.common[0] not in names for names in answers)
            more = f"; for {simpler} of them a simpler one is enough" if simpler else ""
            return f"{self.common[0]} suffices for {where}{more}."
        lacking = sum(not one["answer"] for one in judged)
        more = f"; for {lacking} of them nothing suffices" if lacking and len(judged) > 1 else ""
        return f"No reducer suffices for {where}{more}."

    def to_frame(self) -> DataFrame:
        """Return the choices, one row per recording."""
        return self.choices

    def summary(self) -> str:
        """Write the choices for reading: one line per recording, and one for all."""
        lines = []
        for row in map(describe_choice, list_rows(self.choices)):
            parts = [row[name] for name in ("answer", "simpler", "close", "people")]
            lines.append(f"{row['recording']}: {'; '.join(filter(None, parts))}")
        return "\n".join([*lines, self.headline])

    def to_frames(self) -> dict[str, DataFrame]:
        """Return measures, verdicts, choices, the points of the picture, and people where ratings were used."""
        tables = {"measures": self.frame, "verdicts": self.verdicts, "choices": self.choices}
        tables["points"] = place_points(self.frame, self.verdicts)
        return tables | ({"people": self.people} if len(self.people) else {})

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        machine = describe_machine()
        points = tables["points"]
        front = points[points["on_frontier"]].sort_values("cost_ratio")
        content = {
            "version": __version__, "headline": self.headline, "common": self.common, "context": asdict(self.context),
            "fails_db": FAILS_DB, "simulated": self.simulated, "machine": machine,
            **{name: list_rows(frame) for name, frame in tables.items() if name != "measures"},
        }  # fmt: skip
        values = {
            "result": self, "choices": list(map(describe_choice, list_rows(self.choices))), "scenes": BATTERY,
            "frontiers": {
                str(metric): join_words(list(part["reducer"]))
                for metric, part in front.groupby("metric", sort=False)
            }, "reducers": list_reducers(self, points),
            "battery": map_battery(self.verdicts),
            "notes": list_notes(self), "fails_db": FAILS_DB, "machine": machine,
        }  # fmt: skip
        pictures = [Picture("speed", CAPTION, draw_speed(points))]
        return "tradeoff.html", content, pictures, values


def advise_tradeoff(
    frame: DataFrame,
    context: Context | None = None,
    *,
    ratings: Table | DataFrame | None = None,
    margin: float | None = None,
) -> Tradeoff:
    """Find where reducers fail, and the simplest sufficient one for every recording, from what was measured.

    Parameters
    ----------
    frame : DataFrame
        What `measure_tradeoff` returned.
    context : Context, optional
        Where the reducer is to run, and what is good enough; offline, on one axis, for any mounting if left out.
    ratings : Table or DataFrame, optional
        Ratings of the recordings: participant, recording, reducer, scale, level, rating.
    margin : float, optional
        Points of rating that do not matter, fixed beforehand; without them ratings are not used.

    Returns
    -------
    Tradeoff
        Verdicts and choices, to be written as a page or read as tables.

    Raises
    ------
    ValueError
        If no recording has motion that can be judged.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> from feel321.analysis import advise_tradeoff, measure_tradeoff
    >>> scene = stimuli.make_scene("constrained_drag", duration_s=0.5)
    >>> advise_tradeoff(measure_tradeoff(scene)).choices["answer"].tolist()
    ['pca321']
    """
    import pandas as pd

    context = Context() if context is None else context
    people = compare_rated(ratings, margin=margin)
    verdicts = judge_reducers(frame, context, people)
    own = verdicts[verdicts["kind"] == "recording"]
    choices = []
    about = frame[(frame["kind"] == "recording") & (frame["reducer"] == "")]
    for name, rows in about.groupby("recording", sort=False):
        facts = dict(zip(rows["measure"], rows["value"], strict=True))
        ranked = own[own["recording"] == name]
        choices.append(choose(str(name), ranked, facts=facts, context=context))
    if not len(own):
        why = "; ".join(f"{one['recording']}: {one['problem']}" for one in choices)
        got = f"got none ({why}); check files and units"
        raise ValueError(f"recordings must have motion from 20 to 1000 Hz, {got}")
    simulated = bool(len(people) and people["simulated"].any())
    return Tradeoff(frame, verdicts, pd.DataFrame(choices), people, context, simulated)


def place_points(frame: DataFrame, verdicts: DataFrame) -> DataFrame:
    """Put reducers into the plane of speed and accuracy: one row per point and metric."""
    import pandas as pd

    own = frame[(frame["kind"] == "recording") & (frame["reducer"] != "")]
    own = own.assign(reducer=own["reducer"].map(find_group))
    failing = verdicts[(verdicts["kind"] == "recording") & (verdicts["fails"] != "")]
    hollow = set(failing["reducer"].map(find_group))
    costs = own[own["measure"] == "cost_ratio"].groupby("reducer", sort=False)["value"].median()
    turned = own[(own["condition"] == MOUNTED) & ~own["measure"].isin(NOT_DRAWN)]
    turned = turned.dropna(subset=["value"])
    rows: list[dict[str, Any]] = []
    for metric in dict.fromkeys([*SHOWN, *turned["measure"]]):
        part = turned[turned["measure"] == metric]
        means = part.groupby(["reducer", "recording"], sort=False)["value"].mean()
        groups = means.groupby("reducer", sort=False)
        placed = pd.DataFrame({"cost_ratio": costs, "accuracy": groups.median()})
        placed = placed.assign(lowest=groups.min(), highest=groups.max())
        placed = placed.dropna().rename_axis("reducer").reset_index()
        placed["metric"] = metric
        placed["fails"] = placed["reducer"].isin(hollow)
        sign = -1 if metric in METRIC_INFO and METRIC_INFO[metric].higher == "worse" else 1
        rows += mark_frontier(list_rows(placed), sign=sign)
    return pd.DataFrame(rows)


def find_group(reducer: str) -> str:
    """Find the row that a reducer is in: its own, or that of the three single axes of a form."""
    return GROUPS.get(reducer, reducer)


def mark_frontier(points: list[dict[str, Any]], *, sign: int = 1) -> list[dict[str, Any]]:
    """Mark the points that do not fail, and than which no other of these is as fast and as accurate."""
    sound = [(one["cost_ratio"], -sign * one["accuracy"]) for one in points if not one["fails"]]
    for one in points:
        own = one["cost_ratio"], -sign * one["accuracy"]
        beaten = any(two != own and two[0] <= own[0] and two[1] <= own[1] for two in sound)
        one["on_frontier"] = not (one["fails"] or beaten)
    return points


def draw_speed(points: DataFrame) -> Figure:
    """Draw accuracy against time, a panel per metric, with the frontier."""
    metrics = list(points["metric"].unique())
    looks = figures.assign_looks(list(points["reducer"].unique()))
    with figures.print_style():
        rows = math.ceil(len(metrics) / 2)
        figure = figures.new_canvas(rows * PANEL_CM)
        places = figure.subplots(rows, 2, squeeze=False).ravel()
        for axes, metric in zip(places, metrics, strict=False):
            _draw_panel(axes, points[points["metric"] == metric], looks)
            axes.set_ylabel(capitalise(format_name(metric)))
            axes.set_xlabel("Time relative to the FFT floor")
        for axes in places[len(metrics) :]:
            axes.remove()
        figures.add_legend(figure, figures.make_handles(looks))
    return figure


def _draw_panel(axes: Axes, points: DataFrame, looks: Mapping[str, figures.Look]) -> None:
    axes.set_xscale("log")
    front = points[points["on_frontier"]].sort_values("cost_ratio")
    line: dict[str, Any] = {"drawstyle": "steps-post", "color": figures.GREY, "linewidth": 0.9}
    axes.plot(front["cost_ratio"], front["accuracy"], zorder=2, **line)
    for row in list_rows(points):
        place, look = (row["cost_ratio"], row["accuracy"]), looks[row["reducer"]]
        figures.plot_marks(axes, place[:1], place[1:], look=look, size=5.5, filled=not row["fails"])
    axes.margins(x=0.12, y=0.1)
    axes.axvline(1.0, color=figures.PALE, linewidth=figures.THIN, zorder=1)
    low, high = points["cost_ratio"].min() / 2, 2 * points["cost_ratio"].max()
    ticks = [tick for tick in TICKS if low <= tick <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()


def describe_choice(one: Mapping[str, Any]) -> dict[str, str]:
    """Put a choice into words: the answer, why not simpler, what a better one would gain, doubts, people."""
    facts = {**one, "little": LITTLE_DB, "ratings": RATINGS}
    parts = ("answer", "simpler", "better", "close", "people")
    told = {part: " ".join(render_words("tradeoff", part, one=facts)) for part in parts}
    return {"recording": one["recording"], **told}


def list_reducers(result: Tradeoff, points: DataFrame) -> list[dict[str, Any]]:
    """List reducers for the page, the fastest first and the single axes of a form as one: speed, needs, both marks."""
    own = result.verdicts[result.verdicts["kind"] == "recording"]
    streams = result.frame[result.frame["measure"] == "block_load"].set_index("reducer")["value"]
    answers = result.choices["answer"].map(find_group).value_counts()
    rows: dict[str, dict[str, Any]] = {}
    for place in sorted(list_rows(points), key=lambda one: one["cost_ratio"]):
        new = {"reducer": place["reducer"], "cost_ratio": place["cost_ratio"]}
        row = rows.setdefault(place["reducer"], new)
        row[place["metric"]] = place["accuracy"]
    for name, row in rows.items():
        part = own[own["reducer"].map(find_group) == name]
        members = [one for one in part["reducer"].unique() if one in streams]
        failing = part[part["fails"] != ""]
        row |= {
            "latency_ms": part["latency_ms"].max(), "chosen": int(answers.get(name, 0)),
            "load": max((float(streams[one]) for one in members), default=math.nan),
            "turned": part[part["depends_on_mounting"]]["recording"].nunique(),
            "failing": failing["recording"].nunique(), "recordings": part["recording"].nunique(),
            "fails": [one | {"who": "" if one["reducer"] == name else one["reducer"]} for one in list_rows(failing)],
        }  # fmt: skip
    return list(rows.values())


def map_battery(verdicts: DataFrame) -> dict[str, Any]:
    """Make the map of failures on the battery: scenes in rows, reducers in columns; empty if it was not measured."""
    own = verdicts[verdicts["kind"] == "battery"]
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    for one in list_rows(own):
        place = one["recording"], find_group(one["reducer"])
        cell = cells.setdefault(place, {"fails": "", "turned": False})
        cell["fails"] = " ".join(dict.fromkeys(f"{cell['fails']} {one['fails']}".split()))
        cell["turned"] |= one["depends_on_mounting"]
    scenes, reducers = (list(dict.fromkeys(key[number] for key in cells)) for number in (0, 1))
    return {"scenes": scenes, "reducers": reducers, "cells": cells}


def list_notes(result: Tradeoff) -> list[str]:
    """List what was left out or assumed."""
    facts = result.frame[(result.frame["reducer"] == "") & (result.frame["kind"] == "recording")]
    wide = facts.pivot_table(index="recording", columns="measure", values="value", sort=False)
    notes = []
    cut = wide[wide["used_s"] < 0.98 * wide["duration_s"]] if "used_s" in wide else ()
    if len(cut):
        seconds, several = f"{wide['used_s'].max():.1f} s", format_count(len(cut), "recording")
        notes.append(f"Of {several} only the strongest part was used, up to {seconds}.")
    if not len(result.people):
        needs = "rated reducers and a margin set beforehand ([analysis] margin)"
        notes.append(f"Ratings were not used: that takes {needs}.")
    return notes


LITTLE_DB = 0.1  # Gains below this are not told


def describe_machine() -> dict[str, Any]:
    """Describe what times were measured on: without its name a time means nothing."""
    cpu_list = Path("/proc/cpuinfo")
    lines = cpu_list.read_text(encoding="utf-8").splitlines() if cpu_list.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return {
        "processor": next(named, "") or platform.processor() or platform.machine() or "unknown",
        "cores": os.cpu_count() or 1,
        # Programs that wanted to run in the last minute; not every system counts them.
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy")},
    }
