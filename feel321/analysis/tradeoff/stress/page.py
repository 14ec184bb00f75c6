"""A stress test as data, and its page: answers in words, a heat map whose red cells lead to explanations, tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from feel321.analysis import words
from feel321.analysis.report.section import PageTable, Picture
from feel321.analysis.tradeoff.results import PageParts, PageResult
from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.diagnosis import (
    SIGNS,
    SINGLE_AXES,
    find_reason,
    list_warnings,
)
from feel321.analysis.tradeoff.stress.heatmap import (
    CAPTION,
    FIGURE,
    build_map,
    count_failed_scenes,
    describe_finding,
    describe_letters,
    draw_stress,
    find_undefined,
    format_value,
)
from feel321.analysis.tradeoff.stress.measures import EXPLODED, MEASURES, RANGE_LIMIT, StressCell

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.tradeoff.stress.diagnosis import Diagnosis
    from feel321.analysis.tradeoff.stress.measures import MetricRow


MOVED = MappingProxyType({
    "rotation": "Rotating the sensor",
    "flip": "Flipping the sign of an axis",
    "shift": "Shifting the motion in time",
})
"""Measure -> what is done to the recording, which leaves the motion as it is."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Stress(PageResult):
    """Where reducers fail, how badly, and which recordings come near.

    Parameters
    ----------
    reducers : tuple of str
        Names of the reducers.
    cells : tuple of StressCell
        Every measure of every reducer on every scene of the battery.
    gains : tuple of StressCell
        Perturbation gain of every reducer on every recording.
    metrics : tuple of MetricRow
        The metrics on every scene and recording.
    diagnoses : tuple of Diagnosis
        What in each recording makes reducers fail.
    notes : tuple of str
        What was left out or assumed.
    inputs : Mapping of str to object
        Seed, numbers of takes and draws, digests of the recordings.
    """

    reducers: tuple[str, ...]
    cells: tuple[StressCell, ...]
    gains: tuple[StressCell, ...]
    metrics: tuple[MetricRow, ...]
    diagnoses: tuple[Diagnosis, ...]
    notes: tuple[str, ...]
    inputs: Mapping[str, object]

    @property
    def failures(self) -> tuple[StressCell, ...]:
        """The cells of the battery that fail."""
        return tuple(cell for cell in self.cells if cell.grade == "fails")

    @property
    def warnings(self) -> dict[str, tuple[str, ...]]:
        """The warnings of each recording that has any."""
        found = {one.recording: list_warnings(one, self.gains) for one in self.diagnoses}
        return {name: lines for name, lines in found.items() if lines}

    @property
    def answers(self) -> tuple[str, ...]:
        """The main findings, in words."""
        return (
            describe_finding(
                count_failed_scenes(self.cells, self.reducers), find_undefined(self.cells)
            ),
            _describe_gains(self),
            _describe_invariance(self),
            _describe_faults(self),
            *describe_metrics(self.metrics),
        )

    def to_frames(self) -> dict[str, DataFrame]:
        """Return everything that was measured as tables.

        Returns
        -------
        dict of str to DataFrame
            `cells`: every measure of every reducer on every scene; `metrics`: the metrics on scenes and recordings;
            `recordings`: their signs; `gains`: perturbation gains on them.
        """
        import pandas as pd

        names = (
            "recording",
            "reducer",
            "measure",
            "value",
            "p90",
            "p95",
            "worst",
            "up_to_phase",
            "grade",
        )
        signs = [{"recording": one.recording, **one.figures} for one in self.diagnoses]
        return {
            "cells": pd.DataFrame(map(_to_row, self.cells), columns=names),
            "metrics": pd.DataFrame(map(asdict, self.metrics)),
            "recordings": pd.DataFrame(signs, columns=["recording", *SIGNS]),
            "gains": pd.DataFrame(map(_to_row, self.gains), columns=names),
        }

    def summary(self) -> str:
        """Write the main findings and the warnings for reading.

        Returns
        -------
        str
            One line for each.
        """
        warned = (f"{name}: {line}" for name, lines in self.warnings.items() for line in lines)
        return "\n".join((*self.answers, *warned))

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        del tables
        content = {
            "headline": self.answers[0],
            "answers": self.answers,
            "failed_scenes": count_failed_scenes(self.cells, self.reducers),
            "warnings": self.warnings,
            "measures": list(map(asdict, MEASURES.values())),
            "scenes": {
                name: {"title": one.title, "reason": one.reason} for name, one in BATTERY.items()
            },
            "cells": list(map(_to_row, self.cells)),
            "gains": list(map(_to_row, self.gains)),
            "metrics": list(map(asdict, self.metrics)),
            "recordings": [
                {"name": one.recording, "figures": dict(one.figures), "near": one.near_scenes}
                for one in self.diagnoses
            ],
            "notes": self.notes,
            "inputs": dict(self.inputs),
        }
        pictures = [Picture(FIGURE, CAPTION, partial(draw_stress, self.cells, self.reducers))]
        return PageParts("stress.html", content, pictures, build_page(self))


def _to_row(cell: StressCell) -> dict[str, object]:
    return {**asdict(cell), "grade": cell.grade}


def _describe_gains(result: Stress) -> str:
    """Describe who amplifies noise; single axes are left out, they ignore motion across themselves."""
    worst: dict[str, StressCell] = {}
    for cell in result.cells:
        known = cell.measure == "gain" and not math.isnan(cell.value)
        if known and (cell.reducer not in worst or cell.value > worst[cell.reducer].value):
            worst[cell.reducer] = cell
    own = [cell for name, cell in worst.items() if name not in SINGLE_AXES] or [*worst.values()]
    if not own:
        return "How much sensor noise is amplified is not defined for any reducer."
    most, limit = max(own, key=lambda cell: cell.value), MEASURES["gain"].fails
    steady = [f"{cell.reducer} ({cell.value:.1f})" for cell in own if cell.value < limit]
    if most.value <= 1:
        return "Sensor noise is amplified by no reducer in any scene (median takes)."
    rest = (
        f"in no scene {limit:g} times or more by {words.join_words(steady)}"
        if steady
        else f"every reducer amplifies it {limit:g} times or more in some scene"
    )
    return (
        f"Sensor noise is amplified most by {most.reducer}, {format_value(most.value)} times on the scene "
        f"“{BATTERY[most.recording].title}”; {rest} (median takes)."
    )


def count_failures(result: Stress, measure: str) -> dict[str, int]:
    """Count the scenes on which each reducer fails by a measure."""
    counts = Counter(cell.reducer for cell in result.failures if cell.measure == measure)
    return {name: counts[name] for name in result.reducers}


def _describe_invariance(result: Stress) -> str:
    counts = [count_failures(result, key) for key in MOVED]
    known = {
        cell.reducer for cell in result.cells if cell.measure in MOVED and cell.grade != "undefined"
    }
    steady = [
        name for name in result.reducers if name in known and not any(own[name] for own in counts)
    ]
    moved = words.join_words([what[0].lower() + what[1:] for what in MOVED.values()], "or")
    return (
        f"{moved[0].upper()}{moved[1:]} changes the output by less than {100 * MEASURES['rotation'].fails:.0f} % in "
        f"every scene for {words.join_words(steady or ['no reducer'])} (median takes)."
    )


def _describe_faults(result: Stress) -> str:
    damages = [
        cell for cell in result.cells if cell.measure == "fault" and not math.isnan(cell.value)
    ]
    if not damages:
        return "How much sensor faults change the output is not defined for any reducer."
    worst = max(damages, key=lambda cell: cell.value)
    return (
        "Sensor faults (clipping, steps, gaps, clocks) change the output at most "
        f"{worst.value:.2g} times as much as the input ({worst.reducer}, {BATTERY[worst.recording].title})."
    )


def describe_metrics(rows: Sequence[MetricRow]) -> Iterator[str]:
    """Describe where the paper's metrics fail."""
    moving, exploding = [row for row in rows if row.moves], [row for row in rows if row.explodes]
    yield (
        f"Temporal match varies by more than {RANGE_LIMIT:g} with the mounting alone in {len(moving)} of {len(rows)} "
        "scenes and recordings, although what is felt stays the same; its counterpart does not vary."
    )
    if exploding:
        worst = min(exploding, key=lambda row: row.spectral)
        known = worst.recording in BATTERY
        title = f"“{BATTERY[worst.recording].title}”" if known else worst.recording
        yield (
            f"Spectral match falls below {EXPLODED:g} in {len(exploding)} of {len(rows)}, lowest on {title} "
            f"({worst.worst_reducer}: {worst.spectral:.3g}); the bounded one stays between 0 and 1 "
            f"({worst.spectral_bounded:.2f} there)."
        )


class GradedText(str):
    """An entry of a table of a page; grade: the style class that colours it; link: where it leads."""

    __slots__ = ("grade", "link")
    grade: str
    link: str

    def __new__(cls, text: str, grade: str = "", link: str = "") -> GradedText:
        """Make the text and remember how it is shown."""
        made = super().__new__(cls, text)
        made.grade, made.link = grade, link
        return made


def build_page(result: Stress) -> dict[str, object]:
    """Build what the page shows."""
    return {
        "result": result,
        "caption": CAPTION,
        "key": describe_letters(),
        "map": build_map(result.cells, result.reducers),
        "failed": count_failed_scenes(result.cells, result.reducers),
        "undefined": find_undefined(result.cells),
        "battery": BATTERY,
        "measures": MEASURES,
        "counts": _tabulate_counts(result),
        "grids": [_tabulate_measure(result, measure) for measure in MEASURES],
        "explained": _explain(result),
        "near": {scene: list(_list_near(result, scene)) for scene in BATTERY},
        "gains": _tabulate_gains(result),
        "recordings": _tabulate_recordings(result),
        "metrics": _tabulate_metrics(result),
    }


def name_anchor(scene: str, reducer: str) -> str:
    """Name the place of an explanation."""
    return f"{FIGURE}-{scene}-{reducer}"


def _list_near(result: Stress, scene: str) -> Iterator[str]:
    """List the recordings that come near a scene, with their signs of it."""
    for one in result.diagnoses:
        signs = [sign for sign in one.near_signs if sign.name in BATTERY[scene].signs]
        shown = ", ".join(f"{sign.title} {sign.format(one.figures[sign.name])}" for sign in signs)
        if shown:
            yield f"{one.recording} ({shown})"


def _explain(result: Stress) -> dict[str, dict[str, list[str]]]:
    """List what each reducer fails by on each scene, and why."""
    found: dict[str, dict[str, list[str]]] = {scene: {} for scene in BATTERY}
    for cell in result.failures:
        measure = MEASURES[cell.measure]
        upper = {"90 %": cell.p90, "95 %": cell.p95, "worst": cell.worst}
        notes = [f"limit {measure.fails:g}"]
        notes += [f"{name} {format_value(value)}" for name, value in upper.items()]
        if not math.isnan(cell.up_to_phase):
            notes.append(f"{format_value(cell.up_to_phase)} up to a constant phase")
        value, why = format_value(cell.value, measure.unit), find_reason(cell.measure, cell.reducer)
        line = f"{measure.title} {value} ({', '.join(notes)}): {why}"
        found[cell.recording].setdefault(cell.reducer, []).append(line)
    return found


def _show(cell: StressCell, *, linked: bool = True) -> GradedText:
    """Show the median, and the 90th percentile and the worst where they differ from it."""
    median = format_value(cell.value, MEASURES[cell.measure].unit)
    p90, worst = format_value(cell.p90), format_value(cell.worst)
    alone = math.isnan(cell.p90) or (p90 == worst and p90 in median)
    anchor = name_anchor(cell.recording, cell.reducer)
    link = f"#{anchor}" if linked and cell.grade == "fails" else ""
    return GradedText(median if alone else f"{median} / {p90} / {worst}", cell.grade, link)


def _tabulate_measure(result: Stress, measure: str) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for scene, entry in BATTERY.items():
        own = [cell for cell in result.cells if (cell.recording, cell.measure) == (scene, measure)]
        if any(cell.grade != "undefined" for cell in own):
            rows.append((entry.title, *map(_show, own)))
    title, what = MEASURES[measure].title, MEASURES[measure].what
    caption = f"{title}: {what[0].lower()}{what[1:]}"
    return PageTable(caption, ("Scene", *result.reducers), tuple(rows))


def _tabulate_counts(result: Stress) -> PageTable:
    counts = {key: count_failures(result, key) for key in MOVED}
    limit = f"{100 * MEASURES['rotation'].fails:.0f} %"
    return PageTable(
        f"Number of scenes, of {len(BATTERY)}, on which the output changes by {limit} or more (median takes).",
        ("Reducer", *MOVED.values()),
        tuple(
            (name, *(GradedText(str(own[name]), "caution" * bool(own[name])) for own in counts.values()))
            for name in result.reducers
        ),
    )  # fmt: skip


def _tabulate_gains(result: Stress) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for one in result.diagnoses:
        own = (cell for cell in result.gains if cell.recording == one.recording)
        rows.append((one.recording, *(_show(cell, linked=False) for cell in own)))
    caption = f"Perturbation gain on each recording: median / 90 % / worst of {result.inputs['draws']} noises."
    return PageTable(caption, ("Recording", *result.reducers), tuple(rows))


def _tabulate_recordings(result: Stress) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for one in result.diagnoses:
        values = ((sign, one.figures[name]) for name, sign in SIGNS.items())
        shown = (GradedText(sign.format(v), "caution" * sign.is_near(v)) for sign, v in values)
        rows.append((one.recording, *shown))
    head = ("Recording", *(sign.title for sign in SIGNS.values()))
    caption = "Properties of the recordings that make reducers fail. Marked: beyond the limit."
    return PageTable(caption, head, tuple(rows))


def _tabulate_metrics(result: Stress) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for row in result.metrics:
        title = BATTERY[row.recording].title if row.recording in BATTERY else row.recording
        span = f"{format_value(row.temporal_low)}–{format_value(row.temporal_high)}"
        moved = format_value(row.invariant_high - row.invariant_low)
        rows.append((
            title, GradedText(span, "fails" if row.moves else "good"),
            f"{format_value(row.invariant_high)} (moves by {moved})",
            GradedText(format_value(row.spectral), "fails" if row.explodes else "good"),
            row.worst_reducer or words.ABSENT, format_value(row.spectral_bounded),
            format_value(row.spectral_energy_weighted),
        ))  # fmt: skip
    head = (
        "Scene or recording", "Temporal match (eq. 2), lowest–highest", "Invariant counterpart",
        "Lowest spectral match (eq. 1)", "of", "Bounded", "Energy-weighted",
    )  # fmt: skip
    caption = (
        f"Temporal match fails where it varies by more than {RANGE_LIMIT:g} with the mounting; spectral match where it "
        f"falls below {EXPLODED:g}."
    ).replace("-", words.MINUS)
    return PageTable(caption, head, tuple(rows))
