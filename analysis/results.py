"""Every number of a report by name, with its uncertainty, method and n: what ``results.json`` holds."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from analysis.figures.scatter import count_clipped
from analysis.profile import GROUP
from analysis.scales import APART, note_apart
from analysis.verdict import LEADING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Mapping

    from analysis.association import Association, Difference
    from analysis.findings import Findings, Panel
    from analysis.table import Table

TWO_WAY = "95 % two-way bootstrap interval, over participants and recordings"
ONE_WAY = "95 % bootstrap interval over participants only: these stimuli as the only ones"
STUDENT = "95 % t interval over participants, for these recordings"
NONE = ""

MEAN = "mean over participants of each participant's mean"
COUNT = "count"


@dataclass(frozen=True, slots=True)
class Number:
    """A number and all that is needed to judge it.

    Parameters
    ----------
    name : str
        Dotted path, unique in a report.
    value : float
        The number; NaN where it is not defined.
    low, high : float
        Ends of the interval; NaN where there is none.
    uncertainty : str
        What kind of interval that is; empty where there is none.
    method : str
        How the value was computed.
    n : int
        How many stimuli, participants or judgements the value rests on.
    """

    name: str
    value: float
    low: float
    high: float
    uncertainty: str
    method: str
    n: int


@dataclass(frozen=True, slots=True)
class Results:
    """A report as data.

    Parameters
    ----------
    verdict : tuple of str
        The answer in words.
    numbers : tuple of Number
        Every number shown.
    figures : Mapping of str to str
        Caption of each figure, by file name without suffix.
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
    numbers: tuple[Number, ...]
    figures: Mapping[str, str]
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
            "verdict": self.verdict,
            "simulated": self.simulated,
            "numbers": [_without_nan(asdict(number)) for number in self.numbers],
            "figures": dict(self.figures),
            "notes": self.notes,
            "how": self.how,
            "files": self.files,
            "inputs": dict(self.inputs),
            "versions": dict(self.versions),
        }
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def collect_numbers(table: Table, findings: Findings) -> tuple[Number, ...]:
    """Name every number that a report may show.

    Parameters
    ----------
    table : Table
        What was analysed.
    findings : Findings
        What came out.

    Returns
    -------
    tuple of Number
        Sizes first, then per scale and level associations, differences and stimuli, then profiles.

    Raises
    ------
    ValueError
        If two numbers would bear the same name.
    """
    of_panels = chain.from_iterable(_collect_panel(panel) for panel in findings.panels)
    numbers = (*_count_table(table), *of_panels, *_collect_profile(findings))
    _refuse_doubles(number.name for number in numbers)
    return numbers


def collect_notes(table: Table, findings: Findings) -> tuple[str, ...]:
    """Gather what was left out, assumed or not defined.

    Parameters
    ----------
    table : Table
        What was analysed.
    findings : Findings
        What came out.

    Returns
    -------
    tuple of str
        Each sentence once, those on one scale led by its name.
    """
    rows = table.rows
    notes = [*table.notes, *note_apart(rows)]
    roles = rows.loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"].value_counts().sort_index()
    left_out = "judgements of stimuli with role"
    notes += [f"Associations leave out {count} {left_out} '{role}'." for role, count in roles.items()]
    for panel in findings.panels:
        lead = f"{panel.scale}, {panel.level}"
        found: tuple[Association | Difference, ...] = (*panel.associations, *panel.differences)
        notes += [f"{lead}: {note}" for result in found for note in result.notes]
    return tuple(dict.fromkeys(notes))


def name_path(*parts: str) -> str:
    """Join names to the dotted path of a number.

    Parameters
    ----------
    *parts : str
        Names, some of them chosen by users.

    Returns
    -------
    str
        The path; a dot in a name is written ``%2E``, so that no two lists of names give the same path.

    Examples
    --------
    >>> name_path("profile", "v1.0", "as_is")
    'profile.v1%2E0.as_is'
    """
    return ".".join(part.replace("%", "%25").replace(".", "%2E") for part in parts)


def _refuse_doubles(names: Iterable[str]) -> None:
    doubled = [name for name, times in Counter(names).items() if times > 1]
    if doubled:
        raise ValueError(f"results: got {len(doubled)} names twice, first {doubled[0]}; every number needs its own")


def _count_table(table: Table) -> Iterator[Number]:
    rows = table.rows
    for name in ("participant", "recording", "stimulus_id", "reducer", "scale"):
        yield _count(f"size.{name}", rows[name].nunique(), n=len(rows))
    yield _count("size.judgements", len(rows), n=len(rows))
    yield _count("size.simulated_judgements", int(rows["simulated"].sum()), n=len(rows))


def _collect_panel(panel: Panel) -> Iterator[Number]:
    place = panel.scale, panel.level
    for association in panel.associations:
        yield from _name_association(association, place)
        if association.method == LEADING:
            name, metric = name_path("scatter", *place, association.metric), panel.stimuli[association.metric]
            yield _count(f"{name}.n_below_edge", count_clipped(metric.to_numpy()), n=len(metric))
            lowest = f"smallest {association.metric} of the test stimuli"
            yield Number(f"{name}.lowest", float(metric.min()), math.nan, math.nan, NONE, lowest, len(metric))
    for difference in panel.differences:
        yield from _name_difference(difference, place)
    for row in panel.stimuli.to_dict("records"):
        yield _name_mean(name_path("stimulus", *place, row["stimulus_id"]), row)


def _name_association(result: Association, place: tuple[str, str]) -> Iterator[Number]:
    name = name_path("association", *place, result.metric, result.method)
    method = f"{result.method} correlation of mean ratings of test stimuli with {result.metric}"
    nan, n = math.nan, result.n_items
    yield Number(name, result.value, result.low, result.high, TWO_WAY, method, n)
    narrow = result.participants_low, result.participants_high
    yield Number(f"{name}.participants_only", result.value, *narrow, ONE_WAY, method, n)
    yield Number(f"{name}.ceiling", result.ceiling, nan, nan, NONE, "sqrt(ICC(C,k)), k participants", n)
    yield Number(f"{name}.disattenuated", result.disattenuated, nan, nan, NONE, "correlation / ceiling", n)
    yield from _count_data(name, result)


def _name_difference(result: Difference, place: tuple[str, str]) -> Iterator[Number]:
    name, nan, n = name_path("difference", *place, result.first, result.second, result.method), math.nan, result.n_items
    method = f"{result.method} correlation with {result.first} minus that with {result.second}"
    yield Number(name, result.value, result.low, result.high, TWO_WAY, method, n)
    scale = f"{TWO_WAY}, on Fisher's z"
    z_method = f"{method}, as a difference of Fisher's z"
    yield Number(f"{name}.z", result.z_value, result.z_low, result.z_high, scale, z_method, n)
    one, two = (f"{result.method} correlation with {metric}" for metric in (result.first, result.second))
    yield Number(f"{name}.first_value", result.first_value, nan, nan, NONE, one, n)
    yield Number(f"{name}.second_value", result.second_value, nan, nan, NONE, two, n)
    yield from _count_data(name, result)


def _count_data(name: str, result: Association | Difference) -> Iterator[Number]:
    yield _count(f"{name}.draws", result.draws, n=result.draws)
    for what in ("n_participants", "n_recordings", "n_items", "n_missing"):
        yield _count(f"{name}.{what}", getattr(result, what), n=result.n_items)


def _collect_profile(findings: Findings) -> Iterator[Number]:
    for row in findings.profile.to_dict("records"):
        name = name_path("profile", *(row[key] for key in GROUP))
        yield _name_mean(name, row)
        yield _count(f"{name}.n_participants", row["n_participants"], n=row["n_ratings"])
        yield _count(f"{name}.n_stimuli", row["n_stimuli"], n=row["n_ratings"])
        yield _count(f"{name}.n_ratings", row["n_ratings"], n=row["n_ratings"])


def _name_mean(name: str, row: Mapping[Hashable, Any]) -> Number:
    n = int(row["n_participants"])
    kind = STUDENT if math.isfinite(row["low"]) else NONE
    return Number(name, row["mean"], row["low"], row["high"], kind, f"rating, {MEAN}", n)


def _count(name: str, value: int, *, n: int) -> Number:
    return Number(name, int(value), math.nan, math.nan, NONE, COUNT, int(n))


def _without_nan(fields: dict[str, object]) -> dict[str, object]:
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in fields.items()}
