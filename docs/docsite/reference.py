"""Reference pages: every public name of every face, every verb of the command line."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import click
from sphinx.pycode import ModuleAnalyzer

from docsite.text import ASIDE, contents, table, title, write
from feel321 import analysis

FACES = {
    "feel321.stimuli": "Recordings, reducers, metrics, stimulus sets",
    "feel321.protocols": "Tasks, trials and orders",
    "feel321.study": "Studies and sessions",
    "feel321.analysis": "Statistics, figures, reports",
    "feel321.results": "What functions return",
    "feel321.jobs": "Who does the work",
    "feel321.types": "Types that signatures name",
}


def write_faces(folder: Path) -> None:
    """Write a page for each face, and one for each of its names."""
    rows = [(f":doc:`{face} <{face}/index>`", meaning) for face, meaning in FACES.items()]
    write(
        folder / "index.rst",
        title("Python reference"),
        "Import from these modules only: ``from feel321 import stimuli, analysis``. Each page gives arguments with"
        " shapes and units, what is returned, errors, formula, source and an example. :doc:`/python` shows them at"
        " work.",
        table(("module", "holds"), rows),
        contents(f"{face}/index" for face in FACES),
    )
    for face in FACES:
        _write_face(folder / face, face)


def _write_face(folder: Path, face: str) -> None:
    module = import_module(face)
    names = sorted(module.__all__, key=str.casefold)
    write(
        folder / "index.rst",
        title(face),
        f".. py:module:: {face}\n",
        inspect.getdoc(module) or "",
        table(
            ("name", "purpose"),
            [(f":doc:`{name} <{name}>`", _summarise(module, name)) for name in names],
        ),
    )
    for name in names:
        write(
            folder / f"{name}.rst",
            ASIDE,
            title(name),
            f":doc:`{face} <index>`\n",
            f".. currentmodule:: {face}\n",
            _describe(module, name),
        )


def _describe(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    if inspect.isclass(thing):
        # A record is described in the face of the functions that return it, where it is in both.
        shown = [getattr(analysis, other) for other in analysis.__all__]
        double = module.__name__ == "feel321.results" and thing in shown
        return f".. autoclass:: {name}\n   :members:\n" + "   :no-index:\n" * double
    if inspect.isfunction(thing):
        return f".. autofunction:: {name}\n"
    return f".. py:data:: {name}\n\n" + "".join(
        f"   {line}\n" for line in read_comment(module, name)
    )


def _summarise(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    is_code = inspect.isclass(thing) or inspect.isfunction(thing)
    lines = (inspect.getdoc(thing) or "").splitlines() if is_code else read_comment(module, name)
    return " ".join(" ".join(lines).partition(". ")[0].split()) if not is_code else lines[0]


def read_comment(module: ModuleType, name: str) -> list[str]:
    """Read what stands below a name in the module that defines it: of mappings and other data, and of types."""
    thing = getattr(module, name)
    homes = [
        module,
        *(each for key, each in sorted(sys.modules.items()) if key.startswith("feel321.")),
    ]
    for home in homes:
        if vars(home).get(name) is thing:
            found = ModuleAnalyzer.for_module(home.__name__).find_attr_docs().get(("", name))
            if found:
                return found
    return [""]


def write_commands(path: Path, group: click.Group) -> None:
    """Write the page of the command line: as `--help` has it, verb by verb."""
    verbs = sorted(group.commands.items())
    context = click.Context(group, info_name="feel321", **group.context_settings)
    links = [
        (f":ref:`{verb} <verb-{verb}>`", str(one.get_short_help_str(200))) for verb, one in verbs
    ]
    write(
        path,
        title("Command line"),
        "Every verb takes the study's folder, by default the current one. Exit codes: 0 done, 1 could not or found"
        " problems, 2 wrong use, 130 interrupted. Errors are one line on stderr.",
        table(("verb", "does"), links, widths="15 85"),
        *_describe_options(group, context),
        *(text for verb, one in verbs for text in _describe_verb(verb, one, context)),
    )


def _describe_verb(verb: str, command: click.Command, group: click.Context) -> Iterator[str]:
    context = click.Context(command, info_name=verb, parent=group)
    yield f".. _verb-{verb}:\n"
    yield title(verb, "-")
    usage = " ".join(command.collect_usage_pieces(context))
    yield f".. code-block:: text\n\n   feel321 {verb} {usage}\n"
    for paragraph in inspect.cleandoc(command.help or "").replace("\b", "").split("\n\n"):
        yield " ".join(_quiet(paragraph).split()) + "\n"
    yield from _describe_options(command, context)
    example = inspect.cleandoc((command.epilog or "").replace("\b", "")).removeprefix("Example:")
    if example:
        lines = "".join(
            f"   {line.strip()}\n"
            for line in example.replace("; ", "\n").splitlines()
            if line.strip()
        )
        yield f".. code-block:: sh\n\n{lines}"


def _describe_options(command: click.Command, context: click.Context) -> Iterator[str]:
    records = [each.get_help_record(context) for each in command.get_params(context)]
    rows = [(f"``{names}``", _quiet(meaning)) for names, meaning in filter(None, records)]
    if rows:
        yield table(("option", "meaning"), rows, widths="35 65")


def _quiet(text: str) -> str:
    """Show characters that reStructuredText would read as its own."""
    return (
        text
        .replace("\\", "\\\\")
        .replace("*", "\\*")
        .replace("|", "\\|")
        .replace("`", "\\`")
        .replace("_ ", "\\_ ")
    )
