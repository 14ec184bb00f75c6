"""Shared by all readers of recordings: decoded samples, units, keywords, errors.

A reader raises ValueError with a bare sentence; `read_recording` adds the file's name.
"""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from feel321 import intake
from feel321.stimuli.recording import AXES, UNITS
from feel321.types import Samples

Value = TypeVar("Value", float, str)

RATE_KEYS = ("rate_hz", "fs", "rate", "sample_rate", "samplerate", "sampling_rate", "fs_hz")
UNIT_KEYS = ("unit", "units")
"""What the rate and the unit are called, in archives and sidecars alike."""

NO_UNIT_NOTE = "the file names no unit of acceleration: taken as m/s^2; if it is another, name it (unit, --unit)"

ACCELERATION_SPELLINGS = {
    "m/s^2": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "m/s/s": "m/s^2", "m/s**2": "m/s^2",
    "ms^-2": "m/s^2", "ms-2": "m/s^2", "ms⁻²": "m/s^2", "m·s⁻²": "m/s^2", "m*s^-2": "m/s^2", "ms2": "m/s^2",
    "g": "g", "gn": "g", "g0": "g", "gee": "g", "gees": "g",
    "mg": "mg", "milli-g": "mg", "millig": "mg",
}  # fmt: skip
"""Accepted spellings of a unit of acceleration (case, blanks and underscores aside) and the unit meant."""

TIME_SPELLINGS = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "μs": 1e-6, "usec": 1e-6, "micros": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nsec": 1e-9, "nanoseconds": 1e-9,
}  # fmt: skip
"""Accepted spellings of a unit of time and its size in s."""


@dataclass(frozen=True, slots=True)
class ReadingOptions:
    """Options of the caller; columns are (x, y, z) or (time, x, y, z), by name or number from 0."""

    rate_hz: float | None = None
    unit: str | None = None
    columns: Sequence[str | int] | None = None
    full_scale: float | None = None
    resample: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """The content of a file; first_line is the line of a text file that holds the first sample, from 1."""

    acceleration: Samples
    unit: str | None = None
    rate_hz: float | None = None
    time_s: Samples | None = None
    time_step_s: float = 0.0
    first_line: int | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[Path, ...] = ()
    name: str = ""


def stack_axes(axes: Mapping[str, Samples]) -> Samples:
    """Stack three axes of equal length, (n,) each, to (3, n); never shorten one to fit."""
    if len(axes) < AXES:
        got = f"only the axes {', '.join(sorted(axes))}" if axes else "no axes"
        raise ValueError(
            f"the file must hold three axes x, y, z, got {got}; a reduction needs all three"
        )
    lengths = {axis: axes[axis].size for axis in "xyz"}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{axis} {n}" for axis, n in lengths.items())
        raise ValueError(f"the axes must be of equal length, got {counts} samples; cut them alike")
    return np.stack([axes[axis] for axis in "xyz"])


def as_three_axes(values: Samples) -> Samples:
    """Turn an array to (3, n_samples), or say why it is not three axes."""
    got = f"an array of shape {values.shape}"
    if values.size == 0:
        raise ValueError(f"the array must have the shape (3, n) or (n, 3), got {got}: it is empty")
    if values.ndim == 2 and values.shape[0] == AXES:  # noqa: PLR2004 - axes x samples
        return values
    if values.ndim < 2 or (values.ndim == 2 and 1 in values.shape):  # noqa: PLR2004 - axes x samples
        raise refuse_reduced(got)
    if values.ndim == 2 and values.shape[1] == AXES:  # noqa: PLR2004 - axes x samples
        return values.T
    raise ValueError(
        f"the array must have the shape (3, n) or (n, 3), exactly three axes; got {got}"
    )


def refuse_reduced(got: str) -> ValueError:
    """Return the refusal of a signal with one axis."""
    return ValueError(
        f"{got} is one channel, so already reduced to one axis; read the raw three-axis recording instead"
    )


@contextmanager
def foreign_errors(what: str) -> Iterator[None]:
    """Translate whatever a library raises at a damaged file."""
    try:
        yield
    except Exception as error:  # libraries raise anything at damaged files, even UnboundLocalError
        # The system's own; libraries raise theirs without a number.
        if isinstance(error, intake.TooLargeError) or (isinstance(error, OSError) and error.errno):
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(
            f"cannot be read as {what} ({reason}); the file is damaged or of another kind, copy or export it again"
        ) from error


def normalise(text: str) -> str:
    """Strip case, blanks and underscores, and make both micro signs one."""
    return re.sub(r"[\s_]+", "", text).casefold()


LONGEST_LABEL = 1000
"""Characters: longer ones are no labels, and each gap would be tried."""


def split_unit(label: str, spellings: Container[str]) -> tuple[str, str | None]:
    """Split a column's label, such as ``x_g``, ``acc x (m/s²)`` or ``time [µs]``, into its bare name and its unit.

    Examples
    --------
    >>> split_unit("acc_x_m_s2", ACCELERATION_SPELLINGS)
    ('acc_x', 'ms2')
    >>> split_unit("x [V]", ACCELERATION_SPELLINGS)
    ('x', 'v')
    """
    label = label.strip()
    if len(label) > LONGEST_LABEL:
        return label, None
    if bracketed := re.fullmatch(r"(.+?)[\s_]*[\[(](.*)[\])]", label):
        return bracketed[1], normalise(bracketed[2])
    for gap in re.finditer(r"[\s_]+", label):
        if normalise(label[gap.end() :]) in spellings:
            return label[: gap.start()], normalise(label[gap.end() :])
    return label, None


def parse_unit(text: str) -> str:
    """Return the unit of acceleration meant by a spelling."""
    try:
        return ACCELERATION_SPELLINGS[normalise(text)]
    except (KeyError, TypeError):
        raise ValueError(f"the unit must be one of {', '.join(UNITS)}; got {text!r}") from None


def settle_unit(own: str | None, requested: str | None) -> tuple[str, tuple[str, ...]]:
    """Decide the unit from the file and the caller."""
    wanted = None if requested is None else parse_unit(requested)
    if own and wanted and own != wanted:
        raise ValueError(f"the file gives the unit {own!r}, but unit={requested!r}; leave unit out")
    unit = own or wanted
    return (unit, ()) if unit else ("m/s^2", (NO_UNIT_NOTE,))


def one_value(
    found: Mapping[str, Value], *, argument: str, requested: Value | None
) -> Value | None:
    """Return the value that all names agree on; where they differ, the one that the caller chooses.

    Examples
    --------
    >>> one_value({"fs": 100.0, "rate": 200.0}, argument="rate_hz", requested=200.0)
    200.0
    """
    values = set(found.values())
    if len(values) <= 1:
        return next(iter(values), None)
    if requested is not None and requested in values:
        return requested
    said = ", ".join(f"{name} says {value!r}" for name, value in found.items())
    raise ValueError(
        f"the file gives several values that differ ({said}); choose one of them by {argument}=..."
    )
