"""The folder of results: replaced as a whole, and only what is its own.

A folder holds ``results.json``, pages, ``figures/*.svg`` and ``*.png``, ``tables/*.csv``. ``results.json`` lists its
files: these a later run may replace, all others stay as they are. An interrupted run leaves the former results.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import inline_svg, save_figure
from feel321.analysis.table.columns import DICTIONARY, make_dictionary
from feel321.analysis.words import render_template
from feel321.arguments import as_path
from feel321.files import defuse, make_folder, move_files, temporary_folder
from feel321.records import Result, to_json_value
from feel321.types import PathLike

if TYPE_CHECKING:
    from markupsafe import Markup
    from pandas import DataFrame

    from feel321.analysis.report.section import Picture

PAGE, DETAILS, RESULTS = "index.html", "details.html", "results.json"
METHODS = "methods.md"  # The methods section, which the study writes beside a report
# Only these files may be deleted, whatever ``results.json`` lists
OWN = re.compile(
    r"index\.html|details\.html|results\.json|figures/[^/\\]+\.(?:svg|png)|tables/[^/\\]+\.csv"
)


def list_files(
    figures: Iterable[str], tables: Iterable[str], pages: Iterable[str] = (PAGE,)
) -> tuple[str, ...]:
    """List the files of a folder, by the names of its figures and tables."""
    drawn = (f"figures/{name}.{suffix}" for name in figures for suffix in ("svg", "png"))
    listed = [f"tables/{name}.csv" for name in tables]
    return (RESULTS, *pages, *drawn, *listed, *([f"tables/{DICTIONARY}"] if listed else []))


def write_flags(frame: DataFrame) -> DataFrame:
    """Write flags as TRUE and FALSE, which R takes for what they are, and texts so that no spreadsheet runs them."""

    def write(cell: Any) -> Any:  # noqa: ANN401 - any cell of a table
        return str(cell).upper() if isinstance(cell, bool | np.bool_) else defuse(cell)

    flagged = frame.select_dtypes(["bool", "object", "str"])
    return frame.assign(**{str(name): flagged[name].map(write) for name in flagged})


def check_target(target: Path) -> None:
    """Find out whether results may go to a folder, before minutes are spent on them."""
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{target}: must be a folder, got a file; choose another name")
    _refuse_foreign(target, (RESULTS, PAGE))


def write_folder(  # noqa: PLR0913 - what a folder holds, by name
    path: PathLike,
    content: Mapping[str, Any],
    *,
    page: Callable[[Mapping[str, Markup]], str],
    pictures: Sequence[Picture] = (),
    tables: Mapping[str, DataFrame] = MappingProxyType({}),
    details: str = "",
    kind: str = "report",
) -> Path:
    """Write results, pages, figures and tables beside their place, then put all in that of the former files.

    content: what ``results.json`` holds; its "files" are those of `list_files`. page: renders the first page from the
    figures' SVG by name; details: the second page. tables: by name without suffix; unless one of them is `dictionary`,
    it is made for results of this kind.
    """
    target = as_path(path, "folder")
    check_target(target)
    frames = {f"{kind}/{name}.csv": frame for name, frame in tables.items()}
    if tables and DICTIONARY.removesuffix(".csv") not in tables:
        frames[DICTIONARY] = make_dictionary(frames)
    make_folder(target.parent)
    with temporary_folder(target) as stage:
        make_folder(stage / "figures")
        make_folder(stage / "tables")
        drawings = {}
        for one in pictures:
            save_figure(one.figure, stage / "figures" / one.name)
            drawing = stage / "figures" / f"{one.name}.svg"
            drawings[one.name] = inline_svg(one.name, one.caption, drawing)
        plain: dict[str, Any] = {"index": False, "float_format": "%.10g", "lineterminator": "\n"}
        for name, frame in frames.items():
            place = stage / "tables" / name.rpartition("/")[2]
            write_flags(frame).to_csv(place, encoding="utf-8", **plain)
        listed = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        for name, text in {PAGE: page(drawings), DETAILS: details, RESULTS: listed}.items():
            if text:
                (stage / name).write_text(text, encoding="utf-8", newline="")
        wanted = tuple(content["files"])
        for name in _refuse_foreign(target, wanted) - set(wanted):
            (target / name).unlink(missing_ok=True)
        for name in wanted:
            make_folder((target / name).parent)
        # The list goes first: a run that is interrupted here leaves files that the next one knows for its own.
        move_files({stage / name: target / name for name in wanted})
    return target


def list_own(target: Path) -> list[str]:
    """List the files of a folder that have the names of results, even if `results.json` is damaged; it comes last."""
    found = (path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file())
    own = (name for name in found if name == METHODS or OWN.fullmatch(name))
    return sorted(own, key=lambda name: (name == RESULTS, name))


def remove_results(target: Path) -> None:
    """Remove results of ratings, whatever is left of their list; what else lies in the folder stays."""
    for name in list_own(target):
        (target / name).unlink(missing_ok=True)
    for folder in (target / "figures", target / "tables", target):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _refuse_foreign(target: Path, wanted: Iterable[str]) -> set[str]:
    """Refuse to write over what is not of a former run; return what is."""
    try:
        content = json.loads((target / RESULTS).read_text(encoding="utf-8"))
        former = {name for name in content["files"] if OWN.fullmatch(name)}
    except (OSError, ValueError, TypeError, KeyError):
        former = set()
    for name in wanted:
        if name not in former and (target / name).exists():
            do = "move it away or choose another folder"
            raise FileExistsError(f"{target / name}: exists and is not of a former report; {do}")
    return former


# Results that have one page: the trade-off, power.

# Version of what their ``results.json`` holds: raised when a field changes or goes
SCHEMA_VERSION = 1


# What a folder is made of: template, what results.json holds besides files, figures, what the template shows
PageParts = tuple[str, Mapping[str, object], Sequence["Picture"], Mapping[str, Any]]


class PageResult(Result):
    """A result that has a page."""

    __slots__ = ()

    def write(self, folder: PathLike) -> Path:
        """Write page, numbers, tables and figures in place of those of a former result; return the page."""
        tables = self.to_frames()
        name, content, pictures, values = self._make_page(tables)
        files = list_files([picture.name for picture in pictures], tables)
        target = write_folder(
            folder,
            to_json_value({"schema_version": SCHEMA_VERSION, **content, "files": files}),
            page=lambda drawings: render_template(
                name, pictures=pictures, drawings=drawings, **values
            ),
            pictures=pictures,
            tables=tables,
            kind=type(self).__name__.lower(),
        )
        return target / PAGE

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the numbers as tables, by name."""
        raise NotImplementedError

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        raise NotImplementedError
