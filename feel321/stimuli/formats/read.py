"""Read a recording of any known format: detect it, decode it, check its sampling."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.formats.arrays import read_mat, read_npy, read_npz
from feel321.stimuli.formats.common import Decoded, Request, file_named, settle_unit
from feel321.stimuli.formats.containers import (
    is_lmt,
    read_hatt,
    read_ide,
    read_lmt,
    read_wav_recording,
)
from feel321.stimuli.formats.tables import read_table
from feel321.stimuli.recording import UNITS, Recording, check_finite, check_rate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

# Which format a file is, by its first bytes and only then by its suffix.

MAGIC = {
    b"RIFF": "wav", b"RIFX": "wav", b"RF64": "wav",
    b"PK\x03\x04": "npz", b"PK\x05\x06": "npz", b"\x93NUMPY": "npy",
    b"MATLAB 5.0": "mat", b"\x1aE\xdf\xa3": "ide",
}  # fmt: skip
"""First bytes and the format that they mean."""

HDF5 = (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3")
WIDE_TEXT = (b"\xff\xfe", b"\xfe\xff", b"\x00\x00\xfe\xff")
TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
BINARY_SUFFIXES = (".wav", ".npz", ".npy", ".mat", ".ide")
SUFFIXES = (*TABLE_SUFFIXES, ".xml", *BINARY_SUFFIXES)
"""Every suffix that is read."""

TEXT_CONTROLS = frozenset(b"\t\n\v\f\r")
HEAD_BYTES = 4096


def detect_format(path: Path) -> str:
    """Tell a file's format."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if not head:
        raise ValueError(
            "got an empty file (0 bytes), allowed is a recording; copy or export it again"
        )
    for magic, name in MAGIC.items():
        if head.startswith(magic):
            return name
    if head.startswith(HDF5):
        raise ValueError(
            "got a MATLAB 7.3 or HDF5 file, allowed is an older MAT-file; save it with save(..., '-v7')"
        )
    if head.startswith(WIDE_TEXT):
        raise ValueError("got text in UTF-16 or UTF-32, allowed is UTF-8; save the file as UTF-8")
    return _detect_text(path, head)


def _detect_text(path: Path, head: bytes) -> str:
    suffix = path.suffix.lower()
    is_text = all(byte >= ord(" ") or byte in TEXT_CONTROLS for byte in head)
    if suffix == ".mat" and not is_text:
        return "mat"  # version 4 has no first bytes of its own
    if not is_text:
        raise ValueError(
            f"got binary data of no known format (suffix {suffix!r}), allowed is {_allowed()}"
        )
    if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
        return "hatt"
    if is_lmt(path):
        return "lmt"
    if suffix in TABLE_SUFFIXES:
        return "table"
    if suffix in SUFFIXES:
        raise ValueError(
            f"got text in a {suffix} file; rename it to .csv if it is a table, or export it again"
        )
    raise ValueError(f"got the unknown suffix {suffix!r}, allowed is {_allowed()}")


def _allowed() -> str:
    return " ".join(SUFFIXES)


# What a reader notices and never mends: saturated runs, silent axes, axes that stand still.

SATURATED_SAMPLES = 3
"""So many equal samples in a row at an axis's extreme count as saturated."""

STILL_S = 0.05
"""So long a run of equal samples counts as standing still."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Runs of equal samples on one axis.

    start: (n_runs,); length: (n_runs,); value: (n_runs,), what they are, in m/s².
    """

    start: NDArray[np.intp]
    length: NDArray[np.intp]
    value: NDArray[np.float64]


def inspect_samples(acceleration: NDArray[np.float64], rate_hz: float) -> tuple[str, ...]:
    """Report saturated runs, constant axes and axes that stand still, with counts and positions.

    acceleration: (3, n_samples), samples in m/s², as recorded (not resampled).

    Notes
    -----
    A run is *saturated* if three or more equal samples stand at the axis's minimum or maximum and the
    signal came or went by more than twice the smallest difference between its values: the smooth crest of a
    slow, quantised signal is entered and left one step at a time and is not reported.
    An axis *stands still* if it holds one value for 50 ms while another axis moves; where none moves it is
    silence.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.arange(1000) / 9)
    >>> inspect_samples(np.stack([wave, np.minimum(wave, 0.5), 0 * wave]), 1000.0)[0]
    'axis y: saturated at 0.5 m/s^2 in 18 runs (339 samples), the first at 0.005 s'
    """
    runs = [find_runs(axis) for axis in acceleration]
    held = [_held(axis_runs, rate_hz) for axis_runs in runs]
    silence = np.logical_and.reduce(held)
    findings: list[str] = []
    for name, axis_runs, still in zip("xyz", runs, held, strict=True):
        if axis_runs.start.size == 1:
            findings += _constant(name, axis_runs)
        else:
            findings += _saturated(name, axis_runs, rate_hz=rate_hz)
            findings += _stands_still(name, still & ~silence, rate_hz=rate_hz)
    return tuple(findings)


def find_runs(axis: NDArray[np.float64]) -> Runs:
    """Find the runs of equal samples.

    axis: (n_samples,).
    """
    start = np.concatenate([[0], np.flatnonzero(np.diff(axis)) + 1])
    return Runs(start, np.diff(np.append(start, axis.size)), axis[start])


def _constant(name: str, runs: Runs) -> Iterator[str]:
    if runs.length[0] > 1:
        yield f"axis {name}: flat, {runs.value[0]:.6g} m/s^2 in all {runs.length[0]} samples"


def _saturated(name: str, runs: Runs, *, rate_hz: float) -> Iterator[str]:
    jumps = np.abs(np.diff(runs.value))
    jump = np.maximum(np.append(0.0, jumps), np.append(jumps, 0.0))
    for extreme in (runs.value.min(), runs.value.max()):
        hit = (runs.value == extreme) & (runs.length >= SATURATED_SAMPLES)
        if hit.any() and (hit := hit & (jump > 2 * _smallest_step(runs))).any():
            yield (
                f"axis {name}: saturated at {extreme:.6g} m/s^2 in {hit.sum()} runs "
                f"({runs.length[hit].sum()} samples), the first at {runs.start[hit][0] / rate_hz:.6g} s"
            )


def _smallest_step(runs: Runs) -> float:
    return float(np.diff(np.unique(runs.value)).min())


def _held(runs: Runs, rate_hz: float) -> NDArray[np.bool_]:
    """Return which samples belong to a long run of equal ones, shape (n_samples,)."""
    long = runs.length >= max(SATURATED_SAMPLES, STILL_S * rate_hz)
    return np.repeat(long, runs.length)


def _stands_still(name: str, still: NDArray[np.bool_], *, rate_hz: float) -> Iterator[str]:
    runs = find_runs(still.astype(np.float64))
    long = (runs.value > 0) & (runs.length >= STILL_S * rate_hz)
    if long.any():
        yield (
            f"axis {name}: stands still while another moves, "
            f"{long.sum()} times for {STILL_S * 1000:g} ms or longer "
            f"({runs.length[long].sum()} samples), the first at {runs.start[long][0] / rate_hz:.6g} s"
        )


# One rate for all samples: agreed by file and caller, checked on the time stamps, or made on request.

AGREEMENT = 0.01
"""How far, relatively, two statements of one rate may differ."""

JITTER_LIMIT = 0.01
"""How far, in sampling periods, an interval may differ from the median interval."""

SPLINE_POINTS = 4
"""A cubic spline needs as many samples."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Samples at one rate.

    acceleration: (3, n_samples).
    """

    acceleration: NDArray[np.float64]
    rate_hz: float
    notes: tuple[str, ...] = ()


def settle_sampling(decoded: Decoded, request: Request) -> Sampled:
    """Settle the rate, and check that the samples are regular."""
    requested = None if request.rate_hz is None else check_rate(request.rate_hz)
    stated = _agree(requested, decoded.rate_hz, who="the file")
    if decoded.time_s is None:
        if stated is None:
            raise ValueError(
                "got no sampling rate and no time column, one is needed; give rate_hz=..."
            )
        return Sampled(decoded.acceleration, stated)
    time_s = _check_stamps(decoded)
    measured_hz = (time_s.size - 1) / float(time_s[-1] - time_s[0])
    irregular = _irregular(time_s, decoded.time_step_s)
    if irregular.size == 0:
        rate_hz = _agree(stated, measured_hz, who="the time stamps") or measured_hz
        return Sampled(decoded.acceleration, rate_hz, _coarse_stamps(decoded, rate_hz))
    finding = _describe(time_s, irregular)
    if not request.resample:
        raise ValueError(
            f"got irregular sampling: {finding}; allowed is {JITTER_LIMIT:.0%} of the period; "
            "resample=True (command line: --resample) interpolates to an even rate"
        )
    resampled = _resample(decoded.acceleration, time_s, finding=finding)
    _agree(stated, resampled.rate_hz, who="the time stamps")
    return resampled


def _agree(stated: float | None, own: float | None, *, who: str) -> float | None:
    if stated is None or own is None:
        return stated or own
    if abs(stated / check_rate(own) - 1) > AGREEMENT:
        raise ValueError(
            f"got {stated:g} Hz, but {own:g} Hz by {who}; allowed is a difference of {AGREEMENT:.0%}"
        )
    return stated


def _check_stamps(decoded: Decoded) -> NDArray[np.float64]:
    time_s, n_samples = decoded.time_s, decoded.acceleration.shape[1]
    if time_s is None or time_s.shape != (n_samples,):
        count = 0 if time_s is None else time_s.size
        raise ValueError(
            f"got {count} time stamps for {n_samples} samples, allowed is one stamp per sample"
        )
    if n_samples < 2:  # noqa: PLR2004 - an interval has two ends
        raise ValueError(
            f"got {n_samples} sample with a time stamp, allowed is 2 or more: they give the rate"
        )
    rising = np.diff(time_s) > 0  # false for NaN too
    if not rising.all():
        i = int(np.argmin(rising)) + 1
        place = f"sample {i}" if decoded.first_line is None else f"line {decoded.first_line + i}"
        raise ValueError(
            f"got time stamps that do not increase: {time_s[i]:.9g} after {time_s[i - 1]:.9g} s at {place}; "
            "mend the stamps, or leave the time column out and give rate_hz"
        )
    return time_s


def _irregular(time_s: NDArray[np.float64], step_s: float) -> NDArray[np.intp]:
    """Return the intervals off the median by more than the limit and the rounding of the stamps."""
    intervals = np.diff(time_s)
    period = float(np.median(intervals))
    # A rounded stamp is off by half a printed place, an interval by a whole one.
    rounding = max(step_s, 2 * float(np.spacing(np.abs(time_s).max())))
    return np.flatnonzero(np.abs(intervals - period) > JITTER_LIMIT * period + 1.001 * rounding)


def _describe(time_s: NDArray[np.float64], irregular: NDArray[np.intp]) -> str:
    intervals = np.diff(time_s)
    period = float(np.median(intervals))
    jitter = float(np.abs(intervals - period).max()) / period
    return (
        f"jitter up to {jitter:.1%} of the {period * 1e3:.6g} ms period, "
        f"{irregular.size} of {intervals.size} intervals off, the first at {time_s[irregular[0]]:.6f} s, "
        f"the longest {intervals.max() * 1e3:.6g} ms"
    )


def _coarse_stamps(decoded: Decoded, rate_hz: float) -> tuple[str, ...]:
    step_s = decoded.time_step_s
    if step_s * rate_hz <= JITTER_LIMIT:
        return ()
    share = step_s * rate_hz
    return (
        f"time stamps show steps of {step_s:g} s, {share:.0%} of the period: finer jitter cannot be seen",
    )


def _resample(
    acceleration: NDArray[np.float64], time_s: NDArray[np.float64], *, finding: str
) -> Sampled:
    from scipy.interpolate import make_interp_spline

    if time_s.size < SPLINE_POINTS:
        raise ValueError(
            f"got {time_s.size} samples to resample, allowed is at least {SPLINE_POINTS}"
        )
    elapsed = time_s - time_s[0]
    period = float(np.median(np.diff(time_s)))
    grid = np.arange(int(elapsed[-1] / period * (1 + 1e-12)) + 1) * period
    even = make_interp_spline(elapsed, acceleration, k=3, axis=1)(np.minimum(grid, elapsed[-1]))
    note = f"resampled on request to {grid.size} samples at {1 / period:.6g} Hz by cubic spline: {finding}"
    return Sampled(np.asarray(even, dtype=np.float64), 1 / period, (note,))


# One door for every format: detect, decode, settle unit and sampling, inspect, keep the digest.

READERS: Mapping[str, Callable[[Path, Request], Decoded]] = {
    "wav": read_wav_recording,
    "table": read_table,
    "npz": read_npz,
    "npy": read_npy,
    "mat": read_mat,
    "hatt": read_hatt,
    "lmt": read_lmt,
    "ide": read_ide,
}
"""Format name -> reader, the only list of formats."""


def read_recording(
    path: str | Path,
    *,
    rate_hz: float | None = None,
    unit: str | None = None,
    columns: Sequence[str | int] | None = None,
    full_scale: float | None = None,
    resample: bool = False,
) -> Recording:
    """Read a three-axis recording of any known format.

    Parameters
    ----------
    path : str or Path
        WAV, CSV, TSV, TXT, NPZ, NPY, MAT, HaTT XML, any axis of an LMT-108 triple, or enDAQ IDE. The content
        decides first, the suffix second.
    rate_hz : float, optional
        Sampling rate in Hz, where the file does not say; must agree within 1 % where it does.
    unit : {"m/s^2", "g", "mg"}, optional
        Unit of the samples, where the file does not say; must agree where it does.
    columns : sequence of str or int, optional
        (time, x, y, z) or (x, y, z) of a table, by name or by number from 0. Of an NPZ or MAT file also
        (time, acceleration) or (acceleration,).
    full_scale : float, optional
        What full scale of an integer WAV means, in the unit.
    resample : bool
        Make irregular sampling regular, instead of refusing it.

    Returns
    -------
    Recording
        Acceleration in m/s², its rate, and in `warnings` whatever was assumed, done or noticed.

    Raises
    ------
    ValueError
        If the file cannot be read as a three-axis recording; the message says what was got, what is
        allowed and what to do.
    OSError
        If there is no such file.
    """
    source = Path(path)
    request = Request(rate_hz, unit, columns, full_scale, resample)
    with file_named(source):
        decoded = _decode(source, request)
        unit_found, unit_notes = settle_unit(decoded.unit, unit)
        # What is not finite is refused in the next line.
        with np.errstate(over="ignore", invalid="ignore"):
            acceleration = decoded.acceleration * UNITS[unit_found]
        check_finite(acceleration, "acceleration")
        sampled = settle_sampling(replace(decoded, acceleration=acceleration), request)
        return Recording(
            sampled.acceleration,
            sampled.rate_hz,
            name=decoded.name or source.stem,
            warnings=(
                *unit_notes,
                *decoded.notes,
                *sampled.notes,
                *inspect_samples(acceleration, sampled.rate_hz),
            ),
            sha256=_digest(decoded.sources or (source,)),
        )


def _decode(path: Path, request: Request) -> Decoded:
    if path.is_dir():
        raise IsADirectoryError("got a folder, allowed is one recording file; name a file in it")
    if not path.exists():
        raise FileNotFoundError(f"got no such file in {path.parent}; check the name and the folder")
    kind = detect_format(path)
    if request.columns is not None and kind not in {"table", "npz", "mat"}:
        raise ValueError(
            f"got columns for a {kind} file, allowed is columns for tables, NPZ and MAT; leave it out"
        )
    if request.full_scale is not None and kind != "wav":
        raise ValueError(
            f"got full_scale for a {kind} file, allowed is only for integer WAV; leave it out"
        )
    return READERS[kind](path, request)


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()
