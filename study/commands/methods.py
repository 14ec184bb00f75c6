"""What the verbs about methods (chart, stress, advise) share: which recordings, where to, which seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING

import click

from study.commands.shared import FILE, json_option, report_warnings
from study.folder import StudyFolder

if TYPE_CHECKING:
    from collections.abc import Callable

    from stimuli.recording import Recording

    Verb = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Task:
    """What a verb about methods was asked to do.

    Parameters
    ----------
    study : StudyFolder
        The study's folder; it may hold no study where recordings come from elsewhere.
    scenes : bool
        Whether the bundled scenes are wanted.
    extra : tuple of Path
        Recordings from elsewhere.
    output : Path
        Folder of the results.
    seed : int
        Of all randomness.
    """

    study: StudyFolder
    scenes: bool
    extra: tuple[Path, ...]
    output: Path
    seed: int

    def gather(self) -> tuple[Recording, ...]:
        """Gather what is asked for, conditioned, and report what is odd about it.

        Returns
        -------
        tuple of Recording
            Each with a name of its own.
        """
        recordings = self._gather(conditioned=True)
        report_warnings(recordings)
        return recordings

    def gather_raw(self) -> dict[str, Recording]:
        """Gather the same as it came from the sensor.

        Returns
        -------
        dict of str to Recording
            By name.
        """
        return {recording.name: recording for recording in self._gather(conditioned=False)}

    def _gather(self, *, conditioned: bool) -> tuple[Recording, ...]:
        from study.methods import gather_recordings

        return gather_recordings(self.study.path, scenes=self.scenes, extra=self.extra, conditioned=conditioned)


def method_options(output: str) -> Callable[[Verb], Verb]:
    """Give a verb STUDY and the options that say which recordings; it receives `task` and `as_json`.

    Parameters
    ----------
    output : str
        What the folder of its results is called, in the study's folder.

    Returns
    -------
    callable
        Puts the argument and the options on a verb.
    """

    def give(verb: Verb) -> Verb:
        @click.argument("folder", metavar="[STUDY]", default=Path(), type=FILE)
        @click.option("--scenes", is_flag=True, help="The bundled scenes too; then no study is needed.")
        @click.option(
            "--recordings", "extra", type=FILE, multiple=True,
            help="A recording from elsewhere too, or a folder of them; repeatable, and then no study is needed.",
        )  # fmt: skip
        @click.option("-o", "--output", "target", type=FILE, help=f"Folder of the results.  [default: STUDY/{output}]")
        @click.option("--seed", type=click.IntRange(min=0), help="Of all randomness.  [default: the study's, or 0]")
        @json_option
        @wraps(verb)
        def ask_then_do(
            *, folder: Path, scenes: bool, extra: tuple[Path, ...], target: Path | None, seed: int | None, **own: object
        ) -> None:
            from analysis.report.replacing import check_target

            study, output_folder = _find_folder(folder), target or folder / output
            check_target(output_folder)
            chosen = _find_seed(study) if seed is None else seed
            verb(task=Task(study, scenes, extra, output_folder, chosen), **own)

        return ask_then_do

    return give


def _find_folder(folder: Path) -> StudyFolder:
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: got no folder, allowed is a study's; check the name")
    return StudyFolder(folder)


def _find_seed(study: StudyFolder) -> int:
    from study.settings.reading import read_settings

    return read_settings(study.settings).study.seed if study.settings.is_file() else 0
