"""How a session is begun or resumed: what must not have changed since, and what happens after a long break."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from platform import platform, python_version
from typing import Any

from feel321.files import hold_lock
from feel321.study.session import events
from feel321.study.session import journal as journals
from feel321.study.session.journal import Clock, Journal
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE, Plan, Stale, require_plan

JOURNAL_FORMAT = 1  # in the header of a journal
FROZEN_FILE = "frozen.json"  # of a study's folder: what was decided before the ratings

# Of a header and a later opening: may not even differ where nobody has done anything yet; may differ, for other
# versions may go on with a session and choices be amended; may differ where somebody accepts it: a rig is repaired.
PLANNED = ("participant", "plan_sha256", "stimuli_sha256", "seed")
UNCOMPARED = ("format", "session", "versions", "system", "clock", "frozen")
ACCEPTABLE = ("presenter.rig", "calibration")


def identify_frozen(folder: Path) -> dict[str, str]:
    """Return the digest that the study's frozen file gives of itself, for the header of a session; none without one."""
    try:
        return {"frozen": str(json.loads((folder / FROZEN_FILE).read_bytes())["sha256"])}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


@contextmanager
def open_session(
    folder: Path,
    plan: Plan,
    *,
    identity: Mapping[str, Any],
    now: Clock,
    stale: Stale,
    accept_rig: bool = False,
) -> Iterator[tuple[Plan, Journal]]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    plan: the plan that today's settings give; the stored one must be the same. identity: what must not change within
    the session besides the plan: locale, rig, calibration, and the kind of presenter. Yields the plan as it is stored,
    and the journal with a header and all that was done before.

    A session that was begun with another plan, stimulus set or presenter is refused with what differs; another
    presenter may take over where nobody has done anything yet, in a journal of its own. With accept_rig, another rig or
    certificate is recorded and goes on with the session.
    """
    busy = "another session is writing here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy):
        if (folder / TOMBSTONE_FILE).exists():
            raise ValueError(f"{folder}: {folder.name} was withdrawn; take another code")
        stored, files = _require_same(folder, plan), journals.list_journals(folder)
        number = len(files) or 1
        if files:
            journal = journals.require_journal(files[-1], now=now)
        else:
            journal = journals.create_journal(folder / journals.name_journal(number), now=now)
        if journal.records.has(events.SessionReleased):
            raise ValueError(
                f"{journal.path}: {folder.name} was released, the place in the design is free; take another code"
            )
        header = _make_header(journal, stored, identity, session=number)
        if journal.records.find_header() is None:
            journal.write(header)
        elif not _go_on(journal, header, stale=stale, accept_rig=accept_rig):
            number += 1
            # After a crash in between, the second step alone is due.
            if not journal.records.has(events.SessionSuperseded):
                journal.write(events.SessionSuperseded(number))
            journal = journals.create_journal(folder / journals.name_journal(number), now=now)
            journal.write(_make_header(journal, stored, identity, session=number))
        yield stored, journal


def _require_same(folder: Path, plan: Plan) -> Plan:
    """Read a stored plan, and refuse it where the study has changed since."""
    path = folder / PLAN_FILE
    stored = require_plan(path)
    remedy = (
        f"change it back, begin with another participant, or move {path.parent.parent.name}/ away"
    )
    # By way of JSON, which knows lists only, so that what was stored and what was made anew look alike.
    inputs = (asdict(replace(entry, trials=())) for entry in (stored, plan))
    old, new = (json.loads(json.dumps(entry)) for entry in inputs)
    if differences := find_differences(old, new, ignore={"sha256"}):
        raise ValueError(
            f"{path}: the study was changed since this plan was stored ({'; '.join(differences)}); {remedy}"
        )
    # A session that was begun keeps its trials, whatever a later version would make of the same inputs.
    files = journals.list_journals(folder)
    is_begun = any(journals.read_journal(file).records.find_header() for file in files)
    if not is_begun and stored.trials != plan.trials:
        raise ValueError(
            f"{path}: holds other trials than the study gives; remove the file, or {remedy}"
        )
    return stored


def _make_header(
    journal: Journal, plan: Plan, identity: Mapping[str, Any], *, session: int
) -> events.SessionBegun:
    planned = (plan.participant, plan.sha256, plan.stimuli_sha256, plan.seed)
    versions = {name: version(name) for name in ("feel321", "numpy", "scipy")}
    # The presenter's clock stands beside the time of day, for the offset between both.
    opened = ({"python": python_version(), **versions}, platform())
    clock = {"presenter_s": journal.records.find_elapsed()}
    return events.SessionBegun(JOURNAL_FORMAT, *planned, dict(identity), session, *opened, clock)


def _go_on(
    journal: Journal, header: events.SessionBegun, *, stale: Stale, accept_rig: bool
) -> bool:
    """Go on with a session that was begun, or say that it is left for a new one; header: as it would begin today."""
    records, ended = journal.records, {kind.event for kind in events.OPENING}
    # An opening that was itself broken off leaves fresh records of an old session.
    last = next(record for record in reversed(records) if record.event not in ended)
    away = journal.now() - datetime.fromisoformat(last.utc)
    is_stale = stale.after_h is not None and away > timedelta(hours=stale.after_h)
    is_over = records.has(events.SessionFinished)
    is_left = records.has(events.SessionSuperseded) or (is_stale and stale.policy == "restart")
    if _is_taken_over(journal, header, accept_rig=accept_rig) or (is_left and not is_over):
        return False
    if not is_over:
        clock = {"presenter_s": records.find_elapsed()}
        journal.write(events.SessionResumed(header.versions, header.system, clock))
        if is_stale and stale.policy == "warm_up":
            journal.write(events.WarmUpBegun())
    return True


def _is_taken_over(journal: Journal, header: events.SessionBegun, *, accept_rig: bool) -> bool:
    """Compare headers: refuse what differs, record what is accepted; where nobody has done anything, all may differ."""
    begun, new = next(journal.records.find(events.SessionBegun)), header.to_data()
    old = begun.to_data()
    for event in journal.records.find(events.RigAccepted):
        presenter = old.get("presenter", {}) | {"rig": event.rig}
        old |= {"presenter": presenter, "calibration": event.calibration}
    if not (differences := find_differences(old, new, ignore=UNCOMPARED)):
        return False
    names = {line.partition(" ")[0] for line in differences}
    untouched = {kind.event for kind in events.UNTOUCHED}
    if names.isdisjoint(PLANNED) and {record.event for record in journal.records} <= untouched:
        return True
    is_rig = all(name.startswith(ACCEPTABLE) for name in names)
    if not (is_rig and accept_rig):
        texts = "other texts for participants"
        named = [texts if line.startswith("texts_sha256 ") else line for line in differences]
        former, own = begun.versions.get("feel321"), version("feel321")
        use = "" if former == own else f" or use feel321 {former}, which began it"
        accept = "go on with the rig as it is now (--accept-rig, which records it), "
        raise ValueError(
            f"{journal.path}: the session was begun otherwise ({'; '.join(named)}); change that back{use}, "
            f"{accept if is_rig else ''}begin with another participant, or move "
            f"{journal.path.parent.parent.name}/ away"
        )
    if not journal.records.has(events.SessionFinished):
        rig = new.get("presenter", {}).get("rig")
        journal.write(events.RigAccepted(rig, new.get("calibration"), differences))
    return False


def find_differences(
    old: Mapping[str, Any], new: Mapping[str, Any], *, ignore: Collection[str] = ()
) -> list[str]:
    """Find the values in which two nested mappings differ, named by their keys."""
    before, after = (
        dict(flatten({k: v for k, v in entry.items() if k not in ignore})) for entry in (old, new)
    )
    names = [name for name in before | after if before.get(name) != after.get(name)]
    return [f"{name} {before.get(name)!r} -> {after.get(name)!r}" for name in names]


def flatten(entry: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """List the values of nested mappings, named by their keys."""
    for key, value in entry.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
