"""The sidecar of a WAV file: what a WAV header cannot say."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stimuli.formats.errors import foreign_errors
from stimuli.formats.keys import RATE_KEYS, UNIT_KEYS
from stimuli.formats.units import parse_unit
from stimuli.recording import check_rate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

KEYS = ("unit", "rate_hz", "axes", "full_scale", *UNIT_KEYS, *RATE_KEYS)
ALLOWED = ", ".join(dict.fromkeys(KEYS))
"""Every entry that is read. Others are refused: a misspelt unit is worth a factor of 9.8."""


@dataclass(frozen=True, slots=True)
class Sidecar:
    """What stands in ``NAME.json`` or ``NAME.toml`` beside ``NAME.wav``.

    Parameters
    ----------
    path : Path, optional
        The sidecar; None where there is none.
    unit : str, optional
        The unit, a key of `stimuli.recording.UNITS`.
    rate_hz : float, optional
        The true rate in Hz, which may be fractional.
    axes : sequence of str, optional
        What each channel is, in their order; x, y and z among them.
    full_scale : float, optional
        What full scale of integer samples means, in the unit.
    """

    path: Path | None = None
    unit: str | None = None
    rate_hz: float | None = None
    axes: Sequence[str] | None = None
    full_scale: float | None = None


def read_sidecar(path: Path) -> Sidecar:
    """Read the JSON or TOML file of the same name beside a file.

    Parameters
    ----------
    path : Path
        The file that the sidecar belongs to.

    Returns
    -------
    Sidecar
        What it says; empty where there is none.

    Raises
    ------
    ValueError
        If there are two, or it cannot be read, or an entry is of the wrong kind.
    """
    beside = [path.with_suffix(suffix) for suffix in (".json", ".toml")]
    present = [sidecar for sidecar in beside if sidecar.is_file()]
    if not present:
        return Sidecar()
    if len(present) > 1:
        names = " and ".join(sidecar.name for sidecar in present)
        raise ValueError(f"got two sidecars, {names}, allowed is one; remove the other")
    try:
        return _parse_sidecar(present[0])
    except ValueError as error:
        raise ValueError(f"sidecar {present[0].name}: {error}") from None


def _parse_sidecar(path: Path) -> Sidecar:
    entries = _load(path)
    if not isinstance(entries, dict):
        raise ValueError(f"got a {type(entries).__name__}, allowed is a table with {ALLOWED}")  # noqa: TRY004 - a file's fault, not a caller's
    if unknown := [key for key in entries if key not in KEYS]:
        raise ValueError(f"got the unknown {', '.join(map(repr, unknown))}, allowed is {ALLOWED}; mend or remove it")
    unit = _entry(entries, UNIT_KEYS)
    rate_hz = _entry(entries, RATE_KEYS)
    full_scale = entries.get("full_scale")
    return Sidecar(
        path,
        None if unit is None else parse_unit(unit),
        None if rate_hz is None else check_rate(rate_hz),
        _parse_axes(entries.get("axes")),
        None if full_scale is None else check_full_scale(full_scale),
    )


def _load(path: Path) -> Any:  # noqa: ANN401 - whatever stands in it
    content = path.read_bytes()
    with foreign_errors("JSON" if path.suffix == ".json" else "TOML"):
        text = content.decode("utf-8-sig")
        return json.loads(text) if path.suffix == ".json" else tomllib.loads(text)


def _entry(entries: Mapping[str, Any], keys: Sequence[str]) -> Any:  # noqa: ANN401 - whatever stands there
    """Return what stands under one of several spellings."""
    present = [key for key in keys if entries.get(key) is not None]
    if len(present) > 1:
        raise ValueError(f"got both {' and '.join(present)}, allowed is one of them; remove the other")
    return entries[present[0]] if present else None


def _parse_axes(axes: Any) -> tuple[str, ...] | None:  # noqa: ANN401 - whatever a JSON file holds
    if axes is None:
        return None
    names = tuple(str(axis).lower() for axis in axes) if isinstance(axes, list | str) else ()
    if sorted(name for name in names if name in {"x", "y", "z"}) != ["x", "y", "z"]:
        raise ValueError(f'got axes {axes!r}, allowed is a list with "x", "y" and "z" once each')
    return names


def check_full_scale(full_scale: float) -> float:
    """Return the full scale as a float, or say what is wrong.

    Parameters
    ----------
    full_scale : float
        What full scale means, in the unit.

    Returns
    -------
    float
        The same number.

    Raises
    ------
    ValueError
        If it is not a finite number above 0.
    """
    try:
        return check_rate(full_scale)
    except ValueError:
        raise ValueError(f"got full_scale {full_scale!r}, allowed is a finite number above 0") from None
