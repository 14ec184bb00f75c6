"""What a chart holds: one record per figure that was measured, in the units of their names.

A *method* is a reducer with its window and hop; its label is what tells it apart in every table.
"""

from __future__ import annotations

from dataclasses import dataclass

MEASURES = (
    "spectral_match", "temporal_match",
    "spectral_match_bounded", "spectral_match_energy_weighted", "temporal_match_invariant",
)  # fmt: skip
"""The paper's two metrics, then their bounded counterparts, which no orientation of the sensor changes."""

SWEEPS = ("size", "window", "hop", "block", "rate", "bits")
"""What is varied where cost is measured."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording on which methods are compared.

    Parameters
    ----------
    name : str
        What it is called.
    rate_hz, duration_s : float
        Of the recording.
    used_s : float
        How much of it was used, from its middle.
    sha256 : str
        Of the conditioned samples.
    """

    name: str
    rate_hz: float
    duration_s: float
    used_s: float
    sha256: str


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well one method keeps one scene, by one measure.

    Parameters
    ----------
    sweep : str
        What was varied: reducer (all as they are), window, hop or rate.
    method, reducer : str
        Label of the method, and its reducer.
    scene : str
        Name of the recording.
    rate_hz : float
        Sampling rate at which it was reduced.
    measure : str
        One of `MEASURES`.
    as_mounted : float
        With the sensor as it was.
    mean, sd : float
        Over random sensor orientations (ddof 1).
    rotations : int
        Number of orientations.
    """

    sweep: str
    method: str
    reducer: str
    scene: str
    rate_hz: float
    measure: str
    as_mounted: float
    mean: float
    sd: float
    rotations: int


@dataclass(frozen=True, slots=True)
class Cost:
    """What one method costs under one condition.

    Parameters
    ----------
    sweep : str
        Which of `SWEEPS` it belongs to.
    method, reducer : str
        Label of the method, and its reducer.
    n_samples : int
        Samples per axis and measurement.
    rate_hz : float
        Their sampling rate.
    block : int
        Samples per call; all of them where the method is not streamed.
    bits : int
        Of the input: 32 or 64.
    ns_per_sample, low, high : float
        Median over the rounds and its quartiles.
    real_time : float
        Seconds of signal reduced per second of computing, by the median.
    rounds : int
        Measurements.
    """

    sweep: str
    method: str
    reducer: str
    n_samples: int
    rate_hz: float
    block: int
    bits: int
    ns_per_sample: float
    low: float
    high: float
    real_time: float
    rounds: int


@dataclass(frozen=True, slots=True)
class Growth:
    """How the time of one call grows: overhead + slope n^exponent.

    Parameters
    ----------
    reducer : str
        The reducer.
    overhead_us : float
        Microseconds that every call takes.
    exponent, low, high : float or None
        The power of n and its 95 % interval; None where there are too few lengths for one.
    smallest, largest : int
        Shortest and longest signal, in samples.
    misfit : float
        Root mean square of the relative deviation from the fit.
    """

    reducer: str
    overhead_us: float
    exponent: float
    low: float | None
    high: float | None
    smallest: int
    largest: int
    misfit: float


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory that one call asks for at most, its output included.

    Parameters
    ----------
    reducer : str
        The reducer.
    n_samples : int
        Samples per axis.
    peak_bytes : int
        Most that was held at a time, beside the input.
    relative : float
        The same as a multiple of the input.
    """

    reducer: str
    n_samples: int
    peak_bytes: int
    relative: float


@dataclass(frozen=True, slots=True)
class Precision:
    """What 32-bit input and 32-bit arithmetic change.

    Parameters
    ----------
    reducer : str
        The reducer.
    output : str
        Type of what it gives back for 32-bit input.
    difference_db : float
        Energy of the change of the output relative to the output for 64-bit input; None where nothing changes.
    arithmetic_db : float or None
        Energy of the error of 32-bit samples, coefficients and transforms relative to the output in 64 bits, of the
        worst recording; None where none has an error.
    worst : str
        That recording; empty where there is none.
    """

    reducer: str
    output: str
    difference_db: float | None
    arithmetic_db: float | None = None
    worst: str = ""


@dataclass(frozen=True, slots=True)
class RealTime:
    """Time that a stream takes for a block, against the time until the next one.

    Parameters
    ----------
    reducer : str
        The reducer.
    rate_hz : float
        Sampling rate in Hz.
    block, blocks : int
        Samples per block, and blocks that were timed.
    median_us, p99_us, worst_us : float
        Over the blocks, in microseconds.
    deadline_us : float
        Time until the next block.
    """

    reducer: str
    rate_hz: float
    block: int
    blocks: int
    median_us: float
    p99_us: float
    worst_us: float
    deadline_us: float


@dataclass(frozen=True, slots=True)
class Resources:
    """What a reducer holds and does, by its definition.

    Parameters
    ----------
    reducer : str
        The reducer.
    state_bytes : float
        Numbers that must be held at once, of 8 bytes each.
    operations : float
        Per sample.
    parameters : int
        Values that have to be chosen.
    """

    reducer: str
    state_bytes: float
    operations: float
    parameters: int


@dataclass(frozen=True, slots=True)
class Stability:
    """How many times more the output changes than the input, under sensor noise 60 dB below the recording.

    Parameters
    ----------
    reducer, scene : str
        Of what on what.
    gain, worst : float
        Median and worst over noises.
    draws : int
        Noises.
    """

    reducer: str
    scene: str
    gain: float
    worst: float
    draws: int


@dataclass(frozen=True, slots=True)
class Point:
    """One method in the plane of speed and accuracy, for one measure.

    Methods are compared by the median over scenes: spectral match has no lower bound, so that one scene with a band
    nearly without energy decides a mean.

    Parameters
    ----------
    method, reducer : str
        Label of the method, and its reducer.
    measure : str
        One of `MEASURES`.
    median, mean : float
        Over scenes, of the mean over orientations.
    lowest, highest : float
        Of the scenes.
    se : float
        Standard error of the median that is due to the finite number of orientations.
    ns_per_sample, low, high : float
        Cost: median and quartiles.
    latency_s : float or None
        Algorithmic latency; None if the whole signal is needed.
    on_front : bool
        Whether no other reducer is at least as cheap and as good by this measure, and clearly better in one.
    group : str
        Label of the methods that are equal by construction, drawn as one point; empty for all others.
    """

    method: str
    reducer: str
    measure: str
    median: float
    mean: float
    lowest: float
    highest: float
    se: float
    ns_per_sample: float
    low: float
    high: float
    latency_s: float | None
    on_front: bool
    group: str = ""


@dataclass(frozen=True, slots=True)
class Dominance:
    """A reducer to which another one is to be preferred in every respect.

    Parameters
    ----------
    reducer : str
        The one that is dominated.
    by : str
        The one that is at least as good in cost, latency and both of the paper's metrics, and better in one.
    clear : bool
        Whether at least one of the advantages is beyond the measurement's noise.
    scenes, of : int
        In how many scenes the other one is at least as good by both metrics, and of how many.
    """

    reducer: str
    by: str
    clear: bool
    scenes: int
    of: int


@dataclass(frozen=True, slots=True)
class Rated:
    """Mean rating of a reducer.

    Parameters
    ----------
    reducer, scale, level : str
        What was rated, and how.
    mean : float
        Over participants and recordings.
    low, high : float or None
        95 % t interval over participants: other people, these recordings; None where it is not defined.
    two_way_low, two_way_high : float
        95 % bootstrap interval over participants and recordings: other people, other recordings.
    participants, recordings : int
        How many.
    """

    reducer: str
    scale: str
    level: str
    mean: float
    low: float | None
    high: float | None
    two_way_low: float
    two_way_high: float
    participants: int
    recordings: int


@dataclass(frozen=True, slots=True)
class Machine:
    """What the times were measured on.

    Parameters
    ----------
    processor, system : str
        As they name themselves.
    cores : int
        Logical ones.
    threads : int
        That linear algebra was allowed.
    load : float or None
        Programs that wanted to run in the minute before; None where that is not counted.
    clock : str
        Which of Python's clocks: thread_time is the processor's time of the measured thread alone.
    python, numpy, scipy, feel321 : str
        Versions.
    """

    processor: str
    system: str
    cores: int
    threads: int
    load: float | None
    clock: str
    python: str
    numpy: str
    scipy: str
    feel321: str
