"""The folder of a study, and the record of which settings its stimuli were built from."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from feel321.files import create_text
from feel321.study.session.journal import list_journals
from feel321.study.session.plan import PARTICIPANT_ID

if TYPE_CHECKING:
    from pathlib import Path

SETTINGS_FILE = "study.toml"
RIG_FILE = "rig.toml"

LEDGER_FILE = "ledger.sqlite"

LEDGER_FILES = "ledger."
"""How the names of all files of the ledger begin: the database, what it keeps beside itself, the log."""

BUNDLED = files("feel321.study") / "settings" / "bundled"


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """The places in a study.

    Parameters
    ----------
    path : Path
        The folder that holds `study.toml`.
    is_rehearsal : bool
        Whether sessions are tried out: they lie apart, with a ledger of their own, and nothing is derived from them.
    """

    path: Path
    is_rehearsal: bool = False

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
    def ledger(self) -> Path:
        """Who takes part under which number; beside what it speaks of, so that both are moved or copied as one."""
        return self.sessions / LEDGER_FILE

    @property
    def ledger_log(self) -> Path:
        """What the ledger forgot when it was rebuilt."""
        return self.sessions / "ledger.log"

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
    def strangers(self) -> list[Path]:
        """What else lies beside the participants' folders, sorted: copies, and what drives and programs leave."""
        return [
            entry
            for entry in self._entries
            if not (_is_ours(entry) or entry.name.startswith(LEDGER_FILES))
        ]

    @property
    def journals(self) -> list[Path]:
        """All journals, sorted by participant, then session; copies under other names are none."""
        return [journal for folder in self.participants for journal in list_journals(folder)]

    @property
    def _entries(self) -> list[Path]:
        # Hidden ones are the system's, or a file that is being written.
        return sorted(self.sessions.glob("[!.]*"))


def _is_ours(entry: Path) -> bool:
    return entry.is_dir() and PARTICIPANT_ID.fullmatch(entry.name) is not None


def list_bundled() -> tuple[str, ...]:
    """Name the published studies that are ready to be run again.

    Examples
    --------
    >>> list_bundled()
    ('landin2010', 'lee2022', 'park2019')
    """
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in BUNDLED.iterdir()))


def create_study(path: Path, *, bundled: str | None = None) -> StudyFolder:
    """Begin a study: its folder, a commented `study.toml` that names the bundled scenes, and a `rig.toml`.

    Parameters
    ----------
    path : Path
        The folder; created if missing.
    bundled : str, optional
        Which published study it is to be; one with every setting at its default if left out.

    Returns
    -------
    StudyFolder
        The new study.

    Raises
    ------
    FileExistsError
        If the folder holds a `study.toml` already.
    ValueError
        If there is no such published study.
    """
    text = read_template() if bundled is None else read_bundled(bundled)
    study = StudyFolder(path)
    (path / "recordings").mkdir(parents=True, exist_ok=True)
    create_text(study.settings, text)
    if not study.rig.exists():
        create_text(study.rig, _read_text("rig_template.toml"))
    return study


def require_study(path: Path) -> StudyFolder:
    """Find a study that is there.

    Parameters
    ----------
    path : Path
        The folder.

    Returns
    -------
    StudyFolder
        The study.

    Raises
    ------
    FileNotFoundError
        If the folder holds no `study.toml`.
    """
    study = StudyFolder(path)
    if not study.settings.is_file():
        raise FileNotFoundError(
            f"{path}: got a folder without {SETTINGS_FILE}; name a study, or begin one with: feel321 new {path}"
        )
    return study


def read_template() -> str:
    """Read the `study.toml` that a new study begins with."""
    return _read_text("template.toml")


def read_bundled(name: str) -> str:
    """Read the `study.toml` of a published study."""
    if name not in list_bundled():
        raise ValueError(f"study: got {name!r}, allowed: {', '.join(list_bundled())}")
    return (BUNDLED / f"{name}.toml").read_text(encoding="utf-8")


def _read_text(name: str) -> str:
    return (files("feel321.study") / "settings" / name).read_text(encoding="utf-8")
