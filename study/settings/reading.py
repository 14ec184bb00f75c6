"""Reading `study.toml`; the one place where a mistake in it is put into words."""

from __future__ import annotations

import json
import tomllib
from difflib import get_close_matches
from typing import TYPE_CHECKING, NoReturn

from pydantic import ValidationError

from protocols.registry import PROTOCOLS
from study.settings.conflicts import find_conflicts
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

    from pydantic_core import ErrorDetails

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
    **{("tasks", name): TaskTable for name in PROTOCOLS},
}
"""Which keys are allowed where."""

WRONG_KEY = "[key]"
"""What pydantic adds to the place of a name that is not allowed; the name stands before it."""


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
    try:
        # By way of JSON, where strict reading takes an array for a tuple, but no "5" or true for a number.
        content = json.dumps(tomllib.loads(path.read_text(encoding="utf-8-sig")), default=_refuse_time)
    except TypeError as error:
        raise ValueError(f"{path.name}: {error}") from None
    except ValueError as error:  # TOML's own errors and those of the encoding
        raise ValueError(f"{path}: got no TOML ({error}); mend that place") from None
    except RecursionError:
        raise ValueError(f"{path}: got TOML that is nested too deeply; mend that place") from None
    try:
        settings = Settings.model_validate_json(content, strict=True)
        mistakes = find_conflicts(settings)
    except ValidationError as error:
        mistakes = [_translate(detail) for detail in error.errors(include_url=False)]
    if mistakes:
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return settings


def _refuse_time(value: object) -> NoReturn:
    # A TypeError is how `json` wants to be told.
    raise TypeError(f"got the date or time {value}, allowed are texts, numbers, true and false; put it in quotes")


def _translate(detail: ErrorDetails) -> str:
    names = tuple(part for part in detail["loc"] if isinstance(part, str))
    place = _write_place(detail["loc"])
    if detail["type"] == "json_invalid":  # We wrote the JSON: only its depth can be wrong.
        return "got TOML that is nested too deeply; mend that place"
    if detail["type"] == "extra_forbidden":
        return f"{place}: is no setting; {_suggest(names)}"
    if detail["type"] == "missing":
        return f"{place}: is missing; add it"
    if detail["type"] == "value_error":
        reason = str(detail["ctx"]["error"])
    else:
        # What JSON calls an object is a table in TOML.
        reason = f"allowed: {detail['msg'].removeprefix('Input should be ').replace('an object', 'a table')}"
    # Whole tables are too long an answer to what was got.
    got = "" if "{" in repr(detail["input"]) else f"got {detail['input']!r}, "
    return f"{place}: {got}{reason}"


def _write_place(location: tuple[int | str, ...]) -> str:
    """Write a place as the file's author counts, `recordings[1].unit`; what follows a number is a kind, no key."""
    place = ""
    for before, part in zip((None, *location), location, strict=False):
        if isinstance(part, int):
            place += f"[{part + 1}]"
        elif not isinstance(before, int) and part != WRONG_KEY:
            place += f".{part}" if place else part
    return place


def _suggest(names: tuple[str, ...]) -> str:
    *table, key = names
    # The only tables that are not known are tasks of no protocol, whose names are refused themselves.
    allowed = list(TABLES.get(tuple(table), TaskTable).model_fields)
    near = get_close_matches(key, allowed, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed: {', '.join(allowed)}"
