"""What several verbs share: options, how a study is opened, progress, output and help."""

import inspect
import json
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

from cyclopts import CycloptsError, Parameter, Token
from cyclopts.annotations import resolve_optional

from feel321 import files
from feel321.doors import announcing, clean_text, follow
from feel321.study.folder import require_study
from feel321.study.study import Study

if TYPE_CHECKING:
    from cyclopts import App, Argument

    from feel321.jobs import Workers
    from feel321.stimuli.recording import Recording
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
Number = Annotated[float, within(0, MOST)]
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

        options = {name: getattr(self, name) for name in self.__slots__}
        recording = read_recording(path, **options)
        report_warnings([recording])
        return recording


AS_IT_SAYS = Reading()


def open_study(folder: Path, *, rehearsals: bool = False, clears: bool = True) -> Study:
    """Open a study that is there; what killed processes left in it goes, unless the verb only reads."""
    study = require_study(folder)
    if clears and (swept := [*files.sweep(study.path), *files.sweep_temporary()]):
        names, more = ", ".join(map(str, swept[:5])), len(swept) - 5
        warn(f"removed what an interrupted run left: {names}{f' and {more} more' * (more > 0)}")
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
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    elif sys.stderr is not None:
        with suppress(OSError):
            sys.stderr.write(f"\r{line}" if over else f"{line}\n")
            sys.stderr.flush()


def warn(message: str) -> None:
    """Print a warning to stderr, in one line."""
    if not CALL.get().quiet:
        echo(f"feel321: warning: {clean_text(message)}", err=True)


def report_warnings(recordings: Iterable["Recording"]) -> None:
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


def print_facts(facts: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print numbers as JSON, or lines that a person reads."""
    echo(dump_json(facts) if as_json else "\n".join(lines))


def lay_facts(facts: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Lay out facts for reading, a line each: those that JSON holds, without what is empty."""
    from feel321.records import to_json_value

    for name, fact in (facts if indent else to_json_value(facts)).items():
        several = fact if isinstance(fact, list | tuple) else [fact]
        if isinstance(several[0] if several else None, Mapping):
            for one in several:
                yield f"{indent}{name}:"
                yield from lay_facts(one, f"{indent}  ")
        elif fact not in (None, "", (), []):
            shown = [f"{one:.5g}" if isinstance(one, float) else str(one) for one in several]
            yield f"{indent}{name} {', '.join(shown)}"


def dump_json(entry: object) -> str:
    """Write numbers as JSON, which knows no NaN and no infinity: both become null."""
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


# The help, in plain text, from the verbs' type hints and docstrings.

COLUMN, NARROWEST, WIDEST = 34, 40, 100

PROGRAM = (
    ("--version", "Show the version."),
    ("--install-completion", "Let this shell complete verbs and options."),
)
"""Options of no verb."""

EVERYWHERE = (
    ("-q, --quiet", "Only results and errors."),
    ("-v, --verbose", "Print each step as it begins."),
    ("-h, --help", "Show this text."),
)
"""Options of every verb."""

KINDS = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH", bool: ""}
"""Type of an option -> what stands behind its name."""


def find_example(verb: object) -> str:
    """Read the first example of a verb's docstring."""
    return (inspect.getdoc(verb) or "").partition("Example: ")[2].partition("\n")[0]


def describe_program(about: str, groups: Mapping[str, Mapping[str, object]]) -> str:
    """Describe the program: its verbs by group."""
    lines = ["Usage: feel321 VERB [STUDY] [OPTIONS]", "", *_fill(about)]
    lines += ["", "Options:", *_lay_rows([*PROGRAM, *EVERYWHERE])]
    for title, verbs in groups.items():
        texts = {name: inspect.getdoc(verb) or "" for name, verb in verbs.items()}
        rows = [(name, text.partition("\n\n")[0]) for name, text in texts.items()]
        lines += ["", f"{title}:", *_lay_rows(rows)]
    return "\n".join([*lines, "", "  Begin with: feel321 demo"])


def describe_verb(name: str, app: "App", verb: object) -> str:
    """Describe a verb: what it does, its arguments and options, and an example."""
    text = (inspect.getdoc(verb) or "").partition("\n\nParameters\n")[0]
    *paragraphs, examples = text.split("\n\n")
    found = app.assemble_argument_collection(parse_docstring=True)
    places, rows = [], []
    for one in (one for one in found if one.parse and not one.children):
        if one.name.startswith("-"):
            rows.append(_describe_option(one))
        else:
            is_several = one.field_info.kind is one.field_info.VAR_POSITIONAL
            places.append(one.name if is_several or one.required else f"[{one.name}]")
    lines = [f"Usage: feel321 {name} {' '.join([*places, '[OPTIONS]'])}"]
    for paragraph in paragraphs:
        lines += ["", *_fill(paragraph)]
    lines += ["", "Options:", *_lay_rows([*rows, *EVERYWHERE])]
    return "\n".join([*lines, "", *(f"  {line}" for line in examples.splitlines())])


def _describe_option(argument: "Argument") -> tuple[str, str]:
    """Name an option with what it takes, and say what it means."""
    names = ", ".join(sorted(set(argument.names) - set(argument.negatives), key=len))
    kind = argument.parameter.metavar or KINDS.get(resolve_optional(argument.hint), "NAME")
    default, choices = argument.field_info.default, argument.get_choices()
    notes = [f"one of {', '.join(choices)}"] if choices else []
    if isinstance(default, int | float | str) and default not in {"", False}:
        notes.append(f"default: {default}")
    notes += ["required"] if argument.required else []
    meaning = " ".join([argument.parameter.help or "", *(f"[{note}]" for note in notes)])
    return f"{names} {kind}".rstrip(), meaning


def _lay_rows(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Lay names beside their meanings, in two columns."""
    column = min(max(len(name) for name, _ in rows) + 4, COLUMN)
    for name, text in rows:
        begin = f"  {name}"
        if len(begin) + 2 > column:
            yield begin
            begin = ""
        yield from _fill(text, first=f"{begin:<{column}}", rest=" " * column)


def _fill(text: str, *, first: str = "  ", rest: str = "  ") -> list[str]:
    columns = min(max(shutil.get_terminal_size().columns, NARROWEST), WIDEST)
    words = " ".join(text.split())
    return wrap(
        words, columns, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False
    )
