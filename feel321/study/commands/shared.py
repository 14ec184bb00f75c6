"""What several verbs share: options, how a study is opened, progress and output."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, NoReturn, TextIO, TypeVar

from cyclopts import CycloptsError, Parameter, Token

from feel321 import files
from feel321.doors import announcing, clean_text, follow
from feel321.study.folder import require_study
from feel321.study.study import Study

if TYPE_CHECKING:
    from feel321.jobs import Workers
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.build import Facts
    from feel321.study.folder import StudyFolder

# How a verb is called.


@dataclass(frozen=True, slots=True)
class Call:
    """The words of a command line, and how much is printed besides results and errors."""

    words: Sequence[str] = ()
    quiet: bool = False
    verbose: bool = False
    traceback: bool = False


CALL: ContextVar[Call] = ContextVar("CALL", default=Call())  # noqa: B039 - a call is never changed

SWITCHES = {
    "-q": "quiet", "--quiet": "quiet", "-v": "verbose", "--verbose": "verbose", "--traceback": "traceback",
}  # fmt: skip
"""Switches that every verb has, in any place."""


def read_call(arguments: Sequence[str]) -> Call:
    """Take the switches that every verb has out of a command line; behind -- all words are the verb's."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    given = {SWITCHES[word]: True for word in arguments[:end] if word in SWITCHES}
    words = ["--help" if word == "-h" else word for word in arguments[:end] if word not in SWITCHES]
    return Call((*words, *arguments[end:]), **given)


@contextmanager
def calling(call: Call) -> Iterator[None]:
    """Print as much as a call wants."""
    begun, token = monotonic(), CALL.set(call)

    def log(text: str) -> None:
        echo(f"feel321: {monotonic() - begun:.1f} s: {text}", err=True)

    try:
        with announcing(log if call.verbose else str):
            yield
    finally:
        CALL.reset(token)


def refuse_use(text: str) -> NoReturn:
    """Refuse a combination of arguments: exit code 2."""
    raise CycloptsError(msg=text)


# Arguments and options.

MOST = 1e9
"""Beyond this no option means anything, whatever its unit."""

MOST_SEED = 2**63 - 1


def within(low: float, high: float) -> Parameter:
    """Make the rule that a number lies in a range, both ends included; NaN is in none."""
    allowed = f"{low:g} to {high:g}" if high < MOST_SEED else f"{low:g} or more"

    def check(_kind: object, number: float | None) -> None:
        if number is not None and not low <= number <= high:
            raise ValueError(f"Allowed: {allowed}")

    return Parameter(validator=check)


def _read_path(_kind: type, tokens: Sequence[Token]) -> Path:
    if not tokens[0].value:
        raise ValueError("a name must not be empty; '.' is the current folder")
    return Path(tokens[0].value)


def _read_columns(_kind: type, tokens: Sequence[Token]) -> tuple[str | int, ...]:
    names = tokens[0].value.split(",")
    return tuple(int(name) if name.strip().isdigit() else name for name in names)


File = Annotated[Path, Parameter(converter=_read_path)]
Number = Annotated[float, within(-MOST, MOST)]
Json = Annotated[bool, Parameter(name="--json", help="Print numbers as JSON.")]
Out = Annotated[File | None, Parameter(name=["--out", "-o"], help="Folder of the results.")]
Seed = Annotated[
    int | None, within(0, MOST_SEED), Parameter(help="Random seed; the study's by default.")
]
Participant = Annotated[str, Parameter(metavar="ID", help="The participant's code.")]
Rehearsals = Annotated[bool, Parameter(help="Rehearsals instead of sessions.")]
Several = Annotated[tuple[str, ...], Parameter(metavar="NAME")]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Crew:
    """Who does the work.

    Parameters
    ----------
    workers
        Number of processes.
    scheduler
        A Dask cluster instead: tls://HOST:PORT, or tcp://HOST:PORT (whoever reaches it can run programs).
    """

    workers: Annotated[int, within(1, 1024)] = 1
    scheduler: Annotated[str, Parameter(metavar="ADDRESS")] = ""

    def employ(self) -> "Workers":
        """Employ the workers."""
        from feel321.jobs import Workers

        try:
            return Workers(self.workers, self.scheduler)
        except ValueError as error:
            refuse_use(f"--{error}")


ALONE = Crew()


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Reading:
    """How a recording is read.

    Parameters
    ----------
    unit
        Unit of the samples: m/s^2, g or mg.  [default: what the file says]
    rate_hz
        Sampling rate in Hz.  [default: what the file says]
    columns
        Names or numbers (from 0): time,x,y,z.
    full_scale
        Full scale of integer samples, in the unit.
    resample
        Interpolate irregular sampling to an even rate.
    """

    unit: str | None = None
    rate_hz: Number | None = None
    columns: Annotated[
        tuple[str | int, ...] | None,
        Parameter(converter=_read_columns, n_tokens=1, metavar="NAME,..."),
    ] = None
    full_scale: Number | None = None
    resample: bool = False

    def read(self, path: Path) -> "Recording":
        """Read a recording, and print what was noticed in it."""
        from feel321.stimuli.formats.read import read_recording

        recording = read_recording(
            path,
            rate_hz=self.rate_hz,
            unit=self.unit,
            columns=self.columns,
            full_scale=self.full_scale,
            resample=self.resample,
        )
        report_warnings([recording])
        return recording


AS_IT_SAYS = Reading()

MOST_SWEPT = 5


def open_study(folder: Path, *, rehearsals: bool = False, clears: bool = True) -> Study:
    """Open a study that is there; what killed processes left in it goes, unless the verb only reads."""
    study = require_study(folder)
    swept = [*files.sweep(study.path), *files.sweep_temporary()] if clears else []
    if swept:
        more = f" and {len(swept) - MOST_SWEPT} more" if len(swept) > MOST_SWEPT else ""
        names = ", ".join(map(str, swept[:MOST_SWEPT]))
        warn(f"removed what an interrupted run left: {names}{more}")
    if rehearsals:
        study = type(study)(study.path, is_rehearsal=True)
    return Study(study, wants_bar(), warn=warn)


Word = TypeVar("Word", str, Path)


def split_study(words: Sequence[Word], what: str) -> tuple[Word | None, Word]:
    """Split [STUDY] from what follows it."""
    if not 0 < len(words) <= 2:  # noqa: PLR2004 - a study and one more
        refuse_use(f"takes a study and {what}, got {len(words)} words")
    return (words[0] if len(words) > 1 else None), words[-1]


# Output.


def echo(text: object = "", *, err: bool = False, over: bool = False) -> None:
    """Print lines, of which no name, note or answer can move the terminal's cursor, or change its colours or order.

    over: the next one is printed over it. A terminal that was closed is no error where only a person would read it.
    """
    line = clean_text(str(text), keep="\n\t")
    if not err:
        _print(sys.stdout, line)
    elif sys.stderr is not None:
        with suppress(OSError):
            _print(sys.stderr, f"\r{line}" if over else line, end="" if over else "\n")


def _print(stream: TextIO, line: str, end: str = "\n") -> None:
    stream.write(f"{line}{end}")
    stream.flush()


def warn(message: str) -> None:
    """Print a warning to stderr, in one line."""
    if not CALL.get().quiet:
        echo(f"feel321: warning: {clean_text(message)}", err=True)


def report_warnings(recordings: Iterable["Recording | Facts"]) -> None:
    """Print what was noticed in recordings, one line each, to stderr."""
    for line in cap([f"{one.name}: {text}" for one in recordings for text in one.warnings]):
        warn(line)


MOST_LINES = 20


def cap(
    lines: Sequence[str], *, whole: str = "--json lists all problems and warnings"
) -> list[str]:
    """Cut a long list of lines, and say how many there are more, and where."""
    left = len(lines) - MOST_LINES
    return [*lines[:MOST_LINES], *([f"and {left} more like these; {whole}"] if left > 0 else [])]


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


def recording(study: "StudyFolder", verb: str, path: Path) -> AbstractContextManager[None]:
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
    call = CALL.get()
    return is_terminal() and not call.quiet and not call.verbose


def show_progress(what: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Show a progress bar on stderr, if that is a terminal."""
    return follow(wants_bar(), what)
