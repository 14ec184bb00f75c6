"""Records of the chart, the machine and clock it was measured with, mean ratings, and the Pareto front.

A *method* is a reducer with its window and hop; its label is what tells it apart in every table.
"""

from __future__ import annotations

import json
import os
import platform
import time
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.contrasts.equivalence import profile_reducers
from feel321.analysis.resampling import draw_counts
from feel321.analysis.table.judgements import ROLES
from feel321.analysis.table.reading import order_reducers
from feel321.analysis.words import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray
    from pandas import DataFrame

    Clock = Callable[[], float]

# What a chart holds: one record per figure that was measured, in the units of their names.

MEASURES = (
    "spectral_match", "temporal_match",
    "spectral_match_bounded", "spectral_match_energy_weighted", "temporal_match_invariant",
)  # fmt: skip
"""The paper's two metrics, then their bounded counterparts, which no orientation of the sensor changes."""

SWEEPS = ("size", "window", "hop", "block", "rate", "bits")
"""What is varied where cost is measured."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording on which methods are compared."""

    name: str
    rate_hz: float
    duration_s: float
    used_s: float
    sha256: str


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well one method keeps one scene, by one measure."""

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
    """What one method costs under one condition."""

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

    exponent, low, high: the power of n and its 95 % interval; smallest, largest: shortest and
    longest signal, in samples.
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
    """Memory that one call asks for at most, its output included."""

    reducer: str
    n_samples: int
    peak_bytes: int
    relative: float


@dataclass(frozen=True, slots=True)
class Precision:
    """What 32-bit input and 32-bit arithmetic change."""

    reducer: str
    output: str
    difference_db: float | None
    arithmetic_db: float | None = None
    worst: str = ""


@dataclass(frozen=True, slots=True)
class RealTime:
    """Time that a stream takes for a block, against the time until the next one."""

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
    """What a reducer holds and does, by its definition."""

    reducer: str
    state_bytes: float
    operations: float
    parameters: int


@dataclass(frozen=True, slots=True)
class Stability:
    """How many times more the output changes than the input, under sensor noise 60 dB below the recording."""

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

    on_front: whether no other reducer is at least as cheap and as good by this measure, and clearly
    better in one.
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

    by: the one that is at least as good in cost, latency and both of the paper's metrics, and
    better in one; clear: whether at least one of the advantages is beyond the measurement's noise;
    scenes, of: in how many scenes the other one is at least as good by both metrics, and of how
    many.
    """

    reducer: str
    by: str
    clear: bool
    scenes: int
    of: int


@dataclass(frozen=True, slots=True)
class Rated:
    """Mean rating of a reducer.

    low, high: 95 % t interval over participants: other people, these recordings; two_way_low,
    two_way_high: 95 % bootstrap interval over participants and recordings: other people, other
    recordings.
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
    """What the times were measured on."""

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


# The chart as data: everything measured, as one frozen record that survives JSON.

TABLES: Mapping[str, type] = MappingProxyType({
    "scenes": Scene,
    "points": Point,
    "dominated": Dominance,
    "accuracies": Accuracy,
    "costs": Cost,
    "growth": Growth,
    "memory": Memory,
    "precision": Precision,
    "rated": Rated,
    "realtime": RealTime,
    "resources": Resources,
    "stability": Stability,
})
"""Name of a table -> its record; also the names of the CSV files."""


@dataclass(frozen=True, slots=True)
class Chart:
    """Speed against accuracy, measured in one run.

    Parameters
    ----------
    machine : Machine
        On what.
    scenes : tuple of Scene
        Recordings.
    points : tuple of Point
        Reducers as they are, in the plane of speed and accuracy.
    dominated : tuple of Dominance
        Who is beaten in every respect.
    accuracies : tuple of Accuracy
        All methods and scenes.
    costs : tuple of Cost
        All times.
    growth : tuple of Growth
        Of time with length.
    memory : tuple of Memory
        By length.
    precision : tuple of Precision
        What 32-bit input changes.
    rated : tuple of Rated
        Mean ratings; empty where nobody has rated.
    realtime : tuple of RealTime
        Of the reducers that stream.
    resources : tuple of Resources
        Of all reducers.
    stability : tuple of Stability
        All reducers and scenes.
    seed : int
        Of the orientations, signals and bootstrap.
    effort : str
        Name of the effort: quick or full.
    simulated : bool
        Whether ratings come from simulated participants.
    notes : tuple of str
        What was left out or assumed.
    """

    machine: Machine
    scenes: tuple[Scene, ...]
    points: tuple[Point, ...]
    dominated: tuple[Dominance, ...]
    accuracies: tuple[Accuracy, ...]
    costs: tuple[Cost, ...]
    growth: tuple[Growth, ...]
    memory: tuple[Memory, ...]
    precision: tuple[Precision, ...]
    rated: tuple[Rated, ...]
    realtime: tuple[RealTime, ...]
    resources: tuple[Resources, ...]
    stability: tuple[Stability, ...]
    seed: int
    effort: str
    simulated: bool
    notes: tuple[str, ...]

    def to_json(self, **beside: Any) -> str:  # noqa: ANN401 - whatever JSON holds
        """Write as JSON text.

        Parameters
        ----------
        **beside : object
            Other entries, such as the files that belong to it.

        Returns
        -------
        str
            UTF-8 JSON; what is not defined is null.
        """
        return (
            json.dumps({**asdict(self), **beside}, indent=1, ensure_ascii=False, allow_nan=False)
            + "\n"
        )


def read_json(text: str) -> Chart:
    """Read a chart that was written as JSON."""
    try:
        content = json.loads(text)
        own = {field.name: content[field.name] for field in fields(Chart)}
        tables = {
            name: tuple(record(**row) for row in own[name]) for name, record in TABLES.items()
        }
        return Chart(**{
            **own,
            **tables,
            "machine": Machine(**own["machine"]),
            "notes": tuple(own["notes"]),
        })
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"chart: got JSON that is no chart ({error!r}); run feel321 chart again"
        ) from error


# What times were measured on: without its name a time means nothing.

THREADS = 1
"""Of linear algebra while times are taken."""


def describe_machine(clock: str, *, cpu_list: Path = Path("/proc/cpuinfo")) -> Machine:
    """Describe this machine."""
    from feel321.stimuli.version import __version__

    return Machine(
        processor=_name_processor(cpu_list),
        system=f"{platform.system()} {platform.release()}",
        cores=os.cpu_count() or 1,
        threads=THREADS,
        load=_tell_load(),
        clock=clock,
        python=platform.python_version(),
        numpy=version("numpy"),
        scipy=version("scipy"),
        feel321=__version__,
    )


def _name_processor(cpu_list: Path) -> str:
    try:
        lines = cpu_list.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine() or "unknown"


def _tell_load() -> float | None:
    """Give the programs that wanted to run in the last minute; not every system counts them."""
    try:
        return round(os.getloadavg()[0], 2)
    except (AttributeError, OSError):
        return None


# Which methods are worth having: those that no other one beats in every respect.


def find_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point dominates.

    costs: (n_points, n_objectives), infinite is the worst; returns (n_points,), true where no other
    point is at most as costly in every column and less in one.

    Examples
    --------
    >>> find_front([[1, 3], [2, 2], [2, 3], [3, 1]]).tolist()
    [True, True, False, True]
    """
    return np.asarray(~dominates(costs).any(axis=0))


def dominates(costs: ArrayLike) -> NDArray[np.bool_]:
    """Tell which point dominates which.

    costs: (n_points, n_objectives); returns (n_points, n_points).
    """
    table = np.asarray(costs, dtype=np.float64)
    if np.isnan(table).any():
        raise ValueError(
            "costs: got NaN, allowed are numbers; a point without a value cannot be compared"
        )
    no_worse = (table[:, None, :] <= table[None, :, :]).all(axis=-1)
    better = (table[:, None, :] < table[None, :, :]).any(axis=-1)
    return np.asarray(no_worse & better)


# Times that can be compared: everything is measured in turn, in one run, by a clock that is passed in.

FEWEST_ROUNDS = 3
"""Quartiles of fewer are the values themselves."""

FINE_S = 1e-6
"""A clock that moves in longer steps cannot time a short call."""


def choose_clock() -> tuple[str, Clock]:
    """Choose the clock that other programs disturb least."""
    fine = time.get_clock_info("thread_time").resolution < FINE_S
    return ("thread_time", time.thread_time) if fine else ("perf_counter", time.perf_counter)


def time_in_turn(
    tasks: Sequence[Callable[[], object]],
    *,
    rounds: int,
    clock: Clock,
    rng: np.random.Generator,
    done: Callable[[], None] | None = None,
) -> NDArray[np.float64]:
    """Time every task once per round, in a new order each round.

    A machine that slows down for a while slows all tasks alike, and none always runs behind the same other one. One
    round goes before, unmeasured, so that caches and plans are warm.

    rounds: measurements per task, at least 3; returns (rounds, n_tasks).

    Examples
    --------
    >>> ticks = iter(range(100))
    >>> time_in_turn([int, int], rounds=3, clock=lambda: next(ticks), rng=np.random.default_rng(0)).tolist()
    [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]
    """
    if rounds < FEWEST_ROUNDS:
        raise ValueError(
            f"rounds: got {rounds}, allowed is {FEWEST_ROUNDS} or more: quartiles need them"
        )
    seconds = np.empty((rounds + 1, len(tasks)))
    for number in range(rounds + 1):
        for which in rng.permutation(len(tasks)):
            begun = clock()
            tasks[which]()
            seconds[number, which] = clock() - begun
        if done is not None:
            done()
    return seconds[1:]


# What people said of each reducer, to stand beside speed and match.

DRAWS = 2000
KEY = ["scale", "level", "reducer"]


def rate_reducers(ratings: DataFrame, *, seed: int, draws: int = DRAWS) -> list[Rated]:
    """Average the ratings of every reducer.

    Notes
    -----
    The mean is that of the participants' means. The two-way interval draws participants and recordings with
    replacement, the same draws for all reducers, and takes the 2.5 % and 97.5 % quantiles of the mean.
    """
    tests = ratings[ratings["role"] == ROLES[0]]
    people, scenes = sorted(tests["participant"].unique()), sorted(tests["recording"].unique())
    rng = np.random.default_rng(seed)
    drawn = draw_counts(len(people), draws, rng=rng), draw_counts(len(scenes), draws, rng=rng)
    means = (
        tests
        .groupby([*KEY, "participant", "recording"], observed=True)["rating"]
        .mean()
        .reset_index()
    )
    tables = {
        key: own.pivot_table(
            index="participant", columns="recording", values="rating", observed=True
        )
        for key, own in means.groupby(KEY, observed=True)
    }
    profile = profile_reducers(tests).sort_values(["scale", "level"], kind="stable")
    found = []
    for row in profile.to_dict("records"):
        reducer, scale, level = row["reducer"], row["scale"], row["level"]
        table = tables[scale, level, reducer].reindex(index=people, columns=scenes)
        ends = draw_interval(table.to_numpy(np.float64), *drawn)
        low, high = _tell_ends(row["low"], row["high"])
        counts = int(row["n_participants"]), int(table.notna().any().sum())
        found.append(Rated(reducer, scale, level, float(row["mean"]), low, high, *ends, *counts))
    order = order_reducers(row.reducer for row in found)
    return sorted(found, key=lambda row: (row.scale, row.level, order.index(row.reducer)))


def draw_interval(
    table: NDArray[np.float64], people: NDArray[np.float64], scenes: NDArray[np.float64]
) -> tuple[float, float]:
    """Find the two-way interval of the mean of participants' means.

    table: (n_participants, n_recordings), naN where there is none; people: (draws, n_participants);
    scenes: (draws, n_recordings); returns lower and upper end, between which 95 % of the draws lie.
    """
    seen = np.isfinite(table)
    sums, counts = scenes @ np.where(seen, table, 0.0).T, scenes @ seen.T.astype(np.float64)
    means = np.divide(sums, counts, out=np.zeros_like(sums), where=counts > 0)
    weights = people * (counts > 0)
    total = weights.sum(axis=1)
    drawn = (weights * means).sum(axis=1)[total > 0] / total[total > 0]
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def _tell_ends(*ends: float) -> Sequence[float | None]:
    """One participant, or participants who all agree, give no t interval."""
    return [float(end) if np.isfinite(end) else None for end in ends]
