"""What several verbs share: arguments, options, progress and output."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext, suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feel321 import files
from feel321.doors import announcing, clean_text, follow
from feel321.jobs import Workers
from feel321.study.folder import require_study
from feel321.study.study import Study

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from os import PathLike

    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.build import Facts
    from feel321.study.folder import StudyFolder

    Verb = Callable[..., None]


class _GivenPath(click.Path):
    """A path that was given: the empty name would be the working directory."""

    def convert(
        self, value: str | PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> str | bytes | PathLike[str]:
        if value == "":
            self.fail("a name must not be empty; '.' is the current folder", param, ctx)
        return super().convert(value, param, ctx)


MOST = 1e9
"""Beyond this no option means anything, whatever its unit."""

MOST_WORKERS = 1024


def _describe_range(low: float | None, high: float | None) -> str:
    """Say which numbers are allowed, as people write it.

    Examples
    --------
    >>> _describe_range(1, 3), _describe_range(0, MOST), _describe_range(-MOST, MOST)
    ('1 to 3', '0 or more', '')
    """
    if low is None or low <= -MOST:
        return ""
    return f"{low:g} or more" if high is None or high >= MOST else f"{low:g} to {high:g}"


class BoundedNumber(click.FloatRange):
    """A number in a range; NaN, which is in none, is refused too."""

    name = "number"

    def convert(
        self,
        value: Any,  # noqa: ANN401 - as click has it
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> float:
        """Read a number."""
        number: float = click.FLOAT.convert(value, param, ctx)
        if not abs(number) <= MOST:
            self.fail(f"{value!r} is not a number of at most {MOST:g}", param, ctx)
        return float(super().convert(number, param, ctx))

    def _describe_range(self) -> str:
        return _describe_range(self.min, self.max)


class WholeNumber(click.IntRange):
    """A whole number in a range."""

    name = "number"

    def _describe_range(self) -> str:
        return _describe_range(self.min, self.max)


LOUDNESS = "feel321.loudness"

READING = {"audit", "check", "status"}
"""Verbs that write nothing into a study, so that they leave it as it is."""

FILE = _GivenPath(path_type=Path)


def flag(option: str, text: str, name: str = "") -> Callable[[Verb], Verb]:
    """Give a verb a switch; it receives it under the option's name or another one."""
    return click.option(option, *([name] if name else []), is_flag=True, help=text)


def number_option(option: str, text: str, default: str = "") -> Callable[[Verb], Verb]:
    """Give a verb a number that may be left out; the default stands in the help only."""
    shown = f"  [default: {default}]" if default else ""
    return click.option(option, type=BoundedNumber(-MOST, MOST), help=text + shown)


json_option = flag("--json", "Print the numbers as JSON.", "as_json")
folder_argument = click.argument("folder", metavar="[STUDY]", default=Path(), type=FILE)
participant_option = click.option(
    "--participant", metavar="ID", required=True, help="The participant's code."
)
ratings_option = click.option(
    "--ratings", type=FILE, help="Ratings from elsewhere; with --manifest, no study is needed."
)
manifest_option = click.option(
    "--manifest", type=FILE, help="The stimuli that were rated.  [default: the study's]"
)
metric_option = click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="A numeric column of the manifest as a metric of the primary analysis; repeatable.  [default: as declared]",
)


def out_option(default: str) -> Callable[[Verb], Verb]:
    """Give a verb the folder of its results."""
    return click.option("--out", type=FILE, help=f"Folder of the results.  [default: {default}]")


rehearsals_option = flag(
    "--rehearsals", "Take the rehearsals (run --rehearse) instead of the sessions."
)


def workers_option(verb: Verb) -> Verb:
    """Give a verb the options that say who does the work; it receives `workers`, a Workers."""

    @click.option(
        "--workers",
        "processes",
        type=WholeNumber(1, MOST_WORKERS),
        default=1,
        show_default=True,
        help="Number of processes; each takes a second or two to start, too long for a few short recordings.",
    )
    @click.option(
        "--scheduler",
        metavar="ADDRESS",
        default="",
        help="Use a Dask cluster that sees the same files: tcp://HOST:PORT (not encrypted; anyone who can reach it can "
        "run programs) or tls://HOST:PORT.",
    )
    @wraps(verb)
    def employ_then_do(*, processes: int, scheduler: str, **own: object) -> None:
        try:
            workers = Workers(processes, scheduler)
        except ValueError as error:
            raise click.UsageError(f"--{error}") from None
        verb(workers=workers, **own)

    return employ_then_do


def seed_option(of: str, default: str = "the study's") -> Callable[[Verb], Verb]:
    """Give a verb a random seed."""
    text = f"Random seed{of}.  [default: {default}]"
    return click.option("--seed", type=WholeNumber(0, 2**63 - 1), help=text)


def add_loudness(verb: click.Command) -> click.Command:
    """Give a verb, or all of them, the options that say how much is printed besides results and errors."""

    def choose(context: click.Context, parameter: click.Parameter, value: object) -> None:
        if not value:
            return
        context.meta[LOUDNESS] = parameter.name
        if parameter.name == "verbose":
            context.with_resource(announcing(_log_steps()))

    texts = {
        "quiet": "No progress and no warnings: only results and errors.",
        "verbose": "Print each step as it begins.",
    }
    verb.context_settings.setdefault("help_option_names", ["-h", "--help"])
    verb.params += [
        click.Option([f"-{name[0]}", f"--{name}"], is_flag=True, is_eager=True, expose_value=False,
            callback=choose, help=text)
        for name, text in texts.items()
    ]  # fmt: skip
    return verb


def _log_steps() -> Callable[[str], None]:
    """Make what prints a line for each step, with the time since the beginning."""
    from time import monotonic

    begun = monotonic()
    return lambda text: echo(f"feel321: {monotonic() - begun:.1f} s: {text}", err=True)


def _is(loudness: str) -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and context.meta.get(LOUDNESS) == loudness


def open_study(folder: Path) -> Study:
    """Open a study that is there, for a terminal; what killed processes left in it goes, unless it is only read."""
    study = require_study(folder)
    context = click.get_current_context(silent=True)
    if context is None or context.info_name not in READING:
        report_swept([*files.sweep(study.path), *files.sweep_temporary()])
    return Study(study, wants_bar(), warn=warn)


def report_swept(swept: Sequence[Path]) -> None:
    """Print what was removed of killed processes, in one line."""
    if swept:
        more = f" and {len(swept) - MOST_SWEPT} more" if len(swept) > MOST_SWEPT else ""
        names = ", ".join(map(str, swept[:MOST_SWEPT]))
        warn(f"removed what an interrupted run left: {names}{more}")


MOST_SWEPT = 5


def study_argument(verb: Verb) -> Verb:
    """Give a verb the argument STUDY; it receives `study`, a Study that is there."""

    def find(_context: click.Context, _parameter: click.Parameter, value: Path) -> Study:
        return open_study(value)

    return click.argument("study", metavar="[STUDY]", default=Path(), type=FILE, callback=find)(
        verb
    )


def _split_columns(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> list[str | int] | None:
    if text is None:
        return None
    return [int(name) if name.strip().isdigit() else name for name in text.split(",")]


def recording_argument(verb: Verb) -> Verb:
    """Give a verb the argument RECORDING and the options that say how to read it; it receives `recording`."""

    @click.argument("recording", type=FILE)
    @click.option(
        "--unit", help="Unit of the samples: m/s^2, g or mg.  [default: what the file says]"
    )
    @number_option("--rate-hz", "Sampling rate in Hz.", "what the file says")
    @click.option(
        "--columns",
        callback=_split_columns,
        help="Names or numbers (from 0), such as time,x,y,z.  [default: by name]",
    )
    @number_option("--full-scale", "Full scale of integer samples, in the unit.")
    @flag("--resample", "Interpolate irregular sampling to an even rate.")
    @wraps(verb)
    def read_then_do(
        *,
        recording: Path,
        unit: str | None,
        rate_hz: float | None,
        columns: list[str | int] | None,
        full_scale: float | None,
        resample: bool,
        **own: object,
    ) -> None:
        from feel321.stimuli.formats.read import read_recording

        source = read_recording(
            recording,
            rate_hz=rate_hz,
            unit=unit,
            columns=columns,
            full_scale=full_scale,
            resample=resample,
        )
        report_warnings([source])
        verb(recording=source, **own)

    return read_then_do


def echo(text: object = "", *, err: bool = False, over: bool = False) -> None:
    """Print lines, of which no name, note or answer can move the terminal's cursor, or change its colours or order.

    over: the next one is printed over it. A terminal that was closed is no error where only a person would read it.
    """
    line = clean_text(str(text), keep="\n\t")
    with suppress(OSError) if err else nullcontext():
        click.echo(f"\r{line}" if over else line, nl=not over, err=err)


def warn(message: str) -> None:
    """Print a warning to stderr, in one line."""
    if not _is("quiet"):
        echo(f"feel321: warning: {clean_text(message)}", err=True)


def report_warnings(recordings: Iterable[Recording | Facts]) -> None:
    """Print what was noticed in recordings, one line each, to stderr."""
    for line in cap([f"{one.name}: {text}" for one in recordings for text in one.warnings]):
        warn(line)


MOST_LINES = 20


def cap(
    lines: Sequence[str], *, whole: str = "--json lists all problems and warnings"
) -> list[str]:
    """Cut a long list of lines, and say how many there are more, and where."""
    left = len(lines) - MOST_LINES
    more = [f"and {left} more like these; {whole}"]
    return [*lines[:MOST_LINES], *(more if left > 0 else ())]


def print_json(entry: object) -> None:
    """Print numbers as JSON."""
    echo(dump_json(entry))


def dump_json(entry: object) -> str:
    """Write numbers as JSON, which knows no NaN and no infinity: both become null.

    Examples
    --------
    >>> dump_json([1.5, float("nan")]).split()
    ['[', '1.5,', 'null', ']']
    """
    from feel321.records import to_json_value

    return json.dumps(to_json_value(entry), indent=2, ensure_ascii=False, allow_nan=False)


def recording(study: StudyFolder, verb: str, path: Path) -> AbstractContextManager[None]:
    """Record what a verb writes outside the study's own places, so that a withdrawal finds it."""
    from feel321.study.persons.withdrawal import recording_output
    from feel321.study.session.journal import utc_now

    return recording_output(study, verb, path, now=utc_now)


def print_results(folder: Path, *, as_json: bool) -> None:
    """Print where the page of results is, or all of its numbers."""
    results = folder / "results.json"
    echo(results.read_text(encoding="utf-8") if as_json else folder / "index.html")


def is_terminal() -> bool:
    """Check whether somebody watches stderr; where it is closed (2>&-), Python has none."""
    return sys.stderr is not None and sys.stderr.isatty()


def wants_bar() -> bool:
    """Check whether a progress bar is wanted: on a terminal, unless nothing or each step is to be printed."""
    return is_terminal() and not _is("quiet") and not _is("verbose")


def show_progress(what: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Show a progress bar on stderr, if that is a terminal."""
    return follow(wants_bar(), what)
