"""Recordings in array files (NumPy, MATLAB), WAV, HaTT, LMT and IDE files.

- A MATLAB file is met in a child process (`matlab.py`), whose memory and time are limited.
- WAV: three channels, and a sidecar for what a WAV header cannot say.
- HaTT (Penn Haptic Texture Toolkit): XML with one element per axis. The tags are known second-hand only, so ``AccelX``
  and nested ``Accel/X`` are both read, in any case.
- LMT-108 (TU München): one text file per axis, one value per line, 10 kHz.
- IDE (enDAQ), read by the optional package idelib.
"""

import io
import json
import logging
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from feel321 import files
from feel321.arguments import check_rate
from feel321.stimuli.formats import tables
from feel321.stimuli.recording import AXES
from feel321.stimuli.wav import read_wav, read_wav_header
from feel321.types import Samples

Arrays = Mapping[str, NDArray[Any]]
Columns = Sequence[str | int] | None  # as `read_recording` takes them
Value = TypeVar("Value", float, str)

# Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings.
ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
CHILD_S = 300.0  # So long may a MATLAB file take to be read


def read_npz(path: Path, wanted: Columns) -> tables.Decoded:
    """Read an NPZ archive by the names of its arrays."""
    content = io.BytesIO(files.read_bytes(path))
    with tables.foreign_errors("an NPZ archive"):
        archive = np.load(content, allow_pickle=False)
        # What the directory promises; no more is read of any array.
        files.check_bytes(sum(one.file_size for one in archive.zip.infolist()), "its arrays")
        arrays = {name: np.asarray(array) for name, array in archive.items()}
    return _decode(arrays, wanted)


def read_npy(path: Path, _: None) -> tables.Decoded:
    """Read a single array."""
    content = io.BytesIO(files.read_bytes(path))
    with tables.foreign_errors("an NPY array"):
        array = np.load(content, allow_pickle=False)
    return tables.Decoded(tables.as_three_axes(_as_numbers(array, "the array")))


def read_mat(path: Path, wanted: Columns) -> tables.Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables."""
    with files.open_regular(path):
        limit = files.read_limit()
    files.check_bytes(path.stat().st_size, path.name)
    child = str(Path(__file__).with_name("matlab.py"))
    words = [sys.executable, "-P", child, os.path.abspath(path), str(limit)]  # noqa: PTH100 - links stay as they are
    one_thread = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # each maps memory of its own
    with tables.foreign_errors("a MATLAB file"):
        try:
            done = subprocess.run(words, capture_output=True, timeout=CHILD_S, check=False, env=one_thread)  # noqa: S603 - our own program  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ValueError(f"it takes longer than {CHILD_S:g} s") from None
        said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        if done.returncode and said.startswith("MemoryError"):
            how = f"keep the recording alone, or set a larger {files.LIMIT} in the environment"
            raise files.TooLargeError(f"its variables take more than {limit / 1e6:,.0f} MB; {how}")
        if done.returncode:
            raise ValueError(files.clip(said, 200) or "it ends the program that reads it")
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as archive:
            arrays = dict(archive)
    return _decode(arrays, wanted)


def _decode(arrays: Arrays, wanted: Columns) -> tables.Decoded:
    """Find samples, rate, time and unit among named arrays."""
    columns = {name: array for name, array in arrays.items() if array.size != 1}
    names = tuple(columns)
    place = _choose(names, wanted, found=", ".join(arrays) or "nothing")
    axes = [names[i] for i in place.axes]
    if len(axes) == 1:
        samples = tables.as_three_axes(_as_numbers(columns[axes[0]], repr(axes[0])))
    else:
        vectors = {axis: _vector(columns, name) for axis, name in zip("xyz", axes, strict=True)}
        samples = tables.stack_axes(vectors)
    time_s, step_s = None, 0.0
    if place.time is not None:
        name, second = names[place.time], place.time_unit_s or 1.0
        stamps = _vector(columns, name)
        coarse = columns[name].dtype.type if columns[name].dtype.kind == "f" else np.float64
        time_s = stamps * second
        step_s = float(np.spacing(coarse(np.abs(stamps).max(initial=0.0)))) * second
    units, rates = {axes[0]: place.unit} if place.unit else {}, dict[str, float]()
    for name, array in arrays.items():
        if name.casefold() in tables.RATE_KEYS:
            if array.size != 1:
                raise ValueError(f"the rate must be one number, got {array.size} values")
            rates[name] = float(_as_numbers(array, "the rate").item())
        elif name.casefold() in tables.UNIT_KEYS:
            units[name] = tables.parse_unit(str(array.squeeze()))
    return tables.Decoded(samples, _agree(units), _agree(rates), time_s=time_s, time_step_s=step_s)


def _choose(names: Sequence[str], wanted: Columns, *, found: str) -> tables.Columns:
    """Choose the arrays of samples and time: as asked for, else by their names."""
    if wanted is not None:
        return tables.pick_columns(wanted, labels=names, n_columns=len(names), whole=True)
    bare = [tables.split_unit(name, tables.ACCELERATION_SPELLINGS)[0] for name in names]
    if not any(tables.AXIS.fullmatch(one) or one.casefold() in ACCELERATION_KEYS for one in bare):
        must = "an array must be named 'acceleration' (3, n), or three 'x', 'y' and 'z'"
        raise ValueError(f"{must}, got {found}; or say columns=(name,)")
    return tables.find_columns(names, wholes=ACCELERATION_KEYS)


def _agree(found: Mapping[str, Value]) -> Value | None:
    """Return the value that all names agree on."""
    if len(set(found.values())) > 1:
        said = ", ".join(f"{name} says {value!r}" for name, value in found.items())
        raise ValueError(f"the file gives several values that differ ({said}); leave one in it")
    return next(iter(found.values()), None)


def _vector(columns: Arrays, name: str) -> Samples:
    array = columns[name]
    if max(array.shape) != array.size:  # MATLAB knows no vectors, only rows and columns
        raise ValueError(f"{name!r} must have one value per sample, got shape {array.shape}")
    return _as_numbers(array.ravel(), repr(name))


def _as_numbers(array: NDArray[Any], what: str) -> Samples:
    """Convert real numbers to float64; refuse texts, objects and complex numbers."""
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{what} must be real numbers, got values of type {array.dtype}")
    files.check_bytes(8 * array.size, what)
    # What is not finite is refused where its place is known.
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float64)


FULL_SCALE_NOTE = "integer WAV without full_scale: full scale taken as 1.0 in the unit"


def read_wav_recording(path: Path, full_scale: float | None) -> tables.Decoded:
    """Read three channels of a WAV file, with what the JSON file of the same name says of them."""
    header, beside = read_wav_header(path), path.with_suffix(".json")
    said = _read_sidecar(beside) if beside.is_file() else {}
    axes = said.get("axes", ("x", "y", "z"))
    if header.channels == 1:
        raise tables.refuse_reduced("a WAV file with 1 channel")
    if len(axes) != header.channels:
        must = "there must be 3 channels, one per axis x, y, z, or a sidecar whose axes name each"
        raise ValueError(f"{must}; got {header.channels} for {len(axes)} axes")
    rate_hz = said.get("rate_hz", float(header.rate_hz))
    if abs(rate_hz - header.rate_hz) > max(1.0, 0.001 * header.rate_hz):
        both = f"the header says {header.rate_hz} Hz and the sidecar {rate_hz:g} Hz"
        raise ValueError(f"{both}, which differ by more than 1 Hz or 0.1 %; correct the wrong one")
    own = said.get("full_scale")
    asked = None if full_scale is None else check_rate(full_scale, "full_scale", "")
    if asked and own and asked != own:
        raise ValueError(f"full_scale={asked:g}, but the sidecar says {own:g}; leave one out")
    scale = asked or own
    if scale and header.is_float:
        raise ValueError("full_scale is for integer samples, these are float; leave it out")
    samples, _ = read_wav(path)
    acceleration = samples[[axes.index(axis) for axis in "xyz"]] * (scale or 1.0)
    notes = () if scale or header.is_float else (FULL_SCALE_NOTE,)
    sources = (path, beside) if beside.is_file() else (path,)
    return tables.Decoded(acceleration, said.get("unit"), rate_hz, notes=notes, sources=sources)


def _parse_axes(axes: Any) -> list[str]:  # noqa: ANN401 - whatever stands there
    names = [str(axis).lower() for axis in axes] if isinstance(axes, list | str) else []
    if sorted(name for name in names if name in {"x", "y", "z"}) != ["x", "y", "z"]:
        raise ValueError(f'axes must be a list with "x", "y" and "z" once each, got {axes!r}')
    return names


ENTRIES: Mapping[str, tuple[Sequence[str], Callable[[Any], Any]]] = {
    "unit": (tables.UNIT_KEYS, tables.parse_unit),
    "rate_hz": (tables.RATE_KEYS, check_rate),
    "axes": (("axes",), _parse_axes),
    "full_scale": (("full_scale",), partial(check_rate, what="full_scale", unit="")),
}
"""Entry of a sidecar -> its spellings, and what reads it. No others: a misspelt unit is worth a factor of 9.8."""


def _read_sidecar(path: Path) -> dict[str, Any]:
    """Read what a sidecar says."""
    keys = dict.fromkeys([*ENTRIES, *tables.UNIT_KEYS, *tables.RATE_KEYS])
    found: dict[str, Any] = {}
    try:
        text = files.read_small(path)
        with tables.foreign_errors("JSON"):
            entries: Any = json.loads(text)
        is_table = isinstance(entries, dict)
        if unknown := [key for key in entries if key not in keys] if is_table else [entries]:
            got = ", ".join(files.clip(repr(one)) for one in unknown)
            raise ValueError(f"entries must be {', '.join(keys)}, got {got}; correct or remove it")  # noqa: TRY301
        for name, (spellings, parse) in ENTRIES.items():
            present = [key for key in spellings if entries.get(key) is not None]
            if len(present) > 1:
                raise ValueError(f"{' and '.join(present)} mean the same; remove all but one")  # noqa: TRY301
            if present:
                found[name] = parse(entries[present[0]])
    except ValueError as error:
        said = str(error).removeprefix(f"{path.name}: ")
        raise ValueError(f"sidecar {path.name}: {said}") from None
    return found


SENSOR = r"accel(?:eration)?"
AXIS = re.compile(rf"{SENSOR}_?([xyz])")
UNIT = re.compile(rf"{SENSOR}_?units?")
RATE = re.compile(rf"(?:{SENSOR}_?)?sampl(?:e|ing)_?(?:rate|frequency)")
RATE_VALUE = re.compile(r"(\d+\.?\d*(?:e\+?\d+)?)\s*(k?)(?:hz)?", re.IGNORECASE | re.ASCII)

MOST_TAGS = 10_000
LARGER = 8  # So many tags may an XML file hold, and so many times its text takes in memory


def read_hatt(path: Path, _: None) -> tables.Decoded:
    """Read the three axes, the rate and the unit that an XML recording names."""
    from xml.etree import ElementTree as ET

    content = files.read_bytes(path, most=files.read_limit() // LARGER)
    # Entities can expand without end or name other files; a recording needs neither.
    if re.search(rb"<!\s*(doctype|entity)", content, re.IGNORECASE):
        raise ValueError("the XML declares a document type or entities, which are not read")
    if content.count(b"<") > 2 * MOST_TAGS:
        raise ValueError(f"there are more than {MOST_TAGS} tags")
    with tables.foreign_errors("XML"):
        root = ET.fromstring(content)  # noqa: S314 - entities were refused before
    # Each tag, small, without namespace, and once more with its parent's before it.
    tags: dict[str, list[str]] = defaultdict(list)
    for parent in root.iter():
        above = parent.tag.rpartition("}")[2].casefold()
        for child in parent:
            own = child.tag.rpartition("}")[2].casefold()
            for tag in (own, above + own):
                tags[tag].append((child.text or "").strip())
    axes = {tag[-1]: _only(found, tag) for tag, found in tags.items() if AXIS.fullmatch(tag)}
    if not axes and re.search(rf"\b{SENSOR}\b", " ".join(tags)):
        raise tables.refuse_reduced("a scalar Accel signal (the toolkit's DFT321 output)")
    if not axes:
        got = f"got tags {', '.join(list(tags)[:12]) or 'none'}"
        raise ValueError(f"the XML must hold AccelX, AccelY, AccelZ or Accel/X, Y, Z, {got}")
    units = {text for tag, found in tags.items() if UNIT.fullmatch(tag) for text in found}
    samples = tables.stack_axes({axis: _numbers(text, axis) for axis, text in axes.items()})
    unit = tables.parse_unit(_only(sorted(units), "units")) if units else None
    return tables.Decoded(samples, unit, _find_rate(tags))


def _find_rate(tags: Mapping[str, list[str]]) -> float | None:
    rates = {tag: found for tag, found in tags.items() if RATE.fullmatch(tag)}
    own = {text for tag, found in rates.items() if tag.startswith("accel") for text in found}
    if not (texts := own or {text for found in rates.values() for text in found}):
        return None
    text = _only(sorted(texts), "the sampling rate")
    if not (match := RATE_VALUE.fullmatch(text)):
        raise ValueError(f"the sampling rate must be a number in Hz, got {text!r}")
    return float(match[1]) * (1000.0 if match[2] else 1.0)


def _only(texts: list[str], tag: str) -> str:
    if len(texts) != 1:
        raise ValueError(f"there must be one element for {tag}, got {len(texts)}")
    return texts[0]


def _numbers(text: str, axis: str) -> Samples:
    words = re.split(r"[\s,;]+", text.strip(" \t\r\n,;"))
    try:
        return np.array(words, dtype=np.float64)
    except ValueError as error:
        got = files.clip(str(error), 120)
        raise ValueError(f"a value of the {axis} axis is not a number ({got})") from None


LMT_NAME = re.compile(r"(.+_(?:Movement|Tapping))_([XYZ])_((?:train|test)\d+)\.txt", re.IGNORECASE)
RATE_HZ = 10000.0
RATE_NOTE = "LMT-108 files name no rate: taken as the documented 10000 Hz (rate_hz=... says otherwise)"  # fmt: skip


def read_lmt(path: Path, rate_hz: float | None) -> tables.Decoded:
    """Read one axis of a triple and its two sisters beside it."""
    head, axis, tail = LMT_NAME.fullmatch(path.name).groups()  # type: ignore[union-attr]  # it has such a name
    letters = "XYZ" if axis.isupper() else "xyz"
    sisters = [path.with_name(f"{head}_{letter}_{tail}{path.suffix}") for letter in letters]
    if missing := [sister.name for sister in sisters if not sister.is_file()]:
        got = " and no ".join(missing)
        raise ValueError(f"there must be one file per axis x, y, z beside it, got no {got}")
    axes: dict[str, Samples] = {}
    for name, sister in zip("xyz", sisters, strict=True):
        table = tables.split_table(sister)
        if table.n_columns != 1:
            got = f"got {table.n_columns} columns"
            raise ValueError(f"{sister.name} must hold one value per line, {got}")
        axes[name] = tables.read_numbers(table, (0,)).ravel()
    own, notes = (RATE_HZ, (RATE_NOTE,)) if rate_hz is None else (None, ())
    samples, name = tables.stack_axes(axes), f"{head}_{tail}"
    return tables.Decoded(samples, rate_hz=own, notes=notes, sources=tuple(sisters), name=name)


LOST_SAMPLE = 1.5  # periods: a longer interval has lost samples, a shorter one a coarse clock


def read_ide(path: Path, _: None) -> tables.Decoded:
    """Read the triaxial accelerometer with the highest rate."""
    try:
        from idelib import importer
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[ide]'"
        raise ValueError(f"an enDAQ recording is read by idelib, which is missing; {how}") from None
    # In memory: idelib asks for as many bytes as the file promises, of a file they would be allocated.
    stream = io.BytesIO(files.read_bytes(path))
    stream.name = str(path)  # idelib asks for it
    files.check_bytes(4 * path.stat().st_size, "its samples")  # of two bytes each
    before = logging.root.manager.disable
    logging.disable()  # what is wrong with a file is raised anyway
    try:
        with tables.foreign_errors("an enDAQ recording"):
            dataset = importer.openFile(stream, quiet=True)
            importer.readData(dataset)
            found = [_read_channel(one) for one in dataset.channels.values() if one.sessions]
    finally:
        logging.disable(before)
    measured = [one for one in found if one and one[0].shape[1] > 1]
    if not measured:
        raise ValueError("there must be an accelerometer with three axes and samples, got none")
    samples, unit = max(measured, key=lambda pair: _rate_hz(pair[0][0]))
    time_s = samples[0] - samples[0, 0]
    if np.diff(time_s).max() * _rate_hz(time_s) < LOST_SAMPLE:
        return tables.Decoded(samples[1:], unit, _rate_hz(time_s))
    return tables.Decoded(samples[1:], unit, time_s=time_s)


def _read_channel(channel: Any) -> tuple[Samples, str] | None:  # noqa: ANN401 - idelib is not typed
    """Return time in s and the three axes of an accelerometer, shape (4, n_samples), and their unit."""
    rows: dict[str, tuple[int, str]] = {}  # the recorder's order is not always x, y, z
    for row, one in enumerate(channel.subchannels or ()):
        label_and_unit = one.units or ("", "")
        unit = tables.ACCELERATION_SPELLINGS.get(tables.normalise(str(label_and_unit[1])))
        if unit and (match := re.search(r"\b([xyz])\b", str(one.name), re.IGNORECASE)):
            rows[match[1].lower()] = row, unit
    if len(rows) < AXES:
        return None
    values = np.asarray(channel.getSession().arraySlice(), dtype=np.float64)
    stacked = np.stack([values[0] * 1e-6, *(values[1 + rows[axis][0]] for axis in "xyz")])
    return stacked, rows["x"][1]


def _rate_hz(time_s: Samples) -> float:
    return float((time_s.size - 1) / (time_s[-1] - time_s[0]))
