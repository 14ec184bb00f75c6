"""The help of the command line in plain text, from the verbs' type hints and docstrings."""

import inspect
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from cyclopts.annotations import resolve_optional

if TYPE_CHECKING:
    from cyclopts import App, Argument

WIDEST_NAME = 30
NARROWEST, WIDEST = 40, 100

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

KINDS = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH"}
"""Type of an option -> what stands behind its name."""


def summarise(verb: object) -> str:
    """Read the first sentence of a verb's docstring."""
    return inspect.getdoc(verb).partition("\n\n")[0].replace("\n", " ")  # type: ignore[union-attr]  # every verb has one


def find_example(verb: object) -> str:
    """Read the first example of a verb's docstring."""
    return (inspect.getdoc(verb) or "").partition("Example: ")[2].partition("\n")[0]


def describe_program(about: str, groups: Mapping[str, Mapping[str, object]]) -> str:
    """Describe the program: its verbs by group."""
    lines = ["Usage: feel321 VERB [STUDY] [OPTIONS]", "", *_fill(about)]
    lines += ["", "Options:", *_lay_rows([*PROGRAM, *EVERYWHERE])]
    for title, verbs in groups.items():
        rows = [(name, summarise(verb)) for name, verb in verbs.items()]
        lines += ["", f"{title}:", *_lay_rows(rows)]
    return "\n".join([*lines, "", "  Begin with: feel321 demo"])


def describe_verb(name: str, app: "App", verb: object) -> str:
    """Describe a verb: what it does, its arguments and options, and an example."""
    text = (inspect.getdoc(verb) or "").partition("\n\nParameters\n")[0]
    *paragraphs, examples = text.split("\n\n")
    found = app.assemble_argument_collection(parse_docstring=True)
    arguments = [one for one in found if one.parse and not one.children]
    places = [_name_place(one) for one in arguments if not _is_option(one)]
    lines = [f"Usage: feel321 {name} {' '.join([*places, '[OPTIONS]'])}"]
    for paragraph in paragraphs:
        lines += ["", *_fill(paragraph)]
    rows = [(_name_option(one), _explain(one)) for one in arguments if _is_option(one)]
    lines += ["", "Options:", *_lay_rows([*rows, *EVERYWHERE])]
    return "\n".join([*lines, "", *(f"  {line}" for line in examples.splitlines())])


def _is_option(argument: "Argument") -> bool:
    return argument.name.startswith("-")


def _name_place(argument: "Argument") -> str:
    is_several = argument.field_info.kind is argument.field_info.VAR_POSITIONAL
    return argument.name if is_several or argument.required else f"[{argument.name}]"


def _name_option(argument: "Argument") -> str:
    positive = set(argument.names) - set(argument.negatives)
    names = ", ".join(sorted(positive, key=len))
    kind = resolve_optional(argument.hint)
    if kind is bool:
        return names
    return f"{names} {argument.parameter.metavar or KINDS.get(kind, 'NAME')}"


def _explain(argument: "Argument") -> str:
    default, choices = argument.field_info.default, argument.get_choices()
    notes = [f"one of {', '.join(choices)}"] if choices else []
    if isinstance(default, int | float | str) and default not in {"", False}:
        notes.append(f"default: {default}")
    notes += ["required"] if argument.required else []
    return " ".join([argument.parameter.help or "", *(f"[{note}]" for note in notes)])


def _lay_rows(rows: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Lay names beside their meanings, in two columns."""
    rows = [*rows]
    column = min(max(len(name) for name, _ in rows), WIDEST_NAME) + 4
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
