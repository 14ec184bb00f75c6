"""What must not change within a session: its header compared with what a session opened today would have."""

from __future__ import annotations

import json
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from feel321.study.session import events

UNCOMPARED = ("format", "session", "versions", "system", "clock", "frozen")
"""May differ between a header and a later opening: other versions may go on with a session, and choices be amended."""

FROZEN_FILE = "frozen.json"
"""What was decided before the ratings, in the study's folder (`feel321 freeze`)."""


def identify_frozen(folder: Path) -> dict[str, str]:
    """Return the digest that the study's frozen file gives of itself, for the header of a session; none without one."""
    try:
        return {"frozen": str(json.loads((folder / FROZEN_FILE).read_bytes())["sha256"])}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


ACCEPTABLE = ("presenter.rig", "calibration")
"""May differ where somebody accepts it: a rig may have to be repaired in mid-study."""


def compare_headers(
    begun: events.SessionBegun, header: Mapping[str, Any], *, accepted: Iterable[events.RigAccepted]
) -> list[str]:
    """List in what a session, with the rig that it went on with, differs from the header that it would have today."""
    left = begun.to_data()
    for event in accepted:
        presenter = left.get("presenter", {}) | {"rig": event.rig}
        left |= {"presenter": presenter, "calibration": event.calibration}
    return find_differences(left, header, ignore=UNCOMPARED)


def describe_refusal(
    path: Path, begun: events.SessionBegun, differences: Sequence[str], *, is_rig: bool
) -> str:
    """Say why a session cannot be resumed, and what to do."""
    named = [
        "other texts for participants" if line.startswith("texts_sha256 ") else line
        for line in differences
    ]
    former, own = begun.versions.get("feel321"), version("feel321")
    use = "" if former == own else f" or use feel321 {former}, which began it"
    accept = "go on with the rig as it is now (--accept-rig, which records it), " if is_rig else ""
    return (
        f"{path}: the session was begun otherwise ({'; '.join(named)}); change that back{use}, {accept}"
        f"begin with another participant, or move {path.parent.parent.name}/ away"
    )


def find_differences(
    old: Mapping[str, Any], new: Mapping[str, Any], *, ignore: Collection[str] = ()
) -> list[str]:
    """Find the values in which two nested mappings differ, named by their keys."""
    before, after = (
        _flatten({k: v for k, v in entry.items() if k not in ignore}) for entry in (old, new)
    )
    names = [name for name in before | after if before.get(name) != after.get(name)]
    return [f"{name} {before.get(name)!r} -> {after.get(name)!r}" for name in names]


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in entry.items():
        key = f"{prefix}{name}"
        flat |= _flatten(value, f"{key}.") if isinstance(value, dict) else {key: value}
    return flat
