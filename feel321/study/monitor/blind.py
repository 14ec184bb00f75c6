"""What an experimenter may see of sessions while they run: progress and faults, no ratings and no conditions.

Files are only ever read, and only those that changed since the last look.
"""

from __future__ import annotations

import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, TypeVar

from feel321.analysis.words import format_name
from feel321.files import is_held
from feel321.protocols.trial import Trial
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.minutes import Pace, find_durations, find_left, observe_pace
from feel321.study.people import LOCK_FILE
from feel321.study.session import events
from feel321.study.session.plan import read_as_written, replay
from feel321.study.settings.read import list_items, read_settings
from feel321.study.status import find_catches, find_flags, read_participant

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock, Records
    from feel321.study.session.plan import Dossier
    from feel321.study.settings.schema import Settings
    from feel321.study.status import ParticipantStatus

LIVE = frozenset({"running", "aborted"})
"""States of sessions that were begun and are not over."""

HIDDEN = "[hidden]"
"""Stands for the name of a condition where a message or a note holds one."""

_PLACE = re.compile(r"([\w.-]+\.jsonl?)(?:, line (\d+))?")

_PARTS = re.compile(r"[^\W\d_]+|\d+")
"""Letters, or digits."""

T = TypeVar("T")

PHASES = {"main": "trials"}


@dataclass(slots=True)
class _Seen:
    """A participant's folder as it was last read, and the stamps of its files then."""

    stamp: object
    entry: ParticipantStatus
    dossier: Dossier | None
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class StudyWatch:
    """Watches the sessions of one study."""

    study: StudyFolder
    now: Clock
    _seen: dict[str, _Seen] = field(default_factory=dict)
    _stimuli: tuple[object, StimulusSet | None] = (None, None)
    _settings: tuple[object, Settings | None] = (None, None)
    _pace: tuple[object, Pace] = (None, Pace())

    def look(self) -> dict[str, Any]:
        """Read how every participant is doing, as JSON can hold it."""
        self._stimuli = _renew(
            self._stimuli, self.study.manifest, lambda _: read_stimuli(self.study.stimuli)
        )
        self._settings = _renew(self._settings, self.study.settings, read_settings)
        (_, stimuli), (_, settings) = self._stimuli, self._settings
        folders = self.study.participants
        seen = [self._look_at(folder) for folder in folders]
        self._seen = {folder.name: one for folder, one in zip(folders, seen, strict=True)}
        durations = find_durations(stimuli) if stimuli else {}
        pace = self._find_pace(seen, durations)
        shown = [self._describe(one, pace, durations=durations) for one in seen]
        counts = Counter(entry["state"] for entry in shown)
        names = list_names(stimuli, settings) if stimuli else None
        folder = self.study.path.resolve().name
        return {
            "name": settings.study.name if settings else folder,
            "folder": folder,
            "rehearsals": self.study.is_rehearsal,
            "counts": dict(counts),
            "hidden_whole": names is None and bool(shown),
            "participants": hide_names(shown, names),
        }

    def _look_at(self, folder: Path) -> _Seen:
        files = [path for path in sorted(folder.glob("*.json*")) if path.is_file()]
        stamp = (_stamp(files), is_held(folder / LOCK_FILE))
        known = self._seen.get(folder.name)
        if known is not None and known.stamp == stamp:
            return known
        entry, dossier = read_participant(folder)
        details: dict[str, Any] = {}
        try:
            if dossier is not None and dossier.chains:
                with read_as_written(dossier.newest):
                    details = _describe_session(dossier)
        except (OSError, ValueError) as error:
            entry, dossier = replace(entry, problem=str(error)), None
        return _Seen(stamp, entry, dossier, details)

    def _find_pace(self, seen: Sequence[_Seen], durations: Mapping[str, float]) -> Pace:
        """Find the pace of those who are done; it changes only when somebody else is."""
        over = [one for one in seen if one.entry.state not in LIVE and one.dossier is not None]
        stamp = [one.stamp for one in over]
        if stamp != self._pace[0]:
            dossiers = [one.dossier for one in over if one.dossier is not None]
            self._pace = stamp, observe_pace(dossiers, durations)
        return self._pace[1]

    def _describe(
        self, seen: _Seen, pace: Pace, *, durations: Mapping[str, float]
    ) -> dict[str, Any]:
        entry = seen.entry
        shown: dict[str, Any] = {
            "participant": entry.participant,
            "state": entry.state or "unreadable",
            "simulated": entry.simulated,
            "done": entry.done,
            "total": entry.done + entry.left,
            "left_min": None,
            "quiet_s": None,
            "problem": describe_damage(entry.problem),
            "notes": [{"utc": note.utc, "text": note.text} for note in entry.notes],
            **seen.details,
        }
        if seen.dossier is not None and entry.state in LIVE:
            if durations:
                left = find_left(
                    seen.dossier.plan, seen.dossier.records, durations=durations, pace=pace
                )
                shown["left_min"] = round(max(left.values()) / 60.0, 1)
            last = datetime.fromisoformat(seen.dossier.records[-1].utc)
            shown["quiet_s"] = max(0, round((self.now() - last).total_seconds()))
        return shown


def _stamp(files: Sequence[Path]) -> tuple[object, ...]:
    """Describe files well enough to notice any change."""
    stamps: list[object] = []
    for path in files:
        with suppress(OSError):
            found = path.stat()
            stamps.append((path.name, found.st_size, found.st_mtime_ns))
    return tuple(stamps)


def _renew(
    known: tuple[object, T | None], path: Path, read: Callable[[Path], T]
) -> tuple[object, T | None]:
    """Read a file again if it has changed; None if it cannot be read."""
    stamp = _stamp([path])
    if stamp == known[0]:
        return known
    try:
        return stamp, read(path)
    except (OSError, ValueError):
        return stamp, None


def describe_damage(problem: str) -> str:
    """Name the file and the line that cannot be read, without what they hold.

    Examples
    --------
    >>> describe_damage("p01/session-01.jsonl, line 7: holds 'x', which no session writes")
    'session-01.jsonl, line 7, cannot be read; run feel321 audit'
    """
    if not problem:
        return ""
    found = _PLACE.search(problem)
    name, line = (found[1], found[2]) if found else ("a file of this participant", None)
    return f"{name}{f', line {line},' if line else ''} cannot be read; run feel321 audit"


def list_names(stimuli: StimulusSet, settings: Settings | None) -> list[str]:
    """List every name of a condition in a manifest and in the settings, the longest first."""
    names = {
        name
        for row in stimuli.stimuli
        for name in (row.stimulus_id, row.recording, row.reducer, row.level, row.file)
    }
    if settings is not None:
        names |= {entry.title for entry in settings.recordings}
        names |= {name for item in list_items(settings) for name in (item.reducer, item.level)}
    return sorted(names, key=lambda name: (-len(name), name))


def hide_names(people: list[dict[str, Any]], names: Sequence[str] | None) -> list[dict[str, Any]]:
    """Hide the names of conditions in everything that was written in free words, all of it where no name is known."""
    pattern = re.compile(".+", re.DOTALL) if names is None else _match_names(names)

    def hide(text: str) -> str:
        return pattern.sub(HIDDEN, text)

    return [
        {
            **person,
            **{key: hide(person[key]) for key in ("call", "ended") if key in person},
            "notes": [{**note, "text": hide(note["text"])} for note in person["notes"]],
        }
        for person in people
    ]


def _match_names(names: Sequence[str]) -> re.Pattern[str]:
    """Match names however their letters and digits are joined: dft321, DFT 321, dft-321."""
    parts = (_PARTS.findall(name) for name in names)
    listed = "|".join(r"[\W_]*".join(map(re.escape, one)) for one in parts if one)
    return re.compile(rf"(?<![^\W_])(?:{listed or '(?!)'})(?![^\W_])", re.IGNORECASE)


# One session.


def _describe_session(dossier: Dossier) -> dict[str, Any]:
    plan, records = dossier.plan, dossier.records
    played = list(records.find(events.PartPlayed))
    errors_db = [
        one.delivered["level_error_db"] for one in played if "level_error_db" in one.delivered
    ]
    caught = find_catches(plan, records)
    called = _find_call(records)
    step = "" if not records.find_header() else _describe_step(dossier)
    return {
        "step": "experimenter called" if called else step,
        "call": called,
        "ended": _find_end(records),
        "underruns": sum(one.underruns for one in played),
        "clipped": sum(one.clipped for one in played),
        "device_errors": sum(bool(one.error) for one in played),
        "not_delivered": sum(bool(events.find_loss(one.delivered, plan.flow)) for one in played),
        "playbacks": len(played),
        "level_error_db": max(errors_db, key=abs, default=None),
        "catch_right": sum(caught),
        "catch_trials": len(caught),
        "training": _describe_training(records),
        "flags": list(find_flags(dossier.chains[-1])),
    }


def _describe_step(dossier: Dossier) -> str:
    """Say what the participant is doing, in words that name no condition."""
    last = dossier.records[-1].event
    if last == events.TrialPaused.event:
        return "paused"
    step = replay(dossier.plan, dossier.records).ask()
    if isinstance(step, Trial):
        return f"{format_name(step.protocol)}, {PHASES.get(step.phase, step.phase)}"
    return "" if step is None else f"page: {step.key.replace('_', ' ').replace('.', ', ')}"


def _find_call(records: Records) -> str:
    """Find why the experimenter is called; empty once the page of the call was left."""
    for record in reversed(records):
        if record.event == events.PageRead.event and record.data.get("key") == "call_us":
            return ""
        if record.event == events.DeviceFailed.event:
            return str(record.data.get("reason", ""))
    return ""


def _find_end(records: Records) -> str:
    """Find why the session ended before its end; notes may have been taken since."""
    since = (record for record in reversed(records) if record.event != events.NoteTaken.event)
    last = next(since, None)
    if last is None or last.event != events.SessionAborted.event:
        return ""
    return str(last.data.get("reason", ""))


def _describe_training(records: Records) -> str:
    """Count the rounds of training by how they ended."""
    ends = {"training_passed": "passed", "training_again": "repeated", "training_failed": "failed"}
    counts = Counter(ends[page.key] for page in records.find(events.PageRead) if page.key in ends)
    return ", ".join(f"{count} {word}" for word, count in counts.items())
