"""The folder of results of chart, stress and advise: page, results.json, figures and tables, by one mechanism."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.style import save_figure
from feel321.analysis.report.folder import PAGE, RESULTS, list_files, replace_report
from feel321.analysis.report.page import TEMPLATES, inline_svg
from feel321.analysis.words import keep_together
from feel321.doors import as_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame

    from feel321.analysis.report.section import Picture
    from feel321.types import PathLike


@dataclass(frozen=True, slots=True)
class PageCell:
    """An entry of a table of a page; grade: the class that colours it; link: where it leads."""

    text: str
    grade: str = ""
    link: str = ""

    def __str__(self) -> str:
        """Write it without colour and link."""
        return self.text


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of a page; the first column names the rows."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | PageCell, ...], ...]


def write_results(
    folder: PathLike,
    template: str,
    *,
    content: Mapping[str, object],
    tables: Mapping[str, DataFrame],
    pictures: Sequence[Picture],
    values: Mapping[str, object],
) -> Path:
    """Write a folder of results in the place of the former one, and of nothing else; return its page.

    content: what results.json holds, besides the names of the files; values: what the template shows.
    """
    from markupsafe import Markup

    target = as_path(folder, "folder")
    files = list_files([picture.name for picture in pictures], tables)
    target.parent.mkdir(parents=True, exist_ok=True)
    # Everything is written beside its place first: an interrupted run leaves the former results as they were.
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as name:
        place = Path(name)
        for part in ("figures", "tables"):
            (place / part).mkdir()
        for table, frame in tables.items():
            frame.to_csv(
                place / "tables" / f"{table}.csv",
                index=False,
                float_format="%.10g",
                lineterminator="\n",
            )
        drawings = {}
        for picture in pictures:
            drawing = place / "figures" / picture.name
            save_figure(picture.figure, drawing)
            # matplotlib's links open a window of their own; these lead down the page.
            drawn = inline_svg(picture, drawing.with_suffix(".svg"))
            drawings[picture.name] = Markup(str(drawn).replace(' target="_blank"', ""))  # noqa: S704 - escaped there
        shown = {**values, "pictures": pictures, "drawings": drawings}
        _write(place / PAGE, _render(template, shown))
        whole = _without_undefined({**content, "files": files})
        _write(
            place / RESULTS, json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )
        replace_report(place, target, files=files)
    return target / PAGE


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="")


def _render(template: str, values: Mapping[str, object]) -> str:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=keep_together,
    )
    style = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    return environment.get_template(template).render({**values, "style": style})


def _without_undefined(entry: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Turn numbers that are infinite or not defined into None."""
    if isinstance(entry, Mapping):
        return {key: _without_undefined(value) for key, value in entry.items()}
    if isinstance(entry, list | tuple):
        return [_without_undefined(value) for value in entry]
    return None if isinstance(entry, float) and not math.isfinite(entry) else entry
