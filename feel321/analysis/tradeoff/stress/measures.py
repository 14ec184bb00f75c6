"""Measures of stability: changes of the output, and the limits from which on they fail.

Conventions: `reduce` is called as in `REDUCERS`, `reduce(acceleration, rate_hz)` with acceleration (..., 3, n), and
must take batches. a is the recording, r = reduce(a) its output, ‖·‖ the root of the energy, δ the relative change of
`change.relative_change`, which is sign-free.

The relative change from an output r to another r' is *sign-free*, because the skin does not feel the sign of a
vibration:

    δ(r', r) = min(‖r' - r‖, ‖r' + r‖) / ‖r‖, at most sqrt(2)

sqrt(2) is what lies between two unrelated signals of equal energy: more is not less stable. An output that is silent
and stays silent has changed by 0, one that is silent and becomes anything by sqrt(2).

Every limit is argued from one figure, in `why`: the paper's Weber fraction of vibration, 22 %, taken of the amplitude
(1.7 dB). A caution is about half way to a failure.

Conventions as in `measures`.

References
----------
.. [1] N. Landin et al., EuroHaptics 2010, section 3 (22 % Weber fraction) and Table 1.
   doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from feel321.stimuli.match import OriginalSpectrum, axis_correlations, mean_heard
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.rotation import random_rotations

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from feel321.stimuli.recording import Recording
    from feel321.stimuli.reducers.registry import Reducer

    Samples = NDArray[np.float64]
    Free = Literal["sign", "phase"]
    Grade = Literal["good", "caution", "fails", "undefined"]

# How far two outputs lie apart, as far as it can be felt.

UNRELATED = float(np.sqrt(2))
"""Largest relative change: between two unrelated signals of equal energy."""


class Change(NamedTuple):
    """A change over many draws.

    median, worst, p90: nine of ten are not above `p90`, which is NaN where nothing is drawn.
    """

    median: float
    worst: float
    p90: float = math.nan


def relative_change(changed: Samples, output: Samples, *, free: Free = "sign") -> Samples:
    r"""Tell how much outputs differ from another one, but for its sign or for a constant phase.

    changed: (..., n); output: (..., n); returns (...).

    Notes
    -----
    With H the Hilbert transform, the smallest distance over all phases is

    .. math:: \min_\varphi \|r' - \cos\varphi\, r - \sin\varphi\, Hr\|^2
        = \|r'\|^2 + \|r\|^2 - 2 \sqrt{(r' \cdot r)^2 + (r' \cdot Hr)^2}

    for outputs without offset, whose r and Hr are orthogonal and equally strong.

    Examples
    --------
    >>> u = np.sin(2 * np.pi * np.arange(100) / 10)
    >>> float(relative_change(-u, u)), float(relative_change(1.25 * u, u)), float(relative_change(np.roll(u, 3), u)) > 1
    (0.0, 0.25, True)
    >>> float(relative_change(np.roll(u, 3), u, free="phase").round(6))
    0.0
    """
    if free not in {"sign", "phase"}:
        raise ValueError(f"free: got {free!r}, allowed is 'sign' or 'phase'")
    distance = _phase_free(changed, output) if free == "phase" else _sign_free(changed, output)
    strength = np.linalg.norm(output, axis=-1)
    silent = np.where(distance > 0, UNRELATED, 0.0)
    known = np.broadcast_to(strength > 0, distance.shape)
    relative = np.divide(distance, strength, out=np.array(silent), where=known)
    return np.asarray(np.minimum(relative, UNRELATED))


def admit_moving(recording: Recording, draws: int) -> tuple[Samples, float]:
    """Check what a change is measured on.

    draws: to be at least 1; returns samples: (3, n).
    """
    samples = recording.acceleration
    strength = float(np.linalg.norm(samples))
    if strength == 0:
        raise ValueError(
            f"recording {recording.name!r}: is silent, so no change can be related to it; leave it out"
        )
    if draws < 1:
        raise ValueError(f"draws: got {draws}, allowed is 1 or more")
    return samples, strength


def summarise(changes: Samples) -> Change:
    """Summarise changes over draws.

    changes: (draws,).
    """
    return Change(float(np.median(changes)), float(changes.max()), float(np.quantile(changes, 0.9)))


def _sign_free(changed: Samples, output: Samples) -> Samples:
    apart = np.linalg.norm(changed - output, axis=-1)
    return np.asarray(np.minimum(apart, np.linalg.norm(changed + output, axis=-1)))


def _phase_free(changed: Samples, output: Samples) -> Samples:
    from scipy.signal import hilbert

    analytic = hilbert(output)
    along = np.abs(np.einsum("...n,...n->...", changed, analytic))
    energies = np.square(changed).sum(axis=-1) + np.square(output).sum(axis=-1)
    return np.asarray(np.sqrt(np.maximum(energies - 2 * along, 0.0)))


# MEASURES: what is measured per reducer and scene, from where on it counts as a failure, and why from there.


@dataclass(frozen=True, slots=True)
class Measure:
    """A figure per reducer and scene, and its limits."""

    name: str
    letter: str
    title: str
    brief: str
    unit: str
    caution: float
    fails: float
    what: str
    why: str

    def grade(self, value: float) -> Grade:
        """Judge a figure.

        value: naN where it is not defined.

        Examples
        --------
        >>> [MEASURES["gain"].grade(value) for value in (1.0, 3.0, 1230.0)]
        ['good', 'caution', 'fails']
        """
        if math.isnan(value):
            return "undefined"
        return (
            "fails"
            if abs(value) >= self.fails
            else "caution"
            if abs(value) >= self.caution
            else "good"
        )


_WEBER = "a change of 22 % of the waveform is the paper's Weber fraction of vibration"
_MEASURES = (
    Measure("gain", "G", "Perturbation gain", "gain", "", 3.0, 10.0,
            "How many times more the output changes than the input, under sensor noise 60 dB below the recording.",
            "sensor noise of 10 mg on a drag of 5 m/s² (2 %) then changes 20 % of the output, a Weber fraction; "
            "from 3 on it changes 6 %."),
    Measure("rotation", "R", "Change under rotation", "output changes under rotation", "", 0.1, 0.22,
            "How much the output itself changes if the sensor is glued on in a random other orientation.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("flip", "F", "Change under a flipped axis", "under a flipped axis", "", 0.1, 0.22,
            "How much the output changes if one axis has the other sign (the worst of the three).",
            f"{_WEBER}; the caution is about half of it."),
    Measure("shift", "S", "Change under a shift", "under a shift in time", "", 0.1, 0.22,
            "How much the output changes if the same motion begins up to one window later.",
            f"{_WEBER}; the caution is about half of it."),
    Measure("edge", "W", "Window-edge error", "energy moved across window edges", "", 0.1, 0.2,
            "Which share of the energy the output puts into another half window than the recording has it in.",
            "0.2 is a mean change of the half windows' energy by 40 % (1.5 dB), about a Weber fraction of the "
            "amplitude (1.7 dB)."),
    Measure("energy", "E", "Energy error", "energy error", "dB", 1.5, 3.0,
            "How much stronger or weaker the output vibrates than the recording.",
            "from 1.5 dB on it nears a Weber fraction of the amplitude (1.7 dB); 3 dB is nearly two: half or double "
            "the energy."),
    Measure("spread", "M", "Spread of the metrics", "SD of a metric over rotations", "", 0.05, 0.1,
            "Standard deviation of the match metrics over random orientations of the sensor, the larger of the two.",
            "in the paper's Table 1 the better methods lie 0.1 apart in temporal match (0.40, 0.46, 0.51): "
            "the mounting then decides as much as the method."),
    Measure("fault", "D", "Damage by the fault", "fault amplified", "", 1.5, 2.0,
            "How many times more the output changes than the input, by the fault of the scene (clipping, steps, gaps, "
            "clocks).",
            "at 2 the method does as much harm as the sensor did."),
)  # fmt: skip

MEASURES: Mapping[str, Measure] = MappingProxyType({measure.name: measure for measure in _MEASURES})
"""Name -> measure, the heat map's own first."""


# How unstable a reducer is on one recording, number by number.

LARGEST_DB = 60.0
"""An output that is weaker or stronger by more than this is silent, or out of all proportion."""


def perturbation_gain(
    reduce: Reducer,
    recording: Recording,
    *,
    rng: np.random.Generator,
    draws: int = 20,
    level_db: float = -60.0,
    free: Free = "sign",
) -> Change:
    r"""Tell how much more the output changes than the input, under weak sensor noise.

    draws: noises, at least 1.

    Notes
    -----
    .. math:: G = \delta(R(a + n), R(a)) \,\Big/\, \frac{\|n\|}{\|a\|}, \qquad n \sim N(0, 1)^{3 \times n}
        \text{ scaled to } \|n\| = 10^{L/20} \|a\|

    a condition number measured at a distance [1]_; exactly \|R(n)\| \|a\| / (\|R(a)\| \|n\|) for linear reducers.

    References
    ----------
    .. [1] J. R. Rice, "A theory of condition", SIAM Journal on Numerical Analysis 3(2), 1966. doi:10.1137/0703023

    Examples
    --------
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> from feel321.stimuli.recording import Recording
    >>> u = np.sin(np.arange(500.0))
    >>> anti_phase = Recording([u, -u, 0 * u], 1000, "anti-phase")
    >>> perturbation_gain(REDUCERS["dft321"], anti_phase, rng=np.random.default_rng(0)).median > 100
    True
    """
    if not level_db < 0:
        raise ValueError(
            f"level_db: got {level_db}, allowed is below 0 dB: the noise is weaker than the recording"
        )
    samples, strength = admit_moving(recording, draws)
    share = 10 ** (level_db / 20)
    noise = rng.standard_normal((draws, *samples.shape))
    noise *= share * strength / np.linalg.norm(noise, axis=(-2, -1), keepdims=True)
    outputs = reduce(samples + noise, recording.rate_hz)
    return summarise(
        relative_change(outputs, reduce(samples, recording.rate_hz), free=free) / share
    )


def shift_change(
    reduce: Reducer, recording: Recording, *, rng: np.random.Generator, draws: int = 8
) -> Change:
    """Tell how much the output changes if the same motion begins a little later.

    draws: shifts, at least 1.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 50)), 1000, "drag")
    >>> shift_change(REDUCERS["mag321"], drag, rng=np.random.default_rng(0))
    Change(median=0.0, worst=0.0, p90=0.0)
    """
    samples, _ = admit_moving(recording, draws)
    most = window_samples(DEFAULT_WINDOW_S, recording.rate_hz)
    silence = np.zeros((3, most))
    embedded = np.concatenate([samples, silence], axis=-1)
    shifts = rng.integers(1, most, size=draws, endpoint=True)
    outputs = reduce(
        np.array([np.roll(embedded, shift, axis=-1) for shift in shifts]), recording.rate_hz
    )
    back = np.array([
        np.roll(output, -shift) for output, shift in zip(outputs, shifts, strict=True)
    ])
    return summarise(relative_change(back, reduce(embedded, recording.rate_hz)))


def edge_error(
    reduce: Reducer, recording: Recording, *, window_s: float = DEFAULT_WINDOW_S
) -> float:
    r"""Tell which share of the energy the output puts at the wrong time, across the edges of half windows.

    Notes
    -----
    With p_k and q_k the shares of the energy about the mean of recording and output that lie in half window k, the
    total variation distance :math:`\frac{1}{2} \sum_k |p_k - q_k|`. Energy that a method spreads before a tap, wraps
    around the ends or loses at a frame's edge counts, its overall strength does not.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> tap = np.zeros(200)
    >>> tap[[50, 51]] = 1.0, -1.0
    >>> edge_error(REDUCERS["pca321"], Recording([tap, 2 * tap, -tap], 1000, "tap")) < 1e-12
    True
    """
    samples, _ = admit_moving(recording, 1)
    hop = window_samples(window_s, recording.rate_hz) // 2
    starts = np.arange(0, samples.shape[-1], hop)
    shares = []
    for signal in (samples, np.atleast_2d(reduce(samples, recording.rate_hz))):
        about_mean = signal - signal.mean(axis=-1, keepdims=True)
        energy = np.add.reduceat(np.square(about_mean).sum(axis=0), starts)
        shares.append(energy / energy.sum() if energy.sum() > 0 else np.zeros_like(energy))
    recorded, kept = shares
    return float(np.abs(recorded - kept).sum() / 2) if kept.any() else 1.0


def energy_error(reduce: Reducer, recording: Recording) -> float:
    """Tell how much stronger or weaker the output vibrates than the recording.

    Returns 10 log10 of the ratio of the energies about the mean, in dB, between -60 and 60: an
    offset is not felt.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> u = np.sin(np.arange(1000.0))
    >>> round(energy_error(REDUCERS["soc321"], Recording([u, u, u], 1000, "same")), 2)
    4.77
    """
    samples, _ = admit_moving(recording, 1)
    recorded = float(samples.var(axis=-1).sum())
    if recorded == 0:
        raise ValueError(
            f"recording {recording.name!r}: has an offset and no vibration; choose one that moves"
        )
    kept = float(reduce(samples, recording.rate_hz).var())
    with np.errstate(divide="ignore"):
        return float(np.clip(10 * np.log10(kept / recorded), -LARGEST_DB, LARGEST_DB))


def fault_gain(reduce: Reducer, recording: Recording, *, clean: Recording) -> float:
    """Tell how much more the output suffers from a fault of the recording than the recording itself.

    Returns naN where both are the same.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> u = np.sin(np.arange(100.0))
    >>> whole, cut = (Recording([v, 0 * u, 0 * u], 1000, "x") for v in (u, np.clip(u, -0.5, 0.5)))
    >>> round(fault_gain(REDUCERS["soc321"], cut, clean=whole), 9)
    1.0
    """
    samples, strength = admit_moving(clean, 1)
    if recording.n_samples != clean.n_samples:
        raise ValueError(
            f"clean: got {clean.n_samples} samples, allowed is {recording.n_samples}, as with the fault"
        )
    share = float(np.linalg.norm(recording.acceleration - samples)) / strength
    outputs = (reduce(one.acceleration, one.rate_hz) for one in (recording, clean))
    return float(relative_change(*outputs)) / share if share else float("nan")


# How much depends on the way the sensor was glued on: of the output itself, and of the metrics.

FLIPS = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
"""The axis signs that differ by more than the sign of everything."""


class Spread(NamedTuple):
    """Standard deviations of both metrics over orientations of the sensor.

    spectral_sd, temporal_sd: naN for the spectral one where the recording has no frequency from 20
    to 1000 Hz.
    """

    spectral_sd: float
    temporal_sd: float


def rotation_change(
    reduce: Reducer,
    recording: Recording,
    *,
    rng: np.random.Generator,
    draws: int = 20,
    free: Free = "sign",
) -> Change:
    """Tell how much the output changes if the sensor is glued on in another way.

    draws: orientations, at least 1.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 50)) * [[1], [2], [4]], 1000, "drag")
    >>> change = {name: rotation_change(REDUCERS[name], drag, rng=np.random.default_rng(0))
    ...           for name in ("sax321", "pca321")}
    >>> change["sax321"].median > 0.5, change["pca321"].worst < 1e-12
    (True, True)
    """
    samples, _ = admit_moving(recording, draws)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    outputs = reduce(turned, recording.rate_hz)
    return summarise(relative_change(outputs, reduce(samples, recording.rate_hz), free=free))


def flip_change(reduce: Reducer, recording: Recording) -> Change:
    """Tell how much the output changes if one axis of the sensor has the other sign.

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> u = np.sin(np.arange(50.0))
    >>> same = Recording([u, u, u], 1000, "same")
    >>> round(flip_change(REDUCERS["soc321"], same).worst, 6), flip_change(REDUCERS["mag321"], same).worst
    (0.666667, 0.0)
    """
    samples, _ = admit_moving(recording, 1)
    outputs = reduce(FLIPS[..., None] * samples, recording.rate_hz)
    return summarise(relative_change(outputs, reduce(samples, recording.rate_hz)))


def metric_spread(
    reduce: Reducer, recording: Recording, *, rng: np.random.Generator, draws: int = 20
) -> Spread:
    """Tell how much both metrics depend on the way the sensor was glued on.

    draws: orientations, at least 2.

    References
    ----------
    .. [1] Park & Kuchenbecker, World Haptics 2019. doi:10.1109/WHC.2019.8816148

    Examples
    --------
    >>> from feel321.stimuli.recording import Recording
    >>> from feel321.stimuli.reducers.registry import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 500)) * [[1], [2], [4]], 1000, "drag")
    >>> metric_spread(REDUCERS["sax321"], drag, rng=np.random.default_rng(0)).spectral_sd > 0.1
    True
    """
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"draws: got {draws}, allowed is 2 or more")
    samples, _ = admit_moving(recording, draws)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    outputs = reduce(turned, recording.rate_hz)
    original = OriginalSpectrum(samples, recording.rate_hz)
    spectral = (
        float(np.std(original.match(outputs), ddof=1)) if len(original.smoothed) else float("nan")
    )
    return Spread(spectral, float(np.std(mean_heard(axis_correlations(turned, outputs)), ddof=1)))
