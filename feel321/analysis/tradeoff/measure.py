"""The trade-off measured: one tidy frame, in which each reducer met each recording once.

A reducer meets, of a recording's strongest part: the signal as recorded; disturbed by sensor noise, gaps, clipping and
a gain; turned into orientations of the sensor that are spread evenly over all rotations (Halton points through
Shoemake's formula [1]_), the same for every recording and seed; and each half by itself.

A row of the frame is a number of one reducer on one recording: `kind` (recording, battery, machine), `recording`,
`reducer`, `condition`, `measure`, `value`, `low`, `high`, `n`. Over orientations and draws the value is the mean, low
and high are the extremes; of times they are the median and quartiles; over takes of the battery the median of each.
Rows without a reducer are properties of the recording. Numbers ending in ``_db`` are decibels of energy:

- `level_db`: felt level of the output over that of the recording (energy weighed by the detection threshold).
- `spectrum_db`: loss of the energy common to both spectra (`spectral_match_energy_weighted`).
- `motion_db`: loss of the motion's energy that the output carries (the square of `temporal_match_invariant`).
- `envelope_db`: an error of the depth of modulation from 2 to 50 Hz (`modulation_distance`) at the envelope's crests.
- `pre_echo_db`: energy in the 10 ms before an onset over that in the 10 ms after it; only where there is an onset.
- `change_db`: energy of the change of the output, up to its sign, relative to the output, less the same of the input.

References
----------
.. [1] K. Shoemake, "Uniform random rotations", in Graphics Gems III, Academic Press 1992.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis.tradeoff.battery import BATTERY
from feel321.analysis.tradeoff.cost import (
    CARD_BLOCK,
    CARD_HZ,
    Candidate,
    find_needs,
    list_candidates,
    time_reducers,
    time_stream,
)
from feel321.arguments import as_seed, describe, follow
from feel321.jobs import Job, Workers, gather_results
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    OriginalSpectrum,
    WeberSmoothing,
    axis_correlations,
    linear_grid,
    match_in_windows,
    mean_over_axes,
)
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.recording import AXES, Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals import Pair, compare_depths, find_depths, follow_band, follow_energy
from feel321.stimuli.thresholds import acceleration_threshold, felt_level
from feel321.types import MOST_DB, Metric, Progress, Reducer, Rng, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    Row = dict[str, Any]

COLUMNS = ("kind", "recording", "reducer", "condition", "measure", "value", "low", "high", "n")
RECORDED, MOUNTED, HALVES = "as recorded", "mounting", ("first half", "second half")
DISTURBED = ("noise", "gaps", "clipping", "gain")

SHORTEST_S = 0.1
"""Shortest signal that is judged: two periods of the lowest frequency that the metrics compare."""

NOISE = 0.02  # Sensor noise against the recording, in amplitude: -34 dB

GAP_S, GAP_SHARE = 0.005, 0.01
"""Length of a gap, and the share of the samples that gaps take: lost blocks of a driver."""

CLIPPED = 0.01  # Share of the energy that a sensor cuts off which saturates
QUIET = 0.01  # A half with less of the energy than this is no half to be judged
GAIN = 0.1  # Factor on the recording: a reducer must give as much less

HOP_S, RISE, LOUD = 0.01, 100.0, 0.1
"""An onset is a hop with so many times the energy of the hop before, and that share of the loudest hop's."""

SAME = 1e-9  # An output that turning the sensor changes by less than this is not changed
LEAST = 1e-12  # The least change that is told from none, in energy


Place = tuple[str, str, str]  # Recording, reducer and condition of a row


class Effort(NamedTuple):
    """How much is measured."""

    longest_s: float
    mountings: int
    draws: int
    rounds: int
    takes: int


QUICK = Effort(longest_s=2.0, mountings=8, draws=2, rounds=5, takes=0)
THOROUGH = Effort(longest_s=math.inf, mountings=24, draws=8, rounds=15, takes=8)


class Scope(NamedTuple):
    """What is tried out on every recording."""

    candidates: Sequence[Candidate]
    metrics: Mapping[str, Metric]
    effort: Effort
    seed: int


def measure_tradeoff(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Recording | Iterable[Recording],
    *,
    reducers: str | Reducer | Iterable[str | Reducer] | Mapping[str, Reducer] = "all",
    metrics: str | Metric | Iterable[str | Metric] | Mapping[str, Metric] = (),
    windows_ms: Sequence[float] = (),
    thorough: bool = False,
    rng: Rng = 0,
    workers: int | Workers = 1,
    progress: Progress = False,
) -> DataFrame:
    """Measure speed, accuracy and stability of every reducer on every recording.

    Parameters
    ----------
    recordings : Recording, or iterable of Recording
        Conditioned, as they are felt; each with a name of its own.
    reducers : "all", or a list of str or callables
        Names of `REDUCERS`, dotted names ("mylab.haptics:my321"), or functions f(acceleration, rate_hz); or a mapping
        of names to functions.
    metrics : list of str or callables
        Metrics beside the match metrics: names of `METRICS`, dotted names, or functions f(acceleration, reduced,
        rate_hz); or a mapping of names to functions.
    windows_ms : sequence of float
        Further windows in ms, for the reducers that work in windows.
    thorough : bool
        Whole recordings instead of their strongest 2 s, 72 orientations instead of 24, more draws, and a battery of
        scenes on which reducers are known to fail. Takes many times as long.
    rng : int or Generator
        A seed, or a generator from which one is drawn: of noise and gaps. Times are never the same twice.
    workers : int or Workers
        Who measures; times are taken in this process, when nothing else runs.
    progress : bool or callable
        Whether to show a bar; or called with the numbers of steps done and to do.

    Returns
    -------
    DataFrame
        One row per number: kind, recording, reducer, condition, measure, value, low, high, n.

    Raises
    ------
    ValueError
        If there is no recording, two have the same name, there is no reducer, or one does not return one sample per
        sample.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> from feel321.analysis import measure_tradeoff
    >>> frame = measure_tradeoff(stimuli.make_scene("bumps", duration_s=0.5), reducers=["say321", "dft321"])
    >>> kept = frame[(frame["measure"] == "spectral_match") & (frame["condition"] == "as recorded")]
    >>> kept[["reducer", "value"]].round(2).to_dict("list")
    {'reducer': ['say321', 'dft321'], 'value': [0.45, 1.0]}
    """
    import pandas as pd
    from threadpoolctl import threadpool_limits

    known = as_recordings(recordings)
    chosen = REDUCERS.choose(reducers)
    if not chosen:
        raise ValueError("reducers must be one or more, got none; leave them out to take all")
    candidates = list_candidates(chosen, windows_ms=windows_ms)
    effort = THOROUGH if thorough else QUICK
    scope = Scope(candidates, METRICS.choose(metrics), effort, as_seed(rng))
    jobs: list[Job] = [(measure_recording, (one, scope), {}) for one in known]
    if thorough:
        jobs += [(_measure_scene, (name, scope), {}) for name in BATTERY]
    steps, total = count(1), len(jobs) + len(known)
    # Threads of the linear algebra would be timed with the reducers.
    with follow(progress, "tradeoff") as tick, threadpool_limits(limits=1):
        found = gather_results(jobs, workers=workers, done=lambda: tick(next(steps), total))
        rows = [row for own in found for row in own]
        rows += _measure_costs(known, scope, tick=lambda: tick(next(steps), total))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def as_recordings(given: Recording | Iterable[Recording]) -> tuple[Recording, ...]:
    """Take several recordings, or one; refuse none, two of the same name, and whatever is none."""
    several = (given,) if isinstance(given, Recording | str) else given
    recordings = tuple(several) if isinstance(several, Iterable) else (several,)
    for one in recordings:
        if not isinstance(one, Recording):
            do = "make one with stimuli.read_recording or stimuli.Recording"
            raise TypeError(f"recordings must be Recordings, got {describe(one)}; {do}")
    names = [one.name for one in recordings]
    doubled = [name for name in names if names.count(name) > 1]
    if doubled or not names:
        got = f"{doubled[0]!r} twice; rename one" if doubled else "none; name some"
        raise ValueError(f"recordings must be one or more with different names, got {got}")
    return recordings


def make_row(place: Place, measure: str, values: object, *, kind: str = "recording") -> Row:
    """Make a row of the frame: of several values the mean and the extremes."""
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[~np.isnan(known)]
    several = (known.mean(), known.min(), known.max()) if len(known) else (math.nan,) * 3
    row = (kind, *place, measure, *map(float, several), len(known))
    return dict(zip(COLUMNS, row, strict=True))


def measure_recording(recording: Recording, scope: Scope) -> list[Row]:
    """Measure all that takes no time: properties of a recording, and what every reducer makes of it."""
    about = (recording.name, "", RECORDED)
    felt = felt_level(recording) if recording.rate_hz >= 2 * LOWEST_HZ else 0.0
    known = {"rate_hz": recording.rate_hz, "duration_s": recording.duration_s, "felt_level": felt}
    rows = [make_row(about, *one) for one in known.items()]
    if felt == 0 or recording.duration_s < SHORTEST_S:
        return rows
    piece = take_strongest(recording, scope.effort.longest_s)
    rows.append(make_row(about, "used_s", piece.duration_s))
    # Energy along the second principal axis over that along the first: whether a direction leads.
    values = np.linalg.eigvalsh(np.cov(piece.acceleration))
    ratio = max(values[1], 0.0) / values[2] if values[2] > 0 else math.nan
    rows.append(make_row(about, "eigenvalue_ratio", ratio))
    stage = Stage(piece, scope)
    for candidate in scope.candidates:
        needs = find_needs(candidate, n_samples=piece.n_samples, rate_hz=piece.rate_hz)
        rows += [make_row((piece.name, candidate.name, ""), *one) for one in needs.items()]
        for condition, scores in stage.try_out(candidate):
            place = (piece.name, candidate.name, condition)
            rows += [make_row(place, *one) for one in scores.items()]
    return rows


def take_strongest(recording: Recording, longest_s: float) -> Recording:
    """Take the strongest part of a recording, of a length that is fast to transform."""
    from scipy.fft import prev_fast_len

    wanted = min(longest_s * recording.rate_hz, recording.n_samples)
    length = prev_fast_len(max(round(wanted), 1))
    energy = np.cumsum(np.square(recording.acceleration).sum(axis=0))
    start = int(np.argmax(energy[length - 1 :] - np.concatenate([[0.0], energy[:-length]])))
    return replace(recording, acceleration=recording.acceleration[:, start : start + length])


class Reference:
    """A signal that outputs are compared with: what no orientation of the sensor changes is computed once."""

    def __init__(self, samples: Samples, rate_hz: float, metrics: Mapping[str, Metric]) -> None:
        from scipy import fft

        self.samples, self.rate_hz, self._metrics = samples, rate_hz, metrics
        n = samples.shape[-1]
        self._original = OriginalSpectrum(samples, rate_hz)
        self._smooth = WeberSmoothing(linear_grid(n, rate_hz), rate_hz / n, n // 2 + 1)
        frequency = np.arange(n // 2 + 1) * rate_hz / n
        felt = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
        thresholds = acceleration_threshold(np.where(felt, frequency, LOWEST_HZ))
        self._weights = np.where(felt, 1 / thresholds**2, 0.0)
        self._power = _square(fft.rfft(samples)).sum(axis=0)
        pair = Pair(samples, samples[0], rate_hz)
        energy, _, self._envelope_hz = follow_energy(pair)
        self._felt, self._depths = pair.felt, find_depths(energy, self._envelope_hz)
        self._size = float(np.linalg.norm(samples))
        hop = max(round(HOP_S * rate_hz), 1)
        self._starts = np.arange(0, n, hop)
        hops = np.add.reduceat(np.square(samples).sum(axis=0), self._starts)
        rises = (hops[1:] >= RISE * hops[:-1]) & (hops[1:] >= LOUD * hops.max())
        self._onsets = np.flatnonzero(rises) + 1

    def score_felt(self, output: Samples) -> dict[str, float]:
        """Score what a rotation of the sensor changes only if it changes the output, (n,)."""
        from scipy import fft

        spectrum = fft.rfft(output)
        power, energy = _square(spectrum), follow_band(spectrum, self._felt)
        level = float(power @ self._weights) / float(self._power @ self._weights)
        own, kept = self._power[self._smooth.bins], power[self._smooth.bins]
        total, apart = self._smooth(own + kept).sum(), np.abs(self._smooth(own - kept)).sum()
        distance = float(compare_depths(self._depths, find_depths(energy, self._envelope_hz)))
        spectral, bounded = map(float, self._original.match_both(output))
        found = {
            "level_db": to_db(level),
            "spectrum_db": -to_db(float((total - apart) / (total + apart))),
            "envelope_db": 2 * to_db(1 + distance),
            "spectral_match": spectral,
            "spectral_match_bounded": bounded,
        }
        if len(self._onsets):
            hops = np.add.reduceat(np.square(output), self._starts)
            before, after = hops[self._onsets - 1].sum(), hops[self._onsets].sum()
            found["pre_echo_db"] = to_db(float(before / after)) if after > 0 else MOST_DB
        return found

    def score_along(self, turned: Samples, output: Samples) -> dict[str, float]:
        """Score the waveform against the axes as they are mounted, (3, n); and by a lab's own metrics."""
        size = float(np.linalg.norm(output))
        along = float(np.linalg.norm(turned @ output))
        share = min(along / (size * self._size), 1.0) if size > 0 else 0.0
        return {
            "motion_db": -2 * to_db(share),
            "temporal_match": float(mean_over_axes(axis_correlations(turned, output))),
            "temporal_match_windowed": float(match_in_windows(turned, output, self.rate_hz)),
            **{
                name: float(one(turned, output, self.rate_hz))
                for name, one in self._metrics.items()
            },
        }


def _square(spectrum: Any) -> Samples:  # noqa: ANN401 - complex numbers
    return np.asarray(np.square(spectrum.real) + np.square(spectrum.imag))


def to_db(ratio: float) -> float:
    """Write a ratio of energies in dB, at most 60 either way."""
    most = 10 ** (MOST_DB / 10)
    return 10 * math.log10(min(max(ratio, 1 / most), most))


class Stage:
    """A recording and all that is done to it, made once for all reducers."""

    def __init__(self, recording: Recording, scope: Scope) -> None:
        samples, self._rate_hz = recording.acceleration, recording.rate_hz
        effort = scope.effort
        rng = np.random.default_rng([scope.seed, zlib.crc32(recording.name.encode())])
        self._whole = Reference(samples, self._rate_hz, scope.metrics)
        middle = samples.shape[-1] // 2
        self._halves = {}
        for name, half in zip(HALVES, np.split(samples[:, : 2 * middle], 2, axis=1), strict=True):
            is_loud = np.square(half).sum() >= QUIET * np.square(samples).sum()
            if middle / self._rate_hz >= SHORTEST_S and is_loud and felt_level(half, self._rate_hz):
                self._halves[name] = Reference(half, self._rate_hz, {})
        self._turned = [turn @ samples for turn in spread_turns(effort.mountings)]
        self._disturbed = {
            "noise": [_add_noise(samples, rng) for _ in range(effort.draws)],
            "gaps": [_lose_samples(samples, self._rate_hz, rng) for _ in range(effort.draws)],
            "clipping": [_clip(samples)],
        }

    def try_out(self, candidate: Candidate) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield each condition and what a reducer makes of it: measure -> value, or its values over draws."""
        whole, samples = self._whole, self._whole.samples
        output = self._reduce(candidate, samples)
        felt = whole.score_felt(output)
        yield RECORDED, felt | whole.score_along(samples, output)
        for condition, disturbed in self._disturbed.items():
            changes = [
                find_change(output, self._reduce(candidate, one)) - find_change(samples, one)
                for one in disturbed
            ]
            yield condition, {"change_db": [_change_db(one) for one in changes]}
        scaled = self._reduce(candidate, GAIN * samples) / GAIN
        yield "gain", {"change_db": _change_db(find_change(output, scaled))}
        yield MOUNTED, self._try_mountings(candidate, output, felt)
        for name, half in self._halves.items():
            own = self._reduce(candidate, half.samples)
            yield name, half.score_felt(own) | half.score_along(half.samples, own)

    def _try_mountings(
        self, candidate: Candidate, output: Samples, felt: dict[str, float]
    ) -> dict[str, list[float]]:
        """Turn the sensor; orientations that were found to leave an output as it is are not reduced again."""
        scores: dict[str, list[float]] = {}
        reduced, own, change = output, felt, 0.0
        turns_along = treats_alike = False
        for number, turned in enumerate(self._turned):
            if not (turns_along or (treats_alike and number % AXES)):
                before = reduced
                reduced = self._reduce(candidate, turned)
                own, change = self._whole.score_felt(reduced), find_change(output, reduced)
                alike = number == 1 and find_change(before, reduced) <= SAME**2
                treats_alike = treats_alike or alike
                turns_along = treats_alike and change <= SAME**2
            found = own | self._whole.score_along(turned, reduced)
            found["change_db"] = _change_db(change)
            for name, value in found.items():
                scores.setdefault(name, []).append(value)
        return scores

    def _reduce(self, candidate: Candidate, samples: Samples) -> Samples:
        """Reduce one signal; a function of the caller's own may return anything."""
        output = np.asarray(candidate.reduce(samples, self._rate_hz))
        is_real = output.dtype.kind in "iuf" and bool(np.isfinite(output).all())
        if output.shape != samples.shape[-1:] or not is_real:
            must = f"must return finite real numbers of the shape {samples.shape[-1:]}"
            got = f"got {output.dtype} of shape {output.shape}"
            raise ValueError(f"reducer {candidate.name} {must}, {got}")
        return output.astype(np.float64, copy=False)


def spread_turns(number: int) -> Samples:
    """Spread orientations, (3 * number, 3, 3), evenly over all rotations."""
    from scipy.spatial.transform import Rotation
    from scipy.stats import qmc

    points = qmc.Halton(3, scramble=False).random(number + 1)[1:]  # the first point is a corner
    low, high = np.sqrt(1 - points[:, 0]), np.sqrt(points[:, 0])
    second, third = 2 * np.pi * points[:, 1:].T
    parts = low * np.sin(second), low * np.cos(second), high * np.sin(third), high * np.cos(third)
    turns = Rotation.from_quat(np.transpose(parts)).as_matrix()
    # Each with the axes in each other's place: over all of them the three single axes are equal.
    return np.array([np.roll(turn, step, axis=0) for turn in turns for step in range(AXES)])


def find_change(before: Samples, after: Samples) -> float:
    """Find the energy of a change relative to what was; a vibration and its negative feel alike."""
    energy = float(np.square(before).sum())
    apart = min(float(np.square(after - before).sum()), float(np.square(after + before).sum()))
    if energy == 0:
        return float(apart > 0)
    return apart / energy


def _change_db(change: float) -> float:
    return 10 * math.log10(max(change, LEAST))


def _add_noise(samples: Samples, rng: np.random.Generator) -> Samples:
    noise = rng.standard_normal(samples.shape)
    return samples + NOISE * float(np.linalg.norm(samples) / np.linalg.norm(noise)) * noise


def _lose_samples(samples: Samples, rate_hz: float, rng: np.random.Generator) -> Samples:
    length, n = max(round(GAP_S * rate_hz), 1), samples.shape[-1]
    lost = samples.copy()
    for start in rng.integers(0, max(n - length, 1), size=max(round(GAP_SHARE * n / length), 1)):
        lost[:, start : start + length] = 0.0
    return lost


def _clip(samples: Samples) -> Samples:
    """Saturate all axes at one magnitude, found by bisection."""
    sizes, energy = np.abs(samples), float(np.square(samples).sum())
    low, high = 0.0, float(sizes.max())
    for _ in range(40):
        middle = (low + high) / 2
        cut = float(np.square(np.maximum(sizes - middle, 0.0)).sum())
        low, high = (middle, high) if cut > CLIPPED * energy else (low, middle)
    return np.clip(samples, -high, high)


def _measure_scene(name: str, scope: Scope) -> list[Row]:
    """Measure takes of a scene of the battery: the median over them."""
    import pandas as pd

    takes = []
    for take in range(scope.effort.takes):
        seed = 1000 * scope.seed + take
        own = scope._replace(effort=QUICK, seed=seed)
        takes.append(pd.DataFrame(measure_recording(BATTERY[name].make(seed), own)))
    groups = pd.concat(takes).groupby(list(COLUMNS[1:5]), sort=False, as_index=False)
    found = groups[["value", "low", "high"]].median().assign(kind="battery", n=len(takes))
    return found[list(COLUMNS)].to_dict("records")  # type: ignore[return-value]  # columns have names


def _measure_costs(
    recordings: Sequence[Recording], scope: Scope, *, tick: Callable[[], None]
) -> list[Row]:
    """Time reducers on each recording, those of one length and rate together, and streams block by block."""
    rng, effort = np.random.default_rng(scope.seed), scope.effort
    rows: list[Row] = []
    alike: dict[tuple[int, float], list[Recording]] = {}
    for recording in recordings:
        piece = take_strongest(recording, effort.longest_s)
        alike.setdefault((piece.n_samples, piece.rate_hz), []).append(piece)
    for pieces in alike.values():
        timed = time_reducers(scope.candidates, pieces[0], rounds=effort.rounds, rng=rng)
        for candidate, (median, low, high) in timed:
            own = {"low": low, "high": high, "n": effort.rounds}
            places = [(piece.name, candidate.name, "") for piece in pieces]
            rows += [make_row(place, "cost_ratio", median) | own for place in places]
        for _ in pieces:
            tick()
    for candidate in scope.candidates:
        times_us = time_stream(candidate, rng)
        if times_us is not None:
            median, p99 = np.quantile(times_us, (0.5, 0.99)).tolist()
            place = ("", candidate.name, "")
            load = p99 / (1e6 * CARD_BLOCK / CARD_HZ)
            own = {"low": median, "high": p99, "n": len(times_us)}
            rows.append(make_row(place, "block_us", median, kind="machine") | own)
            rows.append(make_row(place, "block_load", load, kind="machine"))
    return rows
