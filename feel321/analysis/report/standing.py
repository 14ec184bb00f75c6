"""What was declared before the ratings were seen, and which results it makes confirmatory.

A result is confirmatory if its hypothesis (a slope on one scale and level) was frozen before the first rating of a real
person, and metrics, model, stimuli and rules about the data are those of the frozen file. All else is exploratory,
which is no flaw: it means that the data may have suggested the question.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.words import CONFIRMATORY, EXPLORATORY

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.section import Section

STATUS, SLOPES, PAPER = "status", "slopes", "paper_claims"
"""Column that marks a row of a table, the table of the declared tests, and one that has verdicts of its own."""

MODEL: Mapping[str, Any] = {
    "model": (
        "rating ~ 1 + metrics within recordings + metrics between recordings + level within recordings where known + "
        "(1 + metrics within recordings || participant) + (1 + metrics within recordings || recording) + (1 | item) + "
        "(1 | participant:recording) + (1 | reducer) + (1 | participant:reducer), on means over equal repeats, else "
        "on ratings with (1 | participant:item); where recordings share sources, slopes by source, "
        "(1 | source:reducer); restricted maximum likelihood, Satterthwaite's degrees of freedom, at most 2 "
        "(recordings or sources - 1); with fewer than 8 reducers their spread is kept from 0"
    ),
    "alpha": 0.05,
    "correction": "Holm's method over all slopes within recordings of the report",
    "exclusions": (
        "practice, training, rejected trials, hidden references and anchors are left out; no participant is left out "
        "of the primary analysis, and results without those whom screening rules flag stand beside it"
    ),
    "not_estimable": "below 3 participants, 3 recordings (or sources of them), 3 reducers or 2 degrees of freedom",
}  # fmt: skip
"""What feel321 decides about the primary analysis, and no setting: it is frozen with the settings."""

TESTED = frozenset({"value", "quartile_effect", "df", "p_holm"})
"""Statistics of a slope that are the declared test; the others of its family are sensitivity analyses."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A slope that was declared; higher: whether a larger value of the metric means a better match or a worse one."""

    scale: str
    level: str
    metric: str
    higher: str = "better"

    @property
    def place(self) -> tuple[str, str, str]:
        """What it is about."""
        return self.scale, self.level, self.metric

    def __str__(self) -> str:
        """Write it in plain words."""
        ratings = words.format_ratings(
            words.format_name(self.scale) + words.format_level(self.level)
        )
        way = "higher" if self.higher == "better" else "lower"
        metric = words.format_name(self.metric)
        return (
            f"Among the stimuli of one recording, those with a higher {metric} get {way} {ratings}, at equal values of "
            "the other metrics."
        )


UNDECLARED = (
    "No hypotheses were frozen before the data, so all results are exploratory (feel321 freeze)."
)


@dataclass(frozen=True, slots=True)
class Standing:
    """What was declared before the ratings, and how the analysis compares with it.

    Parameters
    ----------
    sentence : str
        The state in one sentence, which opens the page.
    state : str
        ``none``: nothing was frozen; ``before``: frozen before the first rating; ``unsound``: the file cannot be
        trusted; ``elsewhere``: the ratings are not those of the study.
    hypotheses : tuple of Hypothesis
        What was declared.
    reason : str
        Why no result is confirmatory; empty where the declared ones are.
    changes : tuple of str
        Every choice that differs from the frozen one, as "NAME: was ..., now ...".
    frozen_utc, sha256 : str
        When it was frozen, and the digest of ``frozen.json``; empty where nothing was.

    Examples
    --------
    >>> from feel321.results import About
    >>> About("pilot").standing.state
    'none'
    """

    sentence: str = UNDECLARED
    state: str = "none"
    hypotheses: tuple[Hypothesis, ...] = ()
    reason: str = "no hypotheses were frozen before the data"
    changes: tuple[str, ...] = ()
    frozen_utc: str = ""
    sha256: str = ""

    def judge(self, *place: str | None) -> tuple[str, str]:
        """Judge a slope by scale, level and metric.

        Parameters
        ----------
        *place : str
            Scale, level and metric.

        Returns
        -------
        tuple of str
            ``confirmatory`` or ``exploratory``, and why the latter.
        """
        if self.reason:
            return EXPLORATORY, self.reason
        if place not in {one.place for one in self.hypotheses}:
            return EXPLORATORY, "not among the frozen hypotheses"
        return CONFIRMATORY, ""

    def describe_section(self, claims: Iterable[words.Claim]) -> str:
        """Say of a section how many of its verdicts are confirmatory.

        Parameters
        ----------
        claims : iterable of Claim
            Its verdicts on hypotheses; none where it tests no hypothesis.

        Returns
        -------
        str
            In a few words.
        """
        kinds = [one.status for one in claims]
        if (count := kinds.count(CONFIRMATORY)) == len(kinds) and kinds:
            return "Confirmatory: every slope here was declared before the data."
        return f"{count} of {len(kinds)} slopes are confirmatory." if count else "Exploratory."

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds.

        Returns
        -------
        dict
            The fields, with hypotheses in words.
        """
        named = ("sentence", "state", "reason", "frozen_utc", "sha256")
        return {
            **{name: getattr(self, name) for name in named},
            "changes": list(self.changes), "hypotheses": [str(one) for one in self.hypotheses],
        }  # fmt: skip


def mark_section(section: Section, standing: Standing) -> Section:
    """Mark the verdicts and the tables of a section."""
    claims = []
    for one in section.claims:
        status, reason = standing.judge(one.scale, one.level, one.metric)
        claims.append(replace(one, status=status, reason=reason))
    tables = {name: _mark_rows(name, rows, standing) for name, rows in section.tables.items()}
    return replace(section, claims=claims, tables=tables)


def _mark_rows(name: str, rows: DataFrame, standing: Standing) -> DataFrame:
    """Add a column that says of each row whether it was declared; only slopes can have been."""
    if rows.empty or STATUS in rows or name == PAPER:
        return rows
    declared = (
        set()
        if standing.reason
        else {(f"{one.scale}, {one.level}", one.metric) for one in standing.hypotheses}
    )
    if name != SLOPES or not declared:
        return rows.assign(**{STATUS: EXPLORATORY})
    places = zip(rows["attribute"], rows["metric"], strict=True)
    return rows.assign(**{
        STATUS: [CONFIRMATORY if one in declared else EXPLORATORY for one in places]
    })


def mark_number(number: words.Number, standing: Standing) -> words.Number:
    """Mark a number as confirmatory if it is one of a declared test."""
    keys = dict(number.keys)
    place = tuple(keys.get(name) for name in words.TIDY)
    is_test = number.name.startswith("slope.") and number.statistic in TESTED
    status = standing.judge(*place)[0] if is_test and None not in place else EXPLORATORY
    return replace(number, status=status) if status == CONFIRMATORY else number


COMPUTED_WITH = ("numpy", "scipy", "pandas", "statsmodels", "scikit-learn", "matplotlib", "jinja2")


def list_versions() -> dict[str, str]:
    """List the software that computed a report."""
    from feel321 import __version__

    libraries = {name: version(name) for name in COMPUTED_WITH}
    return {"feel321": __version__, "python": platform.python_version(), **libraries}
