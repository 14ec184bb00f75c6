"""Begin or resume a session: the lock, the stored plan, the header, and rules for a long absence."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib.metadata import version
from json import JSONDecodeError
from platform import platform, python_version
from typing import TYPE_CHECKING, Any

from feel321.study.session.journal import create_journal, read_journal, require_journal
from feel321.study.session.plan import (
    compare_plans,
    create_plan,
    find_differences,
    find_elapsed,
    find_header,
    has_event,
    list_journals,
    name_journal,
    require_plan,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.session.journal import Chain, Clock, Journal, Record
    from feel321.study.session.plan import Plan

# Beginning and resuming a session: the lock, the stored plan, the header, and what a long absence means.

PLAN_FILE = "plan.json"
TOMBSTONE_FILE = "withdrawn.json"

FORMAT = 1
"""Form of the journal; its header says which one it has."""

UNCOMPARED = ("format", "session", "versions", "system", "clock")
"""What may differ between a header and a later opening: other versions may go on with a session."""

OPENING_EVENTS = ("clock_stepped", "device", "recovered", "resumed")
"""What an opening records before anybody has come back to work."""

UNTOUCHED = (*OPENING_EVENTS, "begun", "aborted", "superseded")
"""What stands in a journal in which nobody has done anything yet."""

OF_PLAN = ("participant", "plan_sha256", "stimuli_sha256", "seed")
"""What a header has of the plan."""


@dataclass(frozen=True, slots=True)
class Stale:
    """When a session was left for long, and what becomes of it.

    Parameters
    ----------
    after_h : float or None
        Hours without a record; None for never.
    policy : str
        One of `POLICIES`.
    """

    after_h: float | None = 6.0
    policy: str = "warm_up"


@contextmanager
def open_session(
    folder: Path, plan: Plan, *, identity: Mapping[str, Any], now: Clock, stale: Stale
) -> Iterator[tuple[Plan, Journal]]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    Parameters
    ----------
    folder : Path
        The participant's folder; created if missing.
    plan : Plan
        The plan that today's settings give; stored if none is yet.
    identity : mapping
        What must not change within the session besides the plan, as JSON can hold it: locale, rig, calibration,
        and the kind of presenter.
    now : callable
        Gives the time of day, with its zone.
    stale : Stale
        What becomes of a session that was left for long.

    Yields
    ------
    plan : Plan
        The plan as it is stored; its trials are those to present.
    journal : Journal
        With a header and all that was done before.

    Raises
    ------
    ValueError
        If the session was begun with another plan, stimulus set or presenter, saying what differs (another presenter
        may take over where nobody has done anything yet, in a journal of its own); or the participant was released or
        withdrawn.
    BlockingIOError
        If the session is running elsewhere.
    """
    from feel321.files import hold_lock

    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(
        folder / ".lock", busy="another session is writing here; let it finish or stop it first"
    ):
        if (folder / TOMBSTONE_FILE).exists():
            raise ValueError(f"{folder}: {folder.name} was withdrawn; take another code")
        stored = _settle_plan(folder / PLAN_FILE, plan, is_begun=_is_begun(folder))
        header = _make_header(stored, identity)
        journal = _open_newest(folder, header, now=now, stale=stale)
        yield stored, journal


def _is_begun(folder: Path) -> bool:
    return any(find_header(read_journal(path).records) for path in list_journals(folder))


def _settle_plan(path: Path, plan: Plan, *, is_begun: bool) -> Plan:
    if not path.exists():
        create_plan(path, plan)
    stored = require_plan(path)
    remedy = (
        f"change it back, begin with another participant, or move {path.parent.parent.name}/ away"
    )
    if differences := compare_plans(stored, plan):
        raise ValueError(
            f"{path}: the study was changed since this plan was stored ({'; '.join(differences)}); {remedy}"
        )
    # A session that was begun keeps its trials, whatever a later version would make of the same inputs.
    if not is_begun and stored.trials != plan.trials:
        raise ValueError(
            f"{path}: holds other trials than the study gives; remove the file, or {remedy}"
        )
    return stored


def _make_header(plan: Plan, identity: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "participant": plan.participant,
        "plan_sha256": plan.sha256,
        "stimuli_sha256": plan.stimuli_sha256,
        "seed": plan.seed,
        **identity,
    }


def _open_newest(folder: Path, header: Mapping[str, Any], *, now: Clock, stale: Stale) -> Journal:
    journals = list_journals(folder)
    if not journals:
        return _begin(folder, header, session=1, now=now)
    journal = require_journal(journals[-1], now=now)
    if has_event(journal.records, "released"):
        raise ValueError(
            f"{journal.path}: {folder.name} was released, the place in the design is free; take another code"
        )
    begun = find_header(journal.records)
    if begun is None:
        _write_header(journal, header, session=len(journals))
        return journal
    if _may_begin_otherwise(journal, begun, header):
        return _supersede(journal, header, session=len(journals) + 1, now=now)
    _check_header(begun, header, path=journal.path)
    if has_event(journal.records, "finished"):
        return journal
    is_stale = _is_stale(journal, now=now, stale=stale)
    if has_event(journal.records, "superseded") or (is_stale and stale.policy == "restart"):
        return _supersede(journal, header, session=len(journals) + 1, now=now)
    journal.write("resumed", _describe_opening(journal))
    if is_stale and stale.policy == "warm_up":
        journal.write("warm_up", {})
    return journal


def _begin(folder: Path, header: Mapping[str, Any], *, session: int, now: Clock) -> Journal:
    journal = create_journal(folder / name_journal(session), now=now)
    _write_header(journal, header, session=session)
    return journal


def _supersede(journal: Journal, header: Mapping[str, Any], *, session: int, now: Clock) -> Journal:
    """Leave a session as it is and begin the next one; after a crash in between, the second step alone is due."""
    if not has_event(journal.records, "superseded"):
        journal.write("superseded", {"by": session})
    return _begin(journal.path.parent, header, session=session, now=now)


def _write_header(journal: Journal, header: Mapping[str, Any], *, session: int) -> None:
    journal.write(
        "begun", {"format": FORMAT, **header, "session": session, **_describe_opening(journal)}
    )


def _describe_opening(journal: Journal) -> dict[str, Any]:
    # The record's own time of day beside that of the presenter: the offset between both clocks.
    return {
        "versions": {
            "python": python_version(),
            **{name: version(name) for name in ("feel321", "numpy", "scipy")},
        },
        "system": platform(),
        "clock": {"presenter_s": find_elapsed(journal.records)},
    }


def _may_begin_otherwise(
    journal: Journal, begun: Mapping[str, Any], header: Mapping[str, Any]
) -> bool:
    """Say whether another rig, say, is no harm: nobody has done anything yet, and the plan is the same."""
    is_untouched = all(record.event in UNTOUCHED for record in journal.records)
    has_same_plan = all(begun.get(name) == header[name] for name in OF_PLAN)
    return (
        is_untouched and has_same_plan and bool(find_differences(begun, header, ignore=UNCOMPARED))
    )


def _check_header(begun: Mapping[str, Any], header: Mapping[str, Any], *, path: Path) -> None:
    if differences := find_differences(begun, header, ignore=UNCOMPARED):
        raise ValueError(
            f"{path}: the session was begun otherwise ({'; '.join(differences)}); "
            f"change that back, begin with another participant, or move {path.parent.parent.name}/ away"
        )


def _is_stale(journal: Journal, *, now: Clock, stale: Stale) -> bool:
    if stale.after_h is None:
        return False
    # An opening that was itself broken off leaves fresh records of an old session.
    last = next(
        record for record in reversed(journal.records) if record.event not in OPENING_EVENTS
    )
    return now() - datetime.fromisoformat(last.utc) > timedelta(hours=stale.after_h)


# Everything that lies in a participant's folder, read once: the plan and the journals.


@dataclass(frozen=True, slots=True)
class Dossier:
    """A participant's plan and journals."""

    folder: Path
    plan: Plan
    chains: tuple[Chain, ...]

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of the newest journal."""
        return self.chains[-1].records if self.chains else ()


def read_dossier(folder: Path) -> Dossier:
    """Read what lies in a participant's folder, also while a session runs."""
    plan = require_own_plan(folder)
    return Dossier(folder, plan, tuple(read_journal(path) for path in list_journals(folder)))


def require_own_plan(folder: Path) -> Plan:
    """Read a participant's plan."""
    with read_as_written(folder / PLAN_FILE):
        plan = require_plan(folder / PLAN_FILE)
    if plan.participant != folder.name:
        raise ValueError(
            f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here; move it away"
        )
    return plan


@contextmanager
def read_as_written(path: Path) -> Iterator[None]:
    """Say in words that a file whose digests are right holds what feel321 does not write."""
    try:
        yield
    except (AttributeError, KeyError, TypeError, JSONDecodeError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(
            f"{path}: holds what feel321 does not write ({reason}); restore the file from a copy"
        ) from None
