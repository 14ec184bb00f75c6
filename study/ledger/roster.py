"""`participants.csv`: one row per participant, derived from plans and journals and from nothing else."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

from study.files import write_text
from study.ledger.standing import read_standings

if TYPE_CHECKING:
    from pathlib import Path

    from study.folder import StudyFolder
    from study.ledger.standing import Standing

ROSTER_FILE = "participants.csv"

COLUMNS = ("participant", "number", "simulated", "state", "sessions", "done", "total")
"""The table's first columns; one per factor in which participants differ follows."""

LAST_COLUMNS = ("first_utc", "last_utc", "training_passed")

_TRUTH = {True: "true", False: "false", None: ""}


def write_roster(study: StudyFolder) -> Path:
    """Write who takes part, in which group, and how far they have come; those who withdrew are not there.

    Parameters
    ----------
    study : StudyFolder
        The study; the table is replaced in one step.

    Returns
    -------
    Path
        The table.

    Raises
    ------
    OSError
        If a plan is missing.
    ValueError
        If a plan or journal is broken.
    """
    standings = read_standings(study)
    for standing in standings:
        if standing.problem:
            raise ValueError(standing.problem)
    factors = dict.fromkeys(factor for standing in standings for factor in standing.groups)
    rows = [_make_row(standing) for standing in standings]
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, [*COLUMNS, *factors, *LAST_COLUMNS])
    table.writeheader()
    table.writerows(rows)
    path = study.path / ROSTER_FILE
    write_text(path, text.getvalue())
    return path


def _make_row(standing: Standing) -> dict[str, Any]:
    return {
        **standing.groups,
        "participant": standing.participant,
        "number": standing.number,
        "simulated": _TRUTH[standing.simulated],
        "state": standing.state,
        "sessions": len(standing.anchors),
        "done": standing.done,
        "total": standing.total,
        "first_utc": standing.first_utc,
        "last_utc": standing.last_utc,
        "training_passed": _TRUTH[standing.training_passed],
    }
