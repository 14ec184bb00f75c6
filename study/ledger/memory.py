"""What the ledger forgot: a log beside it, in which every rebuild that lost anything leaves a line for good.

The log is a chain like a journal's. Without it, a journal could be cut and the ledger made to agree.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from study.session.journal import create_journal, read_journal, require_journal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from study.folder import StudyFolder
    from study.session.journal import Clock

WAS_MISSING = "all that it had seen, for it was missing"


def tell_time() -> datetime:
    """Tell the time of day.

    Returns
    -------
    datetime
        In UTC.
    """
    return datetime.now(UTC)


def note_forgotten(study: StudyFolder, lines: Sequence[str], *, now: Clock) -> None:
    """Note what the ledger forgets with a rebuild; if that is nothing, nothing is noted.

    Parameters
    ----------
    study : StudyFolder
        The study.
    lines : sequence of str
        What is forgotten, one line each.
    now : callable
        Gives the time of day, with its zone.

    Raises
    ------
    ValueError
        If the log is damaged.
    OSError
        If it cannot be written.
    """
    if not lines:
        return
    # The folder may be moved, its log with it.
    forgot = [line.replace(f"{study.path}/", "") for line in lines]
    begin = require_journal if study.ledger_log.exists() else create_journal
    begin(study.ledger_log, now=now).write("rebuilt", {"forgot": forgot})


def list_forgotten(study: StudyFolder) -> list[str]:
    """List what the ledger ever forgot with a rebuild.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    list of str
        One line each; one that says so if the log is damaged.
    """
    if not study.ledger_log.exists():
        return []
    try:
        records = read_journal(study.ledger_log).records
    except (OSError, ValueError) as error:
        return [str(error)]
    return [
        f"{study.ledger}: was rebuilt at {record.utc}, and forgot: {line}"
        for record in records
        for line in record.data.get("forgot", ())
    ]
