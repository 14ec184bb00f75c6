"""Recordings in WAV, HaTT, LMT and IDE files.

- WAV: three channels, and a sidecar for what a WAV header cannot say.
- HaTT (Penn Haptic Texture Toolkit): XML with one element per axis. The tags are known second-hand only, so ``AccelX``
  and nested ``Accel/X`` are both read, in any case.
- LMT-108 (TU München): one text file per axis, one value per line, 10 kHz.
- IDE (enDAQ), read by the optional package idelib.
"""

import io
import logging
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from feel321 import intake
from feel321.stimuli.formats import common, tables
from feel321.stimuli.formats.arrays import Sidecar, read_sidecar
from feel321.stimuli.recording import AXES, check_rate
from feel321.stimuli.wav import WavHeader, read_wav, read_wav_header
from feel321.types import Samples

FULL_SCALE_NOTE = "integer WAV without full_scale: full scale taken as 1.0 in the unit"


def read_wav_recording(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read three channels of a WAV file."""
    header = read_wav_header(path)
    sidecar = read_sidecar(path)
    channels = _channels(header.channels, sidecar)
    full_scale = _full_scale(header, sidecar, requested=request.full_scale)
    assumed = not (full_scale or header.is_float)
    samples, _ = read_wav(path)
    return common.Decoded(
        samples[channels] * (full_scale or 1.0),
        sidecar.unit,
        _true_rate(header.rate_hz, sidecar),
        notes=(FULL_SCALE_NOTE,) if assumed else (),
        sources=(path,) if sidecar.path is None else (path, sidecar.path),
    )


def _channels(n_channels: int, sidecar: Sidecar) -> list[int]:
    if n_channels == 1:
        raise common.refuse_reduced("a WAV file with 1 channel")
    if n_channels < AXES:
        raise ValueError(f"there must be 3 channels, one per axis x, y, z; got {n_channels}")
    axes = sidecar.axes or ("x", "y", "z")
    if len(axes) != n_channels:
        raise ValueError(
            f"there must be 3 channels, or a sidecar whose axes name every channel; "
            f"got {n_channels} for {len(axes)} axes"
        )
    return [axes.index(axis) for axis in "xyz"]


def _true_rate(header_hz: int, sidecar: Sidecar) -> float:
    rate_hz = sidecar.rate_hz
    if rate_hz is None:
        return float(header_hz)
    if abs(rate_hz - header_hz) > max(1.0, 0.001 * header_hz):
        raise ValueError(
            f"the header says {header_hz} Hz and the sidecar {rate_hz:g} Hz, which differ by more than 1 Hz or 0.1 %; "
            "correct the one that is wrong"
        )
    return rate_hz


def _full_scale(header: WavHeader, sidecar: Sidecar, *, requested: float | None) -> float | None:
    requested = None if requested is None else check_rate(requested, "full_scale", "")
    if requested and sidecar.full_scale and requested != sidecar.full_scale:
        raise ValueError(
            f"full_scale={requested:g}, but the sidecar says {sidecar.full_scale:g}; leave one out"
        )
    full_scale = requested or sidecar.full_scale
    if full_scale and header.is_float:
        raise ValueError(
            "full_scale is for integer samples, these are float and in the unit already; leave it out"
        )
    return full_scale


SENSOR = r"accel(?:eration)?"
AXIS = re.compile(rf"{SENSOR}_?([xyz])")
UNIT = re.compile(rf"{SENSOR}_?units?")
RATE = re.compile(rf"(?:{SENSOR}_?)?sampl(?:e|ing)_?(?:rate|frequency)")
RATE_VALUE = re.compile(r"(\d+\.?\d*(?:e\+?\d+)?)\s*(k?)(?:hz)?", re.IGNORECASE | re.ASCII)

DEEPEST, MOST_TAGS = 64, 10_000
"""So deep may tags be nested, and so many be there."""

LARGER = 8
"""So many times the text of an XML file takes in memory."""


def read_hatt(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read the three axes, the rate and the unit that an XML recording names."""
    content = intake.read_bytes(path, most=intake.read_limit() // LARGER)
    # Entities can expand without end or name other files; a recording needs neither.
    if re.search(rb"<!\s*(doctype|entity)", content, re.IGNORECASE):
        raise ValueError(
            "the XML declares a document type or entities, which are not read; remove them"
        )
    tags = _collect_tags(_parse(content))
    axes = {tag[-1]: _only(found, tag) for tag, found in tags.items() if AXIS.fullmatch(tag)}
    if not axes and re.search(rf"\b{SENSOR}\b", " ".join(tags)):
        raise common.refuse_reduced("a scalar Accel signal (the toolkit's DFT321 output)")
    if not axes:
        raise ValueError(
            "the XML must hold AccelX, AccelY, AccelZ or Accel/X, Y, Z, "
            f"got the tags {', '.join(list(tags)[:12]) or 'none'}"
        )
    units = {text for tag, found in tags.items() if UNIT.fullmatch(tag) for text in found}
    return common.Decoded(
        common.stack_axes({axis: _numbers(text, axis) for axis, text in axes.items()}),
        common.parse_unit(_only(sorted(units), "units")) if units else None,
        _rate(tags),
    )


def _parse(content: bytes) -> Element:
    from xml.etree import ElementTree as ET

    with common.foreign_errors("XML"):
        steps = ET.iterparse(io.BytesIO(content), events=("start", "end"))  # noqa: S314 - entities were refused before
        root: Element = next(steps)[1]
        depth = count = 1
        for event, _ in steps:
            depth, count = (depth + 1, count + 1) if event == "start" else (depth - 1, count)
            if depth > DEEPEST:
                raise ValueError(f"tags are nested deeper than {DEEPEST}")
            if count > MOST_TAGS:
                raise ValueError(f"there are more than {MOST_TAGS} tags")
    return root


def _collect_tags(root: Element) -> Mapping[str, list[str]]:
    """Map each tag, small, without namespace, and once more with its parent's before it, to its texts."""
    tags: dict[str, list[str]] = defaultdict(list)
    collected = 0
    for parent in root.iter():
        for child in parent:
            text = " ".join(child.itertext()).strip()
            collected += len(text)  # once per depth, so that deep ones cost the square
            intake.check_bytes(collected, "texts nested in each other")
            tags[_local(child)].append(text)
            tags[_local(parent) + _local(child)].append(text)
    return tags


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2].casefold()


def _only(texts: list[str], tag: str) -> str:
    if len(texts) != 1:
        raise ValueError(
            f"there must be one element for {tag}, got {len(texts)}; it is not clear which is meant"
        )
    return texts[0]


def _numbers(text: str, axis: str) -> Samples:
    words = re.split(r"[\s,;]+", text.strip(" \t\r\n,;"))
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise ValueError(
            f"a value of the {axis} axis is not a number ({intake.clip(str(error), 120)}); correct it"
        ) from None
    if not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values)))
        raise ValueError(
            f"value {i} of the {axis} axis must be a finite number, got {intake.clip(words[i])!r}"
        )
    return values


def _rate(tags: Mapping[str, list[str]]) -> float | None:
    rates = {tag: found for tag, found in tags.items() if RATE.fullmatch(tag)}
    own = {text for tag, found in rates.items() if tag.startswith("accel") for text in found}
    texts = own or {text for found in rates.values() for text in found}
    if not texts:
        return None
    text = _only(sorted(texts), "the sampling rate")
    if not (match := RATE_VALUE.fullmatch(text)):
        raise ValueError(f"the sampling rate must be a number in Hz, got {text!r}")
    return float(match[1]) * (1000.0 if match[2] else 1.0)


NAME = re.compile(r"(.+_(?:Movement|Tapping))_([XYZ])_((?:train|test)\d+)", re.IGNORECASE)
REDUCED_FOLDER = "accelscansdft321"
RATE_HZ = 10000.0
RATE_NOTE = (
    "LMT-108 files name no rate: taken as the documented 10000 Hz (rate_hz=... says otherwise)"
)


def is_lmt(path: Path) -> bool:
    """Whether, by its path, a file belongs to the LMT-108 set."""
    return path.suffix.lower() == ".txt" and bool(NAME.fullmatch(path.stem) or _is_reduced(path))


def read_lmt(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read one axis of a triple and its two sisters beside it.

    request: the rate, where it is not the documented 10 kHz.
    """
    match = NAME.fullmatch(path.stem)
    if match is None or _is_reduced(path):
        raise common.refuse_reduced("a file of the folder AccelScansDFT321")
    head, axis, tail = match.groups()
    letters = "XYZ" if axis.isupper() else "xyz"
    sisters = {
        letter.lower(): path.with_name(f"{head}_{letter}_{tail}{path.suffix}") for letter in letters
    }
    if missing := [sister.name for sister in sisters.values() if not sister.is_file()]:
        raise ValueError(
            f"there must be one file per axis x, y, z beside it, got no {' and no '.join(missing)}"
        )
    known = request.rate_hz is not None
    return common.Decoded(
        common.stack_axes({axis: _read_axis(sister) for axis, sister in sisters.items()}),
        rate_hz=None if known else RATE_HZ,
        notes=() if known else (RATE_NOTE,),
        sources=tuple(sisters.values()),
        name=f"{head}_{tail}",
    )


def _is_reduced(path: Path) -> bool:
    return any(part.lower() == REDUCED_FOLDER for part in path.absolute().parts[:-1])


def _read_axis(path: Path) -> Samples:
    table = tables.split_table(tables.read_text(path))
    if table.n_columns != 1:
        raise ValueError(f"{path.name} must hold one value per line, got {table.n_columns} columns")
    return tables.read_numbers(table, (0,)).ravel()


class _Content(io.BytesIO):
    """What a file holds: idelib asks for as many bytes as the file promises, of a file they would be allocated."""

    def __init__(self, path: Path) -> None:
        """Read the file."""
        super().__init__(intake.read_bytes(path))
        self.name = str(path)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep idelib from logging what is wrong with a file, which is raised anyway."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(before)


LOST_SAMPLE = 1.5
"""An interval of so many periods means that samples were lost; less is the coarse clock of the blocks."""


def read_ide(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read the triaxial accelerometer with the highest rate."""
    try:
        from idelib import importer
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[ide]'"
        raise ValueError(f"an enDAQ recording is read by idelib, which is missing; {how}") from None
    intake.check_bytes(4 * path.stat().st_size, "its samples")  # of two bytes each
    with common.foreign_errors("an enDAQ recording"), _silence(), _Content(path) as stream:
        dataset = importer.openFile(stream, quiet=True)
        importer.readData(dataset)
        triaxial = [c for c in dataset.channels.values() if c.sessions and len(_axes(c)) == AXES]
        found = [_read_channel(channel) for channel in triaxial]
    measured = [(samples, unit) for samples, unit in found if samples.shape[1] > 1]
    if not measured:
        raise ValueError("there must be an accelerometer with three axes and samples, got none")
    samples, unit = max(measured, key=lambda pair: _rate_hz(pair[0][0]))
    time_s = samples[0] - samples[0, 0]
    even = bool(np.diff(time_s).max() * _rate_hz(time_s) < LOST_SAMPLE)
    return (
        common.Decoded(samples[1:], unit, _rate_hz(time_s))
        if even
        else common.Decoded(samples[1:], unit, time_s=time_s)
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
    """Return the unit of acceleration, or None for other quantities."""
    label_and_unit = subchannel.units or ("", "")
    return common.ACCELERATION_SPELLINGS.get(common.normalise(str(label_and_unit[1])))


def _read_channel(channel: Any) -> tuple[Samples, str | None]:  # noqa: ANN401 - idelib is not typed
    """Return time in s and the three axes, shape (4, n_samples), and their unit."""
    rows = _axes(channel)
    values = np.asarray(channel.getSession().arraySlice(), dtype=np.float64)
    stacked = np.stack([values[0] * 1e-6, *(values[1 + rows[axis]] for axis in "xyz")])
    return stacked, _unit(channel.subchannels[rows["x"]])


def _rate_hz(time_s: Samples) -> float:
    return float((time_s.size - 1) / (time_s[-1] - time_s[0]))
