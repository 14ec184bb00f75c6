"""Golden vectors for streaming reducers: a test of any implementation, in any language, fed block by block.

`check_stream` tries a Python class; `feel321 port FOLDER --form streaming --reducer NAME` writes the same vectors for a
port, as files and a list of blocks and gaps (`feel321.stimuli.port`).

All motions are along a line, so each reducer's output has a closed form, wherever its frames lie, and it stays one
where samples are missing: held or silent, the motion is along the same line. Motion in several directions is tested by
definition where there are no frames, else by laws: a circle keeps its energy, and an output that must not depend on
how the sensor is mounted does not. So the vectors find faults, but two reducers that follow the axis of the motion in
frames both pass as either.

The output is as long as the input plus a latency, which must be the same for all blocks; before it lies silence.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from feel321.doors import check_name
from feel321.stimuli import conform
from feel321.stimuli.conform import ENERGY_TOLERANCE, RATE_HZ, Conformity, Judged
from feel321.stimuli.rotation import random_rotations
from feel321.types import OnGap, Samples, Stream

BLOCKS = (1, 7, 64, 480)
"""Samples fed at a time; the last block is what is left."""

FILLS = ("raise", "hold", "zero")
"""What stands for missing samples; with "raise" there are none."""

N_SAMPLES = 600
MISSING = ((0, 3), (50, 61), (63, 65), (200, 290), (595, 600))
"""Gaps, as first sample and the one after the last: at the start, across block and frame edges, longer than a frame."""

TOLERANCES = MappingProxyType({"float64": conform.TOLERANCE, "float32": conform.FILE_TOLERANCE})
"""Arithmetic -> largest deviation allowed, relative to the largest expected value."""

TURNS, TURN_SLACK = 3, 100.0
"""Orientations that are tried; an axis is less exact than a sample, by so much."""

CIRCLE_SLACK = 0.3
"""Of the peak: a circle's shape changes where it is cut into frames, but its energy does not."""

_LINES: Mapping[str, tuple[float, float, float]] = MappingProxyType({
    "positive": (1.0, 2.0, 2.0), "mixed_signs": (2.0, -6.0, 3.0), "anti_phase": (1.0, -3.0, 2.0),
})  # fmt: skip
_Form = Callable[[Samples, Samples], Samples]


def _project(axis: int) -> _Form:
    return lambda line, wave: line[axis] * wave


def _match(axis: int) -> _Form:
    return lambda line, wave: np.sign(line[axis]) * float(np.linalg.norm(line)) * wave


def _phase_of_sum(line: Samples, wave: Samples) -> Samples:
    """Give the sign of the sum of the components; where it vanishes, that of the strongest."""
    sign = np.sign(line.sum() or line[np.argmax(np.abs(line))])
    return np.asarray(sign * np.linalg.norm(line) * wave)


def _length(line: Samples, wave: Samples) -> Samples:
    return np.asarray(np.linalg.norm(line) * wave)


def _filter_bank(motion: Samples) -> Samples:
    """Make each of six bands as strong as all axes were in the recent past, by their recursions."""
    splits = 40.0 * 2.0 ** np.arange(5)
    poles = np.exp(-2 * np.pi * splits / RATE_HZ)[:, None]
    memories = np.exp(-1 / (np.maximum(0.005, [*1 / splits, 0.0]) * RATE_HZ))[:, None]
    lows, energies, out = np.zeros((5, 3)), np.zeros((6, 2)), []
    for sample in motion.T:
        lows = poles * lows + (1 - poles) * sample
        bands = np.diff(np.vstack([np.zeros(3), lows, sample]), axis=0)
        kept = bands.sum(axis=1)
        energies = memories * energies + np.stack([np.square(bands).sum(axis=1), kept**2], axis=1)
        limited = np.maximum(energies[:, 1], energies[:, 0] / 100)
        gains = np.sqrt(energies[:, 0] / np.where(limited > 0, limited, 1.0))
        out.append(gains @ kept)
    return np.array(out)


_CLOSED_FORMS: Mapping[str, _Form] = MappingProxyType({
    **{f"sa{axis}321": _project(place) for place, axis in enumerate("xyz")},
    "soc321": lambda line, wave: np.asarray(line.sum() * wave),
    "mag321": lambda line, wave: np.asarray(np.linalg.norm(line) * np.abs(wave)),
    "pca321_adaptive": _length,
    "dft321_windowed": _phase_of_sum,
    "dft321_principal_windowed": _length,
    **{f"sa{axis}321_matched_running": _match(place) for place, axis in enumerate("xyz")},
    "pca321_matched_windowed": _length,
    # One gain in all bands; where the axes cancel it is limited, and there is nothing to amplify.
    "dft321_filtered": lambda line, wave: np.asarray(np.sign(line.sum()) * np.linalg.norm(line) * wave),
})  # fmt: skip
"""Reducer -> its output for a motion along a line, (3,), with a waveform, (n,)."""


def _run_axis(axis: int) -> Callable[[Samples], Samples]:
    """One axis with the gain of the recent past, by its recursion: energies fade by exp(-1 / rate) per sample."""

    def reduce(motion: Samples) -> Samples:
        memory, energies, out = np.exp(-1 / RATE_HZ), np.zeros(2), []
        for sample in motion.T:
            energies = memory * energies + [np.square(sample).sum(), sample[axis] ** 2]
            gain = np.sqrt(energies[0] / max(energies[1], energies[0] / 100)) if energies[0] else 0
            out.append(gain * sample[axis])
        return np.array(out)

    return reduce


_DEFINITIONS: Mapping[str, Callable[[Samples], Samples]] = MappingProxyType({
    **{f"sa{axis}321_matched_running": _run_axis(place) for place, axis in enumerate("xyz")},
    "mag321": lambda motion: np.sqrt(np.square(motion).sum(axis=0)),
    "soc321": lambda motion: motion.sum(axis=0),
    "dft321_filtered": _filter_bank,
})  # fmt: skip
"""Reducers without frames -> their output for any motion, (3, n), by definition."""

STREAMING = tuple(_CLOSED_FORMS)
"""Reducers that have vectors: all that stream."""

OPEN_PHASE = "dft321_windowed"
"""The paper's own streaming reducer, whose phase equation 4 leaves open where the axes cancel."""

FREE_SIGN = frozenset({"pca321_adaptive", "dft321_principal_windowed", "pca321_matched_windowed"})
"""Reducers whose output's sign, the same for all of it, is left open."""

TURNS_ALONG = FREE_SIGN | {"mag321"}
"""Reducers whose output does not depend on how the sensor is mounted, but for its sign."""


@dataclass(frozen=True, slots=True, eq=False)
class StreamVector:
    """Three axes, (3, n), NaN where samples are missing; how they are fed; the output, (n,), without its latency."""

    name: str
    acceleration: Samples
    expected: Samples
    block: int
    on_gap: OnGap = "raise"
    slack: float = 0.0


def stream_vectors(reducer: str) -> tuple[StreamVector, ...]:
    """List the vectors, at 1000 Hz, that a conforming stream must reproduce."""
    form = _CLOSED_FORMS[check_name(reducer, STREAMING, "reducer")]
    return tuple(_list_vectors(reducer, form))


def check_stream(
    make: Callable[[float, OnGap], Stream],
    reducer: str,
    *,
    precision: Literal["float64", "float32"] = "float64",
) -> Conformity:
    """Raise unless a streaming reducer reproduces every golden vector, in blocks of any size, over gaps.

    Parameters
    ----------
    make : callable
        Called as make(rate_hz, on_gap), on_gap one of "raise", "hold" and "zero"; must give a new stream with
        `latency_samples`, `process(block)` for blocks of shape (3, k), NaN where samples are missing, and `flush()`.
    reducer : str
        Which reducer it is: a name of `REDUCERS` that streams.
    precision : {"float64", "float32"}
        Arithmetic of the stream: deviations up to 1e-9 or 1e-5 of the peak are allowed.

    Returns
    -------
    Conformity
        Its verdict is "agrees"; of ``dft321_windowed`` also that the output differs where the paper leaves the phase
        open, as in `check_dft321`.

    Raises
    ------
    ValueError
        One line that names the vectors that failed, and how.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> def make(rate_hz, on_gap):
    ...     return stimuli.StreamingReducer("dft321_windowed", rate_hz, on_gap=on_gap)
    >>> stimuli.check_stream(make, "dft321_windowed").verdict
    'agrees'
    >>> stimuli.check_stream(make, "dft321_principal_windowed")
    Traceback (most recent call last):
    ...
    ValueError: dft321_principal_windowed does not conform: ...
    """
    allowed = TOLERANCES[check_name(precision, TOLERANCES, "precision")]
    judged: list[Judged] = []
    for vector in stream_vectors(reducer):
        try:
            output, latency = _feed(make(float(RATE_HZ), vector.on_gap), vector)
        except Exception as error:  # noqa: BLE001 - whatever a foreign implementation raises is its fault to report
            fault = f"{vector.name}: raised {type(error).__name__}: {error}"
            judged.append(Judged(vector.name, (fault,)))
        else:
            judged.append(
                judge_stream(vector, output, latency=latency, allowed=allowed, reducer=reducer)
            )
    found = conform.conclude(judged, form=reducer, name=reducer)
    if reducer in TURNS_ALONG:
        conform.conclude(
            [Judged("turned", tuple(_check_turns(make, allowed)))], form="", name=reducer
        )
    return found


def _list_vectors(reducer: str, form: _Form) -> Iterator[StreamVector]:
    rng = np.random.default_rng(2010)
    noise: Samples = (
        np.round(64 * rng.standard_normal(N_SAMPLES)) / 64
    )  # few bits: the same in float32
    noise[400:480] = 0.0
    for name, blocks in (("positive", BLOCKS), ("mixed_signs", (7,)), ("anti_phase", (64,))):
        for block in blocks:
            yield from _vary(f"{name}_b{block}", form, (np.array(_LINES[name]), noise), block=block)
    line = np.array(_LINES["positive"])
    for block in BLOCKS:
        impulses = np.zeros(N_SAMPLES)
        impulses[[0, 16, 17, 18, 34, 35, 36, 63, 64, 479, 480, 599]] = (
            1, -2, 3, -1, 2, 1.5, -1, 2, -3, 1, 2, -1.5,
        )  # fmt: skip
        yield from _vary(f"impulses_b{block}", form, (line, impulses), block=block)
    even = np.ones(N_SAMPLES)
    if (
        reducer != "pca321_adaptive"
    ):  # a constant segment keeps the axis before it, at first the diagonal
        yield StreamVector("offset_b64", np.outer(line, even), form(line, even), 64)
    if reducer in _DEFINITIONS:
        motion = np.array([[4.0], [2.0], [1.0]]) * rng.integers(-64, 64, (3, N_SAMPLES)) / 64
        yield StreamVector("by_definition_b7", motion, _DEFINITIONS[reducer](motion), 7)
    if reducer == "dft321_windowed":
        angle = 2 * np.pi * 0.2 * np.arange(N_SAMPLES, dtype=np.float64)
        circle = np.array([np.cos(angle), np.sin(angle), 0 * angle], dtype=np.float64)
        expected = np.asarray(2**0.5 * np.cos(angle - np.pi / 4), dtype=np.float64)
        yield StreamVector("circle_b64", circle, expected, 64, slack=CIRCLE_SLACK)


def _vary(
    name: str, form: _Form, motion: tuple[Samples, Samples], *, block: int
) -> Iterator[StreamVector]:
    """Make a motion without gaps, and the same with gaps that are held or silent."""
    line, wave = motion
    there = np.ones(N_SAMPLES, dtype=bool)
    for first, end in MISSING:
        there[first:end] = False
    last = np.maximum.accumulate(np.where(there, np.arange(1, N_SAMPLES + 1), 0))
    held, silent = np.concatenate([[0.0], wave])[last], np.where(there, wave, 0.0)
    moving: Samples = line[:, None] * wave
    yield StreamVector(name, moving, form(line, wave), block)
    holed = np.where(there, moving, np.nan)
    yield StreamVector(f"{name}_hold", holed, form(line, held), block, "hold")
    yield StreamVector(f"{name}_zero", holed, form(line, silent), block, "zero")


def _feed(stream: Stream, vector: StreamVector) -> tuple[Samples, int]:
    """Feed a stream in blocks, then flush it."""
    outputs = []
    for start in range(0, vector.acceleration.shape[1], vector.block):
        given = vector.acceleration[:, start : start + vector.block]
        outputs.append(np.array(stream.process(block := given.copy())))
        if outputs[-1].shape != block.shape[1:]:
            raise ValueError(f"a block of {block.shape[1]} samples gave {outputs[-1].shape}")
        if not np.array_equal(block, given, equal_nan=True):
            raise ValueError("it changes its input")
    return np.concatenate([*outputs, np.asarray(stream.flush())]), int(stream.latency_samples)


def judge_stream(
    vector: StreamVector, output: Samples, *, latency: int, allowed: float, reducer: str
) -> Judged:
    """Compare a stream's output, its latency included, with what is expected."""
    n, name = vector.expected.size, vector.name
    fault = conform.find_misshape(output, (n + latency,))
    if latency < 0 or fault:
        return Judged(name, (f"{name}: {fault or 'the latency is negative'}",))
    expected = np.concatenate([np.zeros(latency), vector.expected])
    signs = (1.0, -1.0) if reducer in FREE_SIGN else (1.0,)
    peak = float(np.abs(expected).max()) or float(np.nanmax(np.abs(vector.acceleration)))
    off = min(float(np.abs(sign * output - expected).max()) for sign in signs) / peak
    energies = float(np.square(output).sum()), float(np.square(expected).sum())
    if off > allowed and reducer == OPEN_PHASE and conform.cancels(vector.acceleration):
        energy = energies[0] / energies[1]
        return Judged(name, tuple(conform.judge_frames(name, energy, n)), energy=energy)
    faults = _list_deviations(off, energies, allowed=allowed, slack=vector.slack)
    named = tuple(f"{name}: {fault}" for fault in faults)
    return Judged(name, named, off * (not vector.slack))


def _list_deviations(
    off: float, energies: tuple[float, float], *, allowed: float, slack: float
) -> Iterator[str]:
    if off > max(allowed, slack):
        yield f"off by {off:.2g} of the peak, more than {allowed:g}"
    if abs(energies[0] - energies[1]) > ENERGY_TOLERANCE * max(energies[1], allowed):
        yield f"holds {energies[0]:.3g} of energy, must be {energies[1]:.3g}"


def _check_turns(make: Callable[[float, OnGap], Stream], allowed: float) -> Iterator[str]:
    """Check that noise in three directions gives one output, however the sensor is mounted."""
    rng = np.random.default_rng(2019)
    # A direction that leads: where none does, the axis is rounding's choice.
    motion = np.array([[4.0], [2.0], [1.0]]) * rng.standard_normal((3, N_SAMPLES))
    turned = [motion, *(turn @ motion for turn in random_rotations(TURNS, rng))]
    outputs = []
    for samples in turned:
        vector = StreamVector("", samples, samples[0], 64)
        outputs.append(_feed(make(float(RATE_HZ), "raise"), vector)[0])
    peak = np.abs(outputs[0]).max()
    for number, output in enumerate(outputs[1:], start=1):
        off = min(np.abs(output - outputs[0]).max(), np.abs(output + outputs[0]).max()) / peak
        if off > TURN_SLACK * allowed:
            yield f"turned_{number}: changes by {off:.2g} of the peak as the sensor is turned"
