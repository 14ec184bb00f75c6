"""`feel321 VERB [STUDY]`: the command line, its help, and the one place where errors become exit codes.

0 done, 1 could not, 2 wrong use, 130 interrupted, 143 ended by SIGTERM, 129 terminal closed.
An error is one line on stderr.
"""

import errno
import inspect
import os
import shutil
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from textwrap import wrap
from typing import NoReturn

from cyclopts import App, Argument, CycloptsError, Parameter, UnusedCliTokensError
from cyclopts.annotations import resolve_optional
from cyclopts.exceptions import MissingArgumentError

from feel321 import __version__, intake
from feel321.doors import clean_text
from feel321.study.folder import UsageError
from feel321.study.terminal import CALL, Call, cap, echo, warn
from feel321.study.verbs import GROUPS, make_verb

DONE, COULD_NOT, WRONG_USE, INTERRUPTED, SIGNALLED = 0, 1, 2, 130, 128

VERBS = [verb for verbs in GROUPS.values() for verb in verbs]

RESUMED = {"collect", "demo", "run", "simulate", "withdraw"}
"""Verbs that continue, when called again, where they were interrupted."""

LONGEST = 1000  # letters of a line of an error
SWITCHES = {"-q": "quiet", "--quiet": "quiet", "--traceback": "traceback"}
"""Switches that every verb has, in any place."""

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
APP.register_install_completion_command(show=False)


class Terminated(KeyboardInterrupt):
    """The process was asked to end, or its terminal was closed; that is treated as Ctrl-C is."""


@contextmanager
def heed_signals() -> Iterator[None]:
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
    token = CALL.set(call)
    try:
        with heed_signals(), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: warn(str(message))
            return _run_verb(call)
    finally:
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
        echo(f"feel321: {intake.clip(clean_text(line), LONGEST)}", err=True)
    return code


# The help, in plain text.

ABOUT = (
    "Find out whether match metrics of three-to-one vibration reduction predict what people feel."
)
COLUMN, NARROWEST, WIDEST = 34, 40, 100

EVERYWHERE = (("-q, --quiet", "Only results and errors."), ("-h, --help", "Show this text."))
"""Options of every verb."""

KINDS = {int: "N", float: "NUMBER", str: "TEXT", bool: ""}
"""Type of an option -> what stands behind its name."""


def read_doc(verb: str) -> str:
    """Read what the docstring of a verb says before its parameters."""
    return (inspect.getdoc(APP[verb].default_command) or "").partition("\n\nParameters\n")[0]


def describe_program() -> str:
    """Describe the program: its verbs by group."""
    completion = ("--install-completion", "Let this shell complete verbs and options.")
    options = [("--version", "Show the version."), completion, *EVERYWHERE]
    lines = ["Usage: feel321 VERB [STUDY] [OPTIONS]", "", *_fill(ABOUT)]
    lines += ["", "Options:", *_lay_rows(options)]
    for title, verbs in GROUPS.items():
        rows = [(name, read_doc(name).partition("\n\n")[0]) for name in verbs]
        lines += ["", f"{title}:", *_lay_rows(rows)]
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
    lines += ["", "Options:", *_lay_rows([*rows, *EVERYWHERE])]
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
