"""One page of a study's sessions while they run, blind: progress and faults, no ratings and no names of conditions.

Journals are only read, and only those that changed since the last look. Nothing written in free words is shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any

from feel321.analysis.page import render_template
from feel321.files import is_held, write_text
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.minutes import find_durations, find_left, observe_pace
from feel321.study.people import LOCK_FILE
from feel321.study.session import events
from feel321.study.session.plan import TOMBSTONE_FILE
from feel321.study.status import find_flags, judge_catches, list_accepted, read_participant

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock, Record
    from feel321.study.session.plan import Dossier

EVERY_S = 5.0
"""How often the page is renewed, and how often a browser reads it again."""

STATES = (
    "experimenter called", "unreadable", "running", "aborted", "claimed", "finished", "released", "withdrawn",
)  # fmt: skip
"""States, those first that somebody should look at."""

LIVE = {"experimenter called", "running", "aborted"}

OWN_PAGE = '<meta name="generator" content="feel321 status --watch">'
"""Tells a page of this module from other files."""


def watch_study(
    study: StudyFolder, page: Path, *, now: Clock, announce: Callable[[object], None]
) -> None:
    """Write the page and renew it until Ctrl-C, each time whole; its last version says that it ended."""
    if page.exists() and OWN_PAGE not in page.read_text(encoding="utf-8", errors="replace"):
        raise FileExistsError(
            f"{page}: exists and is no page of status --watch, so it is not overwritten; choose another name"
        )
    watch = Watch(study, now)
    write_text(page, watch.write_page(), private=True)
    announce(page)
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(EVERY_S)
            write_text(page, watch.write_page(), private=True)
    write_text(page, watch.write_page(is_over=True), private=True)


@dataclass(slots=True)
class Watch:
    """Looks at the sessions of a study; known: what was found of each participant, and of which journals."""

    study: StudyFolder
    now: Clock
    known: dict[str, tuple[object, dict[str, Any], Dossier | None]] = field(default_factory=dict)

    def write_page(self, *, is_over: bool = False) -> str:
        """Write the page as of now."""
        self.known = {folder.name: self._read(folder) for folder in self.study.participants}
        rows = [self._add_times(row, dossier) for _, row, dossier in self.known.values()]
        return render_template(
            "watch.html",
            study=self.study.path.resolve().name,
            is_rehearsal=self.study.is_rehearsal,
            now=self.now().astimezone(),
            every_s=None if is_over else EVERY_S,
            rows=sorted(rows, key=lambda row: STATES.index(row["state"])),
        )

    def _read(self, folder: Path) -> tuple[object, dict[str, Any], Dossier | None]:
        """Look at a participant, unless journals, lock and tombstone are as they were."""
        stamp = is_held(folder / LOCK_FILE), (folder / TOMBSTONE_FILE).exists()
        known = self.known.get(folder.name)
        with suppress(OSError, ValueError):
            if known and known[0] == stamp and known[2] is self.study.read_person(folder):
                return known
        entry, own = read_participant(self.study, folder)
        dossier = own[0] if own else None
        row = {
            "participant": entry.participant, "state": entry.state or "unreadable", "simulated": entry.simulated,
            "answered": entry.answered, "given_up": entry.given_up,
            "total": entry.answered + entry.given_up + entry.left,
        }  # fmt: skip
        return stamp, row | (_describe(dossier) if dossier and dossier.chains else {}), dossier

    def _add_times(self, row: dict[str, Any], dossier: Dossier | None) -> dict[str, Any]:
        """Add the minutes that a session under way has left, and since its last record."""
        if dossier is None or row["state"] not in LIVE:
            return row
        last = datetime.fromisoformat(dossier.records[-1].utc)
        times = {"quiet_min": max(0.0, (self.now() - last).total_seconds() / 60)}
        with suppress(OSError, ValueError):  # there may be no stimulus set
            durations = find_durations(read_stimuli(self.study.stimuli))
            pace = observe_pace([one for *_, one in self.known.values() if one], durations)
            left_s = find_left(dossier.plan, dossier.records, durations=durations, pace=pace)
            times["left_min"] = max(left_s.values()) / 60
        return row | times


def _describe(dossier: Dossier) -> dict[str, Any]:
    """Count what went wrong in a session, without looking at any rating; catch trials have known answers."""
    plan, records = dossier.plan, dossier.records
    played = list(records.find(events.PartPlayed))
    caught = judge_catches(plan, list_accepted(dossier))
    # The experimenter was called, and the page of that call still stands.
    calls = [one.event for one in records if _is_call(one)]
    return {
        "underruns": sum(one.underruns for one in played),
        "errors": sum(bool(one.error) for one in played),
        "lost": sum(bool(events.find_loss(one.delivered, plan.flow)) for one in played),
        "catches": f"{sum(caught)} of {len(caught)}",
        "flags": list(find_flags(dossier.chains[-1])),
        **({"state": STATES[0]} if calls[-1:] == [events.DeviceFailed.event] else {}),
    }


def _is_call(record: Record) -> bool:
    is_page = record.event == events.PageRead.event and record.data.get("key") == "call_us"
    return is_page or record.event == events.DeviceFailed.event
