"""What reducers lose in 32-bit arithmetic: their own code, with 32-bit samples, coefficients and transforms.

Reducers compute in float64 whatever they are given, as a host computer may; a small processor would not. While
`in_32_bit` lasts, the modules of the reducers see a numpy whose results are all 32 bits wide, and the threshold of
rounding is that of 32 bits. Only the chart uses it: it changes these modules for the whole process, so that nothing
else may reduce at the same time.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from stimuli import axes, door, fourier, frames, leading, matched, principal, tracking

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import ModuleType

    from analysis.tradeoff.chart.methods import Method
    from stimuli.recording import Recording

_MODULES = (axes, door, fourier, frames, leading, matched, principal, tracking)
_TYPES = {"float64": np.float32, "complex128": np.complex64}
_NARROW = {np.dtype(name): kind for name, kind in _TYPES.items()}
_SAFE_PEAK = (1e-9, 1e9)
_ROUNDING = 32 * float(np.finfo(np.float32).eps)


class _Narrowed:
    """A function of numpy whose results are at most 32 bits wide per real number."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *given: object, **named: object) -> object:
        return _narrow(self._function(*given, **named))

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever a function of numpy has
        return _Narrowed(getattr(self._function, name))


class _Numpy32:
    """numpy as the modules of the reducers see it in 32 bits."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever numpy has
        found = _TYPES.get(name, getattr(np, name))
        return _Narrowed(found) if callable(found) and not isinstance(found, type) else found


def measure_loss(method: Method, recordings: Iterable[Recording]) -> tuple[float | None, str]:
    """Measure the energy of the error of 32-bit arithmetic relative to the output in 64 bits.

    Parameters
    ----------
    method : Method
        What works.
    recordings : iterable of Recording
        Signals; those whose output is silent are left out.

    Returns
    -------
    loss_db : float or None
        In dB, of the worst recording; None where no recording has an error.
    name : str
        The worst recording; empty where there is none.
    """
    worst: tuple[float | None, str] = (None, "")
    for scene in recordings:
        exact = method.reduce(scene.acceleration, scene.rate_hz)
        error = float(np.sum((reduce_in_32_bit(method, scene) - exact) ** 2))
        if error > 0 and exact.any():
            loss = 10 * float(np.log10(error / np.sum(exact**2)))
            worst = max(worst, (loss, scene.name), key=lambda one: -np.inf if one[0] is None else one[0])
    return worst


def reduce_in_32_bit(method: Method, recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Reduce a recording in 32-bit arithmetic.

    Parameters
    ----------
    method : Method
        What works.
    recording : Recording
        Its samples are brought below 1 by a power of two, which is exact, and rounded to 32 bits.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        The values of the 32-bit output.

    Raises
    ------
    TypeError
        If the output was wider: then something was computed in 64 bits.
    """
    exponent = int(np.frexp(np.abs(recording.acceleration).max(initial=0.0))[1])
    samples = np.ldexp(recording.acceleration, -exponent).astype(np.float32)
    with in_32_bit():
        reduced = method.reduce(samples, recording.rate_hz)
    if reduced.dtype != np.float32:
        raise TypeError(f"{method.label}: got an output of type {reduced.dtype}, allowed is float32 in 32 bits")
    return np.ldexp(reduced.astype(np.float64), exponent)


@contextmanager
def in_32_bit() -> Iterator[None]:
    """Let all reducers compute in 32 bits; not for use beside other threads.

    Yields
    ------
    None
        Everything is as before at the end.
    """
    swaps: list[tuple[ModuleType, str, Any]] = [(module, "np", _Numpy32()) for module in _MODULES]
    swaps += [(module, "ROUNDING", _ROUNDING) for module in _MODULES if hasattr(module, "ROUNDING")]
    swaps += [(leading, "_CUT", np.complex64(np.exp(1j))), (door, "SAFE_PEAK", _SAFE_PEAK)]
    swaps += [(door, "coerce_acceleration", np.asarray)]
    before = [(module, name, getattr(module, name)) for module, name, _ in swaps]
    try:
        for module, name, narrow in swaps:
            setattr(module, name, narrow)
        yield
    finally:
        for module, name, usual in before:
            setattr(module, name, usual)


def _narrow(result: Any) -> Any:  # noqa: ANN401 - whatever numpy gives
    if isinstance(result, (tuple, list)):
        return type(result)(map(_narrow, result))
    kind = _NARROW.get(result.dtype) if isinstance(result, (np.ndarray, np.generic)) else None
    with np.errstate(over="ignore", invalid="ignore"):  # fresh memory holds anything
        return result if kind is None else result.astype(kind)
