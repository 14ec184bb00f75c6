"""What columns the two tables may have, in which unit, and which of them must be there.

Conventions: names are matched exactly. A column that is spelt almost like one of these is refused, because it would
otherwise be passed over; any other column is not used, and is named in the report's notes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from stimuli.manifest import COLUMN_UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of every rating scale."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    meaning : str
        What a cell holds.
    unit : str
        Its unit; empty for names and numbers that only tell things apart.
    needed : bool
        Whether there is no analysis without it.
    used : bool
        Whether the analysis reads it.
    """

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

_MATCHED = {name: Column(unit) for name, unit in COLUMN_UNITS.items()}
MANIFEST: Mapping[str, Column] = {
    **{name: replace(column, used=False) for name, column in _MATCHED.items()},
    **{name: replace(_MATCHED[name], needed=True) for name in ("stimulus_id", "recording", "reducer")},
    **{name: _MATCHED[name] for name in ("level", "role")},
    "source": Column("what the recording was made from, where several are one and the same, turned, cut or edited"),
}
"""One row per stimulus; every metric of `stimuli.match.METRICS` is a column too."""


def list_needed(schema: Mapping[str, Column]) -> list[str]:
    """List the columns without which there is no analysis.

    Parameters
    ----------
    schema : Mapping of str to Column
        A table's columns.

    Returns
    -------
    list of str
        Names.

    Examples
    --------
    >>> list_needed(RATINGS)
    ['participant', 'stimulus_id', 'scale', 'rating']
    """
    return [name for name, column in schema.items() if column.needed]
