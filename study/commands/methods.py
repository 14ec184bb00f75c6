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
    recordings : tuple of Recording
        Conditioned, each with a name of its own.
    output : Path
        Folder of the results.
    seed : int
        Of all randomness.
    """

    study: StudyFolder
    recordings: tuple[Recording, ...]
    output: Path
    seed: int


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
        def gather_then_do(
            *, folder: Path, scenes: bool, extra: tuple[Path, ...], target: Path | None, seed: int | None, **own: object
        ) -> None:
            verb(task=_gather(folder, scenes=scenes, extra=extra, target=target or folder / output, seed=seed), **own)

        return gather_then_do

    return give


def _gather(folder: Path, *, scenes: bool, extra: tuple[Path, ...], target: Path, seed: int | None) -> Task:
    from study.methods import gather_recordings
    from study.settings.reading import read_settings

    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: got no folder, allowed is a study's; check the name")
    recordings = gather_recordings(folder, scenes=scenes, extra=extra)
    report_warnings(recordings)
    study = StudyFolder(folder)
    if seed is None:
        seed = read_settings(study.settings).study.seed if study.settings.is_file() else 0
    return Task(study, recordings, target, seed)
