"""The one registry of every place that may hold data of a person, in the study's folder and outside.

`withdraw`, `audit`, `inventory` and `backup` iterate it. A new kind of file that holds anything of a participant is a
row of `KINDS`; a test plants marks in a study, runs every verb, and finds no mark outside these places.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import TEMPORARY, UNFINISHED
from feel321.study.folder import LEDGER_FILES
from feel321.study.persons.outputs import OUTPUTS_FILE, RESULTS, read_outputs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.study.folder import StudyFolder

REMOVED, REWRITTEN, KEPT, NAMED = "removed", "rewritten", "kept", "named"
"""What a withdrawal does to a place: removes it, writes it without the participant, keeps it, or names it."""


@dataclass(frozen=True, slots=True)
class DataKind:
    """A kind of place: its pattern, what it holds of a person, whether it can be derived again, and its end."""

    pattern: str
    holds: str
    origin: str
    at_withdrawal: str


SOURCE, DERIVED = "source", "derived"
"""Whether what a place holds is nowhere else, or can be derived again."""

_FOLDER = "{sessions,rehearsals}/ID"

KINDS: dict[str, DataKind] = {
    "plan": DataKind(f"{_FOLDER}/plan.json", "code, number, groups, order of trials", SOURCE, REMOVED),
    "journal": DataKind(f"{_FOLDER}/session-NN.jsonl", "every answer with its time, notes", SOURCE, REMOVED),
    "torn": DataKind(f"{_FOLDER}/session-NN.jsonl.tornN", "the piece of a record that a crash cut", SOURCE, REMOVED),
    "personal": DataKind(f"{_FOLDER}/personal.jsonl", "personal answers (age, gender, ...)", SOURCE, REMOVED),
    "delivered": DataKind(f"{_FOLDER}/delivered/*.wav", "what was played in each trial", SOURCE, REMOVED),
    "motion": DataKind(f"{_FOLDER}/motion/*.csv", "the hand's track in each trial", SOURCE, REMOVED),
    "tombstone": DataKind(f"{_FOLDER}/withdrawn.json", "code, number, date, reason, digests", SOURCE, KEPT),
    "lock": DataKind(f"{_FOLDER}/.lock", "nothing; held while writing", DERIVED, REMOVED),
    "other": DataKind(f"{_FOLDER}/*", "whatever somebody put there", SOURCE, REMOVED),
    "ledger": DataKind("{sessions,rehearsals}/ledger.*", "code, number, state, times, digests", SOURCE, REWRITTEN),
    "log": DataKind("{sessions,rehearsals}/ledger.log", "codes, and their deleted ledger entries", SOURCE, KEPT),
    "ratings": DataKind("ratings.csv, ratings.parquet", "every judgement, by code", DERIVED, REWRITTEN),
    "roster": DataKind("participants.csv", "code, groups, progress, thresholds", DERIVED, REWRITTEN),
    "answers": DataKind("answers.csv", "every answer to a question, personal ones too", DERIVED, REWRITTEN),
    "matches": DataKind("matches.csv", "every match of strength, by code", DERIVED, REWRITTEN),
    "results": DataKind("report/, chart/, advice/, ...", "figures and tables of ratings, by code", DERIVED, REMOVED),
    "output": DataKind("named in outputs.jsonl", "what export, analyze --out and others wrote", DERIVED, REMOVED),
    "key": DataKind(".export.key", "key that draws participants' numbers in exports", SOURCE, KEPT),
    "backup": DataKind("named in outputs.jsonl", "a copy of the study", SOURCE, NAMED),
    "checkpoints": DataKind("checkpoints.jsonl", "codes and digests, no answer", SOURCE, KEPT),
    "outputs": DataKind(OUTPUTS_FILE, "where outputs went; no code", SOURCE, KEPT),
    "unfinished": DataKind(".NAME.PID.*.part, feel321-PID-*/", "what a killed run was writing", DERIVED, REMOVED),
    "temporary": DataKind("feel321-PID-*/ of the system", "what a killed run worked on", DERIVED, REMOVED),
}  # fmt: skip
"""Kind of place -> what is to be known of it."""

TABLES = {
    "ratings.csv": "ratings", "ratings.parquet": "ratings", "participants.csv": "roster", "answers.csv": "answers",
    "matches.csv": "matches", "checkpoints.jsonl": "checkpoints", OUTPUTS_FILE: "outputs",
    ".export.key": "key",
}  # fmt: skip
"""Files in the study's folder itself, and their kinds."""

_PERSONAL = (
    (re.compile(r"plan\.json"), "plan"),
    (re.compile(r"session-\d{2,}\.jsonl"), "journal"),
    (re.compile(r"session-\d{2,}\.jsonl\.torn\d+"), "torn"),
    (re.compile(r"personal\.jsonl"), "personal"),
    (re.compile(r"delivered(/.*)?"), "delivered"),
    (re.compile(r"motion(/.*)?"), "motion"),
    (re.compile(r"withdrawn\.json"), "tombstone"),
    (re.compile(r"\.lock"), "lock"),
)  # fmt: skip
"""Names in a participant's folder, and their kinds; all else is of kind "other"."""


@dataclass(frozen=True, slots=True)
class DataPlace:
    """A file or folder that may hold data of a person.

    participants: whose; empty where it may be anybody's. at_withdrawal: see `KINDS`.
    """

    path: Path
    kind: str
    participants: tuple[str, ...] = ()

    @property
    def why(self) -> str:
        """What it holds of a person."""
        return KINDS[self.kind].holds

    @property
    def derived(self) -> bool:
        """Whether it can be derived again from what else is kept."""
        return KINDS[self.kind].origin == DERIVED

    @property
    def at_withdrawal(self) -> str:
        """What a withdrawal does to it."""
        return KINDS[self.kind].at_withdrawal


def list_places(study: StudyFolder) -> Iterator[DataPlace]:
    """List every place that is there; links are listed and never followed."""
    for name in ("sessions", "rehearsals"):
        yield from list_folder(study.path / name)
    for path in sorted(study.path.glob("*")) if study.path.is_dir() else ():
        if path.name in TABLES:
            yield DataPlace(path, TABLES[path.name])
        elif path.name in RESULTS:
            yield from (DataPlace(file, "results") for file in walk(path))
        elif _is_unfinished(path):
            yield from (DataPlace(file, "unfinished") for file in walk(path))
    yield from list_outputs(study)
    for path in sorted(Path(tempfile.gettempdir()).glob("feel321-*")):
        if TEMPORARY.fullmatch(path.name):  # also of other studies; a live process removes its own
            yield from (DataPlace(file, "temporary") for file in walk(path))


def list_folder(sessions: Path) -> Iterator[DataPlace]:
    """List the places in a folder of sessions."""
    for path in sorted(sessions.glob("*")) if sessions.is_dir() else ():
        if path.is_dir() or path.is_symlink():
            yield from (_sort(file, path) for file in walk(path))
        elif _is_unfinished(path):
            yield DataPlace(path, "unfinished")
        elif path.name == "ledger.log":
            yield DataPlace(path, "log")
        elif path.name.startswith(LEDGER_FILES) and path.name != "ledger.folder":
            yield DataPlace(path, "ledger")


def list_outputs(study: StudyFolder) -> Iterator[DataPlace]:
    """List what verbs wrote elsewhere and is still there."""
    for output in read_outputs(study):
        kind = "backup" if output.verb == "backup" else "output"
        if kind == "backup" and output.path.exists():
            yield DataPlace(output.path, kind)
        for name in output.files if kind == "output" else ():
            if (path := output.path / name).exists() or path.is_symlink():
                yield DataPlace(path, kind)


def walk(path: Path) -> Iterator[Path]:
    """List the files in a folder, or the one file; of a link the link itself, and nothing behind it."""
    if path.is_symlink() or not path.is_dir():
        yield path
        return
    for entry in sorted(path.iterdir()):
        yield from walk(entry)


def _is_unfinished(path: Path) -> bool:
    return bool(UNFINISHED.fullmatch(path.name) or TEMPORARY.fullmatch(path.name))


def _sort(path: Path, folder: Path) -> DataPlace:
    name = "" if path == folder else path.relative_to(folder).as_posix()
    if _is_unfinished(path):
        return DataPlace(path, "unfinished", (folder.name,))
    kind = next((kind for names, kind in _PERSONAL if names.fullmatch(name)), "other")
    return DataPlace(path, kind, (folder.name,))
