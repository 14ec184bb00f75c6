"""What the folders and pages of chart, stress and advise share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from feel321.analysis.report.folder import PAGE, ResultsFolder, list_files
from feel321.analysis.report.section import Picture, render_template

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

    from feel321.stimuli.recording import Recording
    from feel321.types import PathLike


def write_results(
    folder: PathLike,
    name: str,
    *,
    content: Mapping[str, object],
    tables: Mapping[str, DataFrame],
    pictures: Sequence[Picture],
    values: Mapping[str, Any],
) -> Path:
    """Write a folder of results in the place of the former one, and of nothing else; return its page.

    name: of the template; content: what results.json holds, besides the names of the files; values: what the template
    shows, besides pictures and drawings.
    """
    files = list_files([picture.name for picture in pictures], tables)
    with ResultsFolder(folder) as results:
        results.draw(pictures)
        results.write(
            without_undefined({**content, "files": files}),
            page=lambda drawings: render_template(
                f"{name}.html", pictures=pictures, drawings=drawings, **values
            ),
            tables=tables,
        )
    return results.path / PAGE


def without_undefined(entry: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Turn numbers that are infinite or not defined into None."""
    if isinstance(entry, Mapping):
        return {key: without_undefined(value) for key, value in entry.items()}
    if isinstance(entry, list | tuple):
        return [without_undefined(value) for value in entry]
    return None if isinstance(entry, float) and not math.isfinite(entry) else entry


def check_names(recordings: Sequence[Recording], *, fewest: int = 0) -> None:
    """Refuse two recordings of the same name, or too few."""
    if len(recordings) < fewest:
        raise ValueError(
            "recordings must be one or more, got none; name some, or add the bundled scenes"
        )
    names = [recording.name for recording in recordings]
    if doubled := [name for name in names if names.count(name) > 1]:
        raise ValueError(
            f"recordings must have different names, got {doubled[0]!r} twice; rename one"
        )
