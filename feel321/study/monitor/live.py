"""The live page: studies as they are now, as HTML for people and as JSON for programs."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC
from threading import Lock
from typing import TYPE_CHECKING, Any

from feel321.analysis.page import render_template
from feel321.study.monitor.blind import LIVE, StudyWatch
from feel321.study.monitor.server import serve_pages

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

STATES = ("running", "aborted", "unreadable", "claimed", "finished", "released", "withdrawn")
"""States, those first that somebody should look at."""

QUIET_S = 120.0
"""After so many seconds without a record the page says how long it is."""


@dataclass(slots=True)
class Monitor:
    """Watches studies, one look at a time."""

    watches: Sequence[StudyWatch]
    now: Clock
    _looking: Lock = field(default_factory=Lock)

    def look(self) -> dict[str, Any]:
        """Read all studies."""
        with self._looking:
            studies = [watch.look() for watch in self.watches]
        utc = self.now().astimezone(UTC).isoformat(timespec="seconds")
        return {"utc": utc, "studies": studies}

    def write_page(self, nonce: str, _query: Mapping[str, str]) -> tuple[str, str]:
        """Write the page."""
        state = self.look()
        for study in state["studies"]:
            study["participants"].sort(key=lambda one: STATES.index(one["state"]))
            study["live"] = [one for one in study["participants"] if one["state"] in LIVE]
        clock = self.now().astimezone().strftime("%H:%M:%S")
        page = render_template(
            "monitor.html", nonce=nonce, clock=clock, quiet_s=QUIET_S, studies=state["studies"]
        )
        return "text/html", page

    def write_state(self, _nonce: str, _query: Mapping[str, str]) -> tuple[str, str]:
        """Write what the page shows as JSON."""
        return "application/json", json.dumps(self.look(), ensure_ascii=False, indent=1)


def serve_monitor(
    studies: Sequence[StudyFolder],
    *,
    host: str,
    port: int,
    now: Clock,
    announce: Callable[[str], None],
) -> None:
    """Show studies on a live page until Ctrl-C."""
    monitor = Monitor([StudyWatch(study, now) for study in studies], now)
    pages = {"/": monitor.write_page, "/state.json": monitor.write_state}
    serve_pages(host, port, pages, announce=announce)
