"""Measures of stability, their limits, and every reducer measured on every scene of the battery.

The *relative change* from an output r to another r' ignores the sign, because the skin does not feel the sign of a
vibration:

    δ(r', r) = min(‖r' - r‖, ‖r' + r‖) / ‖r‖, at most sqrt(2)

with ‖·‖ the root of the energy. sqrt(2) separates two unrelated signals of equal energy: more is not less stable. An
output that is silent and stays silent has changed by 0, one that is silent and becomes anything by sqrt(2).

Every limit is argued from one number, in `why`: the paper's Weber fraction of vibration, 22 %, taken of the amplitude
(1.7 dB). A caution is about half way to a failure.

Each scene is made many times (*takes*), so that every number is a distribution and not the accident of one seed. All
takes go through a reducer as one batch, each with its own noise, orientations and shift.

References
----------
.. [1] N. Landin et al., EuroHaptics 2010, section 3 (22 % Weber fraction) and Table 1.
   doi:10.1007/978-3-642-14075-4_12
.. [2] J. R. Rice, "A theory of condition", SIAM Journal on Numerical Analysis 3(2), 1966. doi:10.1137/0703023
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.doors import announce
from feel321.stimuli.match import OriginalSpectrum, axis_correlations, mean_over_axes
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.rotation import INVARIANTS, random_rotations
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

    Grade = Literal["good", "caution", "fails", "undefined"]

UNRELATED = float(np.sqrt(2))
"""Largest relative change: between two unrelated signals of equal energy."""

LARGEST_DB = 60.0
"""An output that is weaker or stronger by more than this is silent, or out of all proportion."""

FLIPS = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
"""The axis signs that differ by more than the sign of everything."""

TURNS = 4
"""Orientations of every take."""

NOISE_DB = -60.0
"""Level of the sensor noise relative to the recording."""


def relative_change(
    changed: Samples, output: Samples, *, free: Literal["sign", "phase"] = "sign"
) -> Samples:
    r"""Compute how much outputs, (..., n), differ from another one, ignoring its sign or a constant phase.

    Notes
    -----
    With H the Hilbert transform, the smallest distance over all phases is

    .. math:: \min_\varphi \|r' - \cos\varphi\, r - \sin\varphi\, Hr\|^2
        = \|r'\|^2 + \|r\|^2 - 2 \sqrt{(r' \cdot r)^2 + (r' \cdot Hr)^2}

    for outputs without offset, whose r and Hr are orthogonal and equally strong.
    """
    if free == "phase":
        from scipy.signal import hilbert

        along = np.abs(np.einsum("...n,...n->...", changed, hilbert(output)))
        energies = np.square(changed).sum(axis=-1) + np.square(output).sum(axis=-1)
        distance = np.asarray(np.sqrt(np.maximum(energies - 2 * along, 0.0)))
    else:
        apart, beyond = (
            np.linalg.norm(one, axis=-1) for one in (changed - output, changed + output)
        )
        distance = np.asarray(np.minimum(apart, beyond))
    strength = np.linalg.norm(output, axis=-1)
    silent = np.where(distance > 0, UNRELATED, 0.0)
    known = np.broadcast_to(strength > 0, distance.shape)
    relative = np.divide(distance, strength, out=np.array(silent), where=known)
    return np.asarray(np.minimum(relative, UNRELATED))


@dataclass(frozen=True, slots=True)
class Measure:
    """One number per reducer and scene, and its limits."""

    name: str
    letter: str
    title: str
    unit: str
    caution: float
    fails: float
    what: str
    why: str

    def grade(self, value: float) -> Grade:
        """Grade a value; NaN is undefined."""
        if math.isnan(value):
            return "undefined"
        if abs(value) >= self.fails:
            return "fails"
        return "caution" if abs(value) >= self.caution else "good"


_WEBER = "a change of 22 % of the waveform is the paper's Weber fraction of vibration"
_MEASURES = (
    Measure("gain", "G", "Perturbation gain", "", 3.0, 10.0,
            "How many times more the output changes than the input, under sensor noise 60 dB below the recording.",
            "sensor noise of 10 mg on a drag of 5 m/s² (2 %) then changes 20 % of the output, a Weber fraction; "
            "from 3 on it changes 6 %."),
    Measure("rotation", "R", "Change under rotation", "", 0.1, 0.22,
            "How much the output itself changes if the sensor is mounted in another, random orientation.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("flip", "F", "Change under a flipped axis", "", 0.1, 0.22,
            "How much the output changes if one axis has the other sign (the worst of the three).",
            f"{_WEBER}; the caution is about half of it."),
    Measure("shift", "S", "Change under a shift", "", 0.1, 0.22,
            "How much the output changes if the same motion begins up to one window later.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("edge", "W", "Window-edge error", "", 0.1, 0.2,
            "Which share of the energy the output puts into another half window than the recording has it in.",
            "0.2 is a mean change of the half windows' energy by 40 % (1.5 dB), about a Weber fraction of the "
            "amplitude (1.7 dB)."),
    Measure("energy", "E", "Energy error", "dB", 1.5, 3.0,
            "How much stronger or weaker the output vibrates than the recording does.",
            "from 1.5 dB on it nears a Weber fraction of the amplitude (1.7 dB); 3 dB is nearly two: half or double "
            "the energy."),
    Measure("spread", "M", "Spread of the metrics", "", 0.05, 0.1,
            "Standard deviation of the match metrics over random orientations of the sensor, the larger of the two.",
            "in the paper's Table 1 the better reducers lie 0.1 apart in temporal match (0.40, 0.46, 0.51): "
            "the mounting then decides as much as the reducer."),
    Measure("fault", "D", "Damage by the fault", "", 1.5, 2.0,
            "How many times more the output changes than the input, by the fault of the scene (clipping, steps, gaps, "
            "clocks).",
            "at 2 the reducer does as much harm as the sensor did."),
)  # fmt: skip

MEASURES: Mapping[str, Measure] = MappingProxyType({measure.name: measure for measure in _MEASURES})
"""Name -> measure; the first is the number in the cells of the heat map."""


@dataclass(frozen=True, slots=True)
class StressCell:
    """One measure of one reducer on one recording or scene: the median and upper quantiles over takes or noises.

    value: NaN where it is not defined; up_to_phase: a failing gain if a constant phase is ignored too, NaN elsewhere;
    p90, p95: NaN where too few were drawn.
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
        """The grade of the median; a caution where one take in ten fails."""
        measure = MEASURES[self.measure]
        grade = measure.grade(self.value)
        return "caution" if grade == "good" and measure.grade(self.p90) == "fails" else grade


class Change(NamedTuple):
    """A relative change over many draws; p90: nine of ten are not above it."""

    median: float
    worst: float
    p90: float


def perturbation_gain(
    reduce: Reducer,
    recording: Recording,
    *,
    rng: np.random.Generator,
    draws: int = 20,
    level_db: float = NOISE_DB,
    free: Literal["sign", "phase"] = "sign",
) -> Change:
    r"""Compute how many times more the output changes than the input, under weak sensor noise.

    Notes
    -----
    .. math:: G = \delta(R(a + n), R(a)) \,\Big/\, \frac{\|n\|}{\|a\|}, \qquad n \sim N(0, 1)^{3 \times n}
        \text{ scaled to } \|n\| = 10^{L/20} \|a\|

    a condition number measured at a distance [2]_; exactly \|R(n)\| \|a\| / (\|R(a)\| \|n\|) for linear reducers.
    """
    samples, share = recording.acceleration, 10 ** (level_db / 20)
    strength = float(np.linalg.norm(samples))
    if strength == 0:
        raise ValueError(
            f"recording {recording.name!r} must have motion, got silence; leave it out"
        )
    noise = rng.standard_normal((draws, *samples.shape))
    noise *= share * strength / np.linalg.norm(noise, axis=(-2, -1), keepdims=True)
    outputs = reduce(samples + noise, recording.rate_hz)
    gains = relative_change(outputs, reduce(samples, recording.rate_hz), free=free) / share
    return Change(float(np.median(gains)), float(gains.max()), float(np.quantile(gains, 0.9)))


def measure_gains(
    recording: Recording, reducers: Mapping[str, Reducer], *, draws: int, seed: int
) -> list[StressCell]:
    """Measure the perturbation gain of every reducer on a recording."""
    cells = []
    for name, reduce in reducers.items():
        announce(f"{recording.name}, {name}")
        own = [seed, *recording.name.encode()]
        rng = np.random.default_rng([*own, *b"gain"])
        gain, phase = perturbation_gain(reduce, recording, rng=rng, draws=draws), math.nan
        if MEASURES["gain"].grade(gain.median) == "fails":
            again = np.random.default_rng(own)
            phase = perturbation_gain(
                reduce, recording, rng=again, draws=draws, free="phase"
            ).median
        cells.append(
            StressCell(recording.name, name, "gain", gain.median, gain.worst, phase, gain.p90)
        )
    return cells


class Takes(NamedTuple):
    """Takes of one scene, and what is done to them; the same for all reducers.

    samples, noise: (n_takes, 3, n_samples), as is clean, the takes without their fault, if the scene has one; turns:
    (n_takes, TURNS, 3, 3); shifts: (n_takes,), delays in samples, up to one window.
    """

    rate_hz: float
    samples: Samples
    clean: Samples | None
    noise: Samples
    turns: Samples
    shifts: NDArray[np.int64]
    spectra: list[OriginalSpectrum]


def vary(
    recordings: Sequence[Recording], clean: Sequence[Recording] = (), *, rng: np.random.Generator
) -> Takes:
    """Give every take its noise, orientations and shift; all takes are of one length and rate."""
    samples, rate_hz = np.array([one.acceleration for one in recordings]), recordings[0].rate_hz
    noise = rng.standard_normal(samples.shape)
    ratios = [np.linalg.norm(one, axis=(1, 2), keepdims=True) for one in (samples, noise)]
    noise *= 10 ** (NOISE_DB / 20) * ratios[0] / ratios[1]
    count, window = len(recordings), window_samples(DEFAULT_WINDOW_S, rate_hz)
    return Takes(
        rate_hz,
        samples,
        np.array([one.acceleration for one in clean]) if clean else None,
        noise,
        random_rotations(count * TURNS, rng).reshape(count, TURNS, 3, 3),
        rng.integers(1, window, size=count, endpoint=True),
        [OriginalSpectrum(one, rate_hz) for one in samples],
    )


def make_takes(name: str, *, takes: int, seed: int) -> Takes:
    """Make takes of a scene of the battery."""
    scene, numbers = BATTERY[name], [1000 * seed + number for number in range(takes)]
    clean = [scene.make_clean(number) for number in numbers] if scene.fault else []
    rng = np.random.default_rng([seed, *name.encode()])
    return vary([scene.make(number) for number in numbers], clean, rng=rng)


def measure_takes(reduce: Reducer, takes: Takes) -> dict[str, Samples]:
    """Measure one reducer on all takes: measure -> (n_takes,); "phase" is the gain up to a constant phase."""
    samples, rate_hz, share = takes.samples, takes.rate_hz, 10 ** (NOISE_DB / 20)
    output = reduce(samples, rate_hz)
    noisy = reduce(samples + takes.noise, rate_hz)
    turned = np.einsum("trij,tjn->trin", takes.turns, samples)
    outputs = reduce(turned, rate_hz)
    flipped = reduce(FLIPS[:, None, :, None] * samples, rate_hz)
    spreads = [find_spread(*each) for each in zip(takes.spectra, turned, outputs, strict=True)]
    with np.errstate(divide="ignore"):
        energy_db = 10 * np.log10(output.var(axis=-1) / samples.var(axis=-1).sum(axis=-1))
    return {
        "gain": relative_change(noisy, output) / share,
        "rotation": np.median(relative_change(outputs, output[:, None]), axis=-1),
        "flip": relative_change(flipped, output).max(axis=0),
        "shift": _measure_shift(reduce, takes),
        "edge": _measure_edges(samples, output, rate_hz),
        "energy": np.asarray(np.clip(energy_db, -LARGEST_DB, LARGEST_DB)),
        "spread": np.array(spreads),
        "fault": _measure_damage(reduce, takes, output),
        "phase": relative_change(noisy, output, free="phase") / share,
    }


def _measure_shift(reduce: Reducer, takes: Takes) -> Samples:
    silence = np.zeros((*takes.samples.shape[:2], window_samples(DEFAULT_WINDOW_S, takes.rate_hz)))
    embedded = np.concatenate([takes.samples, silence], axis=-1)
    pairs = zip(embedded, takes.shifts, strict=True)
    later = reduce(np.array([np.roll(one, shift, axis=-1) for one, shift in pairs]), takes.rate_hz)
    back = [np.roll(output, -shift) for output, shift in zip(later, takes.shifts, strict=True)]
    return relative_change(np.array(back), reduce(embedded, takes.rate_hz))


def _measure_edges(samples: Samples, output: Samples, rate_hz: float) -> Samples:
    r"""Measure the share of the energy that the output puts into another half window than the recording has it in.

    With p_k and q_k the shares of the energy about the mean of recording and output that lie in half window k, the
    total variation distance :math:`\frac{1}{2} \sum_k |p_k - q_k|`. Energy that a reducer spreads before a tap, wraps
    around the ends or loses at a frame's edge counts, its overall strength does not.
    """
    starts = np.arange(0, samples.shape[-1], window_samples(DEFAULT_WINDOW_S, rate_hz) // 2)
    shares = []
    for signals in (samples, output[:, None]):
        about_mean = signals - signals.mean(axis=-1, keepdims=True)
        energy = np.add.reduceat(np.square(about_mean).sum(axis=1), starts, axis=-1)
        total = energy.sum(axis=-1, keepdims=True)
        shares.append(np.divide(energy, total, out=np.zeros_like(energy), where=total > 0))
    recorded, kept = shares
    return np.where(kept.any(axis=-1), np.abs(recorded - kept).sum(axis=-1) / 2, 1.0)


def find_spread(original: OriginalSpectrum, turned: Samples, outputs: Samples) -> float:
    """Find the standard deviation over orientations of the match metric that varies more."""
    spectral = float(np.std(original.match(outputs), ddof=1)) if len(original.smoothed) else 0.0
    return max(spectral, float(np.std(mean_over_axes(axis_correlations(turned, outputs)), ddof=1)))


def _measure_damage(reduce: Reducer, takes: Takes, output: Samples) -> Samples:
    if takes.clean is None:
        return np.full(len(output), np.nan)
    sizes = [np.linalg.norm(one, axis=(1, 2)) for one in (takes.samples - takes.clean, takes.clean)]
    changed = relative_change(output, reduce(takes.clean, takes.rate_hz))
    return np.asarray(changed / (sizes[0] / sizes[1]))


def measure_scene(
    scene: str, reducers: Mapping[str, Reducer], *, takes: int, seed: int
) -> list[StressCell]:
    """Measure every reducer on one scene of the battery."""
    made, cells = make_takes(scene, takes=takes, seed=seed), []
    for name, reduce in reducers.items():
        announce(f"{scene}, {name}")
        cells += _summarise(scene, name, measure_takes(reduce, made))
    return cells


def _summarise(scene: str, reducer: str, found: Mapping[str, Samples]) -> list[StressCell]:
    """Find median and upper quantiles over takes; an energy error keeps the sign of its median."""
    cells = []
    for key, measure in MEASURES.items():
        median, p90, p95, worst = np.quantile(np.abs(found[key]), (0.5, 0.9, 0.95, 1.0)).tolist()
        sign = -1.0 if np.median(found[key]) < 0 else 1.0
        failing = key == "gain" and measure.grade(median) == "fails"
        phase = float(np.median(found["phase"])) if failing else math.nan
        cells.append(StressCell(scene, reducer, key, sign * median, worst, phase, p90, p95))
    return cells


RANGE_LIMIT = 0.1
"""A temporal match that varies by more with the mounting alone says less than the choice among the paper's reducers."""

EXPLODED = -1.0
"""A spectral match below -1 means that the energy is off by more than three times on average over frequency."""

METRIC_TURNS = 50
"""Orientations of the sensor that the metrics are compared over."""


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
    turned = np.einsum("rij,jn->rin", random_rotations(METRIC_TURNS, rng), samples)
    temporal = mean_over_axes(axis_correlations(turned, outputs[held]))
    invariant = [INVARIANTS["temporal_match"](one, outputs[held], rate_hz) for one in turned[:5]]

    original = OriginalSpectrum(samples, rate_hz)
    matches = {name: float(original.match(output)) for name, output in outputs.items()}
    worst = min(matches, key=matches.__getitem__)
    return MetricRow(
        recording.name, held,
        float(temporal.min()), float(temporal.max()), min(invariant), max(invariant),
        "" if math.isnan(matches[worst]) else worst, matches[worst],
        float(original.match_both(outputs[worst])[1]),
        INVARIANTS["spectral_match"](samples, outputs[worst], rate_hz),
    )  # fmt: skip
