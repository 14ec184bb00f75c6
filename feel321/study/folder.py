"""The folder of a study: its places and tables, how it is begun and found; what checks of it give."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, TypeVar

from feel321.arguments import check_name
from feel321.files import create_text, is_of_group, make_folder, write_table
from feel321.records import Result
from feel321.study.session.events import PartPlayed
from feel321.study.session.journal import PARTICIPANT_ID, Clock, list_journals, utc_now

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.study.session.journal import Record
    from feel321.study.session.plan import Dossier
    from feel321.types import Progress

Read = TypeVar("Read")

SETTINGS_FILE = "study.toml"

DELIVERED = "delivered"  # folder, in each participant's, of the samples that were rendered or measured at each playback

PARTICIPANT_COLUMNS = (
    "participant", "number", "simulated", "state", "sessions", "answered", "given_up", "total",
)  # fmt: skip
"""The first columns of `participants.csv`; one per factor in which participants differ follows.

Last of all come those of `thresholds.list_columns`, where thresholds were measured."""

LAST_PARTICIPANT_COLUMNS = ("first_utc", "last_utc", "training_passed", "rig", "calibration")

RATING_COLUMNS = (  # the columns of `ratings.csv`, in order
    "participant", "session", "protocol", "block", "trial", "repeat", "stimulus_id", "recording", "reducer",
    "level", "reference_id", "scale", "rating", "response_time_s", "onset_s", "underruns", "rejected", "simulated",
    "spectral_match_delivered", "temporal_match_delivered", "spectral_match_bounded_delivered", "level_error_db",
    "delivered_by", "sensation_level_db", "other_id",
)  # fmt: skip

TEMPLATES = files("feel321.study") / "settings"
BUNDLED = TEMPLATES / "bundled"


class UsageError(ValueError):
    """Arguments that cannot be, whatever the study holds: exit code 2 on the command line."""


def name_delivered(number: int) -> str:
    """Name the file of a playback."""
    return f"{number:04}.wav"


def list_delivered(records: Sequence[Record], folder: Path) -> Iterator[tuple[Record, Path, str]]:
    """List the files of what was rendered or measured: who names them, where they are, their digest."""
    for record in records:
        played = record.content if record.event == PartPlayed.event else None
        if isinstance(played, PartPlayed) and played.delivered_sha256:
            name = name_delivered(int(played.measured.get("file_number", 0)))
            yield record, folder / DELIVERED / name, played.delivered_sha256


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """The places in the folder that holds `study.toml`.

    is_rehearsal: whether sessions are tried out: they are stored apart, with numbers of their own, and nothing is
    derived from them. Plans and journals are read once, and again only where a file has changed since.
    """

    path: Path
    is_rehearsal: bool = False
    _known: dict[Path, tuple[object, Dossier]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def settings(self) -> Path:
        """What the lab decides."""
        return self.path / SETTINGS_FILE

    @property
    def rig(self) -> Path:
        """What the lab's actuators are."""
        return self.path / "rig.toml"

    @property
    def frozen(self) -> Path:
        """What was decided before the ratings."""
        return self.path / "frozen.json"

    @property
    def stimuli(self) -> Path:
        """The stimulus set."""
        return self.path / "stimuli"

    @property
    def manifest(self) -> Path:
        """The table of stimuli."""
        return self.stimuli / "manifest.csv"

    @property
    def sessions(self) -> Path:
        """One folder per participant."""
        return self.path / ("rehearsals" if self.is_rehearsal else "sessions")

    @property
    def calibration(self) -> Path:
        """The certificates of the rig."""
        return self.path / "calibration"

    @property
    def ratings(self) -> Path:
        """The table of ratings, derived from the journals."""
        return self.path / "ratings.csv"

    @property
    def report(self) -> Path:
        """The folder of the report."""
        return self.path / "report"

    @property
    def participants(self) -> list[Path]:
        """The participants' folders, sorted; one that a crash left with nothing but its lock was not begun."""
        return [one for one in self._list_entries(ours=True) if any(one.glob("[!.]*"))]

    @property
    def planned(self) -> list[Path]:
        """Folders of those who have a plan or a journal and did not withdraw."""
        from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

        own = [one for one in self.participants if not (one / TOMBSTONE_FILE).exists()]
        return [one for one in own if (one / PLAN_FILE).exists() or list_journals(one)]

    @property
    def strangers(self) -> list[Path]:
        """What else lies beside the participants' folders, sorted: copies, and what drives and programs leave."""
        return self._list_entries(ours=False)

    @property
    def journals(self) -> list[Path]:
        """All journals, sorted by participant, then session, without copies under other names."""
        return [journal for folder in self.participants for journal in list_journals(folder)]

    def read_person(self, folder: Path) -> Dossier:
        """Read the plan and the journals of a participant, unless they are known as they are now."""
        from feel321.study.session.plan import PLAN_FILE, read_dossier

        paths = [folder / PLAN_FILE, *list_journals(folder)]
        # Nobody can set the time of a file's last change of any kind.
        found = [(path, path.stat()) for path in paths if path.exists()]
        stamp = [(path, s.st_ino, s.st_size, s.st_mtime_ns, s.st_ctime_ns) for path, s in found]
        known = self._known.get(folder)
        if known is None or known[0] != stamp:
            known = stamp, read_dossier(folder)
            self._known[folder] = known
        return known[1]

    def read_people(self) -> list[Dossier]:
        """Read everybody of `planned`; all that cannot be read is named at once."""
        return name_all(self.read_person, self.planned)

    def make_sessions(self) -> None:
        """Make the folder of the sessions, its owner's alone; a lab may open it to its group (mode 0750)."""
        make_folder(self.sessions, private=True)

    def write_table(
        self,
        name: str,
        columns: Sequence[str],
        rows: Sequence[Mapping[str, Any]],
        *,
        is_optional: bool = False,
    ) -> Path:
        """Write a table derived from sessions, for whoever may read these; is_optional: if it has or had rows."""
        path = self.path / name
        if rows or not is_optional or path.exists():
            write_table(path, columns, rows, private=True)
            if self.sessions.is_dir() and is_of_group(self.sessions):
                path.chmod(0o640)
        return path

    def _list_entries(self, *, ours: bool) -> list[Path]:
        # Hidden ones are the system's, or a file that is being written.
        entries = sorted(self.sessions.glob("[!.]*"))
        codes = {one for one in entries if PARTICIPANT_ID.fullmatch(one.name) and one.is_dir()}
        return [one for one in entries if (one in codes) is ours]


def name_all(read: Callable[[Path], Read], folders: Iterable[Path]) -> list[Read]:
    """Read several folders; what is wrong with any of them is refused in one go, a line each."""
    found, faults = [], []
    for folder in folders:
        try:
            found.append(read(folder))
        except ValueError as error:
            faults.append(str(error))
    if faults:
        raise ValueError("\n".join(faults))
    return found


def list_bundled() -> tuple[str, ...]:
    """List the studies that are ready to be run: published ones, and designs of our own."""
    names = (entry.name for entry in BUNDLED.iterdir() if entry.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in names))


def create_study(path: Path, *, bundled: str | None = None) -> StudyFolder:
    """Begin a study: its folder, a commented `study.toml` and a `rig.toml`; bundled: which ready study it is to be."""
    text = read_template(bundled)
    study = StudyFolder(path)
    make_folder(path / "recordings")
    create_text(study.settings, text)
    for name in sorted(set(re.findall(r"methods/(\w+\.py)", text if bundled else ""))):
        make_folder(path / "methods")
        code = BUNDLED / "methods" / f"{name}.txt"
        create_text(path / "methods" / name, code.read_text(encoding="utf-8"))
    if not study.rig.exists():
        create_text(study.rig, (TEMPLATES / "rig_template.toml").read_text(encoding="utf-8"))
    return study


def require_study(path: Path) -> StudyFolder:
    """Find a study that is there, or describe what the path is instead."""
    new = f"with: feel321 new {quote(str(path))}"
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such folder; begin a study {new}")
    if not path.is_dir():
        parent = quote(str(path.parent))
        raise NotADirectoryError(f"{path}: a study must be a folder, got a file; try {parent}")
    study = StudyFolder(path)
    if not study.settings.is_file():
        where = "the current folder" if str(path) == "." else str(path)
        raise FileNotFoundError(f"no {SETTINGS_FILE} in {where}; name a study, or begin one {new}")
    return study


def read_template(bundled: str | None = None) -> str:
    """Read the `study.toml` that a new study begins with, or that of a ready study."""
    if bundled is None:
        return (TEMPLATES / "template.toml").read_text(encoding="utf-8")
    check_name(bundled, list_bundled(), "study")
    return (BUNDLED / f"{bundled}.toml").read_text(encoding="utf-8")


@dataclass(frozen=True, slots=True, repr=False)
class OpenStudy:
    """The folder of a study, and how its verbs say what they do; see `Study`."""

    folder: StudyFolder
    progress: Progress = False
    now: Clock = utc_now
    warn: Callable[[str], None] | None = None

    def choose(self, rehearsals: bool) -> StudyFolder:  # noqa: FBT001 - an option, passed on
        """Choose sessions or rehearsals."""
        return replace(self.folder, is_rehearsal=True) if rehearsals else self.folder

    def say(self, message: str) -> None:
        """Give a warning.

        Parameters
        ----------
        message : str
            In one line.
        """
        if self.warn is None:
            warnings.warn(message, stacklevel=4)
        else:
            self.warn(message)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Outcome(Result):
    """What a verb did: numbers, or the JSON file that holds them; lines for people; faults, or only that it failed."""

    facts: Mapping[str, Any] | Path
    lines: Sequence[str] = ()
    faults: Sequence[str] = ()
    failed: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers."""
        if isinstance(self.facts, Path):
            return dict(json.loads(self.facts.read_text(encoding="utf-8")))
        return dict(self.facts)

    def summary(self) -> str:
        """Write the lines."""
        return "\n".join(self.lines)


class Findings(Result):
    """Texts of several kinds."""

    __slots__ = ()

    def to_frame(self) -> DataFrame:
        """Return one row per finding, with the columns `kind` and `text`."""
        import pandas as pd

        kinds = {name: value for name, value in self.to_dict().items() if isinstance(value, list)}
        rows = [(kind.rstrip("s"), text) for kind, texts in kinds.items() for text in texts]
        return pd.DataFrame(rows, columns=["kind", "text"])


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Problems(Findings):
    """What stands in the way of a study; what may not be meant; how strong stimuli are.

    subject: what was checked, if not the study.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    subject: str = ""

    def __add__(self, other: Problems) -> Problems:
        """Put what was found in two parts of a study together."""
        names = ("problems", "warnings", "notes")
        texts = {name: getattr(self, name) + getattr(other, name) for name in names}
        return Problems(**texts, figures={**self.figures, **other.figures})


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Audit(Findings):
    """Findings: every gap, duplicate and edit; remarks; what was compared; id of the newest checkpoint, if any.

    journals: how many were examined.
    """

    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    sentence: str = ""
    checkpoint: str = ""
    journals: int = 0


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Seal(Findings):
    """When, and the checkpoint's id, for the lab book; remotes that have it; problems: why others have not."""

    utc: str
    checkpoint: str
    places: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
