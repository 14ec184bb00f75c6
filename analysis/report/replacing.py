"""A report takes the place of the former one and of nothing else: files that are not its own stay untouched."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

PAGE, RESULTS = "index.html", "results.json"
OWN = re.compile(r"index\.html|results\.json|figures/[^/\\]+\.(?:svg|png)|tables/[^/\\]+\.csv")
"""What a report's files are called; a list that names anything else is not obeyed."""


def list_files(figures: Iterable[str], tables: Iterable[str]) -> tuple[str, ...]:
    """List the files of a report.

    Parameters
    ----------
    figures, tables : iterable of str
        Their file names without suffix.

    Returns
    -------
    tuple of str
        Paths relative to the report's folder.
    """
    drawn = (f"figures/{name}.{suffix}" for name in figures for suffix in ("svg", "png"))
    return (RESULTS, PAGE, *drawn, *(f"tables/{name}.csv" for name in tables))


def check_target(target: Path) -> None:
    """Find out whether a report may go to a folder, before minutes are spent on it.

    Parameters
    ----------
    target : Path
        The folder.

    Raises
    ------
    FileExistsError
        If it is a file, or holds a page or results that are not of a former report.
    """
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{target}: got a file, allowed is a folder, there or not; choose another name")
    _refuse_foreign(target, (RESULTS, PAGE))


def replace_report(place: Path, target: Path, *, files: Iterable[str]) -> None:
    """Move a finished report to its folder, over the former one.

    Parameters
    ----------
    place : Path
        Where the finished report lies, on the same file system.
    target : Path
        Its folder, made if it is missing.
    files : iterable of str
        The files of the report, ``results.json`` first.

    Raises
    ------
    FileExistsError
        If a file is in the way that the former report, by its ``results.json``, does not own; nothing is
        changed then.
    OSError
        If a file cannot be moved.
    """
    wanted = tuple(files)
    former = _refuse_foreign(target, wanted)
    for name in former - set(wanted):
        (target / name).unlink(missing_ok=True)
    for name in wanted:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        # The list goes first: a run that is interrupted here leaves files that the next one knows for its own.
        (place / name).replace(target / name)


def _refuse_foreign(target: Path, wanted: Iterable[str]) -> set[str]:
    """Refuse to write over what is not of a former report; say what is."""
    former = _list_former(target)
    foreign = [name for name in wanted if name not in former and (target / name).exists()]
    if foreign:
        why = "is there, but is not of a former report; move it away or choose another folder"
        raise FileExistsError(f"{target / foreign[0]}: {why}")
    return former


def _list_former(target: Path) -> set[str]:
    try:
        content = json.loads((target / RESULTS).read_text(encoding="utf-8"))
        return {name for name in content["files"] if OWN.fullmatch(name)}
    except (OSError, ValueError, TypeError, KeyError):
        return set()
