"""Run reducers through recordings: one figure per reducer, recording and measure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.stress.change import Change
from analysis.tradeoff.stress.limits import MEASURES
from analysis.tradeoff.stress.measures import edge_error, energy_error, fault_gain, perturbation_gain, shift_change
from analysis.tradeoff.stress.mounting import flip_change, metric_spread, rotation_change

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from analysis.tradeoff.stress.limits import Grade
    from stimuli.recording import Recording
    from stimuli.reduce import Reducer

    Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Cell:
    """One figure.

    Parameters
    ----------
    recording, reducer, measure : str
        Of what; a recording may be a scene of the battery.
    value : float
        The median over takes of a scene or draws of noise, or the figure itself where nothing is drawn; NaN where it is
        not defined.
    worst : float
        The worst of them.
    up_to_phase : float
        For a failing gain: the median gain if a constant phase does not count either; NaN elsewhere.
    p90, p95 : float
        Nine and nineteen of twenty are not worse; NaN where too few were drawn to say so.
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

    Parameters
    ----------
    recordings : sequence of Recording
        Scenes or real recordings; each figure depends on its own recording alone, not on the others.
    reducers : Mapping of str to Reducer
        Name -> reducer.
    measures : sequence of str
        Names of `MEASURES`.
    clean : Mapping of str to Recording
        Recordings without their faults, by name; the damage is not defined for others.
    draws : int
        Noises, orientations and shifts per figure, at least 2.
    seed : int
        Of all randomness; all reducers meet the same draws.
    progress : callable, optional
        Called with the numbers of pairs of recording and reducer done and to do.

    Returns
    -------
    tuple of Cell
        In the order of recordings, reducers, measures.

    Raises
    ------
    ValueError
        If a measure is unknown, a recording is silent, or there are fewer than 2 draws.
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
            phase = _measure_phase(reduce, recording, draws=draws, seed=seed) if failing else math.nan
            cells.append(Cell(recording.name, name, key, figure.median, figure.worst, phase, figure.p90))
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
    """Look a figure up.

    Parameters
    ----------
    cells : sequence of Cell
        Figures.
    recording, reducer, measure : str
        Of what.

    Returns
    -------
    Cell
        The figure.

    Raises
    ------
    ValueError
        If there is none.
    """
    wanted = (recording, reducer, measure)
    for cell in cells:
        if (cell.recording, cell.reducer, cell.measure) == wanted:
            return cell
    raise ValueError(f"cells: got {' / '.join(wanted)}, which was not measured")
