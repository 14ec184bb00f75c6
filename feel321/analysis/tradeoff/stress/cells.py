"""Every reducer and metric measured in every scene of the battery.

The reduced signal is held fixed and only the sensor is turned, so that whatever changes is the metric's own doing: what
is felt stays the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.stress.measures import (
    MEASURES,
    Change,
    edge_error,
    energy_error,
    fault_gain,
    flip_change,
    metric_spread,
    perturbation_gain,
    rotation_change,
    shift_change,
)
from feel321.stimuli.match import METRICS, axis_correlations, mean_heard
from feel321.stimuli.rotation import INVARIANTS, random_rotations

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from feel321.analysis.tradeoff.stress.measures import Grade
    from feel321.stimuli.match import Metric
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.reducers.registry import Reducer

    Progress = Callable[[int, int], None]

# Run reducers through recordings: one figure per reducer, recording and measure.


@dataclass(frozen=True, slots=True)
class Cell:
    """One figure.

    value: naN where it is not defined; up_to_phase: naN elsewhere; p90, p95: naN where too few were
    drawn to say so.
    """

    recording: str
    reducer: str
    measure: str
    value: float
    worst: float
    up_to_phase: float = math.nan
    p90: float = math.nan
    p95: float = math.nan

    @property
    def grade(self) -> Grade:
        """How the figure is judged: by the median, and a caution where one take in ten fails."""
        measure = MEASURES[self.measure]
        grade = measure.grade(self.value)
        return "caution" if grade == "good" and measure.grade(self.p90) == "fails" else grade


def measure_cells(  # noqa: PLR0913 - every choice that changes the figures has a name of its own
    recordings: Sequence[Recording],
    reducers: Mapping[str, Reducer],
    *,
    measures: Sequence[str] = tuple(MEASURES),
    clean: Mapping[str, Recording] = MappingProxyType({}),
    draws: int = 16,
    seed: int,
    progress: Progress | None = None,
) -> tuple[Cell, ...]:
    """Measure every reducer on every recording.

    reducers: name -> reducer; draws: noises, orientations and shifts per figure, at least 2.
    """
    if unknown := [name for name in measures if name not in MEASURES]:
        raise ValueError(f"measures: got {unknown[0]!r}, allowed are {', '.join(MEASURES)}")
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"draws: got {draws}, allowed is 2 or more")
    cells: list[Cell] = []
    pairs = list(product(recordings, reducers.items()))
    for number, (recording, (name, reduce)) in enumerate(pairs, start=1):
        measure = partial(_measure, reduce, recording, draws=draws, seed=seed)
        damage = _measure_fault(reduce, recording, clean.get(recording.name))
        figures = {key: damage if key == "fault" else measure(key) for key in measures}
        for key, figure in figures.items():
            failing = key == "gain" and MEASURES[key].grade(figure.median) == "fails"
            phase = (
                _measure_phase(reduce, recording, draws=draws, seed=seed) if failing else math.nan
            )
            cells.append(
                Cell(recording.name, name, key, figure.median, figure.worst, phase, figure.p90)
            )
        if progress is not None:
            progress(number, len(pairs))
    return tuple(cells)


def _measure(reduce: Reducer, recording: Recording, key: str, *, draws: int, seed: int) -> Change:
    rng = np.random.default_rng([seed, *recording.name.encode(), *key.encode()])
    match key:
        case "gain":
            return perturbation_gain(reduce, recording, rng=rng, draws=draws)
        case "rotation":
            return rotation_change(reduce, recording, rng=rng, draws=draws)
        case "flip":  # of axis flips there are three only, so the worst of them
            worst = flip_change(reduce, recording).worst
            return Change(worst, worst)
        case "shift":
            return shift_change(reduce, recording, rng=rng, draws=draws)
        case "spread":
            larger = float(np.nanmax(metric_spread(reduce, recording, rng=rng, draws=draws)))
            return Change(larger, larger)
    single = (edge_error if key == "edge" else energy_error)(reduce, recording)
    return Change(single, single)


def _measure_fault(reduce: Reducer, recording: Recording, clean: Recording | None) -> Change:
    damage = math.nan if clean is None else fault_gain(reduce, recording, clean=clean)
    return Change(damage, damage)


def _measure_phase(reduce: Reducer, recording: Recording, *, draws: int, seed: int) -> float:
    """Median gain if a constant phase does not count either."""
    rng = np.random.default_rng([seed, *recording.name.encode()])
    return perturbation_gain(reduce, recording, rng=rng, draws=draws, free="phase").median


def find_cell(cells: Sequence[Cell], recording: str, reducer: str, *, measure: str) -> Cell:
    """Look a figure up."""
    wanted = (recording, reducer, measure)
    for cell in cells:
        if (cell.recording, cell.reducer, cell.measure) == wanted:
            return cell
    raise ValueError(f"cells: got {' / '.join(wanted)}, which was not measured")


# Metrics fail too: where the paper's two change with the mounting or explode, beside counterparts that do not.

RANGE_LIMIT = 0.1
"""A temporal match that moves by more with the mounting alone says less than the choice among the paper's methods."""

EXPLODED = -1.0
"""A spectral match below -1 says that the energy is off by more than three times on average over frequency."""


@dataclass(frozen=True, slots=True)
class MetricRow:
    """Both metrics and their counterparts on one recording.

    spectral: naN where none is defined.
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
    recording: Recording,
    reducers: Mapping[str, Reducer],
    *,
    held: str = "dft321",
    draws: int = 50,
    rng: np.random.Generator,
) -> MetricRow:
    """Turn the sensor under a fixed reduced signal, and find the lowest spectral match.

    reducers: name -> reducer.
    """
    samples, rate_hz = recording.acceleration, recording.rate_hz
    chosen = held if held in reducers else next(iter(reducers))
    reduced = reducers[chosen](samples, rate_hz)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    temporal = mean_heard(axis_correlations(turned, reduced))
    invariant = [INVARIANTS["temporal_match"](one, reduced, rate_hz) for one in turned[:5]]
    worst, spectral = _find_lowest(recording, reducers)
    metrics = METRICS["spectral_match_bounded"], INVARIANTS["spectral_match"]
    bounded, weighted = (
        _match(metric, recording, reducers[worst]) if worst else np.nan for metric in metrics
    )
    return MetricRow(
        recording.name,
        chosen,
        float(temporal.min()),
        float(temporal.max()),
        min(invariant),
        max(invariant),
        worst,
        spectral,
        bounded,
        weighted,
    )


def _find_lowest(recording: Recording, reducers: Mapping[str, Reducer]) -> tuple[str, float]:
    """Name of the reducer with the lowest spectral match, and that; nothing where it is not defined."""
    matches = {
        name: _match(METRICS["spectral_match"], recording, reduce)
        for name, reduce in reducers.items()
    }
    defined = {name: match for name, match in matches.items() if np.isfinite(match)}
    if not defined:
        return "", float("nan")
    worst = min(defined, key=defined.__getitem__)
    return worst, defined[worst]


def _match(metric: Metric, recording: Recording, reduce: Reducer) -> float:
    """Match, or NaN where the recording has no frequency to compare."""
    try:
        return metric(
            recording.acceleration,
            reduce(recording.acceleration, recording.rate_hz),
            recording.rate_hz,
        )
    except ValueError:
        return float("nan")


def say_metrics(rows: Sequence[MetricRow]) -> tuple[str, ...]:
    """Say where the paper's metrics fail."""
    moving = [row for row in rows if row.moves]
    exploding = [row for row in rows if row.explodes]
    lines = [
        f"Temporal match moves by more than {RANGE_LIMIT:g} with the mounting alone in {len(moving)} of {len(rows)} "
        "scenes and recordings, though what is felt is the same; its counterpart does not move."
    ]
    if exploding:
        worst = min(exploding, key=lambda row: row.spectral)
        lines.append(
            f"Spectral match falls below {EXPLODED:g} in {len(exploding)} of {len(rows)}, lowest on {worst.recording} "
            f"({worst.worst_reducer}: {worst.spectral:.3g}); the bounded one stays between 0 and 1 "
            f"({worst.spectral_bounded:.2f} there)."
        )
    return tuple(lines)
