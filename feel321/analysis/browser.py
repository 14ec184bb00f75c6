"""The page of a stimulus set: every stimulus drawn, measured, flagged and played, in one file beside the WAV files.

Each stimulus is sketched from its file, small enough for hundreds on one page: the envelope of its waveform, the
spectrum of its loudest 200 ms beside the detection threshold, and how far it lies over that threshold by time and
frequency. Bands are 22 % wide, as those of the spectral match, and axes add by energy.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from base64 import b64encode
from collections import Counter
from dataclasses import replace
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321 import __version__
from feel321.analysis import page
from feel321.analysis.words import MINUS, format_name, format_number
from feel321.doors import as_path
from feel321.files import write_text
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ, WEBER_FRACTION
from feel321.stimuli.sets.manifest import read_details, read_stimuli
from feel321.stimuli.thresholds import CONTACTOR, acceleration_threshold
from feel321.stimuli.wav import read_wav
from feel321.types import PathLike, Samples

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet

PAGE = "index.html"
MARK = "/* feel321 stimuli "
"""Begins what tells our page from another file, and an outdated page from one that is up to date."""

HEAD = 100_000
"""Characters at the beginning of a page in which it stands."""

MOST_SHOWN = 1000
"""Stimuli that a page shows; each takes about 4 kB and 5 ms."""

LOWEST_MATCH = -1.0
"""A spectral match below this is flagged: the stimulus has most of its energy where its recording has none."""

FLAGS: Mapping[str, tuple[str, str]] = {
    "match": ("▼", f"spectral match below {MINUS}1"),
    "undefined": ("?", "match not defined"),
    "threshold": ("○", "below threshold"),
    "clipped": ("▲", "clipped"),
}
"""Name of a flag -> its mark and its words. Anchors are made to match badly: of those the match is not flagged."""

NUMBERS = {
    "spectral_match": ("Spectral match", ""),
    "temporal_match": ("Temporal match", ""),
    "sensation_level_db": ("Level over threshold", "dB"),
}
"""Columns of numbers: their heads and units; all other numbers are folded away."""

# The sketches: how fine they are, and on which scale.
COLUMNS, TIMES = 120, 64
CENTRES_HZ = np.geomspace(LOWEST_HZ, HIGHEST_HZ, 64)
RATE_HZ = 2500.0
"""Enough for 1000 Hz and its band."""

WINDOW_S = 0.2
SHORTEST_S = 0.05
"""Window of the spectrogram of a short stimulus."""

RAMPS = 0.5
"""Share of the window of a spectrum that its ramps take: leaks of 150 Hz stay below the threshold at 20 Hz. By its
length the window has the energy of 200 ms, both of a lasting vibration and of a tap in its middle."""

LOWEST_DB, DARKEST_DB = -40.0, 45.0
"""Lower end of the spectra in dB re 1 m/s² RMS; level over the threshold that is drawn in full ink."""

SHADES = 15


class Sketch(NamedTuple):
    """Three small pictures: two paths of an SVG and a PNG in base64; where the spectrum is furthest over threshold."""

    waveform: str
    spectrum: str
    spectrogram: str
    strongest_hz: float
    over_db: float
    highest_db: float


def write_stimulus_page(folder: PathLike) -> Path:
    """Write the page of a stimulus set, which shows, measures and plays every stimulus.

    Parameters
    ----------
    folder : str or path
        A set that `build_stimuli` built. The page is written beside the WAV files, as `index.html`, and plays them.

    Returns
    -------
    Path
        The page. It is left as it is if the set has not changed since; the same set gives the same bytes.

    Raises
    ------
    ValueError
        If the manifest is damaged, or another `index.html` is there.
    OSError
        If there is no set, or the page cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from feel321 import analysis, stimuli
    >>> scene = stimuli.make_scene("bumps", duration_s=0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     built = stimuli.build_stimuli(scene, folder, reducers=["dft321"])
    ...     analysis.write_stimulus_page(folder).name
    'index.html'
    """
    built = read_stimuli(as_path(folder, "folder"))
    path = built.folder / PAGE
    stamp = _stamp(built)
    found = _read_stamp(path)
    if found == stamp:
        return path
    if found is None and path.exists():
        raise ValueError(
            f"{path}: not written by feel321 and not overwritten; move it away, or build with --no-page"
        )
    write_text(path, _render(built, stamp))
    return path


def remove_stimulus_page(folder: Path) -> None:
    """Remove the page of a set, if it is there and ours."""
    if _read_stamp(folder / PAGE) is not None:
        (folder / PAGE).unlink()


def _stamp(built: StimulusSet) -> str:
    """Name set and page: both have changed if either has."""
    ours = (page.TEMPLATES / name for name in ("base.html", "page.css", *_own("html", "css", "js")))
    text = b"".join(path.read_bytes() for path in ours)
    return f"{built.sha256[:16]}-{hashlib.sha256(__version__.encode() + text).hexdigest()[:8]}"


def _own(*kinds: str) -> list[str]:
    return [f"stimuli.{kind}" for kind in kinds]


def _read_stamp(path: Path) -> str | None:
    """Read the stamp of a page that is there; None if it is not ours."""
    if not path.is_file():
        return None
    with path.open(encoding="utf-8", errors="replace") as file:
        _, mark, rest = file.read(HEAD).partition(MARK)
    return rest.partition(" ")[0] if mark else None


def _render(built: StimulusSet, stamp: str) -> str:
    recipe = _read_recipe(built.folder)
    threshold, full_scale = str(recipe["threshold"]), float(recipe["full_scale_m_s2"])
    shown = _select(built)
    sketches = {}
    for row in shown:
        samples, rate_hz = read_wav(built.folder / row.file)
        sketches[row.stimulus_id] = sketch(full_scale * samples, rate_hz, threshold=threshold)
    highest = max(one.highest_db for one in sketches.values())
    top = max(40, 10 * math.ceil(highest / 10)) if math.isfinite(highest) else 40
    flagged = Counter(flag for row in shown for flag in find_flags(row))
    return page.render_template(
        "stimuli.html",
        styles=_own("css"),
        mark=MARK, stamp=stamp, sha256=built.sha256, built=shown, flags=FLAGS, flagged=flagged,
        groups=_group(shown, sketches, full_scale), sentence=_summarise(built, shown),
        choices={
            "recording": list(dict.fromkeys(row.recording for row in shown)),
            "reducer": list(dict.fromkeys(row.reducer for row in built)),
            "level": list(dict.fromkeys(row.level for row in built)),
        },
        numbers=NUMBERS,
        threshold=format_name(threshold), full_scale=f"{full_scale:g}", top=top, bottom=LOWEST_DB,
        limit=_draw_line(_to_db(_threshold_rms(threshold))), ticks=_list_ticks(top),
        script=(page.TEMPLATES / "stimuli.js").read_text(encoding="utf-8"),
    )  # fmt: skip


def _select(built: StimulusSet) -> StimulusSet:
    """Select the recordings that a page shows: all, or so many that are spread evenly over a large set."""
    together: dict[str, list[Stimulus]] = {}
    for row in built:
        together.setdefault(row.recording, []).append(row)
    step = math.ceil(len(built) / MOST_SHOWN)
    rows = chain.from_iterable(list(together.values())[::step])
    return built if step == 1 else replace(built, stimuli=tuple(rows))


def _read_recipe(folder: Path) -> dict[str, Any]:
    return {"threshold": CONTACTOR, **read_details(folder).recipe}


def _group(
    built: StimulusSet, sketches: Mapping[str, Sketch], full_scale: float
) -> list[dict[str, Any]]:
    """List the recordings, each with its rows; the waveforms of one recording are drawn on one scale."""
    together: dict[str, list[Stimulus]] = {}
    for row in built:
        together.setdefault(row.recording, []).append(row)
    groups, warnings = [], built.warnings
    for name, rows in together.items():
        peak = max(row.peak for row in rows)
        groups.append({
            "name": name,
            "scale": format_number(peak * full_scale, kind="rating"),
            "duration": format_number(rows[0].duration_s),
            "warnings": [text for text in warnings if text.startswith(f"{name}: ")],
            "rows": [
                {
                    "own": row,
                    "sketch": sketches[row.stimulus_id],
                    "size": f"{row.peak / peak:.3g}" if peak else "1",
                    "flags": find_flags(row),
                    "numbers": [
                        (value, format_number(value, kind="rating" if unit else "correlation"))
                        for name, (_, unit) in NUMBERS.items()
                        for value in [getattr(row, name)]
                    ],
                    "further": _list_further(row, full_scale),
                }
                for row in rows
            ],
        })
    return groups


def find_flags(stimulus: Stimulus) -> list[str]:
    """Find what speaks against playing a stimulus, as names of `FLAGS`."""
    is_test = stimulus.role == "test"
    is_silent = math.isnan(stimulus.sensation_level_db) and stimulus.rms_m_s2 == 0
    found = {
        "match": is_test and stimulus.spectral_match < LOWEST_MATCH,
        "undefined": is_test and math.isnan(stimulus.spectral_match),
        "threshold": is_silent or stimulus.sensation_level_db < 0,
        "clipped": stimulus.clipped > 0,
    }
    return [name for name, applies in found.items() if applies]


def _summarise(built: StimulusSet, shown: StimulusSet) -> str:
    flagged = Counter(flag for row in built for flag in find_flags(row))
    hit = sum(bool(find_flags(row)) for row in built)
    counts = ", ".join(f"{flagged[name]} {FLAGS[name][1]}" for name in FLAGS if flagged[name])
    unknown = sum(math.isnan(row.sensation_level_db) and row.rms_m_s2 != 0 for row in built)
    felt = "" if unknown else "all lie above the detection threshold, "
    told = f" Level over threshold not known: {unknown} of {len(built)}." if unknown else ""
    if len(shown) < len(built):
        n, of = (len({row.recording for row in one}) for one in (shown, built))
        told += f" This page shows {n} of {of} recordings, spread evenly; manifest.csv lists all stimuli."
    if not hit:
        return f"None of {len(built)} stimuli is flagged: {felt}none is clipped.{told}"
    return f"{hit} of {len(built)} stimuli {'is' if hit == 1 else 'are'} flagged: {counts}.{told}"


def _list_further(row: Stimulus, full_scale: float) -> dict[str, str]:
    """List the numbers of a stimulus that have no column on the page by what they are called."""
    known = {
        "RMS (m/s²)": row.rms_m_s2,
        "peak (m/s²)": row.peak * full_scale,
        "gain": row.gain,
        "bounded spectral match": row.spectral_match_bounded,
    }
    known |= {format_name(name): value for name, value in row.metrics.items()}
    shown = {name: f"{value:.3g}".replace("-", MINUS) for name, value in known.items()}
    return {**shown, "samples clipped": f"{row.clipped}"}


# Sketches.


def sketch(samples: Samples, rate_hz: float, *, threshold: str) -> Sketch:
    """Sketch a stimulus, shape (n_samples,) or (axes, n_samples), in m/s²."""
    axes = np.atleast_2d(samples)
    waveform = _draw_envelope(axes)
    axes, rate_hz = _slow(axes, rate_hz)
    seconds = axes.shape[-1] / rate_hz
    limits = _threshold_rms(threshold)
    window = _make_window(WINDOW_S / (1 - RAMPS * 5 / 8) * rate_hz, RAMPS)
    bands = _band_energies(axes, rate_hz, window, count=max(round(2 * seconds / WINDOW_S), 1))
    loudest = np.sqrt(bands[np.argmax((bands / limits**2).sum(axis=-1))] / (WINDOW_S * rate_hz))
    over = _to_db(loudest / limits)
    window = _make_window(max(2 * seconds / TIMES, SHORTEST_S) * rate_hz, 1.0)
    bands = _band_energies(axes, rate_hz, window, count=TIMES) / np.square(window).sum()
    shades = SHADES * _to_db(np.sqrt(bands) / limits) / DARKEST_DB
    return Sketch(
        waveform,
        _draw_line(_to_db(loudest)),
        _draw_shades(np.clip(np.ceil(shades), 0, SHADES).astype(np.uint8).T[::-1]),
        float(CENTRES_HZ[over.argmax()]),
        float(over.max()),
        float(_to_db(loudest).max()),
    )


def _slow(axes: Samples, rate_hz: float) -> tuple[Samples, float]:
    """Reduce a signal to a rate that is enough for the skin; all else is quick then."""
    from scipy import fft

    step = max(int(rate_hz / (4 * RATE_HZ)), 1)  # a mean of so few costs 0.1 dB at 1000 Hz
    if step > 1:
        axes, rate_hz = axes[:, : axes.shape[-1] // step * step], rate_hz / step
        axes = axes.reshape(len(axes), -1, step).mean(axis=-1)
    n = axes.shape[-1]
    fewer = math.ceil(n * RATE_HZ / rate_hz)
    if fewer >= n:
        return axes, rate_hz
    spectrum = fft.rfft(axes)[..., : fewer // 2 + 1]
    return np.asarray(fft.irfft(spectrum, fewer)) * (fewer / n), rate_hz * fewer / n


def _make_window(length: float, ramps: float) -> Samples:
    """Make a window whose two ramps together take a share of it (Tukey's; Hann's for 1)."""
    length = max(round(length), 4)
    place = (np.arange(length) + 0.5) / length
    rise = np.clip(np.minimum(place, 1 - place) * 2 / ramps, 0, 1)
    return np.asarray((1 - np.cos(np.pi * rise)) / 2)


def _threshold_rms(threshold: str) -> Samples:
    return np.asarray(acceleration_threshold(CENTRES_HZ, threshold=threshold) / math.sqrt(2))


def _to_db(ratio: Samples) -> Samples:
    return np.asarray(20 * np.log10(np.maximum(ratio, 1e-12)))


def _band_energies(axes: Samples, rate_hz: float, window: Samples, *, count: int) -> Samples:
    """Sum of squares of bands 22 % wide, (count, centres), in windows whose centres are spread over the signal."""
    from scipy import fft

    length, n = len(window), axes.shape[-1]
    padded = np.pad(axes, ((0, 0), (length, length)))
    starts = np.round((np.arange(count) + 0.5) * n / count + length / 2).astype(int)
    frames = np.lib.stride_tricks.sliding_window_view(padded, length, axis=-1)[:, starts]
    size = fft.next_fast_len(length, real=True)
    spectrum = fft.rfft(frames * window, size)
    energy = 2 / size * np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
    summed = np.pad(np.cumsum(energy, axis=-1), ((0, 0), (1, 0)))
    # Bin k reaches from k - 1/2 to k + 1/2; a band holds parts of bins.
    half = WEBER_FRACTION / 2
    low, high = (
        np.clip(CENTRES_HZ * edge * size / rate_hz + 0.5, 0, summed.shape[-1] - 1)
        for edge in (1 - half, 1 + half)
    )
    return np.maximum(
        _interpolate(summed, high) - _interpolate(summed, low), 0.0
    )  # but for rounding


def _interpolate(values: Samples, at: Samples) -> Samples:
    whole = np.minimum(at.astype(int), values.shape[-1] - 2)
    share = at - whole
    return np.asarray((1 - share) * values[:, whole] + share * values[:, whole + 1])


def _draw_envelope(axes: Samples) -> str:
    """Draw the outline of a waveform, of all axes together: from 0 to `COLUMNS`, its peak at 100 or -100."""
    n = axes.shape[-1]
    columns = min(COLUMNS, n)
    starts = np.arange(columns) * n // columns
    lowest = np.minimum.reduceat(axes.min(axis=0), starts)
    highest = np.maximum.reduceat(axes.max(axis=0), starts)
    unit = max(highest.max(), -lowest.min()) or 1.0
    x = np.linspace(0, COLUMNS, columns, dtype=int)
    up, down = (np.round(-100 * half / unit).astype(int) for half in (highest, lowest))
    return _write_path([*zip(x, up, strict=True), *zip(x[::-1], down[::-1], strict=True)]) + "z"


def _draw_line(levels_db: Samples) -> str:
    """Draw a line over `CENTRES_HZ`, spaced evenly as they are by octaves; two units per dB, downwards."""
    levels = np.round(-2 * np.maximum(levels_db, LOWEST_DB)).astype(int)
    return _write_path([*enumerate(levels)])


def _write_path(points: Sequence[tuple[int, int]]) -> str:
    """Write a path by its steps, which are short."""
    (x, y), *_ = points
    steps = [(bx - ax, by - ay) for (ax, ay), (bx, by) in pairwise(points)]
    return f"M{x} {y}l" + " ".join(f"{dx} {dy}" for dx, dy in steps).replace(" -", "-")


def _draw_shades(shades: NDArray[np.uint8]) -> str:
    """Write a picture, (rows, columns) of shades, as a PNG of 16 transparencies: a mask, which the page fills."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    height, width = shades.shape
    packed = shades[:, ::2] << 4 | shades[:, 1::2]
    lines = b"".join(b"\0" + line.tobytes() for line in packed)
    alphas = bytes(255 * shade // SHADES for shade in range(SHADES + 1))
    parts = (
        chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 4, 3, 0, 0, 0)),
        chunk(b"PLTE", bytes(3 * (SHADES + 1))), chunk(b"tRNS", alphas), chunk(b"IDAT", zlib.compress(lines, 9)),
        chunk(b"IEND", b""),
    )  # fmt: skip
    return b64encode(b"\x89PNG\r\n\x1a\n" + b"".join(parts)).decode()


def _list_ticks(top: int) -> dict[str, list[tuple[float, str]]]:
    """List the ticks of the spectra's axes, as shares of width and height from the top left, with their labels."""
    octaves = math.log(CENTRES_HZ[-1] / CENTRES_HZ[0])
    return {
        "x": [(math.log(hz / CENTRES_HZ[0]) / octaves, f"{hz}") for hz in (20, 50, 100, 200, 500)],
        "y": [((top - db) / (top - LOWEST_DB), f"{db}".replace("-", MINUS)) for db in (0, 40)],
    }
