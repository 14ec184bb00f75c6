"""The stress test as data: what ``results.json`` and the tables hold."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from analysis.tradeoff.stress.battery import BATTERY
from analysis.tradeoff.stress.limits import MEASURES
from analysis.tradeoff.stress.metrics import say_metrics
from analysis.tradeoff.stress.signs import SIGNS, warn_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pandas import DataFrame

    from analysis.tradeoff.stress.cells import Cell
    from analysis.tradeoff.stress.metrics import MetricRow
    from analysis.tradeoff.stress.signs import Diagnosis

FIGURES = ("stress",)
TABLES = ("cells", "metrics", "recordings", "gains")


@dataclass(frozen=True, slots=True)
class StressResult:
    """Everything that was measured.

    Parameters
    ----------
    reducers : tuple of str
        In their order.
    cells : tuple of Cell
        Of the battery: every measure.
    gains : tuple of Cell
        Of the real recordings: perturbation gain.
    metrics : tuple of MetricRow
        Of the battery and the recordings.
    diagnoses : tuple of Diagnosis
        Of the recordings.
    notes : tuple of str
        What was left out or assumed.
    inputs : Mapping of str to object
        Seed, draws, digests of the recordings.
    """

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
        outputs = (*_say_gains(self), *_say_steady(self), *_say_invariance(self), *_say_faults(self))
        return (*outputs, *say_metrics(self.metrics))

    def find_near(self, scene: str) -> tuple[str, ...]:
        """Find the recordings that come near a scene.

        Parameters
        ----------
        scene : str
            A name of `BATTERY`.

        Returns
        -------
        tuple of str
            Their names, each with the figures that tell it.
        """
        return tuple(_tell_near(diagnosis, scene) for diagnosis in self.diagnoses if scene in diagnosis.near_scenes)

    def to_json(self) -> str:
        """Write as JSON text, the same text for the same results.

        Returns
        -------
        str
            UTF-8 JSON; a number that is not defined is null.
        """
        from analysis.report.replacing import list_files

        content = {
            "answers": self.answers,
            "warnings": self.warnings,
            "measures": [asdict(measure) for measure in MEASURES.values()],
            "scenes": {name: {"title": scene.title, "reason": scene.reason} for name, scene in BATTERY.items()},
            "cells": [{**asdict(cell), "grade": cell.grade} for cell in self.cells],
            "gains": [{**asdict(cell), "grade": cell.grade} for cell in self.gains],
            "metrics": [asdict(row) for row in self.metrics],
            "recordings": [
                {"name": one.recording, "figures": dict(one.figures), "near": one.near_scenes} for one in self.diagnoses
            ],
            "notes": self.notes,
            "inputs": dict(self.inputs),
            "files": list_files(FIGURES, TABLES),
        }
        return json.dumps(_without_nan(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def to_tables(self) -> dict[str, DataFrame]:
        """Write as tables.

        Returns
        -------
        dict of str to DataFrame
            By the names in `TABLES`.
        """
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

    columns = ["recording", "reducer", "measure", "value", "p90", "p95", "worst", "up_to_phase", "grade"]
    return pd.DataFrame([{**asdict(cell), "grade": cell.grade} for cell in cells], columns=columns)


def _say_gains(result: StressResult) -> Iterable[str]:
    """Say where noise is amplified, but for single axes: that these are deaf across themselves is no news."""
    failing = [cell for cell in result.failures if cell.measure == "gain" and cell.reducer not in _SINGLE]
    for scene in dict.fromkeys(cell.recording for cell in failing):
        told = (f"{cell.reducer} ({cell.value:.0f})" for cell in failing if cell.recording == scene)
        yield f"{BATTERY[scene].title}: perturbation gain above {MEASURES['gain'].fails:g} of {', '.join(told)}."


def _say_invariance(result: StressResult) -> Iterable[str]:
    for key, words in (("rotation", "a turn of the sensor"), ("flip", "a flipped axis"), ("shift", "a shift in time")):
        counts = Counter(cell.reducer for cell in result.failures if cell.measure == key)
        unmoved = [name for name in result.reducers if not counts[name]]
        moved = (f"{name} ({counts[name]})" for name in result.reducers if counts[name])
        yield (
            f"Under {words} the output changes by less than {100 * MEASURES[key].fails:.0f} % in every scene with "
            f"{', '.join(unmoved) or 'no reducer'}; scenes of {len(BATTERY)} in which it changes more: "
            f"{', '.join(moved) or 'none'} (median takes)."
        )


def _say_faults(result: StressResult) -> Iterable[str]:
    damages = [cell for cell in result.cells if cell.measure == "fault" and cell.grade != "undefined"]
    worst = max(damages, key=lambda cell: cell.value)
    yield (
        f"Faults of the sensor (clipping, steps, gaps, clocks) come through at most {worst.value:.2g} times as strong "
        f"as they went in ({worst.reducer}, {BATTERY[worst.recording].title})."
    )


_SINGLE = tuple(f"sa{axis}321{form}" for form in ("", "_matched", "_matched_running") for axis in "xyz")


def _say_steady(result: StressResult) -> Iterable[str]:
    """Say which reducers' gain fails nowhere, and how far it goes: in a median take, in 90 and 95 % and at worst."""
    gains = {name: [cell for cell in result.cells if (cell.reducer, cell.measure) == (name, "gain")]
             for name in result.reducers}  # fmt: skip
    takes = result.inputs["seeds"]
    for name, cells in gains.items():
        if name not in _SINGLE and all(cell.grade != "fails" for cell in cells):
            levels = (max(getattr(cell, key) for cell in cells) for key in ("value", "p90", "p95", "worst"))
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
