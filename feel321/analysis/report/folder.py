"""The folder of results: replaced as a whole, and only what is its own.

A folder holds ``results.json``, pages, ``figures/*.svg`` and ``*.png``, ``tables/*.csv``. ``results.json`` lists its
files: these a later run may replace, all others stay as they are.
"""

from __future__ import annotations

import json
import re
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures.style import save_figure
from feel321.analysis.page import inline_svg
from feel321.analysis.table.dictionary import DICTIONARY, make_dictionary
from feel321.doors import as_path
from feel321.files import defuse, make_folder, move_files, temporary_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from markupsafe import Markup
    from pandas import DataFrame

    from feel321.analysis.report.section import Picture
    from feel321.types import PathLike

PAGE, DETAILS, RESULTS = "index.html", "details.html", "results.json"
METHODS = "methods.md"
"""The methods section, which the study writes beside a report."""

OWN = re.compile(
    r"index\.html|details\.html|results\.json|figures/[^/\\]+\.(?:svg|png)|tables/[^/\\]+\.csv"
)
"""Only these files may be deleted, whatever ``results.json`` lists."""


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


class ResultsFolder:
    """A folder of results while it is written: everything is put beside its place first, then moved there.

    An interrupted run leaves the former results as they were.

    Examples
    --------
    >>> import tempfile
    >>> import pandas as pd
    >>> rows = pd.DataFrame({"reducer": ["dft321"], "r": [0.5]})
    >>> with tempfile.TemporaryDirectory() as place, ResultsFolder(f"{place}/report") as folder:
    ...     content = {"answer": 0.5, "files": list_files([], ["rows"])}
    ...     path = folder.write(content, page=lambda drawings: "<p>0.5</p>", tables={"rows": rows})
    ...     sorted(file.name for file in path.rglob("*") if file.is_file())
    ['dictionary.csv', 'index.html', 'results.json', 'rows.csv']
    """

    def __init__(self, path: PathLike) -> None:
        """Refuse a folder that holds other results."""
        self.path = as_path(path, "folder")
        self.pictures: list[Picture] = []
        self._place: Path | None = None
        self._closing = ExitStack()
        check_target(self.path)

    def __enter__(self) -> ResultsFolder:
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove what was not moved to its place."""
        self._closing.close()

    def draw(self, pictures: Iterable[Picture]) -> None:
        """Draw and save figures, each as SVG and PNG under its name."""
        for picture in pictures:
            self.pictures.append(picture)
            save_figure(picture.figure, self._stage("figures") / picture.name)

    def write(
        self,
        content: Mapping[str, Any],
        *,
        page: Callable[[Mapping[str, Markup]], str],
        tables: Mapping[str, DataFrame],
        details: str = "",
        kind: str = "report",
    ) -> Path:
        """Write results, tables and pages, and put all in the place of the former files; return the folder.

        content: what ``results.json`` holds; its "files" are those of `list_files`. page: renders the first page from
        the figures' SVG by name; details: the second page. tables: by name without suffix; unless one of them is
        `dictionary`, it is made for results of this kind.
        """
        frames = {f"{kind}/{name}.csv": frame for name, frame in tables.items()}
        if tables and DICTIONARY.removesuffix(".csv") not in tables:
            frames[DICTIONARY] = make_dictionary(frames)
        for name, frame in frames.items():
            write_flags(frame).to_csv(
                self._stage("tables") / name.rpartition("/")[2],
                index=False,
                float_format="%.10g",
                lineterminator="\n",
                encoding="utf-8",
            )
        stage = self._stage()
        drawings = {
            one.name: inline_svg(one.name, one.caption, stage / "figures" / f"{one.name}.svg")
            for one in self.pictures
        }
        listed = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        for name, text in {PAGE: page(drawings), DETAILS: details, RESULTS: listed}.items():
            if text:
                (stage / name).write_text(text, encoding="utf-8", newline="")
        wanted = tuple(content["files"])
        for name in _refuse_foreign(self.path, wanted) - set(wanted):
            (self.path / name).unlink(missing_ok=True)
        for name in wanted:
            make_folder((self.path / name).parent)
        # The list goes first: a run that is interrupted here leaves files that the next one knows for its own.
        move_files({stage / name: self.path / name for name in wanted})
        return self.path

    def _stage(self, part: str = "") -> Path:
        """Find where files wait, beside their place so that moving them is quick; made when it is needed."""
        if self._place is None:
            make_folder(self.path.parent)
            self._place = self._closing.enter_context(temporary_folder(self.path))
        stage = self._place / part
        make_folder(stage)
        return stage


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
            raise FileExistsError(
                f"{target / name}: exists and is not of a former report; move it away or choose another folder"
            )
    return former
