"""Recordings in WAV, HaTT, LMT and IDE files.

The tags are known second-hand only, so ``AccelX`` and nested ``Accel/X`` are both read, in any case.
"""

from __future__ import annotations

import io
import re
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.stimuli.formats.arrays import check_full_scale, read_sidecar
from feel321.stimuli.formats.common import (
    ACCELERATION_SPELLINGS,
    Decoded,
    already_reduced,
    foreign_errors,
    normalise,
    parse_unit,
    stack_axes,
)
from feel321.stimuli.formats.tables import lay_out, read_numbers, read_text
from feel321.stimuli.recording import AXES
from feel321.stimuli.wav import read_wav, read_wav_header

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from feel321.stimuli.formats.arrays import Sidecar
    from feel321.stimuli.formats.common import Request
    from feel321.stimuli.wav import WavHeader

# WAV recordings: three channels, and a sidecar for what a WAV header cannot say.


def read_wav_recording(path: Path, request: Request) -> Decoded:
    """Read three channels of a WAV file."""
    header = read_wav_header(path)
    sidecar = read_sidecar(path)
    channels = _channels(header.channels, sidecar)
    full_scale = _full_scale(header, sidecar, requested=request.full_scale)
    notes = (
        ()
        if full_scale
        else ("integer WAV without full_scale: full scale taken as 1.0 in the unit",)
    )
    samples, _ = read_wav(path)
    return Decoded(
        samples[channels] * (full_scale or 1.0),
        sidecar.unit,
        _true_rate(header.rate_hz, sidecar),
        notes=() if header.is_float else notes,
        sources=(path,) if sidecar.path is None else (path, sidecar.path),
    )


def _channels(n_channels: int, sidecar: Sidecar) -> list[int]:
    if n_channels == 1:
        raise already_reduced("a WAV file with 1 channel")
    if n_channels < AXES:
        raise ValueError(f"got {n_channels} channels, allowed is 3: one per axis x, y, z")
    axes = sidecar.axes or ("x", "y", "z")
    if len(axes) != n_channels:
        raise ValueError(
            f"got {n_channels} channels for {len(axes)} axes, allowed is 3, or a sidecar whose axes name every channel"
        )
    return [axes.index(axis) for axis in "xyz"]


def _true_rate(header_hz: int, sidecar: Sidecar) -> float:
    rate_hz = sidecar.rate_hz
    if rate_hz is None:
        return float(header_hz)
    if abs(rate_hz - header_hz) > max(1.0, 0.001 * header_hz):
        raise ValueError(
            f"got {header_hz} Hz in the header and {rate_hz:g} Hz in the sidecar, "
            "allowed is a difference of 1 Hz or 0.1 %; mend the one that is wrong"
        )
    return rate_hz


def _full_scale(header: WavHeader, sidecar: Sidecar, *, requested: float | None) -> float | None:
    requested = None if requested is None else check_full_scale(requested)
    if requested and sidecar.full_scale and requested != sidecar.full_scale:
        own = sidecar.full_scale
        raise ValueError(
            f"got full_scale={requested:g}, but the sidecar says {own:g}; leave one out"
        )
    full_scale = requested or sidecar.full_scale
    if full_scale and header.is_float:
        raise ValueError(
            "got full_scale for float samples, which are in the unit already; leave it out"
        )
    return full_scale


# HaTT recordings (Penn Haptic Texture Toolkit): XML with one element per axis.

SENSOR = r"accel(?:eration)?"
AXIS = re.compile(rf"{SENSOR}_?([xyz])")
UNIT = re.compile(rf"{SENSOR}_?units?")
RATE = re.compile(rf"(?:{SENSOR}_?)?sampl(?:e|ing)_?(?:rate|frequency)")
RATE_VALUE = re.compile(r"(\d+\.?\d*(?:e\+?\d+)?)\s*(k?)(?:hz)?", re.IGNORECASE | re.ASCII)

DEEPEST = 64
"""So deep may tags be nested: texts are collected at each depth, so that deeper ones cost the square."""


def read_hatt(path: Path, _: Request) -> Decoded:
    """Read the three axes, the rate and the unit that an XML recording names."""
    content = path.read_bytes()
    # Entities can expand without end or name other files; a recording needs neither.
    if re.search(rb"<!\s*(doctype|entity)", content, re.IGNORECASE):
        raise ValueError(
            "got XML that declares a document type or entities, allowed is plain XML; remove them"
        )
    tags = _collect_tags(_parse(content))
    axes = {tag[-1]: _one(found, tag) for tag, found in tags.items() if AXIS.fullmatch(tag)}
    if not axes:
        raise _no_axes(tags)
    units = {text for tag, found in tags.items() if UNIT.fullmatch(tag) for text in found}
    return Decoded(
        stack_axes({axis: _numbers(text, axis) for axis, text in axes.items()}),
        parse_unit(_one(sorted(units), "units")) if units else None,
        _rate(tags),
    )


def _parse(content: bytes) -> Element:
    from xml.etree import ElementTree as ET

    with foreign_errors("XML"):
        steps = ET.iterparse(io.BytesIO(content), events=("start", "end"))  # noqa: S314 - entities were refused before
        root: Element = next(steps)[1]
        depth = 1
        for event, _ in steps:
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise ValueError(f"got tags nested deeper than {DEEPEST}")
    return root


def _collect_tags(root: Element) -> Mapping[str, list[str]]:
    """Map each tag, small, without namespace, and once more with its parent's before it, to its texts."""
    tags: dict[str, list[str]] = defaultdict(list)
    for parent in root.iter():
        for child in parent:
            text = " ".join(child.itertext()).strip()
            tags[_local(child)].append(text)
            tags[_local(parent) + _local(child)].append(text)
    return tags


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2].casefold()


def _one(texts: list[str], tag: str) -> str:
    if len(texts) != 1:
        raise ValueError(
            f"got {len(texts)} elements for {tag}, allowed is one; which is meant cannot be told"
        )
    return texts[0]


def _no_axes(tags: Mapping[str, list[str]]) -> ValueError:
    if re.search(rf"\b{SENSOR}\b", " ".join(tags)):
        return already_reduced("a scalar Accel signal (the toolkit's DFT321 output)")
    found = ", ".join(list(tags)[:12]) or "none"
    return ValueError(
        f"got XML without acceleration (tags: {found}), allowed is AccelX, AccelY, AccelZ or Accel/X, Y, Z"
    )


def _numbers(text: str, axis: str) -> NDArray[np.float64]:
    words = re.split(r"[\s,;]+", text.strip(" \t\r\n,;"))
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise ValueError(
            f"got a value of the {axis} axis that is no number ({error}); mend it"
        ) from None
    if not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values)))
        raise ValueError(
            f"got {words[i]!r} as value {i} of the {axis} axis, allowed is a finite number"
        )
    return values


def _rate(tags: Mapping[str, list[str]]) -> float | None:
    rates = {tag: found for tag, found in tags.items() if RATE.fullmatch(tag)}
    own = {text for tag, found in rates.items() if tag.startswith("accel") for text in found}
    texts = own or {text for found in rates.values() for text in found}
    if not texts:
        return None
    text = _one(sorted(texts), "the sampling rate")
    if not (match := RATE_VALUE.fullmatch(text)):
        raise ValueError(f"got the sampling rate {text!r}, allowed is a number in Hz")
    return float(match[1]) * (1000.0 if match[2] else 1.0)


# LMT-108 recordings (TU München): one text file per axis, one value per line, 10 kHz.

NAME = re.compile(r"(.+_(?:Movement|Tapping))_([XYZ])_((?:train|test)\d+)", re.IGNORECASE)
REDUCED_FOLDER = "accelscansdft321"
RATE_HZ = 10000.0
RATE_NOTE = (
    "LMT-108 files name no rate: taken as the documented 10000 Hz (rate_hz=... says otherwise)"
)


def is_lmt(path: Path) -> bool:
    """Tell from the path whether a file belongs to the LMT-108 set."""
    return path.suffix.lower() == ".txt" and bool(NAME.fullmatch(path.stem) or _is_reduced(path))


def read_lmt(path: Path, request: Request) -> Decoded:
    """Read one axis of a triple and its two sisters beside it.

    request: the rate, where it is not the documented 10 kHz.
    """
    match = NAME.fullmatch(path.stem)
    if match is None or _is_reduced(path):
        raise already_reduced("a file of the folder AccelScansDFT321")
    head, axis, tail = match.groups()
    letters = "XYZ" if axis.isupper() else "xyz"
    sisters = {
        letter.lower(): path.with_name(f"{head}_{letter}_{tail}{path.suffix}") for letter in letters
    }
    if missing := [sister.name for sister in sisters.values() if not sister.is_file()]:
        raise ValueError(
            f"got no {' and no '.join(missing)} beside it, allowed is one file per axis x, y, z"
        )
    known = request.rate_hz is not None
    return Decoded(
        stack_axes({axis: _read_axis(sister) for axis, sister in sisters.items()}),
        rate_hz=None if known else RATE_HZ,
        notes=() if known else (RATE_NOTE,),
        sources=tuple(sisters.values()),
        name=f"{head}_{tail}",
    )


def _is_reduced(path: Path) -> bool:
    return any(part.lower() == REDUCED_FOLDER for part in path.absolute().parts[:-1])


def _read_axis(path: Path) -> NDArray[np.float64]:
    table = lay_out(read_text(path))
    if table.n_columns != 1:
        raise ValueError(
            f"got {table.n_columns} columns in {path.name}, allowed is one value per line"
        )
    return read_numbers(table, (0,)).ravel()


# enDAQ recordings (.IDE), read by the optional package idelib.

LOST_SAMPLE = 1.5
"""An interval of so many periods means that samples were lost; less is the coarse clock of the blocks."""


def read_ide(path: Path, _: Request) -> Decoded:
    """Read the triaxial accelerometer with the highest rate."""
    try:
        from idelib import importer
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[ide]'"
        raise ValueError(f"got an enDAQ recording, which idelib reads; {how}") from None
    # Opened here, because idelib leaves a file that it cannot read open.
    with foreign_errors("an enDAQ recording"), path.open("rb") as stream:
        dataset = importer.openFile(stream, quiet=True)
        importer.readData(dataset)
        triaxial = [c for c in dataset.channels.values() if c.sessions and len(_axes(c)) == AXES]
        found = [_read_channel(channel) for channel in triaxial]
    measured = [(samples, unit) for samples, unit in found if samples.shape[1] > 1]
    if not measured:
        raise ValueError(
            "got no accelerometer with three axes and samples, allowed is a triaxial recording"
        )
    samples, unit = max(measured, key=lambda pair: _rate_hz(pair[0][0]))
    time_s = samples[0] - samples[0, 0]
    even = bool(np.diff(time_s).max() * _rate_hz(time_s) < LOST_SAMPLE)
    return (
        Decoded(samples[1:], unit, _rate_hz(time_s))
        if even
        else Decoded(samples[1:], unit, time_s=time_s)
    )


def _axes(channel: Any) -> dict[str, int]:  # noqa: ANN401 - idelib is not typed
    """Return the row of each axis: the recorder's order is not always x, y, z."""
    rows: dict[str, int] = {}
    for row, subchannel in enumerate(channel.subchannels or ()):
        match = re.search(r"\b([xyz])\b", str(subchannel.name), re.IGNORECASE)
        if match and _unit(subchannel):
            rows[match[1].lower()] = row
    return rows


def _unit(subchannel: Any) -> str | None:  # noqa: ANN401 - idelib is not typed
    """Return the unit of acceleration, or None for what is no acceleration."""
    label_and_unit = subchannel.units or ("", "")
    return ACCELERATION_SPELLINGS.get(normalise(str(label_and_unit[1])))


def _read_channel(channel: Any) -> tuple[NDArray[np.float64], str | None]:  # noqa: ANN401 - idelib is not typed
    """Return time in s and the three axes, shape (4, n_samples), and their unit."""
    rows = _axes(channel)
    values = np.asarray(channel.getSession().arraySlice(), dtype=np.float64)
    stacked = np.stack([values[0] * 1e-6, *(values[1 + rows[axis]] for axis in "xyz")])
    return stacked, _unit(channel.subchannels[rows["x"]])


def _rate_hz(time_s: NDArray[np.float64]) -> float:
    return float((time_s.size - 1) / (time_s[-1] - time_s[0]))
