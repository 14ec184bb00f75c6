"""What a report was made from: files, choices and what was handed over, each with its digest, for ``results.json``."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from analysis.table.labels import ROSTER_FILE
from analysis.table.sources import find_sources, tell_recordings

if TYPE_CHECKING:
    from pathlib import Path

    from analysis.report.sections.choices import Choices
    from analysis.table.further import Further
    from analysis.table.reading import Table


def describe_inputs(
    ratings: Path, manifest: Path, *, table: Table, further: Further | None, choices: Choices
) -> dict[str, str]:
    """Describe everything that decides a report.

    Parameters
    ----------
    ratings, manifest : Path
        The two files.
    table : Table
        What was read from them.
    further : Further or None
        Metrics that were handed over.
    choices : Choices
        What was chosen.

    Returns
    -------
    dict of str to str
        Names and SHA-256 digests of the files, of ``participants.csv`` if there is one, of sources where several
        recordings have one, and of metrics handed over; then the choices.
    """
    roster = ratings.with_name(ROSTER_FILE)
    return {
        **_describe_file("ratings", ratings),
        **_describe_file("manifest", manifest),
        **(_describe_file("participants", roster) if roster.is_file() else {}),
        **_describe_sources(table),
        **({} if further is None or further.metrics.empty else _describe_further(further)),
        "metrics": ", ".join(table.metrics),
        **_tell_choices(choices),
    }


def _describe_file(role: str, path: Path) -> dict[str, str]:
    return {role: path.name, f"{role}_sha256": _digest(path.read_bytes())}


def _describe_sources(table: Table) -> dict[str, str]:
    found = find_sources(table.rows)
    if found.is_unique:
        return {}
    told = json.dumps(found.to_dict(), sort_keys=True).encode()
    return {"sources": tell_recordings(len(found), found.nunique()), "sources_sha256": _digest(told)}


def _describe_further(further: Further) -> dict[str, str]:
    text = further.metrics.sort_index().to_csv(float_format="%.17g", lineterminator="\n").encode()
    return {"further_metrics": ", ".join(map(str, further.metrics)), "further_metrics_sha256": _digest(text)}


def _tell_choices(choices: Choices) -> dict[str, str]:
    return {name: "from repeated ratings" if value is None else str(value) for name, value in asdict(choices).items()}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
