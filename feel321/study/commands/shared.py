"""What several verbs share: options, how a study is opened, progress and output."""

import inspect
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, NoReturn, TypeVar

from cyclopts import Parameter, Token

from feel321 import files
from feel321.doors import clean_text, follow
from feel321.study.folder import StudyFolder, UsageError, require_study
from feel321.study.study import Study

if TYPE_CHECKING:
    from feel321.jobs import Workers
    from feel321.stimuli.recording import Recording


class Call(NamedTuple):
    """The words of a command line, and how much is printed besides results and errors."""

    words: Sequence[str] = ()
    quiet: bool = False
    verbose: bool = False
    traceback: bool = False


CALL: ContextVar[Call] = ContextVar("CALL", default=Call())  # noqa: B039 - a call is never changed


def refuse_use(text: str) -> NoReturn:
    """Refuse a combination of arguments: exit code 2."""
    raise UsageError(text)


# Arguments and options.

MOST = 1e9  # beyond this no option means anything, whatever its unit
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


def about(text: str, **more: Any) -> Parameter:  # noqa: ANN401 - what Parameter takes
    """Say what an option means."""
    return Parameter(help=text, **more)


File = Annotated[Path, Parameter(converter=_read_path)]
Number = Annotated[float, within(0, MOST)]
Json = Annotated[bool, about("Print numbers as JSON.", name="--json")]
Out = Annotated[File | None, about("Folder of the results.", name=["--out", "-o"])]
Seed = Annotated[int | None, within(0, MOST_SEED), about("Random seed; the study's by default.")]
Name = Annotated[str | None, Parameter(metavar="NAME")]
Participant = Annotated[str, about("The participant's code.", metavar="ID")]
Rehearsals = Annotated[bool, about("Rehearsals instead of sessions.")]
Several = Annotated[tuple[str, ...], Parameter(name="--metric", metavar="NAME")]


CLUSTER = "A Dask cluster instead: tls://HOST:PORT, or tcp://HOST:PORT (whoever reaches it can run programs)."
SAID = "[default: what the file says]"


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Crew:
    """Who does the work."""

    workers: Annotated[int, within(1, 1024), about("Number of processes.")] = 1
    scheduler: Annotated[str, about(CLUSTER, metavar="ADDRESS")] = ""

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
    """How a recording is read."""

    unit: Annotated[Literal["m/s^2", "g", "mg"] | None, about(f"Unit of the samples. {SAID}")] = (
        None
    )
    rate_hz: Annotated[Number | None, about(f"Sampling rate in Hz. {SAID}")] = None
    columns: Annotated[
        tuple[str | int, ...] | None,
        Parameter(converter=_read_columns, n_tokens=1, metavar="NAME,..."),
        about("Names or numbers (from 0): time,x,y,z."),
    ] = None
    full_scale: Annotated[Number | None, about("Full scale of integer samples, in the unit.")] = (
        None
    )
    resample: Annotated[bool, about("Interpolate irregular sampling to an even rate.")] = False

    def read(self, path: Path) -> "Recording":
        """Read a recording, and print what was noticed in it."""
        from feel321.stimuli.formats.read import read_recording

        recording = read_recording(path, **{name: getattr(self, name) for name in self.__slots__})
        report_warnings([recording])
        return recording


AS_IT_SAYS = Reading()


def open_study(folder: Path, *, rehearsals: bool = False, clears: bool = True) -> Study:
    """Open a study that is there; what killed processes left in it goes, unless the verb only reads."""
    study = require_study(folder)
    if clears and (swept := [*files.sweep(study.path), *files.sweep_temporary()]):
        names, more = ", ".join(map(str, swept[:5])), len(swept) - 5
        warn(f"removed what an interrupted run left: {names}{f' and {more} more' * (more > 0)}")
    return Study(StudyFolder(study.path, is_rehearsal=rehearsals), wants_bar(), warn=warn)


Verb = Callable[..., int | None]


def verb(
    method: Callable[..., Any], *, clears: bool = True, needs_study: bool = True, **hints: object
) -> Callable[[Verb], Verb]:
    """Make a verb of a method of `Study` and of what prints its result.

    hints: what each parameter of the method is as an option; its default and its help are the method's. The options
    `crew` and `rehearsals` are there if named.
    """

    def decorate(show: Verb) -> Verb:
        def call(study: Path = Path(), /, *, as_json: bool = False, **given: Any) -> int | None:  # noqa: ANN401
            rehearsals, crew = given.pop("rehearsals", False), given.pop("crew", None)
            if crew:
                given["workers"] = crew.employ()
            if needs_study:
                opened = open_study(study, rehearsals=rehearsals, clears=clears)
            else:
                opened = Study(StudyFolder(study), wants_bar(), warn=warn)
            return show(opened, method(opened, **given), as_json=as_json)

        defaults = {"crew": ALONE, "rehearsals": False, "as_json": False}
        defaults |= {
            name: one.default for name, one in inspect.signature(method).parameters.items()
        }
        kinds = inspect.Parameter
        place = kinds("study", kinds.POSITIONAL_ONLY, default=Path())
        names = (*hints, "as_json")
        options = [kinds(name, kinds.KEYWORD_ONLY, default=defaults[name]) for name in names]
        call.__signature__ = inspect.Signature([place, *options])  # type: ignore[attr-defined]
        call.__annotations__ = {"study": File, **hints, "as_json": Json}
        call.__doc__ = method.__doc__
        return call

    return decorate


def simulate_sessions(opened: Study, participants: int, seed: int | None = None) -> int:
    """Do as `Study.simulate`, without pandas, which takes a second to import; returns the number of ratings."""
    from feel321.study.simulation import simulate_study

    with follow(opened.progress, "simulate") as step:
        return simulate_study(
            opened.folder, participants=participants, seed=seed, now=opened.now, progress=step, warn=warn
        )  # fmt: skip


Word = TypeVar("Word", str, Path)


def split_study(words: Sequence[Word], what: str) -> tuple[Path, Word]:
    """Split [STUDY] from what follows it."""
    if not 0 < len(words) <= 2:  # noqa: PLR2004 - a study and one more
        refuse_use(f"takes a study and {what}, got {len(words)} words")
    return Path(words[0] if len(words) > 1 else "."), words[-1]


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
WHOLE = "--json lists all problems and warnings"


def cap(lines: Sequence[str], *, whole: str = WHOLE) -> list[str]:
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
        if several and isinstance(several[0], Mapping):
            for one in filter(None, several):
                yield f"{indent}{name}:"
                yield from lay_facts(one, f"{indent}  ")
        elif fact not in (None, "", (), []):
            shown = [f"{one:.5g}" if isinstance(one, float) else str(one) for one in several]
            yield f"{indent}{name} {', '.join(shown)}"


def dump_json(entry: object) -> str:
    """Write numbers as JSON, which knows no NaN and no infinity: both become null."""
    from feel321.records import to_json_value

    return json.dumps(to_json_value(entry), indent=2, ensure_ascii=False, allow_nan=False)


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
    return is_terminal() and not (call.quiet or call.verbose)
