"""Begin or resume a session: the lock, the stored plan, the header, and the rules for a long absence."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib.metadata import version
from platform import platform, python_version
from typing import TYPE_CHECKING, Any

from feel321.files import hold_lock
from feel321.study.session import events
from feel321.study.session.journal import (
    create_journal,
    find_elapsed,
    find_header,
    has_event,
    list_journals,
    name_journal,
    read_journal,
    require_journal,
)
from feel321.study.session.plan import compare_plans, create_plan, find_differences, require_plan

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.session.journal import Chain, Clock, Journal, Record
    from feel321.study.session.plan import Plan

PLAN_FILE = "plan.json"
TOMBSTONE_FILE = "withdrawn.json"

FORMAT = 1
"""Format of the journal; its header says which one it has."""

UNCOMPARED = ("format", "session", "versions", "system", "clock")
"""May differ between a header and a later opening: other versions may go on with a session."""


@dataclass(frozen=True, slots=True)
class Stale:
    """The rule for a session that was left for `after_h` hours (None for never): one of `POLICIES`."""

    after_h: float | None = 6.0
    policy: str = "warm_up"


@contextmanager
def open_session(
    folder: Path, plan: Plan, *, identity: Mapping[str, Any], now: Clock, stale: Stale
) -> Iterator[tuple[Plan, Journal]]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    plan: the plan that today's settings give; stored if none is yet. identity: what must not change within the session
    besides the plan, as JSON can hold it: locale, rig, calibration, and the kind of presenter. Yields the plan as it is
    stored, and the journal with a header and all that was done before.

    A session that was begun with another plan, stimulus set or presenter is refused with what differs; another
    presenter may take over where nobody has done anything yet, in a journal of its own.
    """
    folder.mkdir(parents=True, exist_ok=True)
    busy = "another session is writing here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy):
        if (folder / TOMBSTONE_FILE).exists():
            raise ValueError(f"{folder}: {folder.name} was withdrawn; take another code")
        is_begun = any(find_header(read_journal(path).records) for path in list_journals(folder))
        stored = _settle_plan(folder / PLAN_FILE, plan, is_begun=is_begun)
        yield stored, _open_newest(folder, stored, dict(identity), now=now, stale=stale)


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


def _open_newest(
    folder: Path, plan: Plan, identity: dict[str, Any], *, now: Clock, stale: Stale
) -> Journal:
    journals = list_journals(folder)
    if not journals:
        return _begin(create_journal(folder / name_journal(1), now=now), plan, identity)
    journal = require_journal(journals[-1], now=now)
    if has_event(journal.records, events.SessionReleased):
        raise ValueError(
            f"{journal.path}: {folder.name} was released, the place in the design is free; take another code"
        )
    begun = find_header(journal.records)
    if begun is None:
        return _begin(journal, plan, identity)
    header = _make_header(journal, plan, identity).to_data()
    if differences := find_differences(begun.to_data(), header, ignore=UNCOMPARED):
        if _is_untouched(journal, begun, plan):
            return _supersede(journal, plan, identity)
        raise ValueError(
            f"{journal.path}: the session was begun otherwise ({'; '.join(differences)}); "
            f"change that back, begin with another participant, or move {folder.parent.name}/ away"
        )
    return _resume(journal, plan, identity, now=now, stale=stale)


def _resume(
    journal: Journal, plan: Plan, identity: dict[str, Any], *, now: Clock, stale: Stale
) -> Journal:
    if has_event(journal.records, events.SessionFinished):
        return journal
    is_stale = _is_stale(journal, now=now, stale=stale)
    is_superseded = has_event(journal.records, events.SessionSuperseded)
    if is_superseded or (is_stale and stale.policy == "restart"):
        return _supersede(journal, plan, identity)
    journal.write(events.SessionResumed(*_describe_opening(journal)))
    if is_stale and stale.policy == "warm_up":
        journal.write(events.WarmUpBegun())
    return journal


def _make_header(journal: Journal, plan: Plan, identity: dict[str, Any]) -> events.SessionBegun:
    return events.SessionBegun(
        FORMAT,
        plan.participant,
        plan.sha256,
        plan.stimuli_sha256,
        plan.seed,
        identity,
        len(list_journals(journal.path.parent)),
        *_describe_opening(journal),
    )


def _describe_opening(journal: Journal) -> tuple[dict[str, str], str, dict[str, float]]:
    """Describe versions, system and clock: the presenter's beside the time of day, for the offset between both."""
    versions = {name: version(name) for name in ("feel321", "numpy", "scipy")}
    clock = {"presenter_s": find_elapsed(journal.records)}
    return {"python": python_version(), **versions}, platform(), clock


def _begin(journal: Journal, plan: Plan, identity: dict[str, Any]) -> Journal:
    journal.write(_make_header(journal, plan, identity))
    return journal


def _supersede(journal: Journal, plan: Plan, identity: dict[str, Any]) -> Journal:
    """Leave a session as it is and begin the next one; after a crash in between, the second step alone is due."""
    folder = journal.path.parent
    session = len(list_journals(folder)) + 1
    if not has_event(journal.records, events.SessionSuperseded):
        journal.write(events.SessionSuperseded(session))
    return _begin(create_journal(folder / name_journal(session), now=journal.now), plan, identity)


def _is_untouched(journal: Journal, begun: events.SessionBegun, plan: Plan) -> bool:
    """Check that another rig, say, does no harm: nobody has done anything yet, and the plan is the same."""
    untouched = {kind.event for kind in events.UNTOUCHED}
    same = (begun.participant, begun.plan_sha256, begun.stimuli_sha256, begun.seed) == (
        plan.participant,
        plan.sha256,
        plan.stimuli_sha256,
        plan.seed,
    )
    return same and all(record.event in untouched for record in journal.records)


def _is_stale(journal: Journal, *, now: Clock, stale: Stale) -> bool:
    if stale.after_h is None:
        return False
    # An opening that was itself broken off leaves fresh records of an old session.
    opening = {kind.event for kind in events.OPENING}
    last = next(record for record in reversed(journal.records) if record.event not in opening)
    return now() - datetime.fromisoformat(last.utc) > timedelta(hours=stale.after_h)


@dataclass(frozen=True, slots=True)
class Dossier:
    """A participant's folder, read once: the plan and the journals."""

    folder: Path
    plan: Plan
    chains: tuple[Chain, ...]

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of the newest journal."""
        return self.chains[-1].records if self.chains else ()

    @property
    def newest(self) -> Path:
        """The file of the newest journal; that of the plan before the first."""
        return [self.folder / PLAN_FILE, *list_journals(self.folder)][-1]


def read_dossier(folder: Path) -> Dossier:
    """Read a participant's folder, also while a session runs."""
    plan = require_own_plan(folder)
    return Dossier(folder, plan, tuple(read_journal(path) for path in list_journals(folder)))


def require_own_plan(folder: Path) -> Plan:
    """Read a participant's plan, and refuse one of another participant."""
    plan = require_plan(folder / PLAN_FILE)
    if plan.participant != folder.name:
        raise ValueError(
            f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here; move it away"
        )
    return plan


@contextmanager
def read_as_written(path: Path) -> Iterator[None]:
    """Name the file of a record that feel321 does not write, though its digests are right."""
    try:
        yield
    except ValueError as error:
        if not str(error).startswith("line "):
            raise
        raise ValueError(f"{path}, {error}; restore the file from a copy") from None
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(
            f"{path}: holds what feel321 does not write ({type(error).__name__}: {error}); restore the file from a copy"
        ) from None
