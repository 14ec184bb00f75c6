"""A report as data: what ``results.json`` holds."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections import Counter
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis.table.items import find_sources, format_recordings
from feel321.analysis.table.reading import ROSTER_FILE
from feel321.analysis.words import Number, count_number
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pandas import DataFrame

    from feel321.analysis.report.parts import Choices
    from feel321.analysis.table.reading import Further, Table
    from feel321.analysis.words import Claim

SCHEMA_VERSION = 1
"""Version of ``results.schema.json``, which describes ``results.json``: raised when a field changes or goes."""

COMPUTED_WITH = ("numpy", "scipy", "pandas", "statsmodels", "scikit-learn", "matplotlib", "jinja2")


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Results(Result):
    """A report as data.

    Parameters
    ----------
    verdict : tuple of str
        The answer in words.
    verdicts : tuple of Claim
        The answer for programs: one per scale, level and metric.
    numbers : tuple of Number
        Every number shown.
    answers : Mapping of str to tuple of str
        What each section shows, in words, by its key.
    figures : Mapping of str to str
        Caption of each figure, by file name without suffix.
    captions : tuple of str
        What each table of the page shows.
    notes : tuple of str
        What was left out or assumed.
    how : tuple of str
        How it was computed.
    files : tuple of str
        Every file of the report, relative to its folder: what a later report may replace.
    simulated : bool
        Whether any rating came from a simulated participant.
    inputs : Mapping of str to str
        File names and digests, seed and draws.
    versions : Mapping of str to str
        Software that computed it.
    path : Path
        The report's folder.
    """

    verdict: tuple[str, ...]
    verdicts: tuple[Claim, ...]
    numbers: tuple[Number, ...]
    answers: Mapping[str, tuple[str, ...]]
    figures: Mapping[str, str]
    captions: tuple[str, ...]
    notes: tuple[str, ...]
    how: tuple[str, ...]
    files: tuple[str, ...]
    simulated: bool
    inputs: Mapping[str, str]
    versions: Mapping[str, str]
    path: Path = Path()

    def to_frame(self) -> DataFrame:
        """Return every number of the report.

        Returns
        -------
        DataFrame
            One row per number: its name, value, interval, kind of interval, method and n.
        """
        import pandas as pd

        return pd.DataFrame([asdict(number) for number in self.numbers])

    def summary(self) -> str:
        """Write the answer, a line per finding.

        Returns
        -------
        str
            What opens the report.
        """
        return "\n".join(self.verdict)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds.

        Returns
        -------
        dict
            A number that is not defined is None.
        """
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "path"}
        return {
            "schema_version": SCHEMA_VERSION, "verdict": self.verdict,
            "verdicts": [asdict(claim) for claim in self.verdicts], "simulated": self.simulated,
            "numbers": [_without_nan(asdict(number)) for number in self.numbers],
            "answers": dict(self.answers), "figures": dict(self.figures),
            **{name: fields[name] for name in ("captions", "notes", "how", "files")},
            "inputs": dict(self.inputs), "versions": dict(self.versions),
        }  # fmt: skip

    def to_json(self) -> str:
        """Write as JSON text, the same text for the same results.

        Returns
        -------
        str
            UTF-8 JSON; a number that is not defined is null.
        """
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _without_nan(fields: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in fields.items()
    }


def collect_numbers(table: Table, numbers: Iterable[Number]) -> tuple[Number, ...]:
    """Put the sizes of a table before the numbers of its sections."""
    gathered = {repr(number): number for number in chain(_count_table(table), numbers)}.values()
    times = Counter(number.name for number in gathered)
    if doubled := [name for name, count in times.items() if count > 1]:
        raise ValueError(
            f"results: got {len(doubled)} names twice, first {doubled[0]}; every number needs its own"
        )
    return tuple(gathered)


def _count_table(table: Table) -> Iterator[Number]:
    rows = table.rows
    columns = ("participant", "recording", "stimulus_id", "reducer", "scale")
    sizes = {name: rows[name].nunique() for name in columns}
    sizes |= {"source": find_sources(rows).nunique(), "judgements": len(rows)}
    sizes["simulated_judgements"] = int(rows["simulated"].sum())
    for name, size in sizes.items():
        yield count_number(f"size.{name}", size, n=len(rows))


def describe_inputs(
    ratings: Path, manifest: Path, *, table: Table, further: Further | None, choices: Choices
) -> dict[str, str]:
    """Describe everything that decides a report: files, choices and what was handed over, each with its digest."""
    roster = ratings.with_name(ROSTER_FILE)
    files = {"ratings": ratings, "manifest": manifest, "participants": roster}
    told: dict[str, str] = {}
    for role, path in files.items():
        if path.is_file() or role != "participants":
            told |= {role: path.name, f"{role}_sha256": _digest(path.read_bytes())}
    found = find_sources(table.rows)
    if not found.is_unique:
        told["sources"] = format_recordings(len(found), found.nunique())
        told["sources_sha256"] = _digest(json.dumps(found.to_dict(), sort_keys=True).encode())
    if further is not None and not further.metrics.empty:
        rows = further.metrics.sort_index().to_csv(float_format="%.17g", lineterminator="\n")
        told["further_metrics"] = ", ".join(map(str, further.metrics))
        told["further_metrics_sha256"] = _digest(rows.encode())
    told["metrics"] = ", ".join(table.metrics)
    for name, value in asdict(choices).items():
        told[name] = "from repeated ratings" if value is None else str(value)
    return told


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def list_versions() -> dict[str, str]:
    """List the software that computed a report."""
    from feel321 import __version__

    libraries = {name: version(name) for name in COMPUTED_WITH}
    return {"feel321": __version__, "python": platform.python_version(), **libraries}
