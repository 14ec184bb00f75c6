"""From one recording to its rendered stimuli: condition, reduce, match, resample, fade; no gain yet.

What is rendered is kept in a *parts* folder, one WAV in m/s² and one note of what was measured per stimulus, under a
key made from everything that went into it. A build that was killed finds its parts again; a finished build throws them
away.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.anchors import ANCHORS
from stimuli.condition import condition, fade, resample
from stimuli.door import largest
from stimuli.manifest import write_bytes
from stimuli.match import axis_correlations, mean_heard
from stimuli.perception import THRESHOLDS, loudest_level
from stimuli.recipe import NO_REFERENCE, ORIGINAL
from stimuli.recording import digest_samples
from stimuli.reduce import REDUCERS
from stimuli.spectrum import OriginalSpectrum
from stimuli.version import __version__
from stimuli.wav import write_wav

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.recipe import Recipe
    from stimuli.recording import Recording

    Samples = NDArray[np.float64]

ROUNDING = 1e-9
"""A stimulus below this share of its recording's level is what rounding left of axes that cancelled: silence."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One stimulus to be, before its level.

    Parameters
    ----------
    recording, reducer, role : str
        Made of what, how, and what for.
    key : str
        Digest of all that decides its samples.
    """

    recording: str
    reducer: str
    role: str
    key: str


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured on a rendered stimulus at unit gain.

    Parameters
    ----------
    peak : float
        Largest magnitude in m/s².
    levels : dict of str to float
        Name of a threshold curve -> largest root mean square in any 200 ms, in multiples of the threshold.
    spectral_match, temporal_match, spectral_match_bounded : float
        Matches of the reduced signal with the conditioned recording.
    """

    peak: float
    levels: dict[str, float]
    spectral_match: float
    temporal_match: float
    spectral_match_bounded: float


@dataclass(frozen=True, slots=True)
class _Scale:
    """What the stimuli of one recording are measured against."""

    recording: Recording
    spectrum: OriginalSpectrum
    played: Samples
    levels: dict[str, float]


def list_candidates(recording: Recording, recipe: Recipe) -> tuple[Candidate, ...]:
    """List what a recipe makes of one recording: tests, the hidden reference, anchors.

    Parameters
    ----------
    recording : Recording
        The recording as read, not yet conditioned.
    recipe : Recipe
        What is wanted.

    Returns
    -------
    tuple of Candidate
        In the manifest's order.
    """
    wanted = [(name, "test") for name in recipe.reducers]
    if recipe.reference != NO_REFERENCE:
        wanted.append((recipe.reference, "reference"))
    if recipe.anchors:
        wanted += [(name, "anchor") for name in ANCHORS]
    # The samples, not the file: the same file read in another unit or at another rate is another recording.
    basis = {"version": __version__, "recording": digest_samples(recording), **versions(), **recipe.rendering()}
    return tuple(
        Candidate(recording.name, reducer, role, _digest({**basis, "reducer": reducer})) for reducer, role in wanted
    )


def versions() -> dict[str, str]:
    """Versions of the software whose arithmetic decides the samples.

    Returns
    -------
    dict
        Package name -> version.
    """
    from importlib.metadata import version

    return {name: version(name) for name in ("numpy", "scipy", "soxr")}


def render_recording(
    recording: Recording, candidates: Sequence[Candidate], *, recipe: Recipe, parts: Path
) -> dict[str, Measured]:
    """Render those candidates of one recording that are not in the parts folder yet, and say what was measured.

    Parameters
    ----------
    recording : Recording
        The recording as read.
    candidates : sequence of Candidate
        Stimuli of this recording.
    recipe : Recipe
        How they are made.
    parts : Path
        Folder of the parts.

    Returns
    -------
    dict
        Key -> what was measured.

    Raises
    ------
    ValueError
        If the recording cannot be conditioned, or is silent where people feel.
    """
    measured = {c.key: found for c in candidates if (found := _read_part(parts, c.key)) is not None}
    for candidate, samples, note in _render(recording, [c for c in candidates if c.key not in measured], recipe):
        path = part_path(parts, candidate.key)
        write_wav(path, samples, recipe.rate_hz)
        write_bytes(_note_path(path), json.dumps({"bytes": path.stat().st_size, **asdict(note)}).encode())
        measured[candidate.key] = note
    return measured


def measure_recording(
    recording: Recording, candidates: Sequence[Candidate], *, recipe: Recipe
) -> dict[str, Measured]:
    """Measure candidates of one recording as `render_recording` does, without writing anything.

    Parameters
    ----------
    recording : Recording
        The recording as read.
    candidates : sequence of Candidate
        Stimuli of this recording.
    recipe : Recipe
        How they are made.

    Returns
    -------
    dict
        Key -> what was measured.
    """
    return {candidate.key: note for candidate, _, note in _render(recording, candidates, recipe)}


def part_path(parts: Path, key: str) -> Path:
    """Where a rendered stimulus is kept until the set is complete.

    Parameters
    ----------
    parts : Path
        Folder of the parts.
    key : str
        The candidate's key.

    Returns
    -------
    Path
        The WAV file, in m/s².
    """
    return parts / f"{key}.wav"


def _render(
    recording: Recording, wanted: Sequence[Candidate], recipe: Recipe
) -> Iterator[tuple[Candidate, Samples, Measured]]:
    """Make candidates one after the other: each with its samples for the rig in m/s², and what was measured."""
    if not wanted:
        return
    try:
        scale = _make_scale(condition(recording, recipe.conditioning), recipe)
        for candidate in wanted:
            samples, played = _play(candidate.reducer, scale, recipe)
            yield candidate, played, _measure(samples, played, scale=scale, rate_hz=recipe.rate_hz)
    except ValueError as error:
        raise ValueError(f"recording {recording.name!r}: {error}") from None


def _make_scale(conditioned: Recording, recipe: Recipe) -> _Scale:
    spectrum = OriginalSpectrum(conditioned.acceleration, conditioned.rate_hz)
    if spectrum.reason:
        raise ValueError(f"{spectrum.reason}; nothing can be felt or matched, leave it out")
    played = _for_the_rig(conditioned.acceleration, conditioned.rate_hz, recipe)
    return _Scale(conditioned, spectrum, played, _measure_levels(played, recipe.rate_hz))


def _play(reducer: str, scale: _Scale, recipe: Recipe) -> tuple[Samples, Samples]:
    """Give what is made of a recording, at its own rate and for the rig; there, anchors are as strong as it is."""
    if reducer == ORIGINAL:
        return scale.recording.acceleration, scale.played
    samples = _make(reducer, scale.recording)
    played = _for_the_rig(samples, scale.recording.rate_hz, recipe)
    if reducer not in ANCHORS:
        return samples, played
    own = loudest_level(played, recipe.rate_hz, threshold=recipe.threshold)
    return samples, scale.levels[recipe.threshold] / own * played


def _make(reducer: str, recording: Recording) -> Samples:
    if reducer in ANCHORS:
        seed = [int(recording.sha256[:16], 16), *reducer.encode()]
        return ANCHORS[reducer](recording, np.random.default_rng(seed))
    return REDUCERS[reducer](recording.acceleration, recording.rate_hz)


def _for_the_rig(samples: Samples, rate_hz: float, recipe: Recipe) -> Samples:
    # An offset (mag321 makes one) cannot be felt and only heats the coil; the metrics are taken before it is removed.
    vibration = samples - samples.mean(axis=-1, keepdims=True)
    return fade(resample(vibration, rate_hz, to_hz=recipe.rate_hz), recipe.rate_hz, fade_s=recipe.fade_s)


def _measure(samples: Samples, rendered: Samples, *, scale: _Scale, rate_hz: float) -> Measured:
    # The level is that of what is played: fades and a removed offset change it. The metrics are those of the reduction.
    found = _measure_levels(rendered, rate_hz)
    levels = {name: level if level > ROUNDING * scale.levels[name] else 0.0 for name, level in found.items()}
    if samples.ndim > 1:  # the original itself, matched channel by channel
        return Measured(largest(rendered), levels, 1.0, 1.0, 1.0)
    spectral, bounded = scale.spectrum.match_both(samples)
    temporal = mean_heard(axis_correlations(scale.recording.acceleration, samples))
    return Measured(largest(rendered), levels, float(spectral), float(temporal), float(bounded))


def _measure_levels(played: Samples, rate_hz: float) -> dict[str, float]:
    return {name: loudest_level(played, rate_hz, threshold=name) for name in THRESHOLDS}


def _read_part(parts: Path, key: str) -> Measured | None:
    """Read a part's note, which is written after its samples; a part that is damaged or has none does not count."""
    path = part_path(parts, key)
    try:
        note = json.loads(_note_path(path).read_bytes())
        return Measured(**note) if path.stat().st_size == note.pop("bytes") else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _note_path(part: Path) -> Path:
    return part.with_suffix(".json")


def _digest(what: object) -> str:
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()
