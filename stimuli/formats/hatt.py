"""HaTT recordings (Penn Haptic Texture Toolkit): XML with one element per axis.

The tags are known second-hand only, so ``AccelX`` and nested ``Accel/X`` are both read, in any case.
"""

from __future__ import annotations

import io
import re
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from stimuli.formats.decoded import Decoded, already_reduced, stack_axes
from stimuli.formats.errors import foreign_errors
from stimuli.formats.units import parse_unit

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

SENSOR = r"accel(?:eration)?"
AXIS = re.compile(rf"{SENSOR}_?([xyz])")
UNIT = re.compile(rf"{SENSOR}_?units?")
RATE = re.compile(rf"(?:{SENSOR}_?)?sampl(?:e|ing)_?(?:rate|frequency)")
RATE_VALUE = re.compile(r"(\d+\.?\d*(?:e\+?\d+)?)\s*(k?)(?:hz)?", re.IGNORECASE | re.ASCII)

DEEPEST = 64
"""So deep may tags be nested: texts are collected at each depth, so that deeper ones cost the square."""


def read_hatt(path: Path, _: Request) -> Decoded:
    """Read the three axes, the rate and the unit that an XML recording names.

    Parameters
    ----------
    path : Path
        The XML file.

    Returns
    -------
    Decoded
        The samples; the rate only where a tag gives it, because not every file says 10 kHz.

    Raises
    ------
    ValueError
        If it is no XML, declares entities, holds a reduced signal, or lacks an axis.
    """
    content = path.read_bytes()
    # Entities can expand without end or name other files; a recording needs neither.
    if re.search(rb"<!\s*(doctype|entity)", content, re.IGNORECASE):
        raise ValueError("got XML that declares a document type or entities, allowed is plain XML; remove them")
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
        raise ValueError(f"got {len(texts)} elements for {tag}, allowed is one; which is meant cannot be told")
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
        raise ValueError(f"got a value of the {axis} axis that is no number ({error}); mend it") from None
    if not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values)))
        raise ValueError(f"got {words[i]!r} as value {i} of the {axis} axis, allowed is a finite number")
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
