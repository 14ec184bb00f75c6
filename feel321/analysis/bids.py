"""Ratings read back from a dataset that `feel321 export --bids` wrote: the study's own table, number by number."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from feel321.analysis.table.metrics import make_info
from feel321.analysis.table.roster import ROSTER_FILE
from feel321.analysis.table.sheets import Further
from feel321.doors import as_path
from feel321.files import make_folder, temporary_folder, write_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from feel321.analysis.table.items import Table
    from feel321.types import MetricInfo, PathLike

CHOICES = "derivatives/feel321/code/analysis.json"
"""What an analysis needs besides the tables."""

MISSING = "n/a"
SUBJECT = "sub-"


@dataclass(frozen=True, slots=True)
class OpenedDataset:
    """A dataset as the tables that an analysis reads, and the choices that were exported with it."""

    ratings: Path
    manifest: Path
    choices: Mapping[str, Any]

    @property
    def further(self) -> Further:
        """What was computed from the recordings, which a dataset does not hold."""
        from pandas import DataFrame

        frames = {
            name: None if columns is None else DataFrame(columns)
            for name, columns in self.choices["further"].items()
        }
        metrics = frames["metrics"]
        known = (
            DataFrame() if metrics is None or metrics.empty else metrics.set_index("stimulus_id")
        )
        return Further(
            known.astype(float), tuple(self.choices["notes"]), mountings=frames["mountings"]
        )

    @property
    def info(self) -> dict[str, MetricInfo]:
        """What metrics declare."""
        return {name: make_info(name, one) for name, one in self.choices["info"].items()}

    def read(self) -> Table:
        """Read the table."""
        from feel321.analysis.table.reading import read_table

        declared = self.choices["analysis"]["metrics"]
        further = self.further if set(declared) & set(self.further.metrics) else None
        return read_table(
            self.ratings, self.manifest, metrics=declared, further=further, info=self.info
        )


def read_bids(folder: PathLike) -> Table:
    """Read the ratings of a dataset that `feel321 export --bids` wrote.

    Every number is the study's own; participants have the names of the dataset without ``sub-``, and recordings that
    are one and the same have numbered sources.

    Parameters
    ----------
    folder : path
        The dataset.

    Returns
    -------
    Table
        As `read_table` reads it from the study.

    Raises
    ------
    FileNotFoundError
        If the folder is no such dataset.
    ValueError
        If a table in it was changed so that it cannot be read.

    Examples
    --------
    >>> from feel321 import analysis
    >>> table = analysis.read_bids("dataset")  # doctest: +SKIP
    >>> analysis.fit_primary(table)  # doctest: +SKIP
    """
    with temporary_folder() as place:
        return open_dataset(as_path(folder, "folder"), place).read()


def open_dataset(folder: Path, place: Path) -> OpenedDataset:
    """Write the tables of a dataset into a folder, in the form that an analysis reads."""
    path = folder / CHOICES
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: there is none; name a dataset that feel321 export --bids wrote"
        )
    files = sorted(folder.glob("sub-*/**/*_beh.tsv"))
    people: dict[str, list[dict[str, str]]] = {}
    columns: dict[str, None] = {}
    for file in files:
        label = file.name.partition("_")[0].removeprefix(SUBJECT)
        rows = read_tsv(file)
        columns |= dict.fromkeys(chain(*rows[:1]))
        people.setdefault(label, []).extend({"participant": label, **row} for row in rows)
    for rows in people.values():
        rows.sort(key=lambda row: (int(row["session"]), int(row["trial"])))
    make_folder(place / "stimuli")
    opened = OpenedDataset(
        place / "ratings.csv",
        place / "stimuli" / "manifest.csv",
        json.loads(path.read_text(encoding="utf-8")),
    )
    _write(
        opened.ratings,
        chain(*(people[label] for label in sorted(people))),
        first="participant",
        columns=columns,
    )
    _write(
        opened.manifest, stimuli := read_tsv(folder / "stimuli" / "stimuli.tsv"), columns=stimuli[0]
    )
    roster = [
        {"participant": row.pop("participant_id").removeprefix(SUBJECT), **row}
        for row in read_tsv(folder / "participants.tsv")
    ]
    _write(place / ROSTER_FILE, roster, columns=roster[0])
    return opened


def _write(
    path: Path, rows: Iterable[Mapping[str, str]], *, columns: Iterable[str], first: str = ""
) -> None:
    names = list(dict.fromkeys([*([first] if first else []), *columns]))
    write_table(path, names, rows)


def read_tsv(path: Path) -> list[dict[str, str]]:
    """Read a table of a dataset as texts; a missing value is an empty text."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is none; restore it from a copy")
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(
            file, delimiter="\t", quoting=csv.QUOTE_NONE, restkey="", restval=None
        )
        found = list(rows)
    if odd := next(
        (n for n, row in enumerate(found, start=2) if "" in row or None in row.values()), None
    ):
        raise ValueError(
            f"{path}, line {odd}: must have as many cells as the first line; restore it from a copy"
        )
    if not found:
        raise ValueError(f"{path}: must have at least one row; restore it from a copy")
    return [{name: "" if cell == MISSING else cell for name, cell in row.items()} for row in found]
