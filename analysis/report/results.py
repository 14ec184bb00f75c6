"""A report as data: what ``results.json`` holds."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING

from analysis.numbers import Number, count_number
from analysis.table.sources import find_sources

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from analysis.report.lines import Claim
    from analysis.table.reading import Table


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
    """Put the sizes of a table before the numbers of its sections.

    Parameters
    ----------
    table : Table
        What was analysed.
    numbers : iterable of Number
        Of all sections; one may show what another holds.

    Returns
    -------
    tuple of Number
        Each once.

    Raises
    ------
    ValueError
        If two different numbers bear the same name.
    """
    gathered = tuple({repr(number): number for number in chain(_count_table(table), numbers)}.values())
    doubled = [name for name, times in Counter(number.name for number in gathered).items() if times > 1]
    if doubled:
        raise ValueError(f"results: got {len(doubled)} names twice, first {doubled[0]}; every number needs its own")
    return gathered


def _count_table(table: Table) -> Iterator[Number]:
    rows = table.rows
    for name in ("participant", "recording", "stimulus_id", "reducer", "scale"):
        yield count_number(f"size.{name}", rows[name].nunique(), n=len(rows))
    yield count_number("size.source", find_sources(rows).nunique(), n=len(rows))
    yield count_number("size.judgements", len(rows), n=len(rows))
    yield count_number("size.simulated_judgements", int(rows["simulated"].sum()), n=len(rows))


def _without_nan(fields: dict[str, object]) -> dict[str, object]:
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in fields.items()}
