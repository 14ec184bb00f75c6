"""Rigs and certificates that participants were on, by their journals, and who was on another than the rest."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from feel321.study.session.events import PartPlayed, RigAccepted
from feel321.study.session.journal import Records

LETTERS = 12
"""Of a rig's digest, where it is shown."""

DATA_SHEET = ("sensitivity_mv_per_g", "input_peak_v")
"""What gives the full scale of a sensor."""

ESTIMATED = "latency"
"""How an onset was got (`dac_source`) where the device gave no time of it: `actuator.stream.FROM_LATENCY`."""


@dataclass(frozen=True, slots=True)
class RigUse:
    """The rig of one session: first letters of its digest, the id of its certificate, or `uncalibrated`.

    changes: accepted in mid-session (`run --accept-rig`); estimated: onset times that the device did not give.
    """

    participant: str
    rig: str = ""
    calibration: str = ""
    changes: tuple[str, ...] = ()
    estimated: int = 0


def find_rig_use(participant: str, records: Records) -> RigUse:
    """Find on which rig a session was held, as it was left; simulated participants have none."""
    if (header := records.find_header()) is None:
        return RigUse(participant)
    rig = header.identity.get("presenter", {}).get("rig")
    calibration, changes = header.identity.get("calibration"), []
    for event in records.find(RigAccepted):
        rig, calibration = event.rig, event.calibration
        changes += event.changes
    sources = (event.dac_source for event in records.find(PartPlayed))
    return RigUse(
        participant,
        rig=digest_settings(json.dumps(rig, sort_keys=True))[:LETTERS] if rig else "",
        calibration=calibration["id"] if isinstance(calibration, dict) else calibration or "",
        changes=tuple(changes),
        estimated=sum(source == ESTIMATED for source in sources),
    )


@cache
def digest_settings(text: str) -> str:
    """Make the digest of a rig from its settings as a journal's header holds them, in JSON."""
    from feel321.study.actuator.rig import Rig, digest
    from feel321.study.session.journal import digest as digest_text

    entry = json.loads(text)
    sensor = entry.get("sensor") or {}
    # A sensor is given by its data sheet or by its full scale; a header holds both.
    sheet = {name: sensor.pop(name) for name in DATA_SHEET if name in sensor}
    try:
        rig = Rig.model_validate_json(json.dumps(entry))
        if rig.sensor and sheet:
            rig = rig.model_copy(update={"sensor": rig.sensor.model_copy(update=sheet)})
        return digest(rig)
    except (ValueError, OverflowError):  # of another version
        return digest_text(text)


def describe_rigs(uses: Iterable[RigUse]) -> Iterator[str]:
    """Describe who was on another rig or certificate than most, whose rig was changed, whose onsets are estimates."""
    used = [use for use in uses if use.rig]
    yield from _describe_odd({use.participant: use.rig for use in used}, "rig")
    usual = _find_usual([use.rig for use in used])
    own = {use.participant: use.calibration for use in used if use.rig == usual}
    yield from _describe_odd(own, "certificate")
    for use in used:
        if use.changes:
            yield f"{use.participant}: the rig was changed in mid-session ({'; '.join(use.changes)})"
    for use in used:
        if use.estimated:
            yield f"{use.participant}: {use.estimated} onset times are estimated from the latency: the device gave none"


def _describe_odd(values: Mapping[str, str], what: str) -> Iterator[str]:
    usual = _find_usual(list(values.values()))
    n_usual = sum(value == usual for value in values.values())
    for odd in sorted(set(values.values()) - {usual}):
        who = ", ".join(name for name, value in values.items() if value == odd)
        yield f"{who}: another {what} ({odd or 'none'}) than the other {n_usual} ({usual or 'none'})"


def _find_usual(values: Sequence[Any]) -> Any:  # noqa: ANN401 - whatever is counted
    """Find the value that most have; of several, the one that came first."""
    return max(Counter(values).items(), key=lambda item: item[1])[0] if values else None
