"""What a terminal gets: results on stdout, warnings and errors on stderr, and no text that could move its cursor."""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from typing import Any, NamedTuple

from feel321.arguments import clean_text

MOST_LINES = 20
WHOLE = "--json lists all problems and warnings"


class Call(NamedTuple):
    """The words of a command line, and how much is printed besides results and errors."""

    words: Sequence[str] = ()
    quiet: bool = False
    traceback: bool = False


CALL: ContextVar[Call] = ContextVar("CALL", default=Call())  # noqa: B039 - a call is never changed


def echo(text: object = "", *, err: bool = False, over: bool = False) -> None:
    """Print lines, of which no name, note or answer can move the terminal's cursor, or change its colours or order.

    over: the next one is printed over it. A terminal that was closed is no error where only a person would read it.
    """
    line = clean_text(str(text), keep="\n\t\N{NO-BREAK SPACE}")
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


def cap(lines: Sequence[str], *, whole: str = WHOLE) -> list[str]:
    """Cut a long list of lines, and say how many there are more, and where."""
    left = len(lines) - MOST_LINES
    return [*lines[:MOST_LINES], *([f"and {left} more like these; {whole}"] if left > 0 else [])]


def format_facts(facts: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Lay out facts for reading, a line each: those that JSON holds, without what is empty."""
    from feel321.records import to_json_value

    for name, fact in (facts if indent else to_json_value(facts)).items():
        several = fact if isinstance(fact, list | tuple) else [fact]
        if several and isinstance(several[0], Mapping):
            for one in filter(None, several):
                yield f"{indent}{name}:"
                yield from format_facts(one, f"{indent}  ")
        elif fact not in (None, "", (), []):
            shown = [f"{one:.5g}" if isinstance(one, float) else str(one) for one in several]
            yield f"{indent}{name} {', '.join(shown)}"


def dump_json(entry: object) -> str:
    """Write numbers as JSON, which knows no NaN and no infinity: both become null."""
    from feel321.records import to_json_value

    return json.dumps(to_json_value(entry), indent=2, ensure_ascii=False, allow_nan=False)


def is_terminal() -> bool:
    """Check whether somebody watches stderr; where it is closed (2>&-), Python has none."""
    return sys.stderr is not None and sys.stderr.isatty()


def wants_bar() -> bool:
    """Check whether a progress bar is wanted: on a terminal, unless only results are to be printed."""
    return is_terminal() and not CALL.get().quiet


def is_answerable() -> bool:
    """Check whether somebody can answer a question."""
    return sys.stdin is not None and sys.stdin.isatty()


def ask(question: str) -> str:
    """Ask on stderr; the answer in small letters."""
    echo(question, err=True)
    return sys.stdin.readline().strip().lower()
