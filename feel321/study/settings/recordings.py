"""The recordings of a study: read as `[[recordings]]` say, turned, and what they are of."""

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.recipe import Unread
from feel321.stimuli.synthesis import make_scene
from feel321.study.session.ports import Surface
from feel321.study.settings.schema import SCENE_RATE_HZ, RecordingTable, Settings


def list_surfaces(settings: Settings, folder: Path) -> dict[str, Surface]:
    """List the surfaces that participants touch or see, by the names of their recordings."""
    return {
        entry.title: Surface(entry.sample, folder / entry.picture if entry.picture else None)
        for entry in settings.recordings
    }


def list_origins(settings: Settings) -> dict[str, str]:
    """List what recordings were made from: one source, rotated, gives recordings that are not independent."""
    return {
        entry.title: f"{entry.scene} {entry.seed}" if entry.scene else entry.file or ""
        for entry in settings.recordings
    }


def list_unread(settings: Settings, folder: Path) -> list[Unread]:
    """List the recordings of a study as they are to be read."""
    return [Unread(entry.title, _open_entry, (entry, folder)) for entry in settings.recordings]


def try_recordings(settings: Settings, folder: Path) -> Iterator[tuple[Unread, Recording | str]]:
    """Read each recording of a study in turn; gives its fault instead where it cannot be read."""
    for source in list_unread(settings, folder):
        try:
            yield source, source.read()
        except (OSError, TypeError, ValueError) as error:
            yield source, f"recording {source.name!r}: {error}"


def open_recordings(settings: Settings, folder: Path) -> list[Recording]:
    """Read every recording of a study; all that cannot be read are named at once."""
    found = [one for _, one in try_recordings(settings, folder)]
    if mistakes := [one for one in found if isinstance(one, str)]:
        raise ValueError("\n".join(mistakes))
    return [one for one in found if isinstance(one, Recording)]


def _open_entry(entry: RecordingTable, folder: Path) -> Recording:
    """Read a recording as its table says."""
    if entry.scene:
        rate_hz = entry.rate_hz or SCENE_RATE_HZ
        recording = make_scene(
            entry.scene, rng=entry.seed, rate_hz=rate_hz, duration_s=entry.duration_s
        )
    else:
        own = entry.model_dump(include={"rate_hz", "unit", "columns", "full_scale", "resample"})
        recording = read_recording(folder / (entry.file or ""), **own)
    return recording if entry.rotation is None else turn_recording(recording, entry.rotation)


def turn_recording(recording: Recording, rotation: int) -> Recording:
    """Turn a recording as if its sensor had been mounted in another orientation, which the number seeds."""
    import numpy as np

    from feel321.stimuli.rotation import random_rotations

    turn = random_rotations(1, np.random.default_rng(rotation))[0]
    turned = np.einsum("ij,jn->in", turn, recording.acceleration)
    sha256 = hashlib.sha256(f"{recording.sha256} rotation {rotation}".encode()).hexdigest()
    return replace(recording, acceleration=turned, sha256=sha256)
