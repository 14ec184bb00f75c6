"""The vocabulary of a journal: one type per kind of record, its fields in their order on the disk.

The name of an event stands here and nowhere else. A new event is a class here, and a line where it happens.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, dataclass_transform

from pydantic_core import to_json

from feel321.files import word_fault
from feel321.protocols.trial import DEVICE_FLAGS, FLAGS, LOST, MATCHING, SPOILED, VALID

if TYPE_CHECKING:
    from pydantic import TypeAdapter

    from feel321.protocols.trial import Flow, Trial

E = TypeVar("E", bound="SessionEvent")

EVENTS: dict[str, type[SessionEvent]] = {}


@dataclass_transform(frozen_default=True)
@dataclass(frozen=True)
class SessionEvent:
    """Something that happened in a session; a subclass gives its name."""

    event: ClassVar[str] = ""
    # Fields that a record leaves out where they are empty.
    optional: ClassVar[frozenset[str]] = frozenset()

    def __init_subclass__(cls, event: str = "") -> None:  # noqa: D105 - every subclass is a record
        dataclass(frozen=True)(cls)
        if event:
            cls.event = event
            EVENTS[event] = cls

    def to_data(self) -> dict[str, Any]:
        """Return the fields as a record holds them; those of `identity` stand among the others."""
        data: dict[str, Any] = {}
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value or entry.name not in self.optional:
                data |= value if entry.name == "identity" else {entry.name: value}
        return data


class SessionBegun(SessionEvent, event="begun"):
    """The header; identity: what must not change within the session besides the plan."""

    format: int
    participant: str
    plan_sha256: str
    stimuli_sha256: str
    seed: int
    identity: dict[str, Any]
    session: int
    versions: dict[str, str]
    system: str
    clock: dict[str, float]

    def __post_init__(self) -> None:
        """Refuse what would be no presenter, rig or certificate to whoever reads it."""
        entry: Any = self.identity
        for name in ("presenter", "rig", "sensor"):
            entry = {} if entry.get(name) is None else entry[name]
            is_object = isinstance(entry, dict)
            if not is_object:
                raise ValueError(f"{name} must be an object, got {entry!r}")
            if name == "presenter" and entry.get("simulated", False) not in {True, False}:
                raise ValueError(f"presenter.simulated must be true or false, got {entry!r}")
        own = self.identity.get("calibration")
        is_named = isinstance(own.get("id") if isinstance(own, dict) else own, str)
        if own not in (None, {}) and not is_named:
            raise ValueError(f"calibration must have a text as its id, got {own!r}")


class SessionResumed(SessionEvent, event="resumed"):
    """The session is opened again."""

    versions: dict[str, str]
    system: str
    clock: dict[str, float]


class RigAccepted(SessionEvent, event="rig_accepted"):
    """The session goes on with another rig or certificate than it was begun with; changes: old -> new, by setting."""

    rig: dict[str, Any] | None
    calibration: dict[str, Any] | str | None
    changes: list[str]


class DeviceOpened(SessionEvent, event="device"):
    """The actuators are ready; identity: the device as it describes itself."""

    identity: dict[str, Any]


class ClockStepped(SessionEvent, event="clock_stepped"):
    """The time of day was set back since the record before."""

    back_s: float


class LineRecovered(SessionEvent, event="recovered"):
    """The end of a line that was never finished was moved into another file."""

    torn_bytes: int
    moved_to: str


class WarmUpBegun(SessionEvent, event="warm_up"):
    """The participant was away for long; the practice of the current task comes again."""


class PageRead(SessionEvent, event="page"):
    """A page was shown and left again."""

    key: str
    time_s: float
    stood_s: float


class QuestionAnswered(SessionEvent, event="answered"):
    """A question page was answered, or left open (None); sha256: salted digest of a value that is kept apart."""

    question: str
    occasion: int
    value: float | str | None
    personal: bool
    time_s: float
    stood_s: float
    sha256: str = ""
    optional = frozenset({"sha256"})


class SessionFinished(SessionEvent, event="finished"):
    """All trials are done."""

    trials: int
    given_up: int


class SessionAborted(SessionEvent, event="aborted"):
    """The session ended before its end; it can be resumed."""

    reason: str
    time_s: float


class DeviceFailed(SessionEvent, event="device_failed"):
    """The device lost several trials in a row; the experimenter is called."""

    reason: str
    time_s: float


class SessionSuperseded(SessionEvent, event="superseded"):
    """Another session takes the place of this one."""

    by: int


class SessionReleased(SessionEvent, event="released"):
    """The participant will not come back."""


NOTE_LETTERS = 1000  # longest note, in characters


class NoteTaken(SessionEvent, event="note"):
    """The experimenter's own words about the session; no trial, and nothing follows from them."""

    text: str

    def __post_init__(self) -> None:
        """Refuse what no terminal or table shows as it was written."""
        text = self.text
        if not text.strip() or len(text) > NOTE_LETTERS:
            raise ValueError(f"a note must have 1 to {NOTE_LETTERS} characters, got {len(text)}")
        if odd := next((letter for letter in text if not letter.isprintable()), ""):
            raise ValueError(
                f"a note must be one line without control characters, got {odd!a} at character "
                f"{text.index(odd) + 1}; take several notes instead of several lines"
            )


class AttemptEvent(SessionEvent):
    """Something that happened in an attempt at a trial; attempts are numbered from 1."""

    trial: int
    attempt: int


class TrialShown(AttemptEvent, event="shown"):
    """The trial is before the participant, all markers unset."""


class TrialScheduled(AttemptEvent, event="scheduled"):
    """The trial has a fixed onset; due_s: when its first part was to begin. What it began late shows its onset."""

    due_s: float


class TonePresented(AttemptEvent, event="tone"):
    """A trial of the threshold block: the interval (1 or 2) that vibrates, and its level, dB re 1 m/s² RMS, if any."""

    frequency_hz: float
    interval: int
    level_db: float | None


@dataclass(frozen=True)
class Played:
    """How a part was felt: what the device reports, the engine passes on and the journal keeps."""

    requested_s: float
    onset_s: float | None  # None where it never began
    underruns: int = 0  # times that the device ran dry within the samples
    clipped: int = 0  # samples that were limited
    completed: bool = True
    error: str = ""  # the device's message
    measured: Mapping[str, float] = field(default_factory=dict)
    dac_source: str = ""  # `device` where the onset is the device's own, `latency` where estimated
    delivered: Mapping[str, float] = field(default_factory=dict)  # what the hand got
    delivered_sha256: str = ""
    fault: str = ""  # what is wrong with the rig (`actuator.faults`)
    notice: str = ""  # likewise, where the hand got what was asked

    def __post_init__(self) -> None:
        """Take numbers of the many kinds that devices report, and none of those that are none."""
        put, onset_s = object.__setattr__, self.onset_s  # an audit reads tens of thousands
        onset_s = None if onset_s is None or not isfinite(onset_s) else float(onset_s)
        put(self, "requested_s", float(self.requested_s))
        put(self, "onset_s", onset_s)
        put(self, "underruns", int(self.underruns))
        put(self, "clipped", int(self.clipped))
        put(self, "completed", bool(self.completed))
        for name in ("measured", "delivered"):
            if numbers := getattr(self, name):
                known = {key: float(one) for key, one in numbers.items() if isfinite(one)}
                put(self, name, known)


class PartEvent(AttemptEvent):
    """Something that happened to a part of a trial."""

    part: str


SPARSE = ("measured", "dac_source", "delivered", "delivered_sha256", "fault", "notice")


class PartPlayed(Played, PartEvent, event="played"):
    """A stimulus was played."""

    optional = frozenset(SPARSE)


class SurfaceStroked(PartPlayed, event="prompted"):
    """The participant was asked to stroke the real surface."""


class PartReplayed(PartEvent, event="replayed"):
    """The participant wants to feel a part again; all parts where it is empty."""

    time_s: float


class MarkerMoved(PartEvent, event="moved"):
    """A marker came to rest."""

    value: float
    time_s: float


class ActRefused(AttemptEvent, event="refused"):
    """An act was not accepted."""

    reason: str
    parts: list[str]
    time_s: float


class TrialPaused(AttemptEvent, event="paused"):
    """The participant pauses; the attempt begins anew afterwards."""

    time_s: float


class TrialContinued(AttemptEvent, event="continued"):
    """The pause is over."""

    time_s: float


class TrialRated(AttemptEvent, event="rated"):
    """The answer was given: points, or the part that was chosen, by the part that is judged."""

    values: dict[str, float | str]
    response_time_s: float
    time_s: float
    flags: list[str]
    rejected: bool


class TrialSpoiled(AttemptEvent, event="spoiled"):
    """The attempt ended without an answer."""

    flags: list[str]
    time_s: float


REPAIRS = (ClockStepped, LineRecovered)  # may come anywhere in a journal
OPENING = (*REPAIRS, NoteTaken, DeviceOpened, RigAccepted, SessionResumed)  # before anybody is back
UNTOUCHED = (*OPENING, SessionBegun, SessionAborted, SessionSuperseded)  # nobody has done anything

UNCALIBRATED = "uncalibrated"  # in a header, in place of the identity of a valid certificate


def find_kind(name: str) -> type[SessionEvent]:
    """Find the type of an event."""
    if name not in EVENTS:
        raise ValueError(f"holds {name!r}, which no session writes")
    return EVENTS[name]


@cache
def make_adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """Make what checks that JSON holds a record of a type."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def read_event(name: str, data: Mapping[str, Any]) -> SessionEvent:
    """Read the data of a record; fields of later versions are left out."""
    kind: Any = find_kind(name)
    if "identity" in kind.__match_args__:
        own = {k: v for k, v in data.items() if k not in kind.__match_args__}
        data = {**data, "identity": own}
    try:
        # By JSON's own strictness: a list may fill a tuple and 1 a float, "1" or true may not.
        event: SessionEvent = make_adapter(kind).validate_json(to_json(data), strict=True)
    except (TypeError, ValueError) as error:
        reason = word_fault(error, is_blind=True) if isinstance(error, ValueError) else error
        raise ValueError(f"is not a {name!r} record as feel321 writes it ({reason})") from None
    return event


# What became of an attempt, and why: one model for the engine, the participant's page, status and analysis.

TIMED_OUT = "timed_out"  # flag of an attempt that was not answered in time, and key of a page

UNANSWERABLE = frozenset({"device_error", "not_delivered", "not_felt"})
"""Flags with which an attempt is over: the device failed, or what is felt only once was cut short."""


def judge(event: TrialRated | TrialSpoiled, flow: Flow) -> str:
    """Judge how an attempt ended: `VALID`, `LOST` by the device, or `SPOILED` by the participant."""
    if isinstance(event, TrialRated) and not event.rejected:
        return VALID
    causes = {*flow.reject, *UNANSWERABLE, TIMED_OUT}.intersection(event.flags)
    return SPOILED if causes.isdisjoint(DEVICE_FLAGS) else LOST


def find_faults(played: Played, flow: Flow) -> dict[str, str]:
    """Find what the device did wrong in a playback: flag -> words for the experimenter."""
    if not (played.error or played.fault or played.underruns or played.clipped or played.delivered):
        return {}
    loss = find_loss(played.delivered, flow)
    faults = {
        "device_error": played.error,
        "not_delivered": played.fault or "; ".join(filter(None, [loss, loss and played.notice])),
        "underrun": played.underruns
        and f"the device ran dry ({played.underruns} underruns): close other programs, switch off power saving, or "
        "raise latency_s in rig.toml (pause_s under [calibration] must be more than twice as long)",
        "clipped": played.clipped
        and f"{played.clipped} samples were limited: lower the level, or raise the limit in rig.toml",
    }
    return {flag: str(words) for flag, words in faults.items() if words}


def find_notices(parts: Iterable[Played]) -> dict[str, list[str]]:
    """Group what playbacks say of the rig, though it spoiled none of them, by the words without their figures."""
    found: dict[str, list[str]] = {}
    for notice in filter(None, (part.notice for part in parts)):
        found.setdefault(re.sub(r"[-+]?\d[\d.]*", "", notice), []).append(notice)
    return found


@dataclass(slots=True)
class Attempt:
    """One attempt at a trial: the parts as they were felt last, and what was wrong with them."""

    trial: Trial
    number: int
    parts: dict[str, PartPlayed] = field(default_factory=dict)

    def follow(self, event: AttemptEvent) -> None:
        """Take an event: what was felt to its end stays felt, unless a marker changes how strong it is."""
        match event:
            case PartPlayed():
                before = self.parts.get(event.part)
                if before is None or not before.completed or event.completed or event.error:
                    self.parts[event.part] = event
            case MarkerMoved() if self.trial.protocol == MATCHING:
                self.parts.pop(event.part, None)

    def list_unfelt(self) -> list[str]:
        """List the parts that were not felt to their end."""
        felt = {part.part for part in self.parts.values() if part.completed and not part.error}
        return [part.name for part in self.trial.parts if part.name not in felt]

    def list_flags(self, flow: Flow, *, response_time_s: float | None = None) -> list[str]:
        """List what was wrong with the attempt, with its answer or without."""
        found = {flag for part in self.parts.values() for flag in find_faults(part, flow)}
        if response_time_s is None:
            found |= {"not_felt"} if self.trial.timing == "strict" and self.list_unfelt() else set()
        elif response_time_s < flow.min_response_s:
            found.add("too_fast")
        return [flag for flag in FLAGS if flag in found]

    def describe_faults(self, flow: Flow) -> str:
        """Describe for the experimenter by what the device lost the attempt."""
        causes = {*flow.reject, *UNANSWERABLE}
        found = [find_faults(part, flow).items() for part in self.parts.values()]
        return "; ".join(dict.fromkeys(w for one in found for flag, w in one if flag in causes))


def find_loss(delivered: Mapping[str, float], flow: Flow) -> str:
    """Say why a playback did not reach the sensor as asked; empty if it did, or if nothing measured it."""
    if "coherence" not in delivered:
        return ""
    coherence, error_db = delivered["coherence"], delivered["level_error_db"]
    limit_db = flow.level_error_db if delivered["is_calibrated"] else None
    if not delivered["rms_m_s2"]:
        return (
            "the sensor is silent, without even noise: check its cable, its power and its channel"
        )
    if coherence < flow.min_coherence:
        return (
            f"the sensor shows no trace of the stimulus (coherence {coherence:.2f}, at least {flow.min_coherence:g}): "
            "check that amplifier, coil and sensor are on, and on the channels and the device that rig.toml names"
        )
    if limit_db is not None and abs(error_db) > limit_db:
        return (
            f"the stimulus was {abs(error_db):.1f} dB too {'weak' if error_db < 0 else 'strong'} (at most {limit_db} "
            "dB): check the amplifier's gain, the coil and how the sensor is mounted, or calibrate again"
        )
    # Gains that were typed say nothing of the polarity.
    is_inverted = delivered["is_measured"] and delivered["polarity"] < 0
    inverted = "the motion is inverted: the wires of a coil or of the sensor were swapped since the calibration"
    return inverted if is_inverted else ""
