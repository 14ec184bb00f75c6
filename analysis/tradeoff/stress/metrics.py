"""Metrics fail too: where the paper's two change with the mounting or explode, beside counterparts that do not.

The reduced signal is held fixed and only the sensor is turned, so that whatever changes is the metric's own doing: what
is felt stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.invariant import INVARIANTS
from stimuli.match import METRICS, axis_correlations, mean_heard
from stimuli.rotation import random_rotations

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from stimuli.match import Metric
    from stimuli.recording import Recording
    from stimuli.reduce import Reducer

RANGE_LIMIT = 0.1
"""A temporal match that moves by more with the mounting alone says less than the choice among the paper's methods."""

EXPLODED = -1.0
"""A spectral match below -1 says that the energy is off by more than three times on average over frequency."""


@dataclass(frozen=True, slots=True)
class MetricRow:
    """Both metrics and their counterparts on one recording.

    Parameters
    ----------
    recording : str
        Its name.
    held : str
        The reducer whose output is held fixed while the sensor is turned.
    temporal_low, temporal_high : float
        Lowest and highest temporal match (paper, eq. 2) over the mountings.
    invariant_low, invariant_high : float
        The same of its rotation-invariant counterpart.
    worst_reducer : str
        The one with the lowest spectral match (paper, eq. 1); empty where none is defined.
    spectral : float
        That match; NaN where none is defined.
    spectral_bounded, spectral_energy_weighted : float
        Bounded spectral matches of the same reducer.
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

    Parameters
    ----------
    recording : Recording
        The recording.
    reducers : Mapping of str to Reducer
        Name -> reducer.
    held : str
        The reducer whose output is held fixed; another is taken where `reducers` has it not.
    draws : int
        Orientations of the sensor, uniform over all rotations.
    rng : numpy.random.Generator
        Source of the orientations.

    Returns
    -------
    MetricRow
        The paper's metrics and their counterparts.
    """
    samples, rate_hz = recording.acceleration, recording.rate_hz
    chosen = held if held in reducers else next(iter(reducers))
    reduced = reducers[chosen](samples, rate_hz)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    temporal = mean_heard(axis_correlations(turned, reduced))
    invariant = [INVARIANTS["temporal_match"](one, reduced, rate_hz) for one in turned[:5]]
    worst, spectral = _find_lowest(recording, reducers)
    metrics = METRICS["spectral_match_bounded"], INVARIANTS["spectral_match"]
    bounded, weighted = (_match(metric, recording, reducers[worst]) if worst else np.nan for metric in metrics)
    return MetricRow(
        recording.name, chosen, float(temporal.min()), float(temporal.max()), min(invariant), max(invariant),
        worst, spectral, bounded, weighted,
    )  # fmt: skip


def _find_lowest(recording: Recording, reducers: Mapping[str, Reducer]) -> tuple[str, float]:
    """Name of the reducer with the lowest spectral match, and that; nothing where it is not defined."""
    matches = {name: _match(METRICS["spectral_match"], recording, reduce) for name, reduce in reducers.items()}
    defined = {name: match for name, match in matches.items() if np.isfinite(match)}
    if not defined:
        return "", float("nan")
    worst = min(defined, key=defined.__getitem__)
    return worst, defined[worst]


def _match(metric: Metric, recording: Recording, reduce: Reducer) -> float:
    """Match, or NaN where the recording has no frequency to compare."""
    try:
        return metric(recording.acceleration, reduce(recording.acceleration, recording.rate_hz), recording.rate_hz)
    except ValueError:
        return float("nan")


def say_metrics(rows: Sequence[MetricRow]) -> tuple[str, ...]:
    """Say where the paper's metrics fail.

    Parameters
    ----------
    rows : sequence of MetricRow
        One per recording.

    Returns
    -------
    tuple of str
        Sentences.
    """
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
