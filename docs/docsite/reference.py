"""Reference pages: the index, every public name, every verb, every column of every table."""

from __future__ import annotations

import inspect
import io
import re
import sys
from collections.abc import Iterable
from contextlib import redirect_stdout
from importlib import import_module
from itertools import chain
from pathlib import Path
from types import ModuleType

from sphinx.pycode import ModuleAnalyzer

from docsite.text import block, quiet, table, title, write
from feel321.analysis.table.columns import read_dictionary
from feel321.study.cli import VERBS, main

PAGES = (
    "quickstart", "tutorial", "study", "sessions", "calibration", "reading-the-report", "tradeoff", "planning",
    "evidence", "extensions", "python", "when-something-goes-wrong",
)  # fmt: skip
"""The pages that people write, in the order in which a lab needs them."""

REFERENCE = {
    "reference/settings": "Every key of study.toml and rig.toml: what it may be, its default, its unit",
    "reference/verbs": "The command line: what ``--help`` says of every verb",
    "reference/reducers": "Every 321 transform: formula, figure, when it fails",
    "reference/metrics": "Every metric: formula, range, when it misleads",
    "reference/tables": "Every column of every CSV file",
    "reference/stimuli": "From Python: recordings, reducers, metrics, stimulus sets",
    "reference/protocols": "From Python: tasks, trials and orders",
    "reference/study": "From Python: studies and sessions",
    "reference/analysis": "From Python: statistics, figures, reports",
    "reference/records": "From Python: records and types that signatures name",
}
"""Generated pages, and what they hold."""

FACES = {
    "stimuli": ("feel321.stimuli",),
    "protocols": ("feel321.protocols",),
    "study": ("feel321.study",),
    "analysis": ("feel321.analysis",),
    "records": ("feel321.results", "feel321.jobs", "feel321.types"),
}
"""Page -> modules whose public names it describes."""


def write_index(path: Path) -> None:
    """Write the first page: what the project is, from README, then each page's title and first sentence."""
    readme = (path.parents[1] / "README.md").read_text(encoding="utf-8")
    pages = [(f":doc:`{name}`", _read_opening(path.with_name(f"{name}.md"))) for name in PAGES]
    reference = [(f":doc:`{name}`", meaning) for name, meaning in REFERENCE.items()]
    write(
        path,
        title("feel321"),
        readme.split("\n\n")[1] + "\n",
        table(("page", "about"), pages, widths="30 70"),
        title("Reference", "-"),
        "Made from the program when this site was built.\n",
        table(("page", "holds"), reference, widths="30 70"),
        _list_contents("Guide", PAGES),
        _list_contents("Reference", REFERENCE),
    )


def _read_opening(page: Path) -> str:
    """Read the first sentence of a page's text."""
    text = re.sub(r"^(#|```|\|).*\n", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    paragraph = next(part for part in text.split("\n\n") if re.match(r"\s*[A-Z`]", part))
    sentence = re.split(r"(?<=[.?])\s", " ".join(paragraph.split()))[0]
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", sentence).replace("`", "``")


def _list_contents(caption: str, names: Iterable[str]) -> str:
    lines = "".join(f"   {name}\n" for name in names)
    return f".. toctree::\n   :hidden:\n   :caption: {caption}\n\n{lines}"


def write_faces(folder: Path) -> None:
    """Write the pages of public names."""
    shown: set[int] = set()
    for page, modules in FACES.items():
        faces = [import_module(name) for name in modules]
        parts = (
            [title(face.__name__, "-" if len(faces) > 1 else "="), _describe_face(face, shown)]
            for face in faces
        )
        heading = [title("Records and types")] if len(faces) > 1 else []
        write(folder / f"{page}.rst", *heading, *chain.from_iterable(parts))


def _describe_face(module: ModuleType, shown: set[int]) -> str:
    """Describe the public names of a module; those of an earlier page are there."""
    names = [
        name
        for name in sorted(module.__all__, key=str.casefold)
        if id(getattr(module, name)) not in shown
    ]
    shown.update(id(getattr(module, name)) for name in names)
    links = [
        (f":py:obj:`{name} <{module.__name__}.{name}>`", _summarise(module, name)) for name in names
    ]
    return "\n".join([
        f".. py:module:: {module.__name__}\n",
        (inspect.getdoc(module) or "") + "\n",
        table(("name", "purpose"), links, widths="35 65"),
        f".. currentmodule:: {module.__name__}\n",
        *(_describe(module, name) for name in names),
    ])


def _describe(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    if inspect.isclass(thing):
        return f".. autoclass:: {name}\n   :members:\n"
    if inspect.isfunction(thing):
        return f".. autofunction:: {name}\n"
    comment = "".join(f"   {line}\n" for line in read_comment(module, name))
    return f".. py:data:: {name}\n\n{comment}"


def _summarise(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    if inspect.isclass(thing) or inspect.isfunction(thing):
        return (inspect.getdoc(thing) or "").partition("\n")[0]
    return " ".join(" ".join(read_comment(module, name)).partition(". ")[0].split())


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


def ask_for_help(*words: str) -> str:
    """Ask the command line for help, as a user would."""
    said = io.StringIO()
    with redirect_stdout(said):
        main([*words, "--help"])
    return said.getvalue()


def write_verbs(path: Path) -> None:
    """Write the page of the command line."""
    write(
        path,
        title("Verbs"),
        "The study is a folder, by default the current one.\n",
        block("text", ask_for_help()),
        *(f"{title(verb, '-')}\n{block('text', ask_for_help(verb))}" for verb in VERBS),
    )


def write_tables(path: Path) -> None:
    """Write the data dictionary: every column that a CSV file of feel321 may have."""
    rows = sorted(read_dictionary(), key=lambda row: (row.file != "*", row.file))
    parts = []
    for file in dict.fromkeys(row.file for row in rows):
        listed = [
            (f"``{row.column}``", row.type, row.unit, quiet(row.allowed), quiet(row.meaning))
            for row in rows
            if row.file == file
        ]
        header = ("column", "type", "unit", "allowed", "meaning")
        heading = "Any table" if file == "*" else f"``{file}``"
        parts.append(f"{title(heading, '-')}\n{table(header, listed, widths='24 10 10 18 38')}")
    write(
        path,
        title("Tables"),
        "Every column of the CSV files; ``dictionary.csv`` beside the tables of a study has those that occur there."
        " ``low``, ``high``, ``se``, ``df``, ``t`` and ``p`` after a name are its interval, standard error and test;"
        " a metric is described by what it declares. Flags are ``TRUE`` and ``FALSE``, in tables"
        " derived from journals ``true`` and ``false``; empty cells are missing values.",
        *parts,
    )
