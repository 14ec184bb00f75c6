"""The record of a stress test, and the reasons of its failures in words."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.cells import say_metrics
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS, warn_of
from feel321.analysis.tradeoff.stress.measures import MEASURES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.tradeoff.stress.cells import Cell, MetricRow
    from feel321.analysis.tradeoff.stress.diagnosis import Diagnosis

# The stress test as data: what ``results.json`` and the tables hold.

FIGURES = ("stress",)
TABLES = ("cells", "metrics", "recordings", "gains")


@dataclass(frozen=True, slots=True)
class StressResult:
    """Everything that was measured."""

    reducers: tuple[str, ...]
    cells: tuple[Cell, ...]
    gains: tuple[Cell, ...]
    metrics: tuple[MetricRow, ...]
    diagnoses: tuple[Diagnosis, ...]
    notes: tuple[str, ...]
    inputs: Mapping[str, object]

    @property
    def failures(self) -> tuple[Cell, ...]:
        """The cells of the battery that fail."""
        return tuple(cell for cell in self.cells if cell.grade == "fails")

    @property
    def warnings(self) -> dict[str, tuple[str, ...]]:
        """Warnings of each recording that has any."""
        told = {diagnosis.recording: warn_of(diagnosis, self.gains) for diagnosis in self.diagnoses}
        return {name: lines for name, lines in told.items() if lines}

    @property
    def answers(self) -> tuple[str, ...]:
        """The main findings, in words."""
        outputs = (
            *_say_gains(self),
            *_say_steady(self),
            *_say_invariance(self),
            *_say_faults(self),
        )
        return (*outputs, *say_metrics(self.metrics))

    def find_near(self, scene: str) -> tuple[str, ...]:
        """Find the recordings that come near a scene."""
        return tuple(
            _tell_near(diagnosis, scene)
            for diagnosis in self.diagnoses
            if scene in diagnosis.near_scenes
        )

    def to_json(self) -> str:
        """Write as JSON text, the same text for the same results."""
        from feel321.analysis.report.folder import list_files

        content = {
            "answers": self.answers,
            "warnings": self.warnings,
            "measures": [asdict(measure) for measure in MEASURES.values()],
            "scenes": {
                name: {"title": scene.title, "reason": scene.reason}
                for name, scene in BATTERY.items()
            },
            "cells": [{**asdict(cell), "grade": cell.grade} for cell in self.cells],
            "gains": [{**asdict(cell), "grade": cell.grade} for cell in self.gains],
            "metrics": [asdict(row) for row in self.metrics],
            "recordings": [
                {"name": one.recording, "figures": dict(one.figures), "near": one.near_scenes}
                for one in self.diagnoses
            ],
            "notes": self.notes,
            "inputs": dict(self.inputs),
            "files": list_files(FIGURES, TABLES),
        }
        return (
            json.dumps(_without_nan(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )

    def to_tables(self) -> dict[str, DataFrame]:
        """Write as tables."""
        import pandas as pd

        diagnoses = [{"recording": one.recording, **one.figures} for one in self.diagnoses]
        frames = (
            _tabulate_cells(self.cells),
            pd.DataFrame([asdict(row) for row in self.metrics]),
            pd.DataFrame(diagnoses, columns=["recording", *SIGNS]),
            _tabulate_cells(self.gains),
        )
        return dict(zip(TABLES, frames, strict=True))


def _tabulate_cells(cells: Sequence[Cell]) -> DataFrame:
    import pandas as pd

    columns = [
        "recording",
        "reducer",
        "measure",
        "value",
        "p90",
        "p95",
        "worst",
        "up_to_phase",
        "grade",
    ]
    return pd.DataFrame([{**asdict(cell), "grade": cell.grade} for cell in cells], columns=columns)


def _say_gains(result: StressResult) -> Iterable[str]:
    """Say where noise is amplified, but for single axes: that these are deaf across themselves is no news."""
    failing = [
        cell for cell in result.failures if cell.measure == "gain" and cell.reducer not in _SINGLE
    ]
    for scene in dict.fromkeys(cell.recording for cell in failing):
        told = (f"{cell.reducer} ({cell.value:.0f})" for cell in failing if cell.recording == scene)
        yield f"{BATTERY[scene].title}: perturbation gain above {MEASURES['gain'].fails:g} of {', '.join(told)}."


def _say_invariance(result: StressResult) -> Iterable[str]:
    for key, words in (
        ("rotation", "a turn of the sensor"),
        ("flip", "a flipped axis"),
        ("shift", "a shift in time"),
    ):
        counts = Counter(cell.reducer for cell in result.failures if cell.measure == key)
        unmoved = [name for name in result.reducers if not counts[name]]
        moved = (f"{name} ({counts[name]})" for name in result.reducers if counts[name])
        yield (
            f"Under {words} the output changes by less than {100 * MEASURES[key].fails:.0f} % in every scene with "
            f"{', '.join(unmoved) or 'no reducer'}; scenes of {len(BATTERY)} in which it changes more: "
            f"{', '.join(moved) or 'none'} (median takes)."
        )


def _say_faults(result: StressResult) -> Iterable[str]:
    damages = [
        cell for cell in result.cells if cell.measure == "fault" and cell.grade != "undefined"
    ]
    worst = max(damages, key=lambda cell: cell.value)
    yield (
        f"Faults of the sensor (clipping, steps, gaps, clocks) come through at most {worst.value:.2g} times as strong "
        f"as they went in ({worst.reducer}, {BATTERY[worst.recording].title})."
    )


_SINGLE = tuple(
    f"sa{axis}321{form}" for form in ("", "_matched", "_matched_running") for axis in "xyz"
)


def _say_steady(result: StressResult) -> Iterable[str]:
    """Say which reducers' gain fails nowhere, and how far it goes: in a median take, in 90 and 95 % and at worst."""
    gains = {
        name: [cell for cell in result.cells if (cell.reducer, cell.measure) == (name, "gain")]
        for name in result.reducers
    }
    takes = result.inputs["seeds"]
    for name, cells in gains.items():
        if name not in _SINGLE and all(cell.grade != "fails" for cell in cells):
            levels = (
                max(getattr(cell, key) for cell in cells)
                for key in ("value", "p90", "p95", "worst")
            )
            median, *upper = (f"{level:.1f}" for level in levels)
            yield (
                f"{name}: perturbation gain at most {median} in a median take of any scene, {upper[0]} in 90 % of the "
                f"takes, {upper[1]} in 95 % and {upper[2]} in the worst of {takes}."
            )


def _tell_near(diagnosis: Diagnosis, scene: str) -> str:
    signs = [sign for sign in diagnosis.near_signs if sign.name in BATTERY[scene].signs]
    told = ", ".join(f"{sign.title} {sign.tell(diagnosis.figures[sign.name])}" for sign in signs)
    return f"{diagnosis.recording} ({told})"


def _without_nan(entry: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    if isinstance(entry, dict):
        return {key: _without_nan(value) for key, value in entry.items()}
    if isinstance(entry, list | tuple):
        return [_without_nan(value) for value in entry]
    return None if isinstance(entry, float) and not math.isfinite(entry) else entry


# Why a reducer fails by a measure: the explanation that a red cell leads to.

_SILENT = (
    "it keeps one sensor axis; where that is (nearly) silent, the output is nothing but noise."
)
_CHANCE = "no direction leads, so the noise of the moment chooses the axis, and with it a different motion."
_SUM_PHASE = "the phase is that of x + y + z; where the axes cancel, noise sets it."
_OWN_AXIS = "what it keeps depends on where the sensor's own axes point."
_DIAGONAL = (
    "x + y + z is the projection on the sensor's diagonal, whose direction is the mounting's."
)
_SIGN_SUM = "another sign of one axis is another sum: what added up now cancels."
_LEADING = "the phase is that along the leading axis; where none leads, or little moves along it, noise sets it."
_SLOW = "frames cut slow motion into steps; these leak into all frames."
_STEPS = "within a frame slow motion is an offset, whose axes are merged like a vibration's."
_FRAMES = "frames cut the motion elsewhere, and each frame chooses anew."
_LOST = "it keeps one direction and drops the energy of the two others."

_MATCHED = ("sax321_matched", "say321_matched", "saz321_matched")
_ONE_AXIS = (*_MATCHED, *(f"{name}_running" for name in _MATCHED))
_LEADING_MATCHED = ("pca321_matched", "pca321_matched_windowed")

REASONS: Mapping[tuple[str, str], str] = MappingProxyType({
    ("gain", "sax321"): _SILENT, ("gain", "say321"): _SILENT, ("gain", "saz321"): _SILENT,
    ("gain", "soc321"): "the sum cancels; what is left of it is noise.",
    ("gain", "pca321"): _CHANCE, ("gain", "pca321_adaptive"): _CHANCE,
    ("gain", "dft321"): _SUM_PHASE, ("gain", "dft321_windowed"): _SUM_PHASE,
    ("gain", "dft321_principal"): _LEADING, ("gain", "dft321_principal_windowed"): _LEADING,
    ("rotation", "sax321"): _OWN_AXIS, ("rotation", "say321"): _OWN_AXIS, ("rotation", "saz321"): _OWN_AXIS,
    ("rotation", "soc321"): _DIAGONAL,
    ("rotation", "pca321"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("rotation", "dft321"): "the spectrum stays, but the phase of x + y + z goes with the sensor's diagonal.",
    ("rotation", "dft321_windowed"): "the spectrum stays, but the phase of x + y + z goes with the sensor's diagonal.",
    ("flip", "soc321"): _SIGN_SUM, ("flip", "dft321"): _SIGN_SUM, ("flip", "dft321_windowed"): _SIGN_SUM,
    ("shift", "pca321"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("shift", "pca321_adaptive"): _FRAMES, ("shift", "dft321_windowed"): _FRAMES,
    ("shift", "dft321_principal_windowed"): _FRAMES,
    ("edge", "mag321"): "rectifying turns an offset and a vibration into another envelope.",
    ("edge", "dft321_windowed"): _SLOW, ("edge", "dft321_principal_windowed"): _SLOW,
    ("energy", "sax321"): _LOST, ("energy", "say321"): _LOST, ("energy", "saz321"): _LOST,
    ("energy", "pca321"): _LOST, ("energy", "pca321_adaptive"): _LOST,
    ("energy", "soc321"): "axes in phase add up to too much, axes in anti-phase cancel.",
    ("energy", "mag321"): "the length of the vector is mostly offset, which is not felt; its ripple is what remains.",
    ("fault", "dft321"): "the fault changes the phase of x + y + z at frequencies whose energy it spares.",
    ("fault", "dft321_windowed"): "the fault changes the phase of x + y + z at frequencies whose energy it spares.",
    ("energy", "dft321_windowed"): _STEPS, ("energy", "dft321_principal_windowed"): _STEPS,
    **{("gain", name): _SILENT for name in _ONE_AXIS}, **{("rotation", name): _OWN_AXIS for name in _ONE_AXIS},
    **{("energy", name): "the gain is at most 10: an axis with less than a hundredth of the energy stays weak."
       for name in _ONE_AXIS},
    **{("gain", name): _CHANCE for name in _LEADING_MATCHED},
    ("rotation", "pca321_matched"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("shift", "pca321_matched_windowed"): "where none leads the axis depends on what came first, and is held there.",
})  # fmt: skip
"""(measure, reducer) -> why."""

GENERAL: Mapping[str, str] = MappingProxyType({
    "gain": "the output rests on something that noise decides.",
    "rotation": "the output depends on the sensor's axes.",
    "flip": "the output depends on the signs of the sensor's axes.",
    "shift": "the output depends on where frames begin.",
    "edge": "the envelope of what it keeps is not that of the motion.",
    "energy": "it does not keep the energy of all axes.",
    "fault": "it turns a fault of some samples into another output elsewhere too.",
    "spread": "the metrics of what it keeps change with the mounting; the paper's temporal match does so by itself.",
})  # fmt: skip


def tell_reason(measure: str, reducer: str) -> str:
    """Explain a failure.

    Examples
    --------
    >>> tell_reason("gain", "dft321")
    'the phase is that of x + y + z; where the axes cancel, noise sets it.'
    """
    return REASONS.get((measure, reducer), GENERAL[measure])
