"""What columns the two tables may have, in which unit, and which of them must be there.

Conventions: names are matched exactly. A column that is spelt almost like one of these is refused, because it would
otherwise be passed over; any other column is not used, and is named in the report's notes. What depends on the
lists of `stimuli` is made by a call, so that importing this loads nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MATCH = "how well a stimulus matches its recording"
MATCHES = {"spectral_match": "eq. 1 of Landin et al. 2010, which has no lower bound"}
"""What some metrics are, in words."""

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of every rating scale."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    meaning: str
    unit: str = ""
    needed: bool = False
    used: bool = True


RATINGS: Mapping[str, Column] = {
    "participant": Column("who judged", needed=True),
    "session": Column("which visit of the participant"),
    "protocol": Column("which task"),
    "block": Column("which block of the session"),
    "trial": Column("which trial of the block; with the stimulus, it occurs once"),
    "repeat": Column("how many times the participant has judged it, counted from 1"),
    "stimulus_id": Column("what was judged", needed=True),
    "recording": Column("as in the manifest"),
    "reducer": Column("as in the manifest"),
    "level": Column("as in the manifest"),
    "reference_id": Column("what it was judged against: a stimulus, 'surface', or nothing"),
    "scale": Column("what was asked, such as realism", needed=True),
    "rating": Column("the answer", unit="points from 0 to 100", needed=True),
    "response_time_s": Column("from the end of playback to the answer", unit="s"),
    "onset_s": Column("start of playback, from the start of the session", unit="s", used=False),
    "underruns": Column("interruptions of playback", unit="count"),
    "rejected": Column("whether the judgement does not count", unit="true or false"),
    "simulated": Column("whether the participant is a program", unit="true or false"),
}
"""One row per judgement."""

STAND_INS = {"spectral_match_bounded": "spectral_match"}
"""What is used for a planned metric that a manifest does not have."""

FURTHER: Mapping[str, Column] = {
    "rotation_mean": Column(
        "mean of the {metric} over random orientations of the sensor", unit="1 = perfect match"
    ),
    "rotation_sd": Column(
        "standard deviation of the {metric} over random orientations of the sensor", unit="1"
    ),
    "delivered": Column("{metric} of the signal as it was delivered", unit="1 = perfect match"),
    "energy_weighted": Column(
        "{metric} with frequencies weighted by their energy", unit="1 = perfect match"
    ),
    "invariant": Column(
        "counterpart of the {metric} that no orientation changes", unit="1 = perfect match"
    ),
}
"""What may follow the name of a metric and an underscore: per stimulus in the manifest, or per judgement in the
ratings, where a stimulus has the mean over its judgements. `spectral_match_invariant` is the former name of
`spectral_match_energy_weighted`; tables that use it are read as before."""

_ONLY_OF = {
    "energy_weighted": ("spectral_match",),
    "invariant": ("spectral_match", "temporal_match"),
}


def describe_further() -> dict[str, Column]:
    """List the columns of metrics that an analysis explores, beside those that it was planned for.

    Examples
    --------
    >>> list(describe_further())[:3]
    ['spectral_match_rotation_mean', 'spectral_match_rotation_sd', 'spectral_match_delivered']
    """
    from feel321.stimuli.match import METRICS

    return {
        f"{metric}_{kind}": replace(
            column, meaning=column.meaning.format(metric=metric.replace("_", " "))
        )
        for metric in METRICS
        for kind, column in FURTHER.items()
        if metric in _ONLY_OF.get(kind, METRICS)
    }


def describe_explored(metrics: Sequence[str]) -> dict[str, Column]:
    """List the columns of metrics that an analysis of other metrics explores.

    Examples
    --------
    >>> list(describe_explored(["spectral_match_bounded", "temporal_match"]))[:2]
    ['spectral_match', 'spectral_match_rotation_mean']
    """
    from feel321.stimuli.match import METRICS

    others = {name: Column(MATCHES.get(name, MATCH), unit="1 = perfect match") for name in METRICS}
    return {
        name: column
        for name, column in {**others, **describe_further()}.items()
        if name not in metrics
    }


def describe_ratings() -> dict[str, Column]:
    """List the columns that a table of ratings may have."""
    return {**RATINGS, **describe_further()}


def describe_manifest(metrics: Sequence[str] = ()) -> dict[str, Column]:
    """List the columns that a manifest may have: one row per stimulus."""
    from feel321.stimuli.match import METRICS
    from feel321.stimuli.sets.manifest import COLUMN_UNITS

    needed = ("stimulus_id", "recording", "reducer")
    used = ("level", "role", "rms_m_s2", "gain", "sensation_level_db", *METRICS)
    source = "what the recording was made from, where several are one and the same, turned, cut or edited"
    return {
        **{
            name: Column(unit, needed=name in needed, used=name in (*needed, *used))
            for name, unit in COLUMN_UNITS.items()
        },
        **{name: Column(MATCH) for name in METRICS},
        "source": Column(source),
        **describe_further(),
        **{
            name: Column("a metric that the study declares")
            for name in metrics
            if name not in needed
        },
    }


def list_needed(schema: Mapping[str, Column]) -> list[str]:
    """List the columns without which there is no analysis.

    Examples
    --------
    >>> list_needed(RATINGS)
    ['participant', 'stimulus_id', 'scale', 'rating']
    """
    return [name for name, column in schema.items() if column.needed]
