"""What was declared before the ratings were seen, and which results it makes confirmatory.

A result is confirmatory if its hypothesis (a slope on one scale and level) was frozen before the first session of a
person, and metrics, model, stimuli and rules about the data are those of the frozen file. All else is exploratory,
which is no flaw: it means that the data may have suggested the question.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from feel321.analysis.words import CONFIRMATORY, EXPLORATORY, format_level, format_name

# What feel321 decides about the primary analysis, and no setting: it is frozen with the settings
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
# Quantities of a slope that are the declared test; the others are sensitivity analyses
TESTED = frozenset({"slope", "slope_quartile", "df"})
COMPUTED_WITH = ("numpy", "scipy", "pandas", "statsmodels", "scikit-learn", "matplotlib", "jinja2")


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A slope that was declared; higher: whether a larger value of the metric means a better match or a worse one."""

    scale: str
    level: str
    metric: str
    higher: str = "better"

    def __str__(self) -> str:
        """Write it in plain words."""
        way = "higher" if self.higher == "better" else "lower"
        ratings = f"{format_name(self.scale)} ratings{format_level(self.level)}"
        return (
            f"Among the stimuli of one recording, those with a higher {format_name(self.metric)} get {way} {ratings}, "
            "at equal values of the other metrics."
        )


@dataclass(frozen=True, slots=True)
class Standing:
    """What was declared before the ratings, and how the analysis compares with it.

    sentence: the state in one sentence, which opens the page. state: ``none``: nothing was frozen; ``before``: frozen
    before the first session; ``unsound``: the file cannot be trusted; ``elsewhere``: the ratings are not the study's.
    hypotheses: what was declared. reason: why no result is confirmatory; empty where the declared ones are. changes:
    every choice that differs from the frozen one, as "NAME: was ..., now ...". frozen_utc, sha256: when it was frozen,
    and the digest of ``frozen.json``; empty where nothing was.
    """

    sentence: str = "No hypotheses were frozen before the data, so all results are exploratory (feel321 freeze)."
    state: str = "none"
    hypotheses: tuple[Hypothesis, ...] = ()
    reason: str = "no hypotheses were frozen before the data"
    changes: tuple[str, ...] = ()
    frozen_utc: str = ""
    sha256: str = ""

    def judge(self, *place: str | None) -> tuple[str, str]:
        """Judge a slope by scale, level and metric: ``confirmatory`` or ``exploratory``, and why the latter."""
        if self.reason:
            return EXPLORATORY, self.reason
        if place not in {(one.scale, one.level, one.metric) for one in self.hypotheses}:
            return EXPLORATORY, "not among the frozen hypotheses"
        return CONFIRMATORY, ""

    def mark(self, table: str, row: Mapping[str, Any]) -> str:
        """Mark a row of a table of the frame as ``confirmatory`` or ``exploratory``."""
        if table != "slopes" or row["quantity"] not in TESTED:
            return EXPLORATORY
        return self.judge(row["scale"], row["level"], row["metric"])[0]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields, with hypotheses in words: what ``results.json`` holds."""
        told = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return told | {"hypotheses": [str(one) for one in self.hypotheses]}


@dataclass(frozen=True, slots=True)
class About:
    """What a report's first screen says of the study; date: day of the last rating; protocols: in the order shown."""

    name: str = ""
    date: str = ""
    protocols: tuple[str, ...] = ()
    standing: Standing = Standing()


def list_versions() -> dict[str, str]:
    """List the software that computed a report."""
    from feel321 import __version__

    libraries = {name: version(name) for name in COMPUTED_WITH}
    return {"feel321": __version__, "python": platform.python_version(), **libraries}
