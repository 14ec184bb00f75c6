"""`feel321 VERB [STUDY]`: the command line, and the one place where errors become exit codes.

0 done, 1 could not, 2 wrong use, 130 interrupted, 143 ended by SIGTERM, 129 terminal closed.
An error is one line on stderr.
"""

import errno
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import NoReturn

import click

from feel321 import intake
from feel321.doors import clean_text
from feel321.study.commands.shared import add_loudness, cap, echo, warn

DONE, COULD_NOT, WRONG_USE, INTERRUPTED, SIGNALLED = 0, 1, 2, 130, 128

GROUPS = {
    "Design": {
        "new": "studies", "check": "studies", "build": "studies", "power": "planning", "freeze": "evidence",
        "tradeoff": "tradeoff",
    },
    "Lab": {
        "calibrate": "rig", "doctor": "rig", "run": "lab", "simulate": "studies", "status": "studies",
        "note": "studies", "collect": "stations", "withdraw": "studies",
    },
    "Results": {"analyze": "studies", "audit": "evidence", "seal": "evidence", "export": "exports"},
    "Signals": {"reduce": "signals", "match": "signals"},
    "Example": {"demo": "studies"},
}  # fmt: skip
"""Group of the help -> its verbs, and the module of `feel321.study.commands` that holds each."""

FORMER = {
    "advise": "tradeoff", "chart": "tradeoff", "stress": "tradeoff", "texts": "new --texts",
    "release": "withdraw --keep-data", "monitor": "status --watch",
}  # fmt: skip
"""Verbs whose work another one does now."""

LONGEST = 1000
"""Letters of a line of an error."""

RESUMED = {"build", "collect", "demo", "power", "run", "simulate", "withdraw"}
"""Verbs that continue, when called again, where they were interrupted."""


class Interrupted(Exception):  # noqa: N818 - nothing went wrong
    """Ctrl-C or a signal to end came while a verb ran; its name and what came are the arguments."""


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


class _Verbs(click.Group):
    """The verbs; what click says about Ctrl-C takes two lines, and it cannot know what continues."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs by group, with their whole summaries: click cuts those that do not fit into a line."""
        for group, verbs in GROUPS.items():
            rows = [
                (name, (verb.help or "").partition("\n\n")[0].replace("\n", " "))
                for name in verbs
                if (verb := self.get_command(ctx, name))
            ]
            with formatter.section(group):
                formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a verb; name the one that took over the work of a former one."""
        if args[0] in FORMER:
            ctx.fail(f"{args[0]} is now: feel321 {FORMER[args[0]]}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _tell
                return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise Interrupted(ctx.invoked_subcommand, *stop.args) from None


@click.group(
    cls=_Verbs,
    epilog="Begin with: feel321 demo",
    commands=[
        add_loudness(getattr(import_module(f"feel321.study.commands.{module}"), verb))
        for verbs in GROUPS.values()
        for verb, module in verbs.items()
    ],
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="feel321", prog_name="feel321")
@click.option(
    "--traceback",
    is_flag=True,
    hidden=True,
    expose_value=False,
    help="Show where an error comes from.",
)
def feel321() -> None:
    """Find out whether match metrics of three-to-one vibration reduction predict what people feel."""


add_loudness(feel321)


def _tell(message: object, *_: object, **__: object) -> None:
    """Print what Python warns of as every other warning."""
    warn(str(message))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb."""
    with heed_signals():
        return _run_verb(sys.argv[1:] if arguments is None else list(arguments))


def _run_verb(arguments: Sequence[str]) -> int:
    try:
        code = feel321.main(args=[*arguments], prog_name="feel321", standalone_mode=False)
    except click.UsageError as error:
        return _complain(_hint(error, arguments), code=WRONG_USE)
    except (Interrupted, click.Abort) as stop:
        kept = "; what is done is kept, the same command continues"
        resumed = RESUMED.intersection(map(str, stop.args))
        asked = [one for one in stop.args if isinstance(one, signal.Signals)]
        what = f"ended by {asked[0].name}" if asked else "interrupted"
        code = SIGNALLED + asked[0] if asked else INTERRUPTED
        return _complain(f"{what}{kept if resumed else ''}", code=code)
    except Exception as error:  # the last door: whatever it is, it is one line
        if "--traceback" in arguments:
            raise
        return _complain(_describe(error), code=COULD_NOT)
    return int(code or DONE)


def _hint(error: click.UsageError, arguments: Sequence[str]) -> str:
    """Say what was wrong, where to look, and, where something is missing, what a whole call looks like."""
    verbs = [one for one in arguments if one in feel321.commands]
    path = " ".join(["feel321", *verbs[:1]])
    hint = f"{error.format_message().rstrip('.')}; see: {path} --help"
    if verbs and isinstance(error, click.MissingParameter | click.BadOptionUsage):
        epilog = feel321.commands[verbs[0]].epilog or ""
        hint += (
            ", for example: " + epilog.partition("Example: ")[2].splitlines()[0].partition(";")[0]
        )
    return hint


def _describe(error: Exception) -> str:
    if not isinstance(error, (OSError, TypeError, ValueError)):
        reason = " ".join(str(error).split())
        return f"unexpected {type(error).__name__}: {reason}; run again with feel321 --traceback and report it"
    # The system's own errors say what happened to which file, but not in our words.
    if isinstance(error, OSError) and error.errno is not None:
        place = "" if error.filename is None else f"{error.filename}: "
        remedy = "check the name, and whether you may write there"
        if isinstance(error, FileNotFoundError):
            remedy = "check the name"
        if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}:
            remedy = "make room there and run again"
        return f"{place}{error.strerror}; {remedy}"
    return str(error)


def _complain(message: str, *, code: int) -> int:
    for line in cap(message.splitlines(), whole="feel321 check --json lists all of a study"):
        echo(f"feel321: {intake.clip(clean_text(line), LONGEST)}", err=True)
    return code
