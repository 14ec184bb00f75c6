"""Everything that lies in a participant's folder, read once: the plan and the journals."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from json import JSONDecodeError
from typing import TYPE_CHECKING

from study.session.journal import read_journal
from study.session.opening import PLAN_FILE
from study.session.plan import require_plan
from study.session.replay import list_journals

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from study.session.chain import Chain, Record
    from study.session.plan import Plan


@dataclass(frozen=True, slots=True)
class Dossier:
    """A participant's plan and journals.

    Parameters
    ----------
    folder : Path
        Where they lie.
    plan : Plan
        The plan.
    chains : tuple of Chain
        What each journal holds, oldest first; none before the session was begun.
    """

    folder: Path
    plan: Plan
    chains: tuple[Chain, ...]

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of the newest journal."""
        return self.chains[-1].records if self.chains else ()


def read_dossier(folder: Path) -> Dossier:
    """Read what lies in a participant's folder, also while a session runs.

    Parameters
    ----------
    folder : Path
        The folder.

    Returns
    -------
    Dossier
        Plan and journals.

    Raises
    ------
    OSError
        If the plan is missing.
    ValueError
        If the plan or a journal is broken, or the plan was copied here.
    """
    plan = require_own_plan(folder)
    return Dossier(folder, plan, tuple(read_journal(path) for path in list_journals(folder)))


def require_own_plan(folder: Path) -> Plan:
    """Read a participant's plan.

    Parameters
    ----------
    folder : Path
        The participant's folder.

    Returns
    -------
    Plan
        The plan.

    Raises
    ------
    OSError
        If it is missing.
    ValueError
        If it is broken or lies elsewhere than it was stored.
    """
    with read_as_written(folder / PLAN_FILE):
        plan = require_plan(folder / PLAN_FILE)
    if plan.participant != folder.name:
        raise ValueError(f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here; move it away")
    return plan


@contextmanager
def read_as_written(path: Path) -> Iterator[None]:
    """Say in words that a file whose digests are right holds what feel321 does not write.

    Parameters
    ----------
    path : Path
        The file, or the folder that holds it.

    Yields
    ------
    None
        Nothing.

    Raises
    ------
    ValueError
        In place of what goes wrong where a field is missing or of another kind.
    """
    try:
        yield
    except (AttributeError, KeyError, TypeError, JSONDecodeError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(
            f"{path}: holds what feel321 does not write ({reason}); restore the file from a copy"
        ) from None
