"""`frozen.json`: what was decided, when, with which software, and how many ratings of real people there were by then.

The file holds the digest of itself, and journals hold it too: every session that begins after freezing names it in its
header. So a file that was edited, or written later with the clock set back, is seen. Former states are kept in it.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from feel321.analysis.report.standing import Hypothesis
from feel321.files import write_text
from feel321.study.session.events import TrialRated
from feel321.study.session.identity import FROZEN_FILE
from feel321.study.session.journal import list_journals

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.folder import StudyFolder

SCHEMA = 1
"""Version of the file's form."""


@dataclass(frozen=True, slots=True)
class Seen:
    """The ratings of real people so far: counted, never shown."""

    judgements: int = 0
    participants: int = 0
    first_utc: str = ""


@dataclass(frozen=True, slots=True)
class Frozen:
    """What was frozen.

    participants: planned, None where nothing says it; planned_by: where the number comes from. rated: ratings of real
    people that there were. because: why it replaces the former state; history: former states, oldest first.
    """

    utc: str
    feel321: str
    participants: int | None
    planned_by: str
    rated: Seen
    choices: Mapping[str, Any]
    hypotheses: tuple[Hypothesis, ...]
    words: tuple[str, ...]
    versions: Mapping[str, str]
    because: str = ""
    history: tuple[Frozen, ...] = ()
    sha256: str = field(default="", compare=False)

    @property
    def is_late(self) -> bool:
        """Whether people had rated before."""
        return self.rated.judgements > 0 or self.rated.participants > 0

    def to_json(self) -> dict[str, Any]:
        """Return what the file holds, without the digest of itself."""
        groups: dict[str, dict[str, Any]] = {}
        for name, value in self.choices.items():
            groups.setdefault(name.partition(".")[0], {})[name] = value
        own = asdict(self) | {
            "history": [one.to_json() | {"sha256": one.sha256} for one in self.history]
        }
        del own["sha256"]
        digests = {group: digest_value(held) for group, held in sorted(groups.items())}
        return {"schema": SCHEMA, **own, "digests": digests}


def digest_value(value: object) -> str:
    """Digest a value that JSON can hold, whatever the order of its keys."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def list_versions(frozen: Frozen) -> Iterator[Frozen]:
    """List a frozen state and all before it, the newest first."""
    yield frozen
    yield from reversed(frozen.history)


def write_frozen(study: StudyFolder, frozen: Frozen) -> Frozen:
    """Write the file, with the digest of itself."""
    own = frozen.to_json()
    sealed = replace(frozen, sha256=digest_value(own))
    text = json.dumps(own | {"sha256": sealed.sha256}, indent=1, ensure_ascii=False)
    write_text(study.path / FROZEN_FILE, f"{text}\n")
    return sealed


def read_frozen(study: StudyFolder) -> Frozen | None:
    """Read the file, if there is one; one that is damaged or was edited is refused."""
    path = study.path / FROZEN_FILE
    if not path.is_file():
        return None
    try:
        return _read_state(json.loads(path.read_bytes()))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(
            f"{path}: changed after it was written (its SHA-256 does not match), or not a file of feel321 freeze; "
            "restore it from a copy"
        ) from None


def _read_state(entry: Any) -> Frozen:  # noqa: ANN401 - what JSON holds
    own = dict(entry)
    sha256 = own.pop("sha256")
    if digest_value(own) != sha256 or own.pop("schema") != SCHEMA:
        raise ValueError("another digest or form")
    del own["digests"]
    own |= {
        "rated": Seen(**own["rated"]),
        "hypotheses": tuple(Hypothesis(**one) for one in own["hypotheses"]),
        "words": tuple(own["words"]),
        "history": tuple(map(_read_state, own["history"])),
    }
    return Frozen(**own, sha256=sha256)


# Ratings of real people, counted without a look at any.


def find_first(study: StudyFolder) -> Seen:
    """Count the ratings of people in the journals, and find the first."""
    times = list_times(study)
    first = min((min(found) for found in times.values()), default="")
    return Seen(sum(map(len, times.values())), len(times), first)


def list_times(study: StudyFolder) -> dict[str, list[str]]:
    """List when people rated, by the journals: participant -> times; only those who did."""
    own = (folder for folder in study.participants if not _is_simulated(folder))
    found = {folder.name: list(_list_times(folder)) for folder in own}
    return {name: times for name, times in found.items() if times}


def _is_simulated(folder: Path) -> bool:
    """Check whether a participant is simulated; one whose plan cannot be read counts as a person."""
    from feel321.study.session.plan import PLAN_FILE

    try:
        return json.loads((folder / PLAN_FILE).read_bytes())["simulated"] is True
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _list_times(folder: Path) -> Iterator[str]:
    """List when the ratings of a participant were given; a line without a time counts as the last."""
    mark = f'"event": "{TrialRated.event}"'.encode()
    lines = (line for path in list_journals(folder) for line in path.read_bytes().split(b"\n"))
    for line in (line for line in lines if mark in line):
        try:
            yield str(datetime.fromisoformat(json.loads(line)["utc"]))
        except (ValueError, KeyError, TypeError, RecursionError):
            yield "9999"


def read_time(utc: str) -> datetime:
    """Read a time of day; one that cannot be read is later than all others."""
    try:
        return datetime.fromisoformat(utc)
    except ValueError:
        return datetime.max.replace(tzinfo=UTC)


# Which frozen file sessions know of.


def list_named(study: StudyFolder) -> Iterator[tuple[str, str, str]]:
    """List what the sessions of people know: journal, when it was begun, and the digest that its header names."""
    for folder in (one for one in study.participants if not _is_simulated(one)):
        for path in list_journals(folder):
            with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                head = json.loads(path.read_bytes().partition(b"\n")[0])
                named = head["data"].get("frozen", "")
                yield path.relative_to(study.path).as_posix(), head["utc"], named


def describe_rated(rated: Seen) -> str:
    """Count ratings for a sentence."""
    people = f"{rated.participants} {'person' if rated.participants == 1 else 'people'}"
    return f"{rated.judgements} judgement{'s' * (rated.judgements != 1)} of {people}"


# The state in a line, and what is wrong with it.


def describe_frozen(study: StudyFolder) -> str:
    """Describe in one line what is frozen, for check, status and audit; empty where nothing is."""
    try:
        frozen = read_frozen(study)
    except ValueError:
        return f"frozen: {FROZEN_FILE} cannot be trusted (feel321 audit)"
    if frozen is None:
        return ""
    when = (
        "before any rating"
        if not frozen.is_late
        else f"after {describe_rated(frozen.rated)}: exploratory"
    )
    times = len(frozen.history)
    again = f", amended {times} time{'s' * (times > 1)}" if times else ""
    return f"frozen: {frozen.utc[:16].replace('T', ' ')} UTC, {when}{again}"


def find_faults(study: StudyFolder) -> list[str]:
    """Find reasons to distrust the frozen file: edits, and times that do not agree with the journals."""
    try:
        frozen = read_frozen(study)
    except ValueError as error:
        return [str(error)]
    faults = _list_missing(study) if frozen is None else _list_faults(study, frozen)
    return [f"{study.path / FROZEN_FILE}: {one}" for one in faults]


def _list_missing(study: StudyFolder) -> Iterator[str]:
    """Say that the file was taken away, where a session knows of it."""
    if path := next((path for path, _, named in list_named(study) if named), ""):
        yield f"is not there, though {path} names it in its header; restore it from a copy"


def _list_faults(study: StudyFolder, frozen: Frozen) -> Iterator[str]:
    first = find_first(study).first_utc
    states = list(list_versions(frozen))
    for one in states:
        if first and not one.is_late and read_time(one.utc) > read_time(first):
            yield (
                f"says that it was frozen before any rating, on {one.utc}, but a person had rated by {first}"
            )
    known, begun = {one.sha256 for one in states}, min(read_time(one.utc) for one in states)
    for path, utc, named in list_named(study):
        if named and named not in known:
            yield f"is not the one that {path} names in its header; restore the former file"
        elif not named and read_time(utc) > begun:
            yield f"says that it was written before the session of {path}, whose header knows of no frozen file"
