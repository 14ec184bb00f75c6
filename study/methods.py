"""What chart, stress and advise work on: a study's recordings, the bundled scenes, recordings from elsewhere.

All go through the same conditioning, the study's own, because that is what participants feel. Its crop, which names
times in the study's recordings, is done to those alone. Unconditioned they are as the sensor gave them: conditioning
hides offsets, clipping and the sensor's steps.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from itertools import chain, count
from typing import TYPE_CHECKING

from stimuli.condition import Conditioning, condition
from stimuli.formats import read_recording
from stimuli.manifest import read_stimuli
from stimuli.synthesis import SCENES, make_scene
from study.folder import StudyFolder, require_study
from study.ratings import write_ratings
from study.settings.reading import read_settings
from study.settings.sources import make_recipe, try_recordings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from analysis.table.reading import Table
    from stimuli.recording import Recording

SUFFIXES = frozenset({".wav", ".csv", ".tsv", ".txt", ".npz", ".npy", ".mat", ".xml", ".ide"})
"""What files in a folder are taken for recordings; a single file is read whatever it is called."""


def gather_recordings(
    folder: Path, *, scenes: bool = False, extra: Sequence[Path] = (), conditioned: bool = True
) -> tuple[Recording, ...]:
    """Gather the recordings that methods are compared on.

    Parameters
    ----------
    folder : Path
        The study's folder. It may hold no study where scenes or other recordings are asked for; those are then
        conditioned by default.
    scenes : bool
        Whether the bundled scenes are wanted too.
    extra : sequence of Path
        Recordings from elsewhere: files, or folders whose recordings are all taken.
    conditioned : bool
        Whether they are conditioned; if not, they are as they came from the sensor.

    Returns
    -------
    tuple of Recording
        The study's, the scenes, those from elsewhere; what is there twice is taken once, and each has a name of its
        own, the same whether conditioned or not.

    Raises
    ------
    ValueError
        If recordings cannot be read or conditioned: one line for each.
    OSError
        If there is no study and nothing else is asked for, or a file or folder is missing.
    """
    mistakes: list[str] = []
    own, steps = _open_study(folder, mistakes, needed=not (scenes or extra))
    others = [make_scene(name) for name in SCENES] if scenes else []
    for path in _list_files(extra):
        with _noted(mistakes):
            others.append(read_recording(path))
    recordings = _name_apart(own, others)
    if conditioned:
        crops = [steps.crop_s] * len(own) + [None] * (len(recordings) - len(own))
        recordings = list(_condition_all(recordings, [replace(steps, crop_s=crop) for crop in crops], mistakes))
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return tuple(recordings)


def find_ratings(study: StudyFolder) -> Table | None:
    """Find the ratings of a study, as analyze does: derived from its journals, or a table that was put there.

    Parameters
    ----------
    study : StudyFolder
        The study's folder; it may hold no study.

    Returns
    -------
    Table or None
        Ratings with their stimuli; None where nobody has rated yet.

    Raises
    ------
    ValueError
        If journals or tables are not as they must be.
    """
    from analysis.table.reading import read_table

    if study.journals:
        rated = write_ratings(study, read_stimuli(study.stimuli)) > 0
    else:
        rated = study.ratings.is_file() and study.manifest.is_file()
    return read_table(study.ratings, study.manifest) if rated else None


def _open_study(folder: Path, mistakes: list[str], *, needed: bool) -> tuple[list[Recording], Conditioning]:
    study = require_study(folder) if needed else StudyFolder(folder)
    if not study.settings.is_file():
        return [], Conditioning()
    settings = read_settings(study.settings)
    recordings, unreadable = try_recordings(settings, folder)
    mistakes += unreadable
    return recordings, make_recipe(settings).conditioning


def _condition_all(
    recordings: Iterable[Recording], steps: Iterable[Conditioning], mistakes: list[str]
) -> Iterator[Recording]:
    for recording, own in zip(recordings, steps, strict=True):
        with _noted(mistakes, f"recording {recording.name!r}: "):
            yield condition(recording, own)


@contextmanager
def _noted(mistakes: list[str], whose: str = "") -> Iterator[None]:
    """Note what goes wrong inside, so that everything that is wrong is told at once."""
    try:
        yield
    except (OSError, ValueError) as error:
        mistakes.append(f"{whose}{error}")


def _name_apart(own: Sequence[Recording], others: Iterable[Recording]) -> list[Recording]:
    """Leave out what is there twice, and number those others whose names are taken."""
    named = list(own)
    for recording in others:
        if any(recording.sha256 == former.sha256 for former in named):
            continue
        taken = {former.name for former in named}
        names = chain([recording.name], (f"{recording.name} ({number})" for number in count(2)))
        named.append(replace(recording, name=next(name for name in names if name not in taken)))
    return named


def _list_files(paths: Iterable[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if not path.is_dir():
            files.append(path)
            continue
        found = sorted(entry for entry in path.glob("[!.]*") if entry.suffix.lower() in SUFFIXES and entry.is_file())
        if not found:
            raise FileNotFoundError(
                f"{path}: got a folder without recordings, allowed are files ending in {' '.join(sorted(SUFFIXES))}; "
                "name another"
            )
        files += found
    return files
