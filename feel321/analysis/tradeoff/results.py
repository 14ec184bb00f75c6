"""What the folders and pages of chart, stress and advise share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321.analysis.page import render_template
from feel321.analysis.report.folder import PAGE, ResultsFolder, list_files
from feel321.doors import describe
from feel321.records import Result, to_json_value
from feel321.types import PathLike

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.section import Picture
    from feel321.analysis.table.items import Table
    from feel321.stimuli.recording import Recording

NEEDED = ("participant", "recording", "reducer", "scale", "level", "rating")
"""Columns of ratings that are compared with reducers."""


class PageParts(NamedTuple):
    """What a result's folder is made of: what results.json holds, besides files; figures; what its template shows."""

    template: str
    content: Mapping[str, object]
    pictures: Sequence[Picture]
    values: Mapping[str, Any]


SCHEMA_VERSION = 1
"""Version of what ``results.json`` of chart, stress and advise holds: raised when a field changes or goes."""


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


def as_recordings(
    given: Recording | Iterable[Recording], *, fewest: int = 0
) -> tuple[Recording, ...]:
    """Take several recordings, or one; refuse too few, two of the same name, and whatever is none."""
    from feel321.stimuli.recording import Recording

    recordings = (given,) if isinstance(given, Recording | str) else given
    recordings = tuple(recordings) if isinstance(recordings, Iterable) else (recordings,)
    if len(recordings) < fewest:
        raise ValueError(
            "recordings must be one or more, got none; name some, or add the bundled scenes"
        )
    for one in recordings:
        if not isinstance(one, Recording):
            raise TypeError(
                f"recordings must be Recordings, got {describe(one)}; "
                "make one with stimuli.read_recording or stimuli.Recording"
            )
    names = [recording.name for recording in recordings]
    if doubled := [name for name in names if names.count(name) > 1]:
        raise ValueError(
            f"recordings must have different names, got {doubled[0]!r} twice; rename one"
        )
    return recordings


def as_table(ratings: Table | DataFrame) -> Table:
    """Take ratings as a table; of a data frame, every row is of a test stimulus, and nobody simulated, if not said."""
    from feel321.analysis.arrays import check_columns
    from feel321.analysis.table.items import Table, leave_rejected, name_items, open_ratings

    if isinstance(ratings, Table):
        return ratings
    rows, _ = leave_rejected(name_items(open_ratings(ratings)))
    check_columns(rows, NEEDED, "ratings")
    return Table(
        rows.assign(
            role=rows.get("role", "test"), simulated=rows.get("simulated", False),
            stimulus_id=rows["item"],
        ).reset_index(drop=True), (), (),
    )  # fmt: skip
