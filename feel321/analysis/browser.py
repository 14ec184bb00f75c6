"""The page of a stimulus set: every stimulus drawn, measured, flagged and played, in one file beside the WAV files.

Each stimulus is sketched from its file, small enough for hundreds on one page: the envelope of its waveform, and the
spectrum of its loudest 200 ms beside the detection threshold. Bands are 22 % wide, as those of the spectral match, and
axes add by energy.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321 import __version__
from feel321.analysis import page
from feel321.analysis.words import MINUS
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

    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet

PAGE = "index.html"
MARK = "/* feel321 stimuli "
"""Begins what tells our page from another file, and an outdated page from one that is up to date."""

HEAD = 100_000
"""Characters at the beginning of a page in which it stands."""

MOST_SHOWN = 1000
"""Stimuli that a page shows; each takes about 3 kB and 5 ms."""

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
"""Columns of numbers: their heads and units; all others stand in the manifest."""

# The sketches: how fine they are, and on which scale.
COLUMNS = 120
CENTRES_HZ = np.geomspace(LOWEST_HZ, HIGHEST_HZ, 64)
WINDOW_S = 0.2
RAMPS = 0.5
"""Share of the window of a spectrum that its ramps take: leaks of 150 Hz stay below the threshold at 20 Hz. By its
length the window has the energy of 200 ms, both of a lasting vibration and of a tap in its middle."""

LOWEST_DB = -40.0
"""Lower end of the spectra in dB re 1 m/s² RMS."""


class Sketch(NamedTuple):
    """Two small pictures, paths of an SVG; where the spectrum is furthest over threshold, by how much; its highest."""

    waveform: str
    spectrum: str
    strongest_hz: float
    over_db: float
    highest_db: float


def write_stimulus_page(folder: PathLike) -> Path:
    """Write the page of a stimulus set beside its WAV files, as `index.html`, which plays them.

    It is left as it is if the set has not changed since; the same set gives the same bytes.
    """
    built = read_stimuli(as_path(folder, "folder"))
    path = built.folder / PAGE
    # The stamp names set and page: both have changed if either has.
    kinds = (f"stimuli.{kind}" for kind in ("html", "css", "js"))
    ours = (page.TEMPLATES / name for name in ("base.html", "page.css", *kinds))
    text = __version__.encode() + b"".join(one.read_bytes() for one in ours)
    stamp = f"{built.sha256[:16]}-{hashlib.sha256(text).hexdigest()[:8]}"
    found = _read_stamp(path)
    if found is None and path.exists():
        raise ValueError(
            f"{path}: not written by feel321 and not overwritten; move it away, or build with --no-page"
        )
    if found != stamp:
        write_text(path, _render(built, stamp))
    return path


def remove_stimulus_page(folder: Path) -> None:
    """Remove the page of a set, if it is there and ours."""
    if _read_stamp(folder / PAGE) is not None:
        (folder / PAGE).unlink()


def _read_stamp(path: Path) -> str | None:
    """Read the stamp of a page that is there; None if it is not ours."""
    if not path.is_file():
        return None
    with path.open(encoding="utf-8", errors="replace") as file:
        _, mark, rest = file.read(HEAD).partition(MARK)
    return rest.partition(" ")[0] if mark else None


def _render(built: StimulusSet, stamp: str) -> str:
    recipe: dict[str, Any] = {"threshold": CONTACTOR, **read_details(built.folder).recipe}
    threshold, full_scale = str(recipe["threshold"]), float(recipe["full_scale_m_s2"])
    # All recordings, or so many that are spread evenly over a large set.
    names = list(dict.fromkeys(row.recording for row in built))
    kept = names[:: math.ceil(len(built) / MOST_SHOWN)]
    shown = replace(built, stimuli=tuple(row for row in built if row.recording in kept))
    sketches = {}
    for row in shown:
        samples, rate_hz = read_wav(built.folder / row.file)
        sketches[row.stimulus_id] = sketch(full_scale * samples, rate_hz, threshold=threshold)
    highest = max(one.highest_db for one in sketches.values())
    top = max(40, 10 * math.ceil(highest / 10)) if math.isfinite(highest) else 40
    octaves = math.log(CENTRES_HZ[-1] / CENTRES_HZ[0])
    flags = {row.stimulus_id: find_flags(row) for row in built}
    groups = []
    for name in kept:
        rows = [row for row in shown if row.recording == name]
        warnings = [text for text in built.warnings if text.startswith(f"{name}: ")]
        peak = max(row.peak for row in rows)  # waveforms are drawn on one scale
        groups.append({"name": name, "rows": rows, "peak": peak, "warnings": warnings})
    unknown = sum(math.isnan(row.sensation_level_db) and row.rms_m_s2 != 0 for row in built)
    return page.render_template(
        "stimuli.html",
        styles=["stimuli.css"],
        mark=MARK, stamp=stamp, sha256=built.sha256, built=shown, flags=FLAGS, own=flags, sketches=sketches,
        flagged=Counter(flag for row in shown for flag in flags[row.stimulus_id]),
        every=Counter(flag for one in flags.values() for flag in one), hit=sum(map(bool, flags.values())),
        unknown=unknown, sizes={"shown": len(kept), "recordings": len(names), "stimuli": len(built)}, groups=groups,
        choices={"recording": kept} | {
            name: list(dict.fromkeys(getattr(row, name) for row in built)) for name in ("reducer", "level")
        },
        numbers=NUMBERS, threshold=threshold, full_scale=full_scale, top=top, bottom=LOWEST_DB,
        limit=_draw_line(_to_db(_threshold_rms(threshold))),
        ticks={  # shares of width and height from the top left, with their labels
            "x": [(math.log(hz / CENTRES_HZ[0]) / octaves, f"{hz}") for hz in (20, 50, 100, 200, 500)],
            "y": [((top - db) / (top - LOWEST_DB), f"{db}") for db in (0, 40)],
        },
        script=(page.TEMPLATES / "stimuli.js").read_text(encoding="utf-8"),
    )  # fmt: skip


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


def sketch(samples: Samples, rate_hz: float, *, threshold: str) -> Sketch:
    """Sketch a stimulus, shape (n_samples,) or (axes, n_samples), in m/s²."""
    axes = np.atleast_2d(samples)
    limits = _threshold_rms(threshold)
    bands = _band_energies(axes, rate_hz)
    loudest = np.sqrt(bands[np.argmax((bands / limits**2).sum(axis=-1))] / (WINDOW_S * rate_hz))
    over = _to_db(loudest / limits)
    drawn = _draw_envelope(axes), _draw_line(_to_db(loudest))
    strongest_hz = float(CENTRES_HZ[over.argmax()])
    return Sketch(*drawn, strongest_hz, float(over.max()), float(_to_db(loudest).max()))


def _threshold_rms(threshold: str) -> Samples:
    return np.asarray(acceleration_threshold(CENTRES_HZ, threshold=threshold) / math.sqrt(2))


def _to_db(ratio: Samples) -> Samples:
    return np.asarray(20 * np.log10(np.maximum(ratio, 1e-12)))


def _band_energies(axes: Samples, rate_hz: float) -> Samples:
    """Sum of squares of bands 22 % wide, (windows, centres), in windows that overlap by half."""
    from scipy import fft

    length, n = max(round(WINDOW_S / (1 - RAMPS * 5 / 8) * rate_hz), 4), axes.shape[-1]
    count = max(round(2 * n / rate_hz / WINDOW_S), 1)
    padded = np.pad(axes, ((0, 0), (length, length)))
    starts = np.round((np.arange(count) + 0.5) * n / count + length / 2).astype(int)
    frames = np.lib.stride_tricks.sliding_window_view(padded, length, axis=-1)[:, starts]
    size = fft.next_fast_len(2 * length, real=True)
    place = (np.arange(length) + 0.5) / length
    window = (1 - np.cos(np.pi * np.clip(np.minimum(place, 1 - place) * 2 / RAMPS, 0, 1))) / 2
    spectrum = fft.rfft(frames * window, size)
    energy = 2 / size * np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
    summed = np.pad(np.cumsum(energy, axis=-1), ((0, 0), (1, 0)))
    # Bin k reaches from k - 1/2 to k + 1/2; a band holds parts of bins.
    edges = np.arange(summed.shape[-1]) - 0.5
    below, above = (
        [np.interp(CENTRES_HZ * edge * size / rate_hz, edges, row) for row in summed]
        for edge in (1 - WEBER_FRACTION / 2, 1 + WEBER_FRACTION / 2)
    )
    return np.asarray(np.maximum(np.subtract(above, below), 0.0))  # but for rounding


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
