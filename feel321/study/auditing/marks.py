"""Marks: by what a file of a study is known again, and what may become of it.

A journal and the ledger's log only grow: their mark is the number of lines and the digest of the last one. Of plans,
tombstones, certificates and the manifest nothing may change. What the lab decides (`study.toml`, texts, methods) may
change if it is said why; the rig may, for each session's header holds it, and so may `frozen.json`, which says why
itself. The report changes with each analysis.
Rendered, measured and motion files are known by their digests in the journals, stimuli by those in the manifest.

`heads` are the first six digits of the digest of every line: they locate a changed line but prove nothing.
"""

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import Entry
from feel321.study.session.journal import START, digest, list_journals
from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

GROWING, KEPT, DECIDED, NOTED, REPORT, SLOT = (
    "growing", "kept", "decided", "noted", "report", "slot",
)  # fmt: skip
"""Kinds of files, and of what else has a mark: a participant's slot in the ledger."""

SLOT_PREFIX = "sessions/ledger.sqlite: "

HEAD = 6
"""Digits per line; 24 bits find a line among thousands."""

MANY_LINES = 2000
"""Lines above which a file that does not grow has no heads."""

_KINDS = (
    (SLOT_PREFIX, SLOT),
    (r"sessions/[^/]+/session-\d+\.jsonl$|sessions/ledger\.log$", GROWING),
    (r"sessions/|calibration/|stimuli/", KEPT),
    (r"report/", REPORT),
    (r"(rig\.toml|frozen\.json)$", NOTED),
    (r"", DECIDED),
)


@dataclass(frozen=True, slots=True)
class FileMark:
    """By what a file is known again; lines: of a file that grows, else 0."""

    sha256: str
    lines: int = 0
    heads: str = ""

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> "FileMark":
        """Read a mark from a checkpoint."""
        return cls(str(entry["sha256"]), int(entry.get("lines", 0)), str(entry.get("heads", "")))


def find_kind(name: str) -> str:
    """Find what kind of file a name is of."""
    return next(kind for pattern, kind in _KINDS if re.match(pattern, name))


def name_file(path: Path, study: StudyFolder) -> str:
    """Name a file from the study's folder on."""
    return path.relative_to(study.path).as_posix()


def list_covered(study: StudyFolder, participants: Iterable[Path]) -> Iterator[Path]:
    """List the files that have marks: those of some participants, and those of the study."""
    yield from (path for path in sorted(study.path.glob("*.toml")) if path.is_file())
    own = [study.path / "frozen.json", study.manifest, study.manifest.with_suffix(".json")]
    yield from (path for path in (*own, study.ledger_log) if path.is_file())
    for folder in (study.path / "methods", study.calibration):
        yield from (path for path in sorted(folder.rglob("*")) if _is_own(path))
    report = [study.report / "results.json", study.report / "index.html"]
    report += sorted(study.report.glob("tables/*.csv"))
    yield from (path for path in report if path.is_file())
    for folder in participants:
        kept = [folder / PLAN_FILE] if (folder / PLAN_FILE).is_file() else []
        stone = folder / TOMBSTONE_FILE
        # Until the removal is finished, it is written once more.
        done = stone.is_file() and b'"state": "removed"' in stone.read_bytes()
        yield from [*kept, *([stone] if done else [])]
        yield from (path for path in list_journals(folder) if path.is_file())


def _is_own(path: Path) -> bool:
    return path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")


def take_mark(path: Path, kind: str) -> FileMark:
    """Take the mark of a file as it is now; an unfinished line of one that grows is left out."""
    content = path.read_bytes()
    if kind == GROWING:
        digests = [digest(line) for line in content.split(b"\n")[:-1]]
        heads = "".join(one[:HEAD] for one in digests)
        return FileMark(digests[-1] if digests else START, len(digests), heads)
    lines = content.splitlines() if content.count(b"\n") <= MANY_LINES else []
    is_text = bool(lines) and b"\0" not in content
    heads = "".join(digest(line)[:HEAD] for line in lines) if is_text else ""
    return FileMark(hashlib.sha256(content).hexdigest(), heads=heads)


def take_marks(
    study: StudyFolder, participants: Iterable[Path], entries: Iterable[Entry]
) -> dict[str, FileMark]:
    """Take the marks of a study as it is now: name -> mark."""
    marks = {}
    for path in list_covered(study, participants):
        name = name_file(path, study)
        marks[name] = take_mark(path, find_kind(name))
    for entry in entries:
        if entry.anchors:  # before that, a slot may be given back
            own = digest(f"number {entry.number}, simulated {entry.simulated}")
            marks[f"{SLOT_PREFIX}{entry.participant}"] = FileMark(own)
    return marks


def find_line(before: str, after: str) -> int:
    """Find the first line, from 1, in which the heads of a file differ; 0 if they do not."""
    longest = max(len(before), len(after))
    for at in range(0, longest, HEAD):
        if before[at : at + HEAD] != after[at : at + HEAD]:
            return at // HEAD + 1
    return 0


def continues(path: Path, mark: FileMark) -> bool:
    """Check whether a file that grows begins with the lines that were marked."""
    lines = path.read_bytes().split(b"\n")[:-1]
    if len(lines) < mark.lines:
        return False
    return not mark.lines or digest(lines[mark.lines - 1]) == mark.sha256
