"""The report's folder: results.json, and the files that a new report may replace."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING

from feel321.analysis.table.items import find_sources
from feel321.analysis.words import Number, count_number

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from feel321.analysis.table.reading import Table
    from feel321.analysis.words import Claim

# A report takes the place of the former one and of nothing else: files that are not its own stay untouched.

PAGE, RESULTS = "index.html", "results.json"
OWN = re.compile(r"index\.html|results\.json|figures/[^/\\]+\.(?:svg|png)|tables/[^/\\]+\.csv")
"""What a report's files are called; a list that names anything else is not obeyed."""


def list_files(figures: Iterable[str], tables: Iterable[str]) -> tuple[str, ...]:
    """List the files of a report."""
    drawn = (f"figures/{name}.{suffix}" for name in figures for suffix in ("svg", "png"))
    return (RESULTS, PAGE, *drawn, *(f"tables/{name}.csv" for name in tables))


def check_target(target: Path) -> None:
    """Find out whether a report may go to a folder, before minutes are spent on it."""
    if target.exists() and not target.is_dir():
        raise FileExistsError(
            f"{target}: got a file, allowed is a folder, there or not; choose another name"
        )
    _refuse_foreign(target, (RESULTS, PAGE))


def replace_report(place: Path, target: Path, *, files: Iterable[str]) -> None:
    """Move a finished report to its folder, over the former one."""
    wanted = tuple(files)
    former = _refuse_foreign(target, wanted)
    for name in former - set(wanted):
        (target / name).unlink(missing_ok=True)
    for name in wanted:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        # The list goes first: a run that is interrupted here leaves files that the next one knows for its own.
        (place / name).replace(target / name)


def _refuse_foreign(target: Path, wanted: Iterable[str]) -> set[str]:
    """Refuse to write over what is not of a former report; say what is."""
    former = _list_former(target)
    foreign = [name for name in wanted if name not in former and (target / name).exists()]
    if foreign:
        why = "is there, but is not of a former report; move it away or choose another folder"
        raise FileExistsError(f"{target / foreign[0]}: {why}")
    return former


def _list_former(target: Path) -> set[str]:
    try:
        content = json.loads((target / RESULTS).read_text(encoding="utf-8"))
        return {name for name in content["files"] if OWN.fullmatch(name)}
    except (OSError, ValueError, TypeError, KeyError):
        return set()


# A report as data: what ``results.json`` holds.

SCHEMA_VERSION = 1
"""Version of ``results.schema.json``, which describes ``results.json``: raised when a field changes or goes."""


@dataclass(frozen=True, slots=True)
class Results:
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

    def to_json(self) -> str:
        """Write as JSON text, the same text for the same results.

        Returns
        -------
        str
            UTF-8 JSON; a number that is not defined is null.
        """
        content = {
            "schema_version": SCHEMA_VERSION,
            "verdict": self.verdict,
            "verdicts": [asdict(claim) for claim in self.verdicts],
            "simulated": self.simulated,
            "numbers": [_without_nan(asdict(number)) for number in self.numbers],
            "answers": dict(self.answers),
            "figures": dict(self.figures),
            "captions": self.captions,
            "notes": self.notes,
            "how": self.how,
            "files": self.files,
            "inputs": dict(self.inputs),
            "versions": dict(self.versions),
        }
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def collect_numbers(table: Table, numbers: Iterable[Number]) -> tuple[Number, ...]:
    """Put the sizes of a table before the numbers of its sections."""
    gathered = tuple(
        {repr(number): number for number in chain(_count_table(table), numbers)}.values()
    )
    doubled = [
        name for name, times in Counter(number.name for number in gathered).items() if times > 1
    ]
    if doubled:
        raise ValueError(
            f"results: got {len(doubled)} names twice, first {doubled[0]}; every number needs its own"
        )
    return gathered


def _count_table(table: Table) -> Iterator[Number]:
    rows = table.rows
    for name in ("participant", "recording", "stimulus_id", "reducer", "scale"):
        yield count_number(f"size.{name}", rows[name].nunique(), n=len(rows))
    yield count_number("size.source", find_sources(rows).nunique(), n=len(rows))
    yield count_number("size.judgements", len(rows), n=len(rows))
    yield count_number("size.simulated_judgements", int(rows["simulated"].sum()), n=len(rows))


def _without_nan(fields: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in fields.items()
    }
