"""Recordings in WAV, HaTT, LMT and IDE files.

- WAV: three channels, and a sidecar for what a WAV header cannot say.
- HaTT (Penn Haptic Texture Toolkit): XML with one element per axis. The tags are known second-hand only, so ``AccelX``
  and nested ``Accel/X`` are both read, in any case.
- LMT-108 (TU München): one text file per axis, one value per line, 10 kHz.
- IDE (enDAQ), read by the optional package idelib.
"""

import io
import json
import logging
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feel321 import intake
from feel321.stimuli.formats import common, tables
from feel321.stimuli.recording import AXES, check_rate
from feel321.stimuli.wav import read_wav, read_wav_header
from feel321.types import Samples

FULL_SCALE_NOTE = "integer WAV without full_scale: full scale taken as 1.0 in the unit"


def read_wav_recording(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read three channels of a WAV file, with what the JSON or TOML file of the same name says of them."""
    header = read_wav_header(path)
    beside = [one for suffix in (".json", ".toml") if (one := path.with_suffix(suffix)).is_file()]
    said = _read_sidecar(beside)
    axes = said.get("axes", ("x", "y", "z"))
    if header.channels == 1:
        raise common.refuse_reduced("a WAV file with 1 channel")
    if header.channels < AXES:
        raise ValueError(f"there must be 3 channels, one per axis x, y, z; got {header.channels}")
    if len(axes) != header.channels:
        raise ValueError(
            f"there must be 3 channels, or a sidecar whose axes name every channel; "
            f"got {header.channels} for {len(axes)} axes"
        )
    rate_hz = said.get("rate_hz", float(header.rate_hz))
    if abs(rate_hz - header.rate_hz) > max(1.0, 0.001 * header.rate_hz):
        raise ValueError(
            f"the header says {header.rate_hz} Hz and the sidecar {rate_hz:g} Hz, which differ by more than 1 Hz or "
            "0.1 %; correct the one that is wrong"
        )
    own, asked = said.get("full_scale"), request.full_scale
    asked = None if asked is None else check_rate(asked, "full_scale", "")
    if asked and own and asked != own:
        raise ValueError(f"full_scale={asked:g}, but the sidecar says {own:g}; leave one out")
    full_scale = asked or own
    if full_scale and header.is_float:
        raise ValueError(
            "full_scale is for integer samples, these are float and in the unit already; leave it out"
        )
    samples, _ = read_wav(path)
    return common.Decoded(
        samples[[axes.index(axis) for axis in "xyz"]] * (full_scale or 1.0),
        said.get("unit"),
        rate_hz,
        notes=() if full_scale or header.is_float else (FULL_SCALE_NOTE,),
        sources=(path, *beside),
    )


def _read_sidecar(beside: Sequence[Path]) -> dict[str, Any]:
    """Read what a sidecar says, by its first spelling."""
    if not beside:
        return {}
    if len(beside) > 1:
        names = " and ".join(one.name for one in beside)
        raise ValueError(f"there must be one sidecar, got {names}; remove one of them")
    path = beside[0]
    try:
        text = intake.read_small(path)
        with common.foreign_errors(path.suffix[1:].upper()):
            entries: Any = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
        return _parse_entries(entries)
    except ValueError as error:
        said = str(error).removeprefix(f"{path.name}: ")
        raise ValueError(f"sidecar {path.name}: {said}") from None


def _parse_axes(axes: Any) -> list[str]:  # noqa: ANN401 - whatever stands there
    names = [str(axis).lower() for axis in axes] if isinstance(axes, list | str) else []
    if sorted(name for name in names if name in {"x", "y", "z"}) != ["x", "y", "z"]:
        raise ValueError(f'axes must be a list with "x", "y" and "z" once each, got {axes!r}')
    return names


ENTRIES: Mapping[str, tuple[Sequence[str], Callable[[Any], Any]]] = {
    "unit": (common.UNIT_KEYS, common.parse_unit),
    "rate_hz": (common.RATE_KEYS, check_rate),
    "axes": (("axes",), _parse_axes),
    "full_scale": (("full_scale",), partial(check_rate, what="full_scale", unit="")),
}
KEYS = list(dict.fromkeys([*ENTRIES, *common.UNIT_KEYS, *common.RATE_KEYS]))
"""Entries of a sidecar. Others are refused: a misspelt unit is worth a factor of 9.8."""


def _parse_entries(entries: Any) -> dict[str, Any]:  # noqa: ANN401 - whatever stands there
    allowed = ", ".join(KEYS)
    if not isinstance(entries, dict):
        raise ValueError(f"must be a table with {allowed}, got a {type(entries).__name__}")  # noqa: TRY004 - a file's fault, not a caller's
    if unknown := [key for key in entries if key not in KEYS]:
        raise ValueError(
            f"entries must be {allowed}, got {', '.join(map(repr, unknown))}; correct or remove it"
        )
    found = {}
    for name, (keys, parse) in ENTRIES.items():
        present = [key for key in keys if entries.get(key) is not None]
        if len(present) > 1:
            raise ValueError(f"{' and '.join(present)} mean the same; remove all but one")
        if present:
            found[name] = parse(entries[present[0]])
    return found


SENSOR = r"accel(?:eration)?"
AXIS = re.compile(rf"{SENSOR}_?([xyz])")
UNIT = re.compile(rf"{SENSOR}_?units?")
RATE = re.compile(rf"(?:{SENSOR}_?)?sampl(?:e|ing)_?(?:rate|frequency)")
RATE_VALUE = re.compile(r"(\d+\.?\d*(?:e\+?\d+)?)\s*(k?)(?:hz)?", re.IGNORECASE | re.ASCII)

MOST_TAGS = 10_000
LARGER = 8
"""So many tags may an XML file hold, and so many times its text takes in memory."""


def read_hatt(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read the three axes, the rate and the unit that an XML recording names."""
    content = intake.read_bytes(path, most=intake.read_limit() // LARGER)
    # Entities can expand without end or name other files; a recording needs neither.
    if re.search(rb"<!\s*(doctype|entity)", content, re.IGNORECASE):
        raise ValueError(
            "the XML declares a document type or entities, which are not read; remove them"
        )
    if content.count(b"<") > 2 * MOST_TAGS:
        raise ValueError(f"there are more than {MOST_TAGS} tags")
    tags = _collect_tags(content)
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


def _collect_tags(content: bytes) -> Mapping[str, list[str]]:
    """Map each tag, small, without namespace, and once more with its parent's before it, to its texts."""
    from xml.etree import ElementTree as ET

    with common.foreign_errors("XML"):
        root = ET.fromstring(content)  # noqa: S314 - entities were refused before
    tags: dict[str, list[str]] = defaultdict(list)
    collected = 0
    for parent in root.iter():
        above = parent.tag.rpartition("}")[2].casefold()
        for child in parent:
            text = " ".join(child.itertext()).strip()
            collected += len(text)  # once per depth, so that deep ones cost the square
            intake.check_bytes(collected, "texts nested in each other")
            own = child.tag.rpartition("}")[2].casefold()
            tags[own].append(text)
            tags[above + own].append(text)
    return tags


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


def _is_reduced(path: Path) -> bool:
    return any(part.lower() == REDUCED_FOLDER for part in path.absolute().parts[:-1])


def read_lmt(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read one axis of a triple and its two sisters beside it."""
    match = NAME.fullmatch(path.stem)
    if match is None or _is_reduced(path):
        raise common.refuse_reduced("a file of the folder AccelScansDFT321")
    head, axis, tail = match.groups()
    sisters = [
        path.with_name(f"{head}_{letter}_{tail}{path.suffix}")
        for letter in ("XYZ" if axis.isupper() else "xyz")
    ]
    if missing := [sister.name for sister in sisters if not sister.is_file()]:
        raise ValueError(
            f"there must be one file per axis x, y, z beside it, got no {' and no '.join(missing)}"
        )
    axes: dict[str, Samples] = {}
    for name, sister in zip("xyz", sisters, strict=True):
        table = tables.split_table(sister)
        if table.n_columns != 1:
            raise ValueError(
                f"{sister.name} must hold one value per line, got {table.n_columns} columns"
            )
        axes[name] = tables.read_numbers(table, (0,)).ravel()
    known = request.rate_hz is not None
    return common.Decoded(
        common.stack_axes(axes),
        rate_hz=None if known else RATE_HZ,
        notes=() if known else (RATE_NOTE,),
        sources=tuple(sisters),
        name=f"{head}_{tail}",
    )


LOST_SAMPLE = 1.5
"""An interval of so many periods means that samples were lost; less is the coarse clock of the blocks."""


def read_ide(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read the triaxial accelerometer with the highest rate."""
    try:
        from idelib import importer
    except ImportError:
        how = "install it from feel321's source folder: pip install -c constraints.txt '.[ide]'"
        raise ValueError(f"an enDAQ recording is read by idelib, which is missing; {how}") from None
    # In memory: idelib asks for as many bytes as the file promises, of a file they would be allocated.
    stream = io.BytesIO(intake.read_bytes(path))
    stream.name = str(path)  # idelib asks for it
    intake.check_bytes(4 * path.stat().st_size, "its samples")  # of two bytes each
    before = logging.root.manager.disable
    logging.disable()  # what is wrong with a file is raised anyway
    try:
        with common.foreign_errors("an enDAQ recording"):
            dataset = importer.openFile(stream, quiet=True)
            importer.readData(dataset)
            channels = [one for one in dataset.channels.values() if one.sessions]
            found = [_read_channel(one) for one in channels if len(_axes(one)) == AXES]
    finally:
        logging.disable(before)
    measured = [(samples, unit) for samples, unit in found if samples.shape[1] > 1]
    if not measured:
        raise ValueError("there must be an accelerometer with three axes and samples, got none")
    samples, unit = max(measured, key=lambda pair: _rate_hz(pair[0][0]))
    time_s = samples[0] - samples[0, 0]
    if np.diff(time_s).max() * _rate_hz(time_s) < LOST_SAMPLE:
        return common.Decoded(samples[1:], unit, _rate_hz(time_s))
    return common.Decoded(samples[1:], unit, time_s=time_s)


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
