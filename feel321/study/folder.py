"""The folder of a study: its places, how it is begun and found, and what its stimuli were made of."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, TypeVar

from feel321 import intake
from feel321.doors import check_name
from feel321.files import create_text, is_of_group, make_folder, write_text
from feel321.study.session.journal import PARTICIPANT_ID, list_journals

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from feel321.study.session.plan import Dossier

Read = TypeVar("Read")

SETTINGS_FILE = "study.toml"
RIG_FILE = "rig.toml"

DELIVERED = "delivered"
"""Folder, in each participant's, of the samples that were rendered or measured at each playback."""

TEMPLATES = files("feel321.study") / "settings"
BUNDLED = TEMPLATES / "bundled"


def name_delivered(number: int) -> str:
    """Name the file of a playback.

    Examples
    --------
    >>> name_delivered(12)
    '0012.wav'
    """
    return f"{number:04}.wav"


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
        return self.path / RIG_FILE

    @property
    def stimuli(self) -> Path:
        """The stimulus set."""
        return self.path / "stimuli"

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
    def manifest(self) -> Path:
        """The table of stimuli."""
        return self.stimuli / "manifest.csv"

    @property
    def report(self) -> Path:
        """The folder of the report."""
        return self.path / "report"

    @property
    def participants(self) -> list[Path]:
        """The participants' folders, sorted; one that a crash left with nothing but its lock was not begun."""
        return [entry for entry in self._entries if _is_ours(entry) and any(entry.glob("[!.]*"))]

    @property
    def planned(self) -> list[Path]:
        """Folders of those who have a plan or a journal and did not withdraw."""
        from feel321.study.session.plan import PLAN_FILE, TOMBSTONE_FILE

        own = [one for one in self.participants if not (one / TOMBSTONE_FILE).exists()]
        return [one for one in own if (one / PLAN_FILE).exists() or list_journals(one)]

    @property
    def strangers(self) -> list[Path]:
        """What else lies beside the participants' folders, sorted: copies, and what drives and programs leave."""
        return [entry for entry in self._entries if not _is_ours(entry)]

    @property
    def journals(self) -> list[Path]:
        """All journals, sorted by participant, then session, without copies under other names."""
        return [journal for folder in self.participants for journal in list_journals(folder)]

    def read_person(self, folder: Path) -> Dossier:
        """Read the plan and the journals of a participant, unless they are known as they are now."""
        from feel321.study.session.plan import PLAN_FILE, read_dossier

        paths = [folder / PLAN_FILE, *list_journals(folder)]
        stamp = [(path, path.exists() and _stamp(path)) for path in paths]
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

    def share(self, path: Path) -> None:
        """Let the group read a table that was derived from sessions which it may read."""
        if path.is_file() and self.sessions.is_dir() and is_of_group(self.sessions):
            path.chmod(0o640)

    @property
    def _entries(self) -> list[Path]:
        # Hidden ones are the system's, or a file that is being written.
        return sorted(self.sessions.glob("[!.]*"))


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


def _stamp(path: Path) -> tuple[int, ...]:
    """Say by what an unchanged file is known; nobody can set the time of its last change of any kind."""
    found = path.stat()
    return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _is_ours(entry: Path) -> bool:
    return entry.is_dir() and PARTICIPANT_ID.fullmatch(entry.name) is not None


def list_bundled() -> tuple[str, ...]:
    """List the studies that are ready to be run: published ones, and designs of our own.

    Examples
    --------
    >>> list_bundled()
    ('airotouch', 'generated', 'landin2010', 'lee2022', 'park2019')
    """
    files = (entry.name for entry in BUNDLED.iterdir() if entry.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in files))


def create_study(path: Path, *, bundled: str | None = None) -> StudyFolder:
    """Begin a study: its folder, a commented `study.toml` that works as it is, and a `rig.toml`.

    bundled: which ready study it is to be; if left out, one of bundled scenes, with the settings that labs change
    first. Methods of its own that it names are written beside it.
    """
    text = read_template() if bundled is None else read_bundled(bundled)
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


def add_methods(study: StudyFolder) -> None:
    """Add an example of every kind of method of a lab's own to a study that was just begun."""
    home = study.path / "methods"
    make_folder(home)
    for entry in (TEMPLATES / "methods").iterdir():
        if entry.name.endswith(".py.txt"):
            create_text(home / entry.name.removesuffix(".txt"), entry.read_text(encoding="utf-8"))
    taps = [100 * 0.9 ** (n % 250) * (-1) ** (n // 4) for n in range(2000)]
    lines = ["2000", *(f"{0.4 * one:.4f} {-0.3 * one:.4f} {one:.4f}" for one in taps)]
    create_text(study.path / "recordings" / "tap.xyz", "\n".join(lines) + "\n")
    text = intake.read_small(study.settings)
    begin, end = text.index("reducers = ["), text.index("levels = [")
    own = 'reducers = ["say321", "pca321", "dft321", "my321", "wav321"]  # the last two are your own, see below\n'
    text = (text[:begin] + own + text[end:]).replace("metrics = []", 'metrics = ["snr"]')
    text = text.replace("screening = []", 'screening = ["methods/slow.py:slow"]')
    text = text.replace(
        'protocols = ["realism", "similarity"]',
        'protocols = ["realism", "similarity", "methods/roughness.py:roughness"]',
    )
    tables = (TEMPLATES / "methods" / "tables.toml").read_text(encoding="utf-8")
    write_text(study.settings, text + tables)


def require_study(path: Path) -> StudyFolder:
    """Find a study that is there, or describe what the path is instead."""
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: no such folder; begin a study with: feel321 new {quote(str(path))}"
        )
    if not path.is_dir():
        raise NotADirectoryError(
            f"{path}: a study must be a folder, got a file; try {quote(str(path.parent))}"
        )
    study = StudyFolder(path)
    if not study.settings.is_file():
        where = "the current folder" if str(path) == "." else str(path)
        raise FileNotFoundError(
            f"no {SETTINGS_FILE} in {where}; name a study, or begin one with: feel321 new {quote(str(path))}"
        )
    return study


def read_template() -> str:
    """Read the `study.toml` that a new study begins with."""
    return (TEMPLATES / "template.toml").read_text(encoding="utf-8")


def read_bundled(name: str) -> str:
    """Read the `study.toml` of a published study."""
    check_name(name, list_bundled(), "study")
    return (BUNDLED / f"{name}.toml").read_text(encoding="utf-8")


def read_recipe(folder: Path) -> dict[str, Any]:
    """Read the recipe that a stimulus set was made by."""
    from feel321.stimuli.sets.manifest import read_details

    return read_details(folder).recipe


def is_in_use(study: StudyFolder, stimuli_sha256: str) -> bool:
    """Check whether any plan or journal names a stimulus set."""
    # By the bare text, so that damaged files count too.
    files = study.sessions.glob("*/*.json*")
    return any(stimuli_sha256.encode() in path.read_bytes() for path in files if path.is_file())
