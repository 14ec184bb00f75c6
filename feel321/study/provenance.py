"""What the built stimulus set was made of, against what the settings ask for today."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.stimuli.sets.recipe import Recipe
    from feel321.study.folder import StudyFolder

MANIFEST_JSON = "manifest.json"


@dataclass(frozen=True, slots=True)
class Origin:
    """What `manifest.json` says.

    recordings: name of each recording -> digest of its source.
    """

    recipe: dict[str, Any]
    rows: list[dict[str, Any]]
    recordings: dict[str, str]


def read_origin(folder: Path) -> Origin:
    """Read what a stimulus set was made of."""
    path = folder / MANIFEST_JSON
    try:
        details = json.loads(path.read_bytes())
        rows = list(details["stimuli"])
        return Origin(
            dict(details["recipe"]),
            rows,
            {row["recording"]: row["recording_sha256"] for row in rows},
        )
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ValueError(
            f"{path}: is missing or damaged ({type(error).__name__}); restore it from a copy, or, as long as no "
            "session was planned with this set, write it anew with: feel321 build"
        ) from None


def find_changes(folder: Path, recipe: Recipe, recordings: Mapping[str, str | None]) -> list[str]:
    """Compare a built set with what the settings ask for; no recording is read for it.

    recordings: name of each recording in the settings -> digest of its source.
    """
    origin = read_origin(folder)
    wanted = json.loads(json.dumps(asdict(recipe)))
    changes = list(_compare_recipes(origin.recipe, wanted))
    if set(origin.recordings) != set(recordings):
        built, named = (", ".join(sorted(names)) for names in (origin.recordings, recordings))
        changes.append(f"recordings: built from {built}; the settings name {named}")
    changes += [
        f"recording {name!r}: is not the one that the set was built from"
        for name, sha256 in recordings.items()
        if sha256 is not None and origin.recordings.get(name, sha256) != sha256
    ]
    return [f"{folder}: {change}" for change in changes]


def is_in_use(study: StudyFolder, stimuli_sha256: str) -> bool:
    """Check whether any plan or journal names a stimulus set."""
    # By the bare text, so that damaged files count too.
    files = study.sessions.glob("*/*.json*")
    return any(stimuli_sha256.encode() in path.read_bytes() for path in files if path.is_file())


def _compare_recipes(
    built: Mapping[str, Any], wanted: Mapping[str, Any], *, table: str = ""
) -> Iterator[str]:
    for key in sorted({*built, *wanted}):
        old, new = built.get(key), wanted.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _compare_recipes(old, new, table=f"{key}.")
        elif old != new:
            yield f"{table}{key}: built with {json.dumps(old)}; the settings say {json.dumps(new)}"
