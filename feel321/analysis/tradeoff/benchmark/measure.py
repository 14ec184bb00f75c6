"""What a card says of a method: accuracy, stability, look-ahead and cost, each by the measures of chart and stress.

*Look-ahead* is measured, not believed: from some sample on a signal is replaced by another one, and how much earlier
the output changes is how far the method looks ahead. A method whose output changes from the beginning, wherever the
signal does, needs the whole recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.benchmark.battery import NOISES, QUIET, SEGMENT_S
from feel321.analysis.tradeoff.chart.accuracy import Scorer
from feel321.analysis.tradeoff.chart.points import MEASURES as ACCURACIES
from feel321.analysis.tradeoff.stress.battery import N_SAMPLES, RATE_HZ, make_texture, whiten
from feel321.analysis.tradeoff.stress.measures import MEASURES, measure_takes, perturbation_gain
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING, StreamingReducer
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.analysis.tradeoff.benchmark.battery import Battery
    from feel321.stimuli.recording import Recording

    Row = dict[str, Any]

DIGITS = 6
"""Significant digits of a card's numbers."""

NOTHING = 1e-9
"""Below it lie rounding errors, which are others on another processor."""

CHANGES = 16
"""Places at which a signal is replaced by another one, spread unevenly over frames."""

DIFFERENT = 1e-6
"""Share of an output's peak from which on two outputs differ."""

FROM_START = 0.1
"""A method whose output changes within this share of the signal, wherever the signal changes, needs all of it."""


@dataclass(frozen=True, slots=True)
class Entrant:
    """A method under its short name: the function, what it declares of itself and the digest of its code."""

    name: str
    reduce: Reducer
    sha256: str | None
    latency_s: float | None = None
    operations: float | None = None
    state: float | None = None

    @property
    def declared(self) -> Row:
        """What stands in its card."""
        facts = {"operations": self.operations, "state": self.state, "latency_s": self.latency_s}
        return {"name": self.name, "sha256": self.sha256, **{k: trim(v) for k, v in facts.items()}}


def trim(value: float | None) -> float | None:
    """Round to what a card shows; None where there is no number, 0 where there is nothing but rounding errors."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{DIGITS - 1}e}") if abs(value) > NOTHING else 0.0


def find_latency(name: str, rate_hz: float) -> float | None:
    """Find the delay of a streaming form, in s; None where there is none."""
    if name in WHY_NOT_STREAMING:
        return None
    return StreamingReducer(name, rate_hz).latency_samples / rate_hz


def measure_recordings(
    method: Entrant, recordings: Sequence[Recording], turns: Samples
) -> list[Row]:
    """Measure a method on recordings, in every mounting: a row per recording."""
    return [_measure_recording(method, one, turns) for one in recordings]


def _measure_recording(method: Entrant, recording: Recording, turns: Samples) -> Row:
    samples, rate = recording.acceleration, recording.rate_hz
    turned = turns @ samples
    outputs = [method.reduce(one, rate) for one in (samples, *turned)]
    scorer = Scorer(recording)
    scores = np.array([scorer.score(*pair) for pair in zip(turned, outputs[1:], strict=True)])
    values = {
        "mean": scores.mean(axis=0), "lowest": scores.min(axis=0), "sd": scores.std(axis=0, ddof=1),
        "segment": list(_score_segments(recording, outputs[0])),
    }  # fmt: skip
    own = [*b"benchmark", *recording.name.encode()]
    rng = np.random.default_rng(own)
    gain = perturbation_gain(method.reduce, recording, rng=rng, draws=NOISES)
    row: Row = {"recording": recording.name, "gain": trim(gain.median)}
    for place, measure in enumerate(ACCURACIES):
        row[measure] = {key: trim(float(found[place])) for key, found in values.items()}
    return row


def _score_segments(recording: Recording, output: Samples) -> Iterator[float]:
    """Score segments of the output of a whole recording, as mounted: the median over segments, measure by measure."""
    length = round(SEGMENT_S * recording.rate_hz)
    starts = range(0, recording.n_samples - length + 1, length)
    parts = [slice(start, start + length) for start in starts]
    energies = [float(np.square(recording.acceleration[:, part]).sum()) for part in parts]
    scores = []
    for part, energy in zip(parts, energies, strict=True):
        if energy >= QUIET * max(energies):
            piece = type(recording)(recording.acceleration[:, part], recording.rate_hz)
            scores.append(Scorer(piece).score(piece.acceleration, output[part]))
    yield from np.median(scores, axis=0).tolist()


def measure_stress(method: Entrant, battery: Battery) -> list[Row]:
    """Measure a method on the stress test's scenes: a row per scene, with the median over its takes."""
    rows = []
    for scene, takes in battery.takes.items():
        found = measure_takes(method.reduce, takes)
        medians = {key: float(np.median(found[key])) for key in MEASURES}
        fails = [key for key, value in medians.items() if MEASURES[key].grade(value) == "fails"]
        rows.append({"scene": scene, **{k: trim(v) for k, v in medians.items()}, "fails": fails})
    return rows


def measure_look_ahead(reduce: Reducer) -> float | None:
    """Measure how far a method looks ahead, in s; None where it needs the whole recording."""
    rng = np.random.default_rng([*b"look-ahead"])
    first, second = (4 * whiten(make_texture(rng, 3)) for _ in range(2))
    before = reduce(first, RATE_HZ)
    ahead, begins = [], []
    for place in np.linspace(0.3 * N_SAMPLES, 0.9 * N_SAMPLES, CHANGES).astype(int):
        changed = np.concatenate([first[:, :place], second[:, place:]], axis=1)
        differs = np.abs(reduce(changed, RATE_HZ) - before) > DIFFERENT * np.abs(before).max()
        begin = int(np.argmax(differs)) if differs.any() else int(place)
        begins.append(begin)
        ahead.append(max(int(place) - begin, 0))
    return None if max(begins) < FROM_START * N_SAMPLES else max(ahead) / RATE_HZ


def summarise_recordings(rows: Sequence[Row]) -> Row | None:
    """Summarise rows of recordings: medians over recordings, the lowest over mountings and recordings."""
    if not rows:
        return None
    accuracy = {}
    for measure in ACCURACIES:
        columns = {key: [row[measure][key] for row in rows] for key in rows[0][measure]}
        accuracy[measure] = {
            "median": _median(columns["mean"]), "lowest": trim(_lowest(columns["lowest"])),
            "mounting_sd": _median(columns["sd"]), "segments": _median(columns["segment"]),
        }  # fmt: skip
    gains = [row["gain"] for row in rows]
    return {"accuracy": accuracy, "gain": {"median": _median(gains), "worst": trim(max(gains))}}


def summarise_stress(rows: Sequence[Row]) -> Row:
    """Summarise rows of stress scenes: median and worst over scenes, and the scenes in which a method fails."""
    summary: Row = {}
    for measure in MEASURES:
        known = [(abs(row[measure]), row["scene"]) for row in rows if row[measure] is not None]
        worst, scene = max(known, default=(None, None), key=lambda one: one[0])
        summary[measure] = {
            "median": _median([value for value, _ in known]), "worst": worst, "scene": scene,
        }  # fmt: skip
    return {
        **summary,
        "failed_scenes": sum(bool(row["fails"]) for row in rows),
        "scenes": len(rows),
    }


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return trim(float(np.median(known))) if known else None


def _lowest(values: Sequence[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def check_repeats(method: Entrant, recording: Recording) -> None:
    """Refuse a method that changes its input, or whose output is another one the second time."""
    given = recording.acceleration.copy()
    once, again = (method.reduce(given, recording.rate_hz) for _ in range(2))
    if not np.array_equal(given, recording.acceleration):
        raise ValueError("it changes its input; let it work on a copy")
    if not np.array_equal(once, again):
        raise ValueError(
            f"two runs on the same signal differ by up to {np.abs(once - again).max():.3g}, and a card must come out "
            "the same again; fix the seed of what is random in it"
        )
