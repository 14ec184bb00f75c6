"""The vocabulary of a journal: one type per kind of record, its fields in their order on the disk.

The name of an event stands here and nowhere else. A new event is a class here, and a line where it happens.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, dataclass_transform

from feel321.protocols.trial import DEVICE_FLAGS, FLAGS, LOST, MATCHING, SPOILED, VALID

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from feel321.protocols.trial import Flow, Trial

E = TypeVar("E", bound="SessionEvent")


EVENTS: dict[str, type[SessionEvent]] = {}
"""Name -> type of every event."""


@dataclass_transform(frozen_default=True)
@dataclass(frozen=True)
class SessionEvent:
    """Something that happened in a session; a subclass gives its name."""

    event: ClassVar[str] = ""

    def __init_subclass__(cls, event: str = "") -> None:
        """Make a record of every subclass, and register those with a name."""
        dataclass(frozen=True)(cls)
        if event:
            cls.event = event
            EVENTS[event] = cls

    def to_data(self) -> dict[str, Any]:
        """Return the fields as a record holds them; those of `identity` stand among the others."""
        data: dict[str, Any] = {}
        for entry in fields(self):
            value = getattr(self, entry.name)
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
        presenter = _check_object(self.identity, "presenter")
        if presenter.get("simulated", False) not in {True, False}:
            raise ValueError(f"presenter.simulated must be true or false, got {presenter!r}")
        _check_object(_check_object(presenter, "rig"), "sensor")
        if not isinstance(self.identity.get("calibration"), str):
            certificate = _check_object(self.identity, "calibration")
            if certificate and not isinstance(certificate.get("id"), str):
                raise ValueError(f"calibration must have a text as its id, got {certificate!r}")


def _check_object(entry: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return what stands under a name, which must be an object, or not there."""
    value = entry.get(name)
    if value is None or isinstance(value, dict):
        return value or {}
    raise ValueError(f"{name} must be an object, got {value!r}")


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
    """A question page was answered; value: None where it was left open, occasion: from 1, where it is asked again.

    personal: whether the value is personal data. sha256: salted digest of a value that is kept apart, in place of it.
    """

    question: str
    occasion: int
    value: float | str | None
    personal: bool
    time_s: float
    stood_s: float
    sha256: str = ""

    def to_data(self) -> dict[str, Any]:
        """Return the fields; without the digest where the value itself is there."""
        return {k: v for k, v in super().to_data().items() if v or k != "sha256"}


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


NOTE_LETTERS = 1000
"""Longest note, in characters."""


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
    """A trial of the threshold block: the interval (1 or 2) that vibrates, and its level in dB re 1 m/s² RMS.

    level_db: None in a catch trial, in which neither interval vibrates.
    """

    frequency_hz: float
    interval: int
    level_db: float | None


@dataclass(frozen=True)
class Played:
    """How a part was felt: what the device reports, the engine passes on and the journal keeps.

    onset_s: None where it never began. underruns, clipped: times that the device ran dry within the samples, samples
    that were limited. completed: it was felt to its end. error: the device's message, empty if all went well. measured:
    by the device, such as its own time of the onset. dac_source: `device` where that time is its own, `latency` where
    it is the time of the request and the latency. delivered: what the hand got, compared with what was asked
    (`actuator.delivered`); with `coherence` if a sensor measured it, without if a certificate predicts it. fault: what
    is wrong with the rig by this playback, with the coil named (`actuator.faults`). notice: the same where the hand got
    what was asked all the same.
    """

    requested_s: float
    onset_s: float | None
    underruns: int = 0
    clipped: int = 0
    completed: bool = True
    error: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)
    dac_source: str = ""
    delivered: Mapping[str, float] = field(default_factory=dict)
    delivered_sha256: str = ""
    fault: str = ""
    notice: str = ""

    def __post_init__(self) -> None:
        """Take numbers of the many kinds that devices report, and none of those that are none."""
        onset_s = self.onset_s
        whole = {
            "requested_s": float(self.requested_s),
            "onset_s": float(onset_s) if onset_s is not None and isfinite(onset_s) else None,
            "underruns": int(self.underruns),
            "clipped": int(self.clipped),
            "completed": bool(self.completed),
            "measured": {k: float(v) for k, v in self.measured.items() if isfinite(v)},
            "delivered": {k: float(v) for k, v in self.delivered.items() if isfinite(v)},
        }
        for name, value in whole.items():
            object.__setattr__(self, name, value)


class PartEvent(AttemptEvent):
    """Something that happened to a part of a trial."""

    part: str


class PartPlayed(Played, PartEvent, event="played"):
    """A stimulus was played; see `Playback`."""

    def to_data(self) -> dict[str, Any]:
        """Return the fields; what only some devices give is left out where it is empty."""
        optional = {"measured", "dac_source", "delivered", "delivered_sha256", "fault", "notice"}
        return {k: v for k, v in super().to_data().items() if v or k not in optional}


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


REPAIRS = (ClockStepped, LineRecovered)
"""May come anywhere in a journal."""

OPENING = (*REPAIRS, NoteTaken, DeviceOpened, RigAccepted, SessionResumed)
"""May come before anybody has come back to work."""

UNTOUCHED = (*OPENING, SessionBegun, SessionAborted, SessionSuperseded)
"""May come in a journal in which nobody has done anything yet."""


UNCALIBRATED = "uncalibrated"
"""In a header, in place of the identity of a certificate, where the rig has no valid one."""


def find_kind(name: str) -> type[SessionEvent]:
    """Find the type of an event."""
    if not isinstance(name, str) or name not in EVENTS:
        raise ValueError(f"holds {name!r}, which no session writes")
    return EVENTS[name]


def read_event(name: str, data: Mapping[str, Any]) -> SessionEvent:
    """Read the data of a record; fields of later versions are left out."""
    try:
        event: SessionEvent = _make_reader(find_kind(name).event)(data)
    except (TypeError, ValueError) as error:
        reason = describe_fault(error)
        raise ValueError(f"is not a {name!r} record as feel321 writes it ({reason})") from None
    return event


def describe_fault(error: Exception) -> str:
    """Describe why an entry was refused: the first fault of pydantic's list, or the error itself."""
    listed: Any = getattr(error, "errors", list)()
    faults = [f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in listed]
    return [*faults, str(error)][0]


@cache
def _make_reader(name: str) -> Callable[[Mapping[str, Any]], Any]:
    from pydantic import TypeAdapter
    from pydantic_core import to_json

    kind = EVENTS[name]
    known = [entry.name for entry in fields(kind)]
    validate = TypeAdapter(kind).validate_json

    def read(data: Mapping[str, Any]) -> Any:  # noqa: ANN401 - an event of that kind
        if "identity" in known:
            data = {**data, "identity": {k: v for k, v in data.items() if k not in known}}
        # JSON's own strictness: a list may fill a tuple and 1 a float, "1" or true may not.
        return validate(to_json(data), strict=True)

    return read


# What became of an attempt, and why: one model for the engine, the participant's page, status and analysis.


TIMED_OUT = "timed_out"
"""Flag of an attempt that was not answered in time, and key of the page that says so."""

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
    loss = find_loss(played.delivered, flow)
    faults = {
        "device_error": played.error,
        "not_delivered": played.fault or "; ".join(filter(None, [loss, loss and played.notice])),
        "underrun": f"the device ran dry ({played.underruns} underruns): close other programs, switch off power "
        "saving, or raise latency_s in rig.toml (pause_s under [calibration] must be more than twice as long)"
        if played.underruns
        else "",
        "clipped": f"{played.clipped} samples were limited: lower the level, or raise the limit in rig.toml"
        if played.clipped
        else "",
    }
    return {flag: words for flag, words in faults.items() if words}


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

    @property
    def key(self) -> tuple[int, int]:
        """Numbers of trial and attempt."""
        return self.trial.number, self.number

    def follow(self, event: AttemptEvent) -> None:
        """Take an event; a marker that changes how strong a part is makes that part unfelt.

        What was felt to its end stays felt, though it be cut short when it is felt again.
        """
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

    def list_flags(self, *, response_time_s: float | None = None, flow: Flow) -> list[str]:
        """List what was wrong with the attempt, with its answer or without."""
        found = {flag for part in self.parts.values() for flag in find_faults(part, flow)}
        is_open = response_time_s is None
        if response_time_s is not None and response_time_s < flow.min_response_s:
            found.add("too_fast")
        if is_open and self.trial.timing == "strict" and self.list_unfelt():
            found.add("not_felt")
        return [flag for flag in FLAGS if flag in found]

    def describe_faults(self, flow: Flow) -> str:
        """Describe for the experimenter by what the device lost the attempt."""
        causes = {*flow.reject, *UNANSWERABLE}
        found = [find_faults(part, flow).items() for part in self.parts.values()]
        words = [words for faults in found for flag, words in faults if flag in causes]
        return "; ".join(dict.fromkeys(words))


def find_loss(delivered: Mapping[str, float], flow: Flow) -> str:
    """Say why a playback did not reach the sensor as asked; empty if it did, or if nothing measured it."""
    if "coherence" not in delivered:
        return ""
    coherence, error_db = delivered["coherence"], delivered["level_error_db"]
    limit_db = flow.level_error_db if delivered["is_calibrated"] else None
    sign = "weak" if error_db < 0 else "strong"
    faults = {
        "the sensor is silent, without even noise: check its cable, its power and its channel": (
            not delivered["rms_m_s2"]
        ),
        f"the sensor shows no trace of the stimulus (coherence {coherence:.2f}, at least {flow.min_coherence:g}): "
        "check that amplifier, coil and sensor are on, and on the channels and the device that rig.toml names": (
            coherence < flow.min_coherence
        ),
        f"the stimulus was {abs(error_db):.1f} dB too {sign} (at most {limit_db} dB): check the amplifier's gain, the "
        "coil and how the sensor is mounted, or calibrate again": (
            limit_db is not None and abs(error_db) > limit_db
        ),
        "the motion is inverted: the wires of a coil or of the sensor were swapped since the calibration": (
            # gains that were typed say nothing of it
            bool(delivered["is_measured"]) and delivered["polarity"] < 0
        ),
    }
    return next((fault for fault, is_so in faults.items() if is_so), "")
