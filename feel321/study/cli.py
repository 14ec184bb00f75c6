"""`feel321 VERB [STUDY]`: the command line, its help, and the one place where errors become exit codes.

0 done, 1 could not, 2 wrong use, 130 interrupted, 143 ended by SIGTERM, 129 terminal closed.
An error is one line on stderr.
"""

from __future__ import annotations

import errno
import gc
import inspect
import os
import shutil
import signal
import sys
import threading
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from textwrap import wrap
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_args, get_type_hints

from cyclopts import App, Argument, CycloptsError, Parameter, UnusedCliTokensError
from cyclopts.annotations import resolve_optional
from cyclopts.exceptions import MissingArgumentError

from feel321 import __version__, files
from feel321.arguments import as_path, clean_text
from feel321.files import clip, read_small
from feel321.study import options, verbs
from feel321.study.folder import (
    SETTINGS_FILE,
    Outcome,
    StudyFolder,
    UsageError,
    create_study,
    read_template,
    require_study,
)
from feel321.study.study import Study
from feel321.study.terminal import CALL, Call, cap, dump_json, echo, wants_bar, warn

if TYPE_CHECKING:
    from feel321.analysis.report.write import Results
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import Audit, Problems, Seal
    from feel321.study.power import StudyPower

DONE, COULD_NOT, WRONG_USE, INTERRUPTED, SIGNALLED = 0, 1, 2, 130, 128

GROUPS = {  # group of the help -> its verbs
    "Design": ("new", "check", "build", "power", "freeze", "tradeoff"),
    "Lab": ("calibrate", "doctor", "run", "simulate", "status", "note", "collect", "withdraw"),
    "Results": ("analyze", "audit", "seal", "export"),
    "Signals": ("reduce", "match"),
    "Example": ("demo",),
}

ANYWHERE = {"analyze", "check", "doctor"}  # verbs that can do something without a study

# Verbs that leave what a killed process left.
READING = {*ANYWHERE, "audit", "calibrate", "export", "status"}

WORDY = {"run"}  # verbs that print as they go, and no numbers at their end

VERBS = [verb for verbs in GROUPS.values() for verb in verbs]

RESUMED = {"collect", "demo", "run", "simulate", "withdraw"}
"""Verbs that continue, when called again, where they were interrupted."""

COMPLETION = "--install-completion"
MOST_NEW = 50_000  # objects before garbage is looked for: among what was imported there is none
LONGEST = 1000  # letters of a line of an error
# Switches that every verb has, in any place.
SWITCHES = {"-q": "quiet", "--quiet": "quiet", "--traceback": "traceback"}


class Terminated(KeyboardInterrupt):
    """The process was asked to end, or its terminal was closed; that is treated as Ctrl-C is."""


@contextmanager
def handle_signals() -> Iterator[None]:
    """Make the signals to end do what Ctrl-C does, unless they are ignored (nohup) or handled already."""

    def stop(number: int, _frame: object) -> NoReturn:
        for name in heeded:  # a second one would break off what cleans up
            signal.signal(name, signal.SIG_IGN)
        raise Terminated(signal.Signals(number))

    is_main = threading.current_thread() is threading.main_thread()
    names = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    heeded = [one for one in names if is_main and signal.getsignal(one) is signal.SIG_DFL]
    for one in heeded:
        signal.signal(one, stop)
    try:
        yield
    finally:
        for one in heeded:
            signal.signal(one, signal.SIG_DFL)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; behind -- all words are the verb's."""
    given = sys.argv[1:] if arguments is None else arguments
    end = given.index("--") if "--" in given else len(given)
    switches = {SWITCHES[word]: True for word in given[:end] if word in SWITCHES}
    words = ["--help" if word == "-h" else word for word in given[:end] if word not in SWITCHES]
    call = Call((*words, *given[end:]), **switches)
    token, usual = CALL.set(call), gc.get_threshold()
    gc.set_threshold(MOST_NEW)
    try:
        with handle_signals(), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: warn(str(message))
            return _run_verb(call)
    finally:
        gc.set_threshold(*usual)
        CALL.reset(token)


def _run_verb(call: Call) -> int:
    verb = call.words[0] if call.words else ""
    try:
        return _call(call.words)
    except (CycloptsError, UsageError) as error:
        return _complain(_hint(error, verb), code=WRONG_USE)
    except KeyboardInterrupt as stop:
        kept = "; what is done is kept, the same command continues" if verb in RESUMED else ""
        if asked := [one for one in stop.args if isinstance(one, signal.Signals)]:
            return _complain(f"ended by {asked[0].name}{kept}", code=SIGNALLED + asked[0])
        return _complain(f"interrupted{kept}", code=INTERRUPTED)
    except BrokenPipeError:  # whoever read our output went away, and has to be told nothing
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return COULD_NOT
    except Exception as error:  # the last door: whatever it is, it is one line
        if call.traceback:
            raise
        return _complain(_describe(error), code=COULD_NOT)


def _call(words: Sequence[str]) -> int:
    if not words:
        raise UsageError("Missing command")
    if words[0] == "--version":
        echo(f"feel321, version {__version__}")
    elif words[0] == "--help":
        echo(describe_program())
    elif words[0] in VERBS and "--help" in words:
        echo(describe_verb(words[0]))
    else:
        if words[0] == COMPLETION:  # costs time to import
            APP.register_install_completion_command(COMPLETION, show=False)
        return int(APP(words) or DONE)
    return DONE


def _hint(error: Exception, verb: str) -> str:
    """Say what was wrong, where to look, and, where something is missing, what a whole call looks like."""
    said = str(error).partition(" Available commands: ")[0].rstrip(".")
    if isinstance(error, UnusedCliTokensError):
        said = f"got {' '.join(error.unused_tokens or ())!r}, which is one argument too many"
    if verb not in VERBS:
        return f"{said}; see: feel321 --help"
    hint = f"{said}; see: feel321 {verb} --help"
    if isinstance(error, MissingArgumentError):
        example = read_doc(verb).partition("Example: ")[2].partition("\n")[0]
        hint += f", for example: {example.partition(';')[0]}"
    return hint


def _describe(error: Exception) -> str:
    if not isinstance(error, (OSError, TypeError, ValueError)):
        reason = " ".join(str(error).split())
        again = "run again with feel321 --traceback and report it"
        return f"unexpected {type(error).__name__}: {reason}; {again}"
    # The system's own errors say what happened to which file, but not in our words.
    if isinstance(error, OSError) and error.errno is not None:
        place = "" if error.filename is None else f"{error.filename}: "
        is_full = error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
        remedy = "make room there and run again" if is_full else "check the name"
        if not is_full and not isinstance(error, FileNotFoundError):
            remedy += ", and whether you may write there"
        return f"{place}{error.strerror}; {remedy}"
    return str(error)


def _complain(message: str, *, code: int) -> int:
    for line in cap(message.splitlines(), whole="feel321 check --json lists all of a study"):
        echo(f"feel321: {clip(clean_text(line), LONGEST)}", err=True)
    return code


# The verbs, each made of a method of `Study`, or of a function where there need be no study. Options come from the
# signature, read as `options` says, help from the docstring; what is returned is printed.

DEMO_PARTICIPANTS = 16
PER_FILE = 10  # findings of one file that are printed; the others are counted

NAMED = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
Json = Annotated[bool, Parameter(name="--json", help="Print numbers as JSON.")]
Into = Annotated[
    options.File, Parameter(help="Study to collect into. [default: .]", metavar="STUDY")
]


def open_study(name: str, path: Path) -> Study:
    """Open the study that a verb works on; what killed processes left in it goes, unless the verb only reads."""
    if name not in ANYWHERE:
        require_study(path)
    if name not in READING and (swept := [*files.sweep(path), *files.sweep_temporary()]):
        names, more = ", ".join(map(str, swept[:5])), len(swept) - 5
        warn(f"removed what an interrupted run left: {names}{f' and {more} more' * (more > 0)}")
    return Study(StudyFolder(path), wants_bar(), warn=warn)


def demo(*, out: options.Target = Path("demo-study")) -> None:
    """Run a whole study with simulated participants.

    Example: feel321 demo --out demo-study

    Parameters
    ----------
    out : str or path
        Folder of the study.
    """
    from feel321.study.observer import NUMBERED

    folder = StudyFolder(as_path(out))
    if not folder.path.exists() or not any(folder.path.iterdir()):
        create_study(folder.path)
    # What is anything but the demonstration is left alone.
    people = [entry.name for entry in folder.participants if not NUMBERED.fullmatch(entry.name)]
    refusal = ""
    if not folder.settings.is_file():
        refusal = f"{folder.path}: holds files that demo did not write"
    elif read_small(folder.settings) != read_template():
        refusal = f"{folder.settings}: edited, or written by another version of feel321"
    elif people:
        refusal = f"{folder.path}: holds a session of {people[0]}, who is no simulated participant"
    if refusal:
        raise FileExistsError(f"{refusal}; name another folder with --out")
    study = Study(folder, wants_bar(), warn=warn)
    stimuli = study.build()
    echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    rows = study.simulate(DEMO_PARTICIPANTS).to_dict()["ratings"]
    echo(f"{folder.ratings}: {rows} ratings of {DEMO_PARTICIPANTS} simulated participants")
    study.analyze()
    echo(folder.report / "index.html")


def make_verb(name: str) -> Callable[..., int]:
    """Make a verb of what has its name: a function whose arguments are those of a command line, and its exit code."""
    homes = (Study, verbs, SimpleNamespace(demo=demo))
    do: Callable[..., Any] = next(getattr(one, name) for one in homes if hasattr(one, name))
    parameters = _list_parameters(do)
    if name not in WORDY and inspect.signature(do).return_annotation != "None":
        parameters.append(NAMED("as_json", default=False, annotation=Json))

    def call(*words: Any, as_json: bool = False, **given: Any) -> int:  # noqa: ANN401
        if not hasattr(Study, name):
            return finish(do(*words, **given), as_json=as_json)
        path, rest = _split(name, parameters[0], words, into=given.pop("into", None))
        opened = open_study(name, path)
        found = getattr(opened, name)(*rest, **given)
        return finish(SHOWN[name](opened, found) if name in SHOWN else found, as_json=as_json)

    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    call.__doc__ = do.__doc__
    return call


def _list_parameters(do: Callable[..., Any]) -> list[inspect.Parameter]:
    """List the parameters of a verb: those of a function, or of a method, with the study in the place of `self`."""
    own = dict(inspect.signature(do).parameters)
    is_method = own.pop("self", None) is not None
    texts = SimpleNamespace(__annotations__={one.name: one.annotation for one in own.values()})
    hints = get_type_hints(texts, {"options": options}, include_extras=True)
    listed = [one.replace(annotation=hints[one.name]) for one in own.values()]
    if not is_method:
        return listed
    places = [one for one in listed if one.kind is one.VAR_POSITIONAL or one.default is one.empty]
    places = [one for one in places if one.kind is not one.KEYWORD_ONLY]
    named = [NAMED(one.name, default=one.default, annotation=one.annotation)
             for one in listed if one not in places]  # fmt: skip
    if not places:
        only = inspect.Parameter.POSITIONAL_ONLY
        study = inspect.Parameter("study", only, default=Path(), annotation=options.File)
        return [study, *named]
    if places[0].kind is inspect.Parameter.VAR_POSITIONAL:
        return [*places, *named, NAMED("into", default=Path(), annotation=Into)]
    words = f"[STUDY] {get_args(places[0].annotation)[1].metavar}"
    annotation = Annotated[str, Parameter(name=words, required=True)]
    several = inspect.Parameter.VAR_POSITIONAL
    return [inspect.Parameter("words", several, annotation=annotation), *named]


def _split(
    name: str, first: inspect.Parameter, words: Sequence[Any], *, into: Path | None
) -> tuple[Path, Sequence[Any]]:
    """Split the study from the arguments of a method."""
    if first.kind is first.POSITIONAL_ONLY:
        return (words[0] if words else Path()), ()
    if first.name != "words":
        return into or Path(), words
    what, (*before, last) = get_args(first.annotation)[1].name[0].split()[-1], words
    if len(before) > 1:
        raise UsageError(f"takes a study and {what}, got {len(words)} words")
    if last and not before and (Path(last) / SETTINGS_FILE).is_file():
        raise UsageError(f"{last} is a study; name {what}, too: feel321 {name} {last} {what}")
    return Path(*before), (last,)


def finish(outcome: Outcome | None, *, as_json: bool) -> int:
    """Print what a verb returned; faults are errors."""
    if outcome is None:
        return 0
    if as_json and isinstance(outcome.facts, Path):
        echo(outcome.facts.read_text(encoding="utf-8"))
    elif as_json:
        echo(dump_json(outcome.facts))
    elif outcome.lines:
        echo("\n".join(outcome.lines))
    if outcome.faults:
        raise OSError("\n".join(outcome.faults))
    return int(outcome.failed)


# What is printed of results that are more than an outcome.


def show_problems(study: Study, found: Problems) -> Outcome:
    """Show what stands in the way of a study; warnings go to stderr."""
    for text in cap(found.warnings):
        warn(text)
    count = len(found.warnings)
    counted = f", {count} warning{'s' * (count > 1)}" if count else ""
    good = f"{found.subject or study.folder.path}: no problems{counted}"
    facts = {"problems": found.problems, "warnings": found.warnings, "notes": found.notes}
    lines = [*(cap(found.problems) or [good]), *found.notes]
    return Outcome({**facts, **found.figures}, lines, failed=bool(found.problems))


def show_set(study: Study, found: StimulusSet) -> Outcome:
    """Show how many stimuli there are, and what is worth knowing of their gains."""
    from feel321.study.strength import describe_built

    notes = describe_built(study.settings, found)
    count, folder = len(found.stimuli), str(found.folder)
    facts = {"stimuli": count, "folder": folder, "sha256": found.sha256, "notes": notes}
    return Outcome(facts, [f"{folder}: {count} stimuli, set {found.sha256[:12]}", *cap(notes)])


def show_page(_study: Study, found: Results | StudyPower) -> Outcome:
    """Show where the page is, below the answer if there is one."""
    answer = [found.summary()] if hasattr(found, "answer") else []
    return Outcome(found.path / "results.json", [*answer, str(found.path / "index.html")])


def show_audit(study: Study, found: Audit) -> Outcome:
    """Show the findings, file by file."""
    by_file: dict[str, list[str]] = defaultdict(list)
    for text in found.findings:
        by_file[text.partition(": ")[0].partition(", line ")[0]].append(text)
    lines = []
    for own in by_file.values():
        more = f"  and {len(own) - PER_FILE} more in this file (--json lists all)"
        lines += [*own[:PER_FILE], *([more] if len(own) > PER_FILE else [])]
    n = found.journals
    good = f"{study.folder.path}: {n} journal{'s' * (n != 1)}, no contradiction in them"
    lines = [*(cap(lines) or [good]), *filter(None, [found.sentence]), *found.remarks]
    return Outcome(asdict(found), lines, failed=bool(found.findings))


def show_seal(study: Study, found: Seal) -> Outcome:
    """Show the checkpoint, and where it was pushed to."""
    for problem in found.problems:
        warn(problem)
    unset = "not pushed, because no remote is set: feel321 seal --to REMOTE"
    places = [f"pushed to {place}" for place in found.places] or [unset]
    return Outcome(asdict(found), [f"{study.folder.path}: checkpoint {found.checkpoint}", *places])


SHOWN: dict[str, Callable[[Study, Any], Outcome]] = {  # verb -> what shows the result of its method
    "analyze": show_page, "audit": show_audit, "build": show_set, "check": show_problems, "power": show_page,
    "seal": show_seal, "status": lambda _, found: Outcome(asdict(found), [found.summary()]),
    "run": lambda _, found: Outcome({}, failed=bool(found.stopped)),  # the session has said how far it is
}  # fmt: skip


APP = App(
    "feel321",
    help_flags=(),
    version_flags=(),
    default_parameter=Parameter(negative=()),
    result_action="return_value",
    exit_on_error=False,
    print_error=False,
    suppress_keyboard_interrupt=False,
)
for _verb in VERBS:
    APP.command(make_verb(_verb), name=_verb)


ABOUT = (
    "Find out whether match metrics of three-to-one vibration reduction predict what people feel."
)
COLUMN, NARROWEST, WIDEST = 34, 40, 100

# Options of every verb.
EVERYWHERE = (("-q, --quiet", "Only results and errors."), ("-h, --help", "Show this text."))

# Type of an option -> what stands behind its name.
KINDS = {int: "N", float: "NUMBER", str: "TEXT", bool: ""}


def read_doc(verb: str) -> str:
    """Read what the docstring of a verb says before its parameters."""
    return (inspect.getdoc(APP[verb].default_command) or "").partition("\n\nParameters\n")[0]


def describe_program() -> str:
    """Describe the program: its verbs by group."""
    completion = (COMPLETION, "Let this shell complete verbs and options.")
    options = [("--version", "Show the version."), completion, *EVERYWHERE]
    lines = ["Usage: feel321 VERB [STUDY] [OPTIONS]", "", *_fill(ABOUT)]
    lines += ["", "Options:", *_format_rows(options)]
    for title, names in GROUPS.items():
        rows = [(name, read_doc(name).partition("\n\n")[0]) for name in names]
        lines += ["", f"{title}:", *_format_rows(rows)]
    return "\n".join([*lines, "", "  Begin with: feel321 demo"])


def describe_verb(verb: str) -> str:
    """Describe a verb: what it does, its arguments and options, and an example."""
    *paragraphs, examples = read_doc(verb).split("\n\n")
    found = APP[verb].assemble_argument_collection(parse_docstring=True)
    places, rows = [], []
    for one in (one for one in found if one.parse and not one.children):
        if one.name.startswith("-"):
            rows.append(_describe_option(one))
        else:
            is_several = one.field_info.kind is one.field_info.VAR_POSITIONAL
            places.append(one.name if is_several or one.required else f"[{one.name}]")
    lines = [f"Usage: feel321 {verb} {' '.join([*places, '[OPTIONS]'])}"]
    for paragraph in paragraphs:
        lines += ["", *_fill(paragraph)]
    lines += ["", "Options:", *_format_rows([*rows, *EVERYWHERE])]
    return "\n".join([*lines, "", *(f"  {line}" for line in examples.splitlines())])


def _describe_option(argument: Argument) -> tuple[str, str]:
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


def _format_rows(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Format names and their meanings in two columns."""
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
