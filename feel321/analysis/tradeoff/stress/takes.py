"""The battery over many seeds: every figure is a distribution over takes of its scene, not the chance of one.

All takes of a scene go through a reducer together, as one batch, and every take has its own noise, orientations and
shift. The figures are those of `measures` and `mounting`, which say what they mean; tests hold both to agree.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.cells import Cell
from feel321.analysis.tradeoff.stress.measures import FLIPS, LARGEST_DB, MEASURES, relative_change
from feel321.stimuli.match import OriginalSpectrum, axis_correlations, mean_heard
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.rotation import random_rotations

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from feel321.stimuli.reducers.registry import Reducer

    Samples = NDArray[np.float64]

TURNS = 4
"""Orientations of every take."""

NOISE = 1e-3
"""Sensor noise against the recording, in amplitude: -60 dB."""

QUANTILES = (0.5, 0.9, 0.95, 1.0)


class Takes(NamedTuple):
    """Takes of one scene, and what is done to them; the same for all reducers.

    samples, clean: (n_takes, 3, n_samples); noise: (n_takes, 3, n_samples); turns: (n_takes, TURNS,
    3, 3); shifts: (n_takes,), delays in samples, up to one window.
    """

    name: str
    rate_hz: float
    samples: Samples
    clean: Samples
    noise: Samples
    turns: Samples
    shifts: NDArray[np.int64]
    spectra: list[OriginalSpectrum]


def measure_battery(
    reducers: Mapping[str, Reducer],
    *,
    seeds: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Cell, ...]:
    """Measure every reducer on every scene of the battery.

    reducers: name -> reducer; seeds: takes of every scene, at least 2.
    """
    if seeds < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"seeds: got {seeds}, allowed is 2 or more")
    cells: list[Cell] = []
    for scene in BATTERY:
        takes = make_takes(scene, seeds=seeds, seed=seed)
        for name, reduce in reducers.items():
            cells += _summarise(scene, name, measure_takes(reduce, takes))
            if progress is not None:
                progress(len(cells) // len(MEASURES), len(BATTERY) * len(reducers))
    return tuple(cells)


def make_takes(scene: str, *, seeds: int, seed: int) -> Takes:
    """Make takes of a scene."""
    entry, numbers = BATTERY[scene], [1000 * seed + number for number in range(seeds)]
    recordings = [entry.make(number) for number in numbers]
    samples = np.array([recording.acceleration for recording in recordings])
    rng = np.random.default_rng([seed, *scene.encode()])
    noise = rng.standard_normal(samples.shape)
    noise *= (
        NOISE
        * np.linalg.norm(samples, axis=(1, 2), keepdims=True)
        / np.linalg.norm(noise, axis=(1, 2), keepdims=True)
    )
    rate_hz = recordings[0].rate_hz
    return Takes(
        scene,
        rate_hz,
        samples,
        np.array([entry.make_clean(number).acceleration for number in numbers]),
        noise,
        random_rotations(seeds * TURNS, rng).reshape(seeds, TURNS, 3, 3),
        rng.integers(1, window_samples(DEFAULT_WINDOW_S, rate_hz), size=seeds, endpoint=True),
        [OriginalSpectrum(recording.acceleration, rate_hz) for recording in recordings],
    )


def measure_takes(reduce: Reducer, takes: Takes) -> dict[str, Samples]:
    """Measure one reducer on takes of a scene.

    Returns (n_takes,).
    """
    samples, rate_hz = takes.samples, takes.rate_hz
    output = reduce(samples, rate_hz)
    noisy = reduce(samples + takes.noise, rate_hz)
    turned = np.einsum("trij,tjn->trin", takes.turns, samples)
    outputs = reduce(turned, rate_hz)
    flipped = reduce(FLIPS[:, None, :, None] * samples, rate_hz)
    return {
        "gain": relative_change(noisy, output) / NOISE,
        "rotation": np.median(relative_change(outputs, output[:, None]), axis=-1),
        "flip": relative_change(flipped, output).max(axis=0),
        "shift": _shift(reduce, takes),
        "edge": _find_edge_errors(samples, output, rate_hz),
        "energy": _find_energy_errors(samples, output),
        "spread": np.array([
            _find_spread(*each) for each in zip(takes.spectra, turned, outputs, strict=True)
        ]),
        "fault": _find_damage(reduce, takes, output),
        "phase": relative_change(noisy, output, free="phase") / NOISE,
    }


def _shift(reduce: Reducer, takes: Takes) -> Samples:
    silence = np.zeros((*takes.samples.shape[:2], window_samples(DEFAULT_WINDOW_S, takes.rate_hz)))
    embedded = np.concatenate([takes.samples, silence], axis=-1)
    later = np.array([
        np.roll(one, shift, axis=-1) for one, shift in zip(embedded, takes.shifts, strict=True)
    ])
    outputs = zip(reduce(later, takes.rate_hz), takes.shifts, strict=True)
    back = np.array([np.roll(output, -shift) for output, shift in outputs])
    return relative_change(back, reduce(embedded, takes.rate_hz))


def _find_edge_errors(samples: Samples, output: Samples, rate_hz: float) -> Samples:
    starts = np.arange(0, samples.shape[-1], window_samples(DEFAULT_WINDOW_S, rate_hz) // 2)
    shares = []
    for signals in (samples, output[:, None]):
        about_mean = signals - signals.mean(axis=-1, keepdims=True)
        energy = np.add.reduceat(np.square(about_mean).sum(axis=1), starts, axis=-1)
        total = energy.sum(axis=-1, keepdims=True)
        shares.append(np.divide(energy, total, out=np.zeros_like(energy), where=total > 0))
    recorded, kept = shares
    return np.where(kept.any(axis=-1), np.abs(recorded - kept).sum(axis=-1) / 2, 1.0)


def _find_energy_errors(samples: Samples, output: Samples) -> Samples:
    with np.errstate(divide="ignore"):
        errors = 10 * np.log10(output.var(axis=-1) / samples.var(axis=-1).sum(axis=-1))
    return np.asarray(np.clip(errors, -LARGEST_DB, LARGEST_DB))


def _find_spread(original: OriginalSpectrum, turned: Samples, outputs: Samples) -> float:
    """Give the standard deviation over orientations of the match metric that varies more."""
    spectral = float(np.std(original.match(outputs), ddof=1)) if len(original.smoothed) else 0.0
    return max(spectral, float(np.std(mean_heard(axis_correlations(turned, outputs)), ddof=1)))


def _find_damage(reduce: Reducer, takes: Takes, output: Samples) -> Samples:
    if not BATTERY[takes.name].fault:
        return np.full(len(output), np.nan)
    apart = np.linalg.norm(takes.samples - takes.clean, axis=(1, 2)) / np.linalg.norm(
        takes.clean, axis=(1, 2)
    )
    return np.asarray(relative_change(output, reduce(takes.clean, takes.rate_hz)) / apart)


def _summarise(scene: str, reducer: str, found: Mapping[str, Samples]) -> list[Cell]:
    """Median and upper quantiles over takes; an energy error keeps the sign that is the worst."""
    cells = []
    for key in MEASURES:
        sizes = np.abs(found[key])
        median, *upper = np.quantile(sizes, QUANTILES).tolist()
        sign = -1.0 if np.median(found[key]) < 0 else 1.0
        failing = key == "gain" and MEASURES[key].grade(median) == "fails"
        phase = float(np.median(found["phase"])) if failing else math.nan
        cells.append(Cell(scene, reducer, key, sign * median, upper[-1], phase, *upper[:2]))
    return cells
