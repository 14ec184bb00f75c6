"""WAV recordings: three channels, and a sidecar for what a WAV header cannot say."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stimuli.formats.decoded import Decoded, already_reduced
from stimuli.formats.units import parse_unit
from stimuli.recording import AXES, check_rate
from stimuli.wav import read_wav, read_wav_header

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from stimuli.formats.decoded import Request
    from stimuli.wav import WavHeader


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


def read_wav_recording(path: Path, request: Request) -> Decoded:
    """Read three channels of a WAV file.

    Parameters
    ----------
    path : Path
        The WAV file; a sidecar beside it is read too.
    request : Request
        Full scale of integer samples, where no sidecar gives it.

    Returns
    -------
    Decoded
        The samples in the unit: floats as they are, integers as fractions of full scale times full scale.

    Raises
    ------
    ValueError
        If the file is damaged, has not three channels, or contradicts its sidecar.
    """
    header = read_wav_header(path)
    sidecar = read_sidecar(path)
    channels = _channels(header.channels, sidecar)
    full_scale = _full_scale(header, sidecar, requested=request.full_scale)
    notes = () if full_scale else ("integer WAV without full_scale: full scale taken as 1.0 in the unit",)
    samples, _ = read_wav(path)
    return Decoded(
        samples[channels] * (full_scale or 1.0),
        sidecar.unit,
        _true_rate(header.rate_hz, sidecar),
        notes=() if header.is_float else notes,
        sources=(path,) if sidecar.path is None else (path, sidecar.path),
    )


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
    text = path.read_text(encoding="utf-8-sig")
    entries: Any = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    if not isinstance(entries, dict):
        allowed = "allowed is a table with unit, rate_hz, axes, full_scale"
        raise ValueError(f"got a {type(entries).__name__}, {allowed}")  # noqa: TRY004 - a file's fault, not a caller's
    unit, rate_hz, full_scale = (entries.get(key) for key in ("unit", "rate_hz", "full_scale"))
    return Sidecar(
        path,
        None if unit is None else parse_unit(unit),
        None if rate_hz is None else check_rate(rate_hz),
        _parse_axes(entries.get("axes")),
        None if full_scale is None else check_full_scale(full_scale),
    )


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
        raise ValueError(f"got full_scale={requested:g}, but the sidecar says {own:g}; leave one out")
    full_scale = requested or sidecar.full_scale
    if full_scale and header.is_float:
        raise ValueError("got full_scale for float samples, which are in the unit already; leave it out")
    return full_scale
