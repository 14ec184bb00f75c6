"""Recordings as they came from the sensor: conditioning hides offsets, clipping and the sensor's steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.formats import read_recording
from stimuli.synthesis import SCENES, make_scene
from study.folder import StudyFolder
from study.methods import _list_files, _name_apart
from study.settings.reading import read_settings
from study.settings.sources import open_recordings

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from stimuli.recording import Recording


def gather_sensor(folder: Path, *, scenes: bool = False, extra: Sequence[Path] = ()) -> dict[str, Recording]:
    """Gather what `gather_recordings` does, unconditioned.

    Parameters
    ----------
    folder : Path
        The study's folder; it may hold no study.
    scenes : bool
        Whether the bundled scenes are wanted too.
    extra : sequence of Path
        Recordings from elsewhere: files or folders.

    Returns
    -------
    dict of str to Recording
        By the names that `gather_recordings` gives them.

    Raises
    ------
    ValueError
        If recordings cannot be read.
    OSError
        If a file or folder is missing.
    """
    study = StudyFolder(folder)
    own = open_recordings(read_settings(study.settings), folder) if study.settings.is_file() else []
    others = [make_scene(name) for name in SCENES] if scenes else []
    others += [read_recording(path) for path in _list_files(extra)]
    return {recording.name: recording for recording in _name_apart(own, others)}
