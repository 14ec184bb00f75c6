"""A result that has a page: its folder holds numbers, tables, figures and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321.analysis.page import render_template
from feel321.analysis.report.folder import PAGE, ResultsFolder, list_files
from feel321.records import Result, to_json_value
from feel321.types import PathLike

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.section import Picture

SCHEMA_VERSION = 1
"""Version of what ``results.json`` holds: raised when a field changes or goes."""


class PageParts(NamedTuple):
    """What a folder is made of: what results.json holds, besides files; figures; what the template shows."""

    template: str
    content: Mapping[str, object]
    pictures: Sequence[Picture]
    values: Mapping[str, Any]


class PageResult(Result):
    """A result that has a page."""

    __slots__ = ()

    def write(self, folder: PathLike) -> Path:
        """Write page, numbers, tables and figures.

        Parameters
        ----------
        folder : str or PathLike
            The folder. The files of a former result are replaced; all others stay.

        Returns
        -------
        Path
            The page.

        Raises
        ------
        OSError
            If a file cannot be written, or would replace one that is not of a former result.
        """
        tables = self.to_frames()
        name, content, pictures, values = self._make_page(tables)
        files = list_files([picture.name for picture in pictures], tables)
        with ResultsFolder(folder) as results:
            results.draw(pictures)
            results.write(
                to_json_value({"schema_version": SCHEMA_VERSION, **content, "files": files}),
                page=lambda drawings: render_template(
                    name, pictures=pictures, drawings=drawings, **values
                ),
                tables=tables,
                kind=type(self).__name__.lower(),
            )
        return results.path / PAGE

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the numbers as tables, by name."""
        raise NotImplementedError

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        raise NotImplementedError
