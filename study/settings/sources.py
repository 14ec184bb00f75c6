"""From settings to signals: the recordings that a study names, and the recipe for its stimuli.

A recording with a `rotation` is turned before anything else is done to it, as if its sensor had been glued on
otherwise. The number seeds an orientation uniform over all rotations: the same number turns every recording alike.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from stimuli.condition import Conditioning
from stimuli.formats import read_recording
from stimuli.recipe import Recipe
from stimuli.synthesis import make_scene
from study.settings.tables import SceneTable

if TYPE_CHECKING:
    from pathlib import Path

    from stimuli.recording import Recording
    from study.settings.tables import FileTable, Settings


@dataclass(frozen=True, slots=True)
class Surface:
    """The real surface that a recording was taken from.

    Parameters
    ----------
    sample : str or None
        What it is called in the lab; None where it is not at hand.
    picture : Path or None
        A picture of it; None where there is none.
    """

    sample: str | None
    picture: Path | None


def list_surfaces(settings: Settings, folder: Path) -> dict[str, Surface]:
    """Look up the surfaces that participants stroke or see; a trial names them by their recordings.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder; file names are relative to it.

    Returns
    -------
    dict of str to Surface
        The surface of every recording, by the recording's name.
    """
    return {
        entry.title: Surface(entry.sample, folder / entry.picture if entry.picture else None)
        for entry in settings.recordings
    }


def list_origins(settings: Settings) -> dict[str, str]:
    """Look up what recordings were made from: those that are one, turned, are not independent of each other.

    Parameters
    ----------
    settings : Settings
        The study's settings.

    Returns
    -------
    dict of str to str
        The file, or the scene and its seed, of every recording, by the recording's name.
    """
    return {
        entry.title: f"{entry.scene} {entry.seed}" if isinstance(entry, SceneTable) else entry.file
        for entry in settings.recordings
    }


def open_recordings(settings: Settings, folder: Path) -> list[Recording]:
    """Read every recording of a study.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder; file names are relative to it.

    Returns
    -------
    list of Recording
        In the order of the settings, named as there.

    Raises
    ------
    ValueError
        If recordings cannot be read: one line for each.
    """
    recordings, mistakes = try_recordings(settings, folder)
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return recordings


def try_recordings(settings: Settings, folder: Path) -> tuple[list[Recording], list[str]]:
    """Read every recording of a study that can be read, and say why the others cannot.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder; file names are relative to it.

    Returns
    -------
    recordings : list of Recording
        Those that can be read.
    mistakes : list of str
        One line for each of the others.
    """
    recordings: list[Recording] = []
    mistakes: list[str] = []
    for entry in settings.recordings:
        try:
            recordings.append(_open_recording(entry, folder))
        except (OSError, ValueError) as error:
            mistakes.append(f"recording {entry.title!r}: {error}")
    return recordings, mistakes


def make_recipe(settings: Settings) -> Recipe:
    """Put the settings of the stimuli and the rig into a recipe.

    Parameters
    ----------
    settings : Settings
        The study's settings.

    Returns
    -------
    Recipe
        How stimuli are made from recordings.
    """
    stimuli, rig = settings.stimuli, settings.rig
    steps = stimuli.conditioning
    return Recipe(
        conditioning=Conditioning(
            remove_offset=steps.remove_offset,
            high_pass_hz=steps.high_pass_hz,
            low_pass_hz=steps.low_pass_hz,
            crop_s=steps.crop_s,
        ),
        reducers=stimuli.reducers,
        levels=stimuli.levels,
        anchors=stimuli.anchors,
        reference=stimuli.reference,
        gain=stimuli.gain,
        fade_s=stimuli.fade_s,
        threshold=stimuli.threshold,
        rate_hz=rig.rate_hz,
        full_scale_m_s2=rig.full_scale_m_s2,
        headroom=rig.headroom,
    )


def turn_recording(recording: Recording, rotation: int) -> Recording:
    """Turn a recording into a random orientation of its sensor.

    Parameters
    ----------
    recording : Recording
        As it was read.
    rotation : int
        Seed of the orientation.

    Returns
    -------
    Recording
        Turned; its digest is of its source's and of the seed, so that a stimulus set of another orientation is told.
    """
    import numpy as np

    from stimuli.rotation import random_rotations

    turn = random_rotations(1, np.random.default_rng(rotation))[0]
    return replace(
        recording,
        acceleration=np.einsum("ij,jn->in", turn, recording.acceleration),
        sha256=hashlib.sha256(f"{recording.sha256} rotation {rotation}".encode()).hexdigest(),
    )


def _open_recording(entry: SceneTable | FileTable, folder: Path) -> Recording:
    if isinstance(entry, SceneTable):
        recording = make_scene(entry.scene, seed=entry.seed, rate_hz=entry.rate_hz, duration_s=entry.duration_s)
    else:
        recording = read_recording(
            folder / entry.file,
            rate_hz=entry.rate_hz,
            unit=entry.unit,
            columns=entry.columns,
            full_scale=entry.full_scale,
            resample=entry.resample,
        )
    if entry.rotation is not None:
        recording = turn_recording(recording, entry.rotation)
    return replace(recording, name=entry.title)
