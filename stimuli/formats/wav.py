"""WAV recordings: three channels, and a sidecar for what a WAV header cannot say."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.formats.decoded import Decoded, already_reduced
from stimuli.formats.sidecar import check_full_scale, read_sidecar
from stimuli.recording import AXES
from stimuli.wav import read_wav, read_wav_header

if TYPE_CHECKING:
    from pathlib import Path

    from stimuli.formats.decoded import Request
    from stimuli.formats.sidecar import Sidecar
    from stimuli.wav import WavHeader


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
