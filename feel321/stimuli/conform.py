"""Whether a lab's own reducer or metric keeps the form that everything else relies on, one sentence per check.

Reducers are tried on the lengths that public code fails on (1, 2, 3, even, odd), on silence, on signals twice and a
thousandth as strong, twice and in a second process; their streaming form in blocks of any size against the offline
form.
"""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.stimuli.own_methods import OwnMetric, OwnReducer
from feel321.types import Samples

if TYPE_CHECKING:
    from feel321.extensions import Method

RATE_HZ = 10_000.0
LENGTHS = (1, 2, 3, 64, 97, 1000)
LONG = 5000
FLOAT32 = 1e-5  # Relative deviation that files of 32-bit floats allow
ROUNDING = 1e-9
BLOCKS = (0, 1, 7, 64, 500)

_ELSEWHERE = (
    "import pickle, sys; path, work = pickle.load(sys.stdin.buffer); sys.path[:] = path; "
    "from feel321.stimuli.conform import digest_result; print(digest_result(pickle.loads(work)))"
)


@dataclass(frozen=True, slots=True)
class Checked:
    """The result of one check."""

    check: str
    passed: bool
    text: str


def _make_signal(n: int = LONG, seed: int = 321) -> Samples:
    scale = np.array([[1.0], [2.0], [0.5]])
    return np.asarray(scale * np.random.default_rng(seed).standard_normal((3, n)))


def _compare(got: Samples, wanted: Samples, *, method: Method, what: str) -> None:
    tolerance = FLOAT32 if method.origin == "command" else ROUNDING
    scale = float(np.abs(wanted).max(initial=0.0)) or 1.0
    off = float(np.abs(got - wanted).max(initial=0.0)) / scale
    if not off <= tolerance:
        raise ValueError(f"{what}: off by {off:.2g} of the peak, more than {tolerance:g}")


def _load(method: Method) -> str:
    if method.origin == "command":
        return "a command; it is run for every signal"
    found = method.load()
    if not callable(found):
        got = f"got {type(found).__name__}"
        raise TypeError(f"{method}: must be a function, or a class with __call__, {got}")
    return f"{method.place}, sha256 {method.sha256[:12]}"


def _check_shapes(reducer: OwnReducer) -> str:
    for n in LENGTHS:
        reducer(_make_signal(n), RATE_HZ)
    return f"n finite real numbers for n = {', '.join(map(str, LENGTHS))}"


def _check_silence(reducer: OwnReducer) -> str:
    single = np.zeros((3, 64))
    found = reducer(single, RATE_HZ)
    single[1] = _make_signal(64)[0]
    reducer(single, RATE_HZ)
    if found.any():
        raise ValueError(f"silence must stay silence, got a peak of {np.abs(found).max():.3g}")
    return "silence stays silence, silent axes do no harm"


def _check_scaling(reducer: OwnReducer) -> str:
    signal = _make_signal()
    once = reducer(signal, RATE_HZ)
    for factor in (2.0, 1e-3):
        what = f"a signal {factor:g} times as strong must give an output {factor:g} times as strong"
        scaled = reducer(factor * signal, RATE_HZ)
        _compare(scaled, factor * once, method=reducer.method, what=what)
    return "twice the signal gives twice the output"


def _check_batches(reducer: OwnReducer) -> str:
    if not reducer.method.find_fact("batches", otherwise=False):
        return "not claimed; signals are given one by one"
    many = np.stack([_make_signal(97, seed) for seed in range(3)])
    alone = np.stack([reducer(one, RATE_HZ) for one in many])
    _compare(reducer(many, RATE_HZ), alone, method=reducer.method, what="batches")
    return "several signals at once, (..., 3, n), as one by one"


def _check_stream(reducer: OwnReducer) -> str:
    """Compare the streaming form, in blocks of many sizes, with the offline form."""
    stream = reducer.open_stream(RATE_HZ)
    if stream is None:
        return "no streaming form"
    signal, rng, parts, start = _make_signal(), np.random.default_rng(1), [], 0
    while start < signal.shape[1]:
        size = int(rng.choice(BLOCKS))
        parts.append(stream.process(signal[:, start : start + size]))
        start += size
    parts.append(stream.flush())
    what = "the streaming form must give what the offline form gives, latency_samples later"
    got = np.concatenate(parts)[stream.latency_samples :]
    _compare(got, reducer(signal, RATE_HZ), method=reducer.method, what=what)
    return f"as the offline form, {stream.latency_samples} samples later, in blocks of any size"


def _check_metric(metric: OwnMetric) -> str:
    """Check what a metric gives for short, silent, strong and weak signals; and which way it goes."""
    axis, noise = _make_signal()[0], _make_signal(seed=7)[0]
    for n in LENGTHS[2:]:
        metric(_make_signal(n), _make_signal(n, 1)[0], RATE_HZ)
    for acceleration in (_make_signal(), np.zeros((3, LONG))):
        metric(acceleration, np.zeros(LONG), RATE_HZ)
    for reduced in (-axis, 10 * axis, 1e-3 * noise):
        metric(np.array([axis] * 3), reduced, RATE_HZ)
    same, other = (metric(np.array([axis] * 3), one, RATE_HZ) for one in (axis, noise))
    higher = metric.info.higher
    if not (same >= other if higher == "better" else same <= other):
        raise ValueError(
            f"higher is declared {higher}, but a signal gives {same:.4g} against itself and {other:.4g} against noise; "
            "declare the other direction"
        )
    return f"higher is {higher}: {same:.4g} for a signal against itself, {other:.4g} against noise"


def digest_result(method: Method) -> str:
    """Digest what a method makes of a signal."""
    signal = _make_signal(seed=5)
    if method.kind == "reducer":
        return hashlib.sha256(OwnReducer(method)(signal, RATE_HZ).tobytes()).hexdigest()
    return repr(OwnMetric(method)(signal, _make_signal(seed=6)[0], RATE_HZ))


def _check_repeats(own: OwnReducer | OwnMetric) -> str:
    if digest_result(own.method) != digest_result(own.method):
        raise ValueError("two calls with the same signal differ: random numbers need a fixed seed")
    return "the same twice"


def _check_elsewhere(own: OwnReducer | OwnMetric) -> str:
    """Compare with a second process, as parallel builds do."""
    method = own.method
    if method.origin in {"command", "function"}:
        return f"not tried: a {method.origin}"
    work = pickle.dumps((sys.path, pickle.dumps(method)))
    done = subprocess.run(  # noqa: S603 - this very Python
        [sys.executable, "-c", _ELSEWHERE], input=work, capture_output=True, check=False
    )
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise ValueError(f"fails in a second process: {last}")
    if done.stdout.decode().split()[-1] != digest_result(method):
        need = "random numbers need a fixed seed, and nothing may depend on the order of sets"
        raise ValueError(f"a second process gives another result: {need}")
    return "the same in a second process"


CHECKS: dict[str, dict[str, Callable[[Any], str]]] = {
    "reducer": {
        "shape": _check_shapes, "silence": _check_silence, "repeats": _check_repeats, "scaling": _check_scaling,
        "second process": _check_elsewhere, "batches": _check_batches, "streaming": _check_stream,
    },
    "metric": {"returns": _check_metric, "repeats": _check_repeats, "second process": _check_elsewhere},
}  # fmt: skip
SLOW = frozenset({"second process", "batches", "streaming"})


def check_method(method: Method, *, quick: bool = False) -> list[Checked]:
    """Check a reducer or a metric; quick: without batches, streaming and the second process."""
    found = [_try("loads", _load, method)]
    if not found[0].passed:
        return found
    own = OwnReducer(method) if method.kind == "reducer" else OwnMetric(method)
    wanted = {
        name: one for name, one in CHECKS[method.kind].items() if not (quick and name in SLOW)
    }
    return found + [_try(name, check, own) for name, check in wanted.items()]


def _try(name: str, check: Callable[[Any], str], tried: object) -> Checked:
    try:
        return Checked(name, passed=True, text=check(tried))
    except (TypeError, ValueError) as error:
        return Checked(name, passed=False, text=str(error))
