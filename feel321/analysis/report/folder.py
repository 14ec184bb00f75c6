"""The folder of results of report and trade-off: replaced as a whole, and only what is its own.

A folder holds ``results.json``, ``index.html``, ``figures/*.svg`` and ``*.png``, ``tables/*.csv``. ``results.json``
lists its files: these a later run may replace, all others stay as they are.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import subprocess
import sys
from contextlib import ExitStack, suppress
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
    from types import TracebackType

    from markupsafe import Markup
    from pandas import DataFrame

    from feel321.analysis.report.section import Picture
    from feel321.types import MetricInfo, PathLike

PAGE, RESULTS = "index.html", "results.json"
OWN = re.compile(r"index\.html|results\.json|figures/[^/\\]+\.(?:svg|png)|tables/[^/\\]+\.csv")
"""Only these files may be deleted, whatever ``results.json`` lists."""

BACKGROUND = len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else "12") > 1
"""Whether figures may be drawn by a second process: only where there is a core for it."""


def list_files(figures: Iterable[str], tables: Iterable[str]) -> tuple[str, ...]:
    """List the files of a folder, by the names of its figures and tables."""
    drawn = (f"figures/{name}.{suffix}" for name in figures for suffix in ("svg", "png"))
    listed = [f"tables/{name}.csv" for name in tables]
    return (RESULTS, PAGE, *drawn, *listed, *([f"tables/{DICTIONARY}"] if listed else []))


def write_flags(frame: DataFrame) -> DataFrame:
    """Write flags as TRUE and FALSE, which R takes for what they are, and texts so that no spreadsheet runs them."""
    words = {True: "TRUE", False: "FALSE"}
    flags = [
        name
        for name in frame
        if str(frame[name].dtype) in {"bool", "object"}
        and frame[name].dropna().map(type).isin([bool, np.bool_]).all()
    ]
    texts = {
        str(name): frame[name].map(defuse)
        for name in frame
        if name not in flags and str(frame[name].dtype) in {"object", "str"}
    }
    return frame.assign(**texts, **{str(name): frame[name].map(words) for name in flags})


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

    def __init__(self, path: PathLike, *, background: bool = False) -> None:
        """Refuse a folder that holds other results; in the background: let a second process draw, if a core is free."""
        self.path = as_path(path, "folder")
        self.pictures: list[Picture] = []
        self._place: Path | None = None
        self._closing = ExitStack()
        self._artist: subprocess.Popen[str] | None = None
        self._background = background and BACKGROUND
        check_target(self.path)

    def __enter__(self) -> ResultsFolder:
        """Begin; the second process loads what it draws with while the first figure is computed."""
        if self._background:
            with suppress(OSError):  # then all is drawn here
                self._artist = subprocess.Popen(  # noqa: S603 - our own words
                    [sys.executable, "-c", _ARTIST, json.dumps(sys.path)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    text=True,
                )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove what was not moved to its place."""
        if self._artist is not None:
            self._artist.kill()
            self._artist.communicate()
        self._closing.close()

    def draw(self, pictures: Iterable[Picture]) -> None:
        """Draw and save figures, each as SVG and PNG under its name."""
        for picture in pictures:
            self.pictures.append(picture)
            if not self._hand_over(picture):
                save_figure(picture.figure, self._stage("figures") / picture.name)

    def write(
        self,
        content: Mapping[str, Any],
        *,
        page: Callable[[Mapping[str, Markup]], str],
        tables: Mapping[str, DataFrame],
        kind: str = "report",
        info: Mapping[str, MetricInfo] | None = None,
    ) -> Path:
        """Write results, tables and page, and put all in the place of the former files; return the folder.

        content: what ``results.json`` holds; its "files" are those of `list_files`. page: renders the page from the
        figures' SVG, by name. tables: by name without suffix; `dictionary.csv` beside them describes their columns, by
        the kind of results; info: what metrics declare of themselves.
        """
        files = {f"{kind}/{name}.csv": frame for name, frame in tables.items()}
        if tables:
            files[f"{kind}/{DICTIONARY}"] = make_dictionary(files, info)
        for file, frame in files.items():
            write_flags(frame).to_csv(
                self._stage("tables") / file.rpartition("/")[2],
                index=False,
                float_format="%.10g",
                lineterminator="\n",
                encoding="utf-8",
            )
        self._finish_drawing()
        stage = self._stage()
        drawings = {
            one.name: inline_svg(one.name, one.caption, stage / "figures" / f"{one.name}.svg")
            for one in self.pictures
        }
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        (stage / RESULTS).write_text(f"{text}\n", encoding="utf-8", newline="")
        (stage / PAGE).write_text(page(drawings), encoding="utf-8", newline="")
        _replace(stage, self.path, files=content["files"])
        return self.path

    def _stage(self, part: str = "") -> Path:
        """Find where files wait, beside their place so that moving them is quick; made when it is needed."""
        if self._place is None:
            make_folder(self.path.parent)
            self._place = self._closing.enter_context(temporary_folder(self.path))
        stage = self._place / part
        make_folder(stage)
        return stage

    def _hand_over(self, picture: Picture) -> bool:
        """Let the second process draw a figure; False if it cannot."""
        if self._artist is None:
            return False
        order, stem = self._find_order(picture), self._stage("figures") / picture.name
        try:
            order.write_bytes(pickle.dumps((picture.drawing, stem)))
            print(order, file=self._artist.stdin, flush=True)
        except (OSError, pickle.PicklingError, AttributeError, TypeError):
            order.unlink(missing_ok=True)
            return False
        return True

    def _find_order(self, picture: Picture) -> Path:
        return self._stage("orders") / f"{picture.name}.pickle"

    def _finish_drawing(self) -> None:
        """Draw from the last figure towards where the second process is, and what it could not draw."""
        if self._artist is None:
            return
        left = []
        for picture in reversed(self.pictures):
            try:
                self._find_order(picture).unlink()  # whoever removes an order draws it
            except OSError:
                left.append(picture)
            else:
                save_figure(picture.figure, self._stage("figures") / picture.name)
        self._artist.communicate()
        for picture in left:
            stem = self._stage("figures") / picture.name
            if self._artist.returncode or not stem.with_name(f"{stem.name}.png").exists():
                save_figure(picture.figure, stem)


_ARTIST = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
import pickle
from pathlib import Path
import matplotlib.figure
from feel321.analysis.figures.style import save_figure
for line in sys.stdin:
    order = Path(line.rstrip("\\n"))
    try:
        content = order.read_bytes()
        order.unlink()
    except OSError:
        continue  # drawn by the other process
    drawing, stem = pickle.loads(content)
    save_figure(drawing() if callable(drawing) else drawing, stem)
"""
"""What the second process runs. It imports neither the caller's script nor anything of a running session."""


METHODS = "methods.md"
"""The methods section, which the study writes beside a report."""


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


def _replace(place: Path, target: Path, *, files: Iterable[str]) -> None:
    """Move finished results to their folder, over the former ones."""
    wanted = tuple(files)
    former = _refuse_foreign(target, wanted)
    for name in former - set(wanted):
        (target / name).unlink(missing_ok=True)
    for name in wanted:
        make_folder((target / name).parent)
    # The list goes first: a run that is interrupted here leaves files that the next one knows for its own.
    move_files({place / name: target / name for name in wanted})


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
