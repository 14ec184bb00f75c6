"""A lab's own reducers and metrics, called like feel321's: what they get is a copy, what they give is checked.

Any program can be a reducer: it reads a float32 WAV file of three channels, in m/s², and writes one of one channel, as
long and at the same rate. As a metric it also reads the reduced signal and prints a number on the last line.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from feel321.arguments import coerce_real, describe
from feel321.extensions import Method, call, find_method, split_command
from feel321.files import temporary_folder
from feel321.stimuli.recording import check_acceleration
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import MetricInfo, Samples

TIMEOUT_S = 60.0  # How long a command may take for one signal, unless its table says `timeout_s`
SLACK = 1e-9  # What rounding may add to a metric's declared bounds


def _call_on_copies(
    method: Method,
    function: Callable[..., object],
    samples: Sequence[Samples],
    *rest: float,
    doing: str,
) -> object:
    """Call a lab's function on copies of the samples, which it must leave as they are."""
    copies = [one.copy() for one in samples]
    output = call(method, function, *copies, *rest, doing=doing)
    for after, before in zip(copies, samples, strict=True):
        if after.shape != before.shape or not np.array_equal(after, before, equal_nan=True):
            raise ValueError(f"{method}: changed its input, which others share; work on a copy")
    return output


@dataclass(frozen=True, slots=True)
class OwnReducer:
    """A lab's reducer, with the calling form of `REDUCERS`."""

    method: Method

    @property
    def __name__(self) -> str:
        """The short name."""
        return self.method.name

    def __call__(self, acceleration: ArrayLike, rate_hz: float) -> Samples:
        """Reduce (..., 3, n) to (..., n): all signals at once where it declares `batches`, else one by one."""
        samples = check_acceleration(acceleration)
        if samples.ndim == 2 or self.method.find_fact("batches", otherwise=False):  # noqa: PLR2004 - axes x samples
            return self._reduce(samples, rate_hz)
        *many, axes, n = samples.shape
        rows = [self._reduce(one, rate_hz) for one in samples.reshape(-1, axes, n)]
        return np.reshape(rows, (*many, n))

    def _reduce(self, samples: Samples, rate_hz: float) -> Samples:
        where = _describe_input(samples, rate_hz)
        if self.method.origin == "command":
            output: object = _run_program(self.method, samples, rate_hz)
        else:
            function = self.method.load()
            output = _call_on_copies(self.method, function, [samples], float(rate_hz), doing=where)
        return _check_output(self.method, output, samples, where=where)

    def open_stream(self, rate_hz: float) -> OwnStream | None:
        """Open its streaming form, `stream(rate_hz)`, where it has one."""
        make = self.method.find_fact("stream") if self.method.is_python else None
        if make is None:
            return None
        stream = call(self.method, make, float(rate_hz), doing="opening its stream")
        return OwnStream(self.method, stream)

    def find_latency(self, rate_hz: float) -> float | None:
        """Find how many s after its sample a result can be there: measured in samples, or declared; else None."""
        stream = self.open_stream(rate_hz)
        samples = stream.latency_samples if stream else self.method.find_fact("latency")
        return samples / rate_hz if isinstance(samples, int | float) else None


@dataclass(frozen=True, slots=True)
class OwnStream:
    """The streaming form of a lab's reducer: `process(block)`, `flush()` and `latency_samples`."""

    method: Method
    stream: Any

    @property
    def latency_samples(self) -> int:
        """Its constant delay."""
        latency = call(self.method, getattr, self.stream, "latency_samples")
        if isinstance(latency, bool) or not isinstance(latency, int | np.integer) or latency < 0:
            got = f"got {describe(latency)}"
            raise ValueError(f"{self.method}: latency_samples must be a whole number from 0, {got}")
        return int(latency)

    def process(self, block: ArrayLike, *, out: Samples | None = None) -> Samples:
        """Reduce the next samples, (3, k), to as many, (k,)."""
        samples = check_acceleration(block)
        where = f"given a block of shape {samples.shape}"
        process = call(self.method, getattr, self.stream, "process")
        output = _call_on_copies(self.method, process, [samples], doing=where)
        checked = _check_output(self.method, output, samples, where=where)
        if out is None:
            return checked
        np.copyto(out, checked)
        return out

    def flush(self) -> Samples:
        """End the signal and return the samples that the delay still holds back."""
        doing = "ending its stream"
        output = call(self.method, call(self.method, getattr, self.stream, "flush"), doing=doing)
        return _check_output(self.method, output, np.zeros((3, self.latency_samples)), where=doing)


@dataclass(frozen=True, slots=True)
class OwnMetric:
    """A lab's metric, with the calling form of `METRICS`."""

    method: Method

    @property
    def __name__(self) -> str:
        """The short name."""
        return self.method.name

    @property
    def info(self) -> MetricInfo:
        """What it declares."""
        own = {name: self.method.find_fact(name) for name in ("higher", "low", "high", "unit")}
        known = {name: value for name, value in own.items() if value is not None}
        label = self.method.find_fact("label") or self.method.name.replace("_", " ")
        try:
            return MetricInfo(label, **known)
        except (TypeError, ValueError) as error:
            do = f"declare it in [metrics.{self.method.name}]"
            raise ValueError(f"{self.method}: {error}; {do}") from None

    def __call__(self, acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float) -> float:
        """Compare three axes, (3, n), with one, (n,)."""
        samples, signal = check_acceleration(acceleration), coerce_real(reduced, "reduced")
        where, info = _describe_input(samples, rate_hz), self.info
        if self.method.origin == "command":
            value: object = _run_program(self.method, samples, rate_hz, reduced=signal)
        else:
            both, function = [samples, signal], self.method.load()
            value = _call_on_copies(self.method, function, both, float(rate_hz), doing=where)
        known = isinstance(value, int | float | np.ndarray | np.generic)
        got = np.asarray(value if known else None)
        if got.size != 1 or got.dtype.kind not in "iuf":
            raise ValueError(f"{self.method}: must return a number, got {describe(value)}; {where}")
        number = float(got.item())
        slack = SLACK * max(1.0, abs(number)) if math.isfinite(number) else 0.0
        if math.isinf(number) or number < info.low - slack or number > info.high + slack:
            raise ValueError(
                f"{self.method}: must return a number from {info.low:g} to {info.high:g}, or NaN where nothing can be "
                f"compared, got {number:g}; {where}; correct it, or declare low and high"
            )
        return number


def find_reducer(given: object, taken: Collection[str]) -> OwnReducer:
    """Find a lab's reducer."""
    return OwnReducer(find_method("reducer", given, taken=taken))


def find_metric(given: object, taken: Collection[str]) -> OwnMetric:
    """Find a lab's metric."""
    return OwnMetric(find_method("metric", given, taken=taken))


def _describe_input(samples: Samples, rate_hz: float) -> str:
    return f"given samples of shape {samples.shape} at {rate_hz:g} Hz"


def _check_output(method: Method, output: object, samples: Samples, *, where: str) -> Samples:
    """Return a reducer's output as float64, or say what is wrong with it."""
    wanted = (*samples.shape[:-2], samples.shape[-1])
    must = f"{method}: must return finite real numbers of shape {wanted}"
    try:
        got = np.asarray(output)
    except Exception:  # noqa: BLE001 - whatever an object of the lab does
        raise ValueError(f"{must}, got {type(output).__name__}; {where}") from None
    if got.shape != wanted or got.dtype.kind not in "iuf":
        what = describe(output) if got.dtype == object else f"{got.dtype} of shape {got.shape}"
        raise ValueError(f"{must}, got {what}; {where}")
    if np.ma.is_masked(output):
        raise ValueError(f"{must}, got masked values; {where}")
    reduced = got.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(reduced))
    if bad.size:
        raise ValueError(f"{must}, got {bad.size} that are not finite, first at {bad[0]}; {where}")
    return reduced


def _run_program(
    method: Method, samples: Samples, rate_hz: float, *, reduced: Samples | None = None
) -> object:
    """Run a program from WAV to WAV; or, given a reduced signal, one that prints a number."""
    if samples.ndim != 2:  # noqa: PLR2004 - axes x samples
        raise ValueError(f"{method}: a command takes one signal at a time; leave out batches")
    with temporary_folder() as folder:
        source, target = folder / "input.wav", folder / "output.wav"
        write_wav(source, samples, round(rate_hz))
        if reduced is not None:
            write_wav(target, reduced, round(rate_hz))
            printed = _run(method, {"{input}": str(source), "{reduced}": str(target)})
            last = printed.rpartition("\n")[2].strip()
            with suppress(ValueError):
                return float(last)
            return last
        _run(method, {"{input}": str(source), "{output}": str(target)})
        if not target.is_file():
            do = "it must write a WAV file there"
            raise ValueError(f"{method}: the command wrote no file at {{output}}; {do}")
        try:
            samples, rate = read_wav(target)
        except (OSError, ValueError) as error:
            why = f"{{output}} cannot be read as a WAV file ({error})"
            raise ValueError(f"{method}: {why}") from None
        if rate != round(rate_hz):
            must = f"{{output}} must have its recording's rate of {round(rate_hz)} Hz"
            raise ValueError(f"{method}: {must}, got {rate} Hz; resample it")
        return samples


def _run(method: Method, files: Mapping[str, str]) -> str:
    """Run a command in the study's folder, and return what it printed."""
    words = split_command(method.kind, method.name, method.place)
    for mark, path in {**files, "{python}": sys.executable}.items():
        words = [word.replace(mark, path) for word in words]
    limit_s = float(method.find_fact("timeout_s", TIMEOUT_S))
    try:
        done = subprocess.run(  # noqa: S603 - the lab's own program, named in its study.toml
            words, cwd=method.folder, capture_output=True, timeout=limit_s, check=False, stdin=subprocess.DEVNULL
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        what = f"the command took longer than {limit_s:g} s and was stopped"
        raise ValueError(f"{method}: {what}; set timeout_s in its table") from None
    except OSError as error:
        do = "check its name, and whether it may be run"
        raise ValueError(f"{method}: {words[0]}: {error.strerror}; {do}") from None
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2][:200]
        said = f": {last}" if last else " and wrote nothing to stderr"
        raise ValueError(f"{method}: the command ended with exit code {done.returncode}{said}")
    return done.stdout.decode(errors="replace").strip()
