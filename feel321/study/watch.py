"""One page of a study's sessions while they run, blind: progress and faults, no ratings and no names of conditions.

Journals are only read, and only those that changed since the last look. Nothing written in free words is shown.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any

from feel321.analysis.page import render_template
from feel321.files import write_text
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.minutes import find_durations, observe_pace
from feel321.study.status import CALLED, CALLED_FOR, GOING_ON, add_minutes, read_participant

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock
    from feel321.study.status import Known

EVERY_S = 5.0
"""How often the page is renewed, and how often a browser reads it again."""

STATES = (CALLED, "", "running", "aborted", "claimed", "finished", "released", "withdrawn")
"""States, those first that somebody should look at; without one, files cannot be read."""

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
    """Looks at the sessions of a study; known: what was found, for as long as it is so."""

    study: StudyFolder
    now: Clock
    known: Known = field(default_factory=dict)

    def write_page(self, *, is_over: bool = False) -> str:
        """Write the page as of now."""
        study, now = self.study, self.now()
        entries = {one: read_participant(study, one, self.known) for one in study.participants}
        with suppress(OSError, ValueError):  # there may be no stimulus set
            durations = find_durations(read_stimuli(study.stimuli))
            pace = observe_pace([dossier for dossier, *_ in self.known.values()], durations)
            entries |= add_minutes(entries, self.known, durations=durations, pace=pace)
        rows: list[dict[str, Any]] = []
        for one in sorted(entries.values(), key=lambda one: STATES.index(one.state)):
            warnings = [text for text in one.warnings if not text.startswith(CALLED_FOR)]
            quiet_min = None
            if one.state in GOING_ON and one.last_activity:
                quiet = now - datetime.fromisoformat(one.last_activity)
                quiet_min = max(0.0, quiet.total_seconds() / 60)
            rows.append({"own": one, "warnings": warnings, "quiet_min": quiet_min})
        return render_template(
            "watch.html",
            study=study.path.resolve().name,
            is_rehearsal=study.is_rehearsal,
            now=now.astimezone(),
            every_s=None if is_over else EVERY_S,
            rows=rows,
        )
