"""Read a recording of any known format: detect it, decode it, settle unit and sampling, inspect it.

The first bytes decide which format a file is, and only then its suffix. What is noticed is never repaired.
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from feel321.arguments import as_path, check_finite, check_rate
from feel321.files import check_samples, file_named, open_regular, read_bytes
from feel321.stimuli.formats import files
from feel321.stimuli.formats.tables import Decoded, parse_unit, read_table
from feel321.stimuli.recording import UNITS, Recording
from feel321.types import PathLike, Samples

MAGIC: Mapping[str, tuple[bytes, ...]] = {
    "wav": (b"RIFF", b"RIFX", b"RF64"), "npz": (b"PK\x03\x04", b"PK\x05\x06"), "npy": (b"\x93NUMPY",),
    "ide": (b"\x1aE\xdf\xa3",),
}  # fmt: skip
"""Format and the first bytes that mean it."""

REFUSED = {
    (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"):
        "MATLAB 7.3 and HDF5 files are not read; save it as an older MAT-file with save(..., '-v7')",
    (b"\xff\xfe", b"\xfe\xff", b"\x00\x00\xfe\xff"):
        "the text is in UTF-16 or UTF-32; save the file as UTF-8",
}  # fmt: skip
TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
SUFFIXES = (*TABLE_SUFFIXES, ".xml", ".wav", ".npz", ".npy", ".mat", ".ide")
TEXT_CONTROLS = frozenset(b"\t\n\v\f\r")
HEAD_BYTES = 4096


def detect_format(path: Path) -> str:
    """Find a file's format."""
    with open_regular(path) as file:
        head = file.read(HEAD_BYTES)
    if not head:
        raise ValueError("the file is empty (0 bytes); copy or export it again")
    if why := next((why for starts, why in REFUSED.items() if head.startswith(starts)), ""):
        raise ValueError(why)
    suffix = path.suffix.lower()
    is_text = all(byte >= ord(" ") or byte in TEXT_CONTROLS for byte in head)
    signs = {name: head.startswith(starts) for name, starts in MAGIC.items()} | {
        "mat": head.startswith(b"MATLAB 5.0") or (suffix == ".mat" and not is_text),  # version 4
        "hatt": is_text and head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"),
        "lmt": is_text and files.LMT_NAME.fullmatch(path.name) is not None,
        "table": is_text and suffix in TABLE_SUFFIXES,
    }
    if kind := next((kind for kind, is_so in signs.items() if is_so), ""):
        return kind
    if is_text and suffix in SUFFIXES:
        raise ValueError(f"a {suffix} file must not hold text; rename it to .csv if it is a table")
    got = f"the suffix {suffix!r}" if is_text else f"binary data of no known format ({suffix!r})"
    raise ValueError(f"the file must be one of {' '.join(SUFFIXES)}, got {got}")


SATURATED_SAMPLES = 3  # So many equal samples in a row at an axis's extreme count as saturated


def inspect_samples(acceleration: Samples, rate_hz: float) -> tuple[str, ...]:
    """Report saturated runs and constant axes, in samples (3, n) as recorded, not resampled.

    Saturated: three or more equal samples at an extreme that it came to or left by more than twice its smallest step.
    """
    findings = []
    for name, axis in zip("xyz", acceleration, strict=True):
        start = np.concatenate([[0], np.flatnonzero(np.diff(axis)) + 1])
        length, value = np.diff(np.append(start, axis.size)), axis[start]
        if len(start) == 1 and axis.size > 1:
            findings.append(f"axis {name}: flat, {value[0]:.6g} m/s^2 in all {axis.size} samples")
        jumps = np.abs(np.diff(value))
        jump = np.maximum(np.append(0.0, jumps), np.append(jumps, 0.0))
        for extreme in dict.fromkeys([value.min(), value.max()]) if len(start) > 1 else ():
            hit = (value == extreme) & (length >= SATURATED_SAMPLES)
            if hit.any():  # sorting takes long
                hit &= jump > 2 * np.diff(np.unique(value)).min()
            if hit.any():
                where = f"the first at {start[hit][0] / rate_hz:.6g} s"
                at = f"axis {name}: saturated at {extreme:.6g} m/s^2"
                findings.append(f"{at} in {hit.sum()} runs ({length[hit].sum()} samples), {where}")
    return tuple(findings)


AGREEMENT = 0.01  # How far, relatively, two statements of one rate may differ
JITTER_LIMIT = 0.01  # How far, in sampling periods, an interval may differ from the median interval
SPLINE_POINTS = 4  # A cubic spline needs as many samples


def settle_sampling(
    decoded: Decoded, *, rate_hz: float | None, resample: bool
) -> tuple[Samples, float, tuple[str, ...]]:
    """Settle the rate, and check that the samples are regular, or make them so; samples, rate and notes."""
    requested = None if rate_hz is None else check_rate(rate_hz)
    stated, samples = _agree(requested, decoded.rate_hz, who="the file"), decoded.acceleration
    if decoded.time_s is None:
        if stated is None:
            raise ValueError("there is no sampling rate and no time column; give rate_hz=...")
        return samples, stated, ()
    time_s = _check_stamps(decoded, decoded.time_s)
    finding, step_s = _find_jitter(time_s, decoded.time_step_s), decoded.time_step_s
    if not finding:
        measured_hz = (time_s.size - 1) / float(time_s[-1] - time_s[0])
        rate = _agree(stated, measured_hz, who="the time stamps") or measured_hz
        share = step_s * rate
        note = f"time stamps show steps of {step_s:g} s, {share:.0%} of the period: finer jitter cannot be seen"
        return samples, rate, (note,) if share > JITTER_LIMIT else ()
    if not resample:
        must = f"sampling must be regular to {JITTER_LIMIT:.0%} of the period, got {finding}"
        how = "resample=True (command line: --resample) interpolates to an even rate"
        raise ValueError(f"{must}; {how}")
    if time_s.size < SPLINE_POINTS:
        raise ValueError(f"resampling needs {SPLINE_POINTS} samples or more, got {time_s.size}")
    from scipy.interpolate import make_interp_spline

    elapsed = time_s - time_s[0]
    period = float(np.median(np.diff(time_s)))
    n_even = int(elapsed[-1] / period * (1 + 1e-12)) + 1
    check_samples(n_even, len(samples), 1 / period)
    grid = np.minimum(np.arange(n_even) * period, elapsed[-1])
    even = make_interp_spline(elapsed, samples, k=3, axis=1)(grid)
    _agree(stated, 1 / period, who="the time stamps")
    made = f"{n_even} samples at {1 / period:.6g} Hz by cubic spline"
    return even, 1 / period, (f"resampled on request to {made}: {finding}",)


def _agree(stated: float | None, own: float | None, *, who: str) -> float | None:
    if stated and own and abs(stated / check_rate(own) - 1) > AGREEMENT:
        most = f"they may differ by {AGREEMENT:.0%}"
        raise ValueError(f"the rate is {stated:g} Hz, but {own:g} Hz by {who}; {most}")
    return stated or own


def _check_stamps(decoded: Decoded, time_s: Samples) -> Samples:
    n_samples = decoded.acceleration.shape[1]
    if time_s.shape != (n_samples,):
        got = f"got {time_s.size} for {n_samples} samples"
        raise ValueError(f"there must be one time stamp per sample, {got}")
    if n_samples < 2:  # noqa: PLR2004 - an interval has two ends
        raise ValueError(f"there must be 2 time stamps or more, for a rate; got {n_samples}")
    rising = np.diff(time_s) > 0  # false for NaN too
    if not rising.all():
        i = int(np.argmin(rising)) + 1
        place = f"sample {i}" if decoded.first_line is None else f"line {decoded.first_line + i}"
        got = f"got {time_s[i]:.9g} after {time_s[i - 1]:.9g} s at {place}"
        how = "correct them, or leave the time column out and give rate_hz"
        raise ValueError(f"time stamps must increase, {got}; {how}")
    return time_s


def _find_jitter(time_s: Samples, step_s: float) -> str:
    """Describe the intervals that are off the median by more than the limit and the rounding of the stamps, if any."""
    intervals = np.diff(time_s)
    period = float(np.median(intervals))
    jitter = np.abs(intervals - period)
    # A rounded stamp is off by half a printed place, an interval by a whole one.
    rounding = max(step_s, 2 * float(np.spacing(np.abs(time_s).max())))
    irregular = np.flatnonzero(jitter > JITTER_LIMIT * period + 1.001 * rounding)
    if not irregular.size:
        return ""
    most = f"jitter up to {float(jitter.max()) / period:.1%} of the {period * 1e3:.6g} ms period"
    off = f"{irregular.size} of {intervals.size} intervals off"
    return f"{most}, {off}, the first at {time_s[irregular[0]]:.6f} s, the longest {intervals.max() * 1e3:.6g} ms"


NO_UNIT_NOTE = "the file names no unit of acceleration: taken as m/s^2; if it is another, name it (unit, --unit)"


READERS: Mapping[str, Callable[[Path, Any], Decoded]] = {
    "wav": files.read_wav_recording,
    "table": read_table,
    "npz": files.read_npz,
    "npy": files.read_npy,
    "mat": files.read_mat,
    "hatt": files.read_hatt,
    "lmt": files.read_lmt,
    "ide": files.read_ide,
}
"""Format name -> reader, the only list of formats; it also takes the one option that the format has."""


def read_recording(
    path: PathLike,
    *,
    rate_hz: float | None = None,
    unit: str | None = None,
    columns: Sequence[str | int] | None = None,
    full_scale: float | None = None,
    resample: bool = False,
) -> Recording:
    r"""Read a three-axis recording of any known format.

    Parameters
    ----------
    path : str or path
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

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from feel321 import stimuli
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "tap.csv")
    ...     _ = path.write_text("x,y,z\n0,0,1\n0,1,0\n1,0,0\n")
    ...     stimuli.read_recording(path, rate_hz=1000, unit="g")
    Recording('tap', 3 samples at 1000 Hz, 0.003 s)
    """
    source = as_path(path)
    with file_named(source):
        if source.is_dir():
            raise IsADirectoryError("is a folder; name a recording file in it")
        if not os.path.lexists(source):
            raise FileNotFoundError(f"there is no such file in {source.parent}; check the name")
        kind = detect_format(source)
        if columns is not None and kind not in {"table", "npz", "mat"}:
            raise ValueError(f"columns is for tables, NPZ and MAT, got a {kind} file; leave it out")
        if full_scale is not None and kind != "wav":
            raise ValueError(f"full_scale is for integer WAV, got a {kind} file; leave it out")
        option = {"wav": full_scale, "lmt": rate_hz}.get(kind, columns)
        decoded = READERS[kind](source, option)
        wanted, own = None if unit is None else parse_unit(unit), decoded.unit
        if own and wanted and own != wanted:
            raise ValueError(f"the file gives the unit {own!r}, but unit={unit!r}; leave unit out")
        # What is not finite is refused in the next line.
        with np.errstate(over="ignore", invalid="ignore"):
            acceleration = decoded.acceleration * UNITS[own or wanted or "m/s^2"]
        check_finite(acceleration, "acceleration")
        decoded = replace(decoded, acceleration=acceleration)
        samples, rate, notes = settle_sampling(decoded, rate_hz=rate_hz, resample=resample)
        digest = hashlib.sha256()
        for one in decoded.sources or (source,):
            digest.update(read_bytes(one))
        said = () if own or wanted else (NO_UNIT_NOTE,)
        told = (*said, *decoded.notes, *notes, *inspect_samples(acceleration, rate))
        name = decoded.name or source.stem
        return Recording(samples, rate, name=name, warnings=told, sha256=digest.hexdigest())
