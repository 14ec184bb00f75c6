"""Reading `study.toml`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.registry import PROTOCOLS
from study.settings.conflicts import find_conflicts
from study.settings.parsing import parse_toml
from study.settings.session_tables import BreaksTable, QualityTable, RehearsalTable, SessionTable, StaleTable, TaskTable
from study.settings.tables import (
    AnalysisTable,
    ConditioningTable,
    FileTable,
    ObserverTable,
    RigTable,
    SceneTable,
    Settings,
    StimuliTable,
    StudyTable,
)

if TYPE_CHECKING:
    from pathlib import Path

    from study.settings.fields import Table

TABLES: dict[tuple[str, ...], type[Table]] = {
    (): Settings,
    ("analysis",): AnalysisTable,
    ("observer",): ObserverTable,
    ("recordings", "file"): FileTable,
    ("recordings", "scene"): SceneTable,
    ("rig",): RigTable,
    ("session",): SessionTable,
    ("session", "breaks"): BreaksTable,
    ("session", "quality"): QualityTable,
    ("session", "rehearsal"): RehearsalTable,
    ("session", "stale"): StaleTable,
    ("stimuli",): StimuliTable,
    ("stimuli", "conditioning"): ConditioningTable,
    ("study",): StudyTable,
    ("tasks",): TaskTable,  # of no protocol: the name itself is refused
    **{("tasks", name): TaskTable for name in PROTOCOLS},
}
"""Which keys are allowed where."""


def read_settings(path: Path) -> Settings:
    """Read and check a `study.toml`.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Settings
        The settings, defaults filled in.

    Raises
    ------
    ValueError
        If the file is not TOML, or anything in it is not allowed: one line per mistake, all of them.
    OSError
        If the file cannot be read.
    """
    settings = parse_toml(path, Settings, tables=TABLES)
    mistakes = find_conflicts(settings)
    if mistakes:
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return settings
