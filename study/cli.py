"""`feel321 VERB [STUDY]`: the command line, and the one place where errors become exit codes.

0 done, 1 could not, 2 wrong use, 130 interrupted. An error is one line on stderr.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from study import commands

if TYPE_CHECKING:
    from collections.abc import Sequence

DONE, COULD_NOT, WRONG_USE, INTERRUPTED = 0, 1, 2, 130


@click.group(
    epilog="Begin with: feel321 demo",
    commands=[getattr(commands, name) for name in commands.__all__],
    no_args_is_help=False,
)
@click.version_option(package_name="feel321", prog_name="feel321")
@click.option("--traceback", is_flag=True, hidden=True, expose_value=False, help="Show where an error comes from.")
def feel321() -> None:
    """Find out whether match metrics of three-to-one vibration reduction predict what people feel."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    arguments : sequence of str, optional
        What follows `feel321`; those of the process if left out.

    Returns
    -------
    int
        The exit code.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        code = feel321.main(args=arguments, prog_name="feel321", standalone_mode=False)
    except click.UsageError as error:
        return _complain(_hint(error), code=WRONG_USE)
    except click.Abort:
        return _complain("interrupted; what is done is kept, the same command goes on", code=INTERRUPTED)
    except (OSError, TypeError, ValueError) as error:
        if "--traceback" in arguments:
            raise
        return _complain(_describe(error), code=COULD_NOT)
    return int(code or DONE)


def _hint(error: click.UsageError) -> str:
    path = error.ctx.command_path if error.ctx else "feel321"
    return f"{error.format_message().rstrip('.')}; see: {path} --help"


def _describe(error: Exception) -> str:
    # The system's own errors say what happened to which file, but not in our words.
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}; check the name, and whether you may write there"
    return str(error)


def _complain(message: str, *, code: int) -> int:
    for line in message.splitlines():
        click.echo(f"feel321: {line}", err=True)
    return code
