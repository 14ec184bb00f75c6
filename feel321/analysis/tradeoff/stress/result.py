"""A stress test as data: its answers in words, its tables, and the reason of every failure."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS, SINGLE_AXES, Diagnosis, list_warnings
from feel321.analysis.tradeoff.stress.measures import MEASURES, StressCell
from feel321.records import Result
from feel321.stimuli.match import METRICS, axis_correlations, mean_over_axes
from feel321.stimuli.rotation import INVARIANTS, random_rotations

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.stimuli.recording import Recording
    from feel321.types import Reducer

RANGE_LIMIT = 0.1
"""A temporal match that varies by more with the mounting alone says less than the choice among the paper's reducers."""

EXPLODED = -1.0
"""A spectral match below -1 means that the energy is off by more than three times on average over frequency."""

TURNS = 50
"""Orientations of the sensor that the metrics are compared over."""

MOVED = MappingProxyType({
    "rotation": "Rotating the sensor",
    "flip": "Flipping the sign of an axis",
    "shift": "Shifting the motion in time",
})
"""Measure -> what is done to the recording, which leaves the motion as it is."""


@dataclass(frozen=True, slots=True)
class MetricRow:
    """The paper's two metrics and their counterparts on one recording; NaN where they are not defined.

    held: the reducer whose output is held fixed while the sensor is turned, so that whatever changes is the metric's
    own doing; spectral: the lowest of all reducers, that of worst_reducer.
    """

    recording: str
    held: str
    temporal_low: float
    temporal_high: float
    invariant_low: float
    invariant_high: float
    worst_reducer: str
    spectral: float
    spectral_bounded: float
    spectral_energy_weighted: float

    @property
    def moves(self) -> bool:
        """Whether the temporal match changes with the mounting by more than the limit."""
        return self.temporal_high - self.temporal_low > RANGE_LIMIT

    @property
    def explodes(self) -> bool:
        """Whether a spectral match is below the limit."""
        return self.spectral < EXPLODED


def compare_metrics_under_rotation(
    recording: Recording, reducers: Mapping[str, Reducer], *, rng: np.random.Generator
) -> MetricRow:
    """Turn the sensor under a fixed reduced signal, and find the lowest spectral match."""
    samples, rate_hz = recording.acceleration, recording.rate_hz
    outputs = {name: reduce(samples, rate_hz) for name, reduce in reducers.items()}
    held = "dft321" if "dft321" in reducers else next(iter(reducers))
    turned = np.einsum("rij,jn->rin", random_rotations(TURNS, rng), samples)
    temporal = mean_over_axes(axis_correlations(turned, outputs[held]))
    invariant = [INVARIANTS["temporal_match"](one, outputs[held], rate_hz) for one in turned[:5]]

    def match(metric: Any, name: str) -> float:  # noqa: ANN401 - a metric of any registry
        try:
            return float(metric(samples, outputs[name], rate_hz))
        except ValueError:  # no frequency to compare
            return float("nan")

    matches = {name: match(METRICS["spectral_match"], name) for name in reducers}
    defined = {name: value for name, value in matches.items() if np.isfinite(value)}
    worst = min(defined, key=defined.__getitem__, default="")
    further = METRICS["spectral_match_bounded"], INVARIANTS["spectral_match"]
    return MetricRow(
        recording.name, held,
        float(temporal.min()), float(temporal.max()), min(invariant), max(invariant),
        worst, defined.get(worst, float("nan")),
        *(match(metric, worst) if worst else float("nan") for metric in further),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class StressResult(Result):
    """Everything that a stress test measures."""

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
            *_describe_gains(self),
            *_describe_steady(self),
            *_describe_invariance(self),
            *_describe_faults(self),
            *describe_metrics(self.metrics),
        )

    def to_frames(self) -> dict[str, DataFrame]:
        """Return everything that was measured as tables.

        Returns
        -------
        dict of str to DataFrame
            `cells`: reducer x scene x measure; `metrics`: the metrics on each scene and recording; `recordings`: the
            signs of each recording; `gains`: perturbation gain on each recording.
        """
        import pandas as pd

        names = ("recording", "reducer", "measure", "value", "p90", "p95", "worst", "up_to_phase")
        cells, gains = (
            pd.DataFrame(map(_to_row, own), columns=[*names, "grade"])
            for own in (self.cells, self.gains)
        )
        signs = [{"recording": one.recording, **one.figures} for one in self.diagnoses]
        return {
            "cells": cells,
            "metrics": pd.DataFrame(map(asdict, self.metrics)),
            "recordings": pd.DataFrame(signs, columns=["recording", *SIGNS]),
            "gains": gains,
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


def build_content(result: StressResult) -> dict[str, object]:
    """Build what ``results.json`` holds."""
    return {
        "answers": result.answers,
        "warnings": result.warnings,
        "measures": [asdict(measure) for measure in MEASURES.values()],
        "scenes": {
            name: {"title": scene.title, "reason": scene.reason} for name, scene in BATTERY.items()
        },
        "cells": [_to_row(cell) for cell in result.cells],
        "gains": [_to_row(cell) for cell in result.gains],
        "metrics": [asdict(row) for row in result.metrics],
        "recordings": [
            {"name": one.recording, "figures": dict(one.figures), "near": one.near_scenes}
            for one in result.diagnoses
        ],
        "notes": result.notes,
        "inputs": dict(result.inputs),
    }


def _to_row(cell: StressCell) -> dict[str, object]:
    return {**asdict(cell), "grade": cell.grade}


def _describe_gains(result: StressResult) -> Iterator[str]:
    """Name the scenes on which noise is amplified; single axes are left out, they ignore motion across themselves."""
    failing = [
        cell
        for cell in result.failures
        if cell.measure == "gain" and cell.reducer not in SINGLE_AXES
    ]
    for scene in dict.fromkeys(cell.recording for cell in failing):
        own = (f"{cell.reducer} ({cell.value:.0f})" for cell in failing if cell.recording == scene)
        limit = f"{MEASURES['gain'].fails:g}"
        yield f"{BATTERY[scene].title}: perturbation gain above {limit} for {', '.join(own)}."


def _describe_steady(result: StressResult) -> Iterator[str]:
    """Name the reducers whose gain fails nowhere, and how far it goes: in the median take, in 90 and 95 %, at worst."""
    for name in result.reducers:
        own = [cell for cell in result.cells if (cell.reducer, cell.measure) == (name, "gain")]
        if name not in SINGLE_AXES and all(cell.grade != "fails" for cell in own):
            median, p90, p95, worst = (
                f"{max(getattr(cell, key) for cell in own):.1f}"
                for key in ("value", "p90", "p95", "worst")
            )
            yield (
                f"{name}: perturbation gain at most {median} in the median take of any scene, {p90} in 90 % of the "
                f"takes, {p95} in 95 % and {worst} in the worst of {result.inputs['seeds']}."
            )


def count_failures(result: StressResult, measure: str) -> dict[str, int]:
    """Count the scenes on which each reducer fails by a measure."""
    counts = Counter(cell.reducer for cell in result.failures if cell.measure == measure)
    return {name: counts[name] for name in result.reducers}


def _describe_invariance(result: StressResult) -> Iterator[str]:
    for key, what in MOVED.items():
        steady = [name for name, count in count_failures(result, key).items() if not count]
        limit = f"{100 * MEASURES[key].fails:.0f} %"
        yield (
            f"{what} changes the output by less than {limit} in every scene for {', '.join(steady) or 'no reducer'} "
            "(median takes)."
        )


def _describe_faults(result: StressResult) -> Iterator[str]:
    damages = [
        cell for cell in result.cells if cell.measure == "fault" and cell.grade != "undefined"
    ]
    worst = max(damages, key=lambda cell: cell.value)
    yield (
        "Sensor faults (clipping, steps, gaps, clocks) come out at most "
        f"{worst.value:.2g} times as strong as they go in ({worst.reducer}, {BATTERY[worst.recording].title})."
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
        yield (
            f"Spectral match falls below {EXPLODED:g} in {len(exploding)} of {len(rows)}, lowest on {worst.recording} "
            f"({worst.worst_reducer}: {worst.spectral:.3g}); the bounded one stays between 0 and 1 "
            f"({worst.spectral_bounded:.2f} there)."
        )


_AXES, _GAINED = SINGLE_AXES[:3], SINGLE_AXES[3:]
_PCA, _DFT = ("pca321", "pca321_adaptive"), ("dft321", "dft321_windowed")
_PCA_MATCHED = ("pca321_matched", "pca321_matched_windowed")
_DFT_PRINCIPAL = ("dft321_principal", "dft321_principal_windowed")
_FRAMES = ("dft321_windowed", "dft321_principal_windowed")
_REASONS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "gain": {
        "it keeps one sensor axis; where that is (nearly) silent, the output is nothing but noise.": SINGLE_AXES,
        "the sum cancels; what is left of it is noise.": ("soc321",),
        "no direction leads, so the noise of the moment determines the axis, and with it a different motion.":
            (*_PCA, *_PCA_MATCHED),
        "the phase is that of x + y + z; where the axes cancel, noise sets it.": _DFT,
        "the phase is that along the leading axis; where none leads, or little moves along it, noise sets it.":
            _DFT_PRINCIPAL,
        "the output depends on something that noise determines.": (),
    },
    "rotation": {
        "what it keeps depends on where the sensor's own axes point.": SINGLE_AXES,
        "x + y + z is the projection on the sensor's diagonal, whose direction is the mounting's.": ("soc321",),
        "equal eigenvalues: rounding chooses among equally good axes.": ("pca321", "pca321_matched"),
        "the spectrum stays, but the phase of x + y + z follows the sensor's diagonal.": _DFT,
        "the output depends on the sensor's axes.": (),
    },
    "flip": {
        "another sign of one axis is another sum: what added up now cancels.": ("soc321", *_DFT),
        "the output depends on the signs of the sensor's axes.": (),
    },
    "shift": {
        "equal eigenvalues: rounding chooses among equally good axes.": ("pca321",),
        "frames cut the motion elsewhere, and each frame chooses anew.": ("pca321_adaptive", *_FRAMES),
        "where none leads the axis depends on what came first, and is held there.": ("pca321_matched_windowed",),
        "the output depends on where frames begin.": (),
    },
    "edge": {
        "rectifying turns an offset and a vibration into another envelope.": ("mag321",),
        "frames cut slow motion into steps; these leak into all frames.": _FRAMES,
        "the envelope of what it keeps is not that of the motion.": (),
    },
    "energy": {
        "it keeps one direction and drops the energy of the two others.": (*_AXES, *_PCA),
        "axes in phase add up to too much, axes in anti-phase cancel.": ("soc321",),
        "the length of the vector is mostly offset, which is not felt; its ripple is what remains.": ("mag321",),
        "within a frame slow motion is an offset, whose axes are merged like a vibration's.": _FRAMES,
        "the gain is at most 10: an axis with less than a hundredth of the energy stays weak.": _GAINED,
        "it does not keep the energy of all axes.": (),
    },
    "fault": {
        "the fault changes the phase of x + y + z at frequencies whose energy it spares.": _DFT,
        "it turns a fault of some samples into another output elsewhere too.": (),
    },
    "spread": {
        "the metrics of what it keeps change with the mounting; the paper's temporal match does so by itself.": (),
    },
})  # fmt: skip
"""Measure -> reason -> the reducers that fail for it; the last one is the reason of all others."""


def find_reason(measure: str, reducer: str) -> str:
    """Find why a reducer fails by a measure."""
    reasons = _REASONS[measure]
    return next((why for why, names in reasons.items() if reducer in names), [*reasons][-1])
