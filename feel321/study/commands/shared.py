"""What several verbs share: arguments, progress, output, the clock."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import wraps
from math import isfinite
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from os import PathLike

    from feel321.stimuli.recording import Recording

    Verb = Callable[..., None]


class _Place(click.Path):
    """A path that was given: the empty name would be the working directory."""

    def convert(
        self, value: str | PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> str | bytes | PathLike[str]:
        if value == "":
            self.fail(
                "got an empty name, allowed is that of a file or folder ('.' is this one)",
                param,
                ctx,
            )
        return super().convert(value, param, ctx)


FILE = _Place(path_type=Path)

json_option = click.option("--json", "as_json", is_flag=True, help="Print figures as JSON.")


def study_argument(verb: Verb) -> Verb:
    """Give a verb the argument STUDY; it receives `study`, a StudyFolder that is there."""

    def find(_context: click.Context, _parameter: click.Parameter, value: Path) -> StudyFolder:
        return find_study(value)

    return click.argument("study", metavar="[STUDY]", default=Path(), type=FILE, callback=find)(
        verb
    )


def find_study(path: Path) -> StudyFolder:
    """Find the study that a user means, or say what the name stands for instead."""
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: there is no such folder; begin a study with: feel321 new {quote(str(path))}"
        )
    if not path.is_dir():
        raise NotADirectoryError(
            f"{path}: got a file, allowed is a study's folder; try {quote(str(path.parent))}"
        )
    return require_study(path)


def recording_argument(verb: Verb) -> Verb:
    """Give a verb the argument RECORDING and the options that say how to read it; it receives `recording`."""

    @click.argument("recording", type=FILE)
    @click.option(
        "--unit", help="Unit of the samples: m/s^2, g or mg.  [default: what the file says]"
    )
    @click.option(
        "--rate-hz", type=float, help="Sampling rate in Hz.  [default: what the file says]"
    )
    @click.option(
        "--columns", help="Names or numbers (from 0), such as time,x,y,z.  [default: by name]"
    )
    @click.option("--full-scale", type=float, help="Full scale of integer samples, in the unit.")
    @click.option("--resample", is_flag=True, help="Mend irregular sampling.")
    @wraps(verb)
    def read_then_do(
        *,
        recording: Path,
        unit: str | None,
        rate_hz: float | None,
        columns: str | None,
        full_scale: float | None,
        resample: bool,
        **own: object,
    ) -> None:
        from feel321.stimuli.formats.read import read_recording

        source = read_recording(
            recording,
            rate_hz=rate_hz,
            unit=unit,
            columns=None
            if columns is None
            else [_name_column(name) for name in columns.split(",")],
            full_scale=full_scale,
            resample=resample,
        )
        report_warnings([source])
        verb(recording=source, **own)

    return read_then_do


def report_warnings(recordings: Iterable[Recording]) -> None:
    """Print what was noticed in recordings, one line each, to stderr."""
    for recording in recordings:
        for warning in recording.warnings:
            warn(f"{recording.name}: {warning}")


def warn(message: str) -> None:
    """Print a warning to stderr."""
    click.echo(f"feel321: warning: {message}", err=True)


def print_json(entry: object) -> None:
    """Print figures as JSON."""
    click.echo(dump_json(entry))


def dump_json(entry: object) -> str:
    """Write figures as JSON, which knows no NaN and no infinity: both become null.

    Examples
    --------
    >>> dump_json([1.5, float("nan")]).split()
    ['[', '1.5,', 'null', ']']
    """
    return json.dumps(_replace_undefined(entry), indent=2, ensure_ascii=False, allow_nan=False)


@contextmanager
def show_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on stderr, if that is a terminal."""
    from tqdm import tqdm

    # Where stderr is closed (2>&-), Python has none.
    hidden = sys.stderr is None or not sys.stderr.isatty()
    with tqdm(desc=what, file=sys.stderr, disable=hidden, leave=False) as bar:

        def move(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield move


def now() -> datetime:
    """Tell the time of day."""
    return datetime.now(UTC)


def _name_column(text: str) -> str | int:
    return int(text) if text.strip().isdigit() else text


def _replace_undefined(entry: object) -> object:
    if isinstance(entry, dict):
        return {key: _replace_undefined(value) for key, value in entry.items()}
    if isinstance(entry, list | tuple):
        return [_replace_undefined(value) for value in entry]
    return None if isinstance(entry, float) and not isfinite(entry) else entry
