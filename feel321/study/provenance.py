"""Whether a stimulus set is what the settings ask for."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.stimuli.sets.recipe import Recipe, describe_recipe
from feel321.stimuli.sets.render import list_methods
from feel321.study.folder import read_origin
from feel321.study.settings.read import make_recipe

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings


def require_current_set(study: StudyFolder, settings: Settings) -> None:
    """Check that the stimulus set is the one of the settings; no recording is read for it."""
    named = dict.fromkeys(entry.title for entry in settings.recordings)
    if changes := find_changes(study.stimuli, make_recipe(settings, study.path), named):
        raise ValueError(
            "\n".join(f"{change}; run feel321 build {quote(str(study.path))}" for change in changes)
        )


def find_changes(folder: Path, recipe: Recipe, recordings: Mapping[str, str | None]) -> list[str]:
    """Compare a built set with what the settings ask for; no recording is read for it.

    recordings: name of each recording in the settings -> digest of its source.
    """
    origin = read_origin(folder)
    wanted = json.loads(json.dumps(describe_recipe(recipe)))
    changes = list(_compare_recipes(origin.recipe, wanted))
    changes += _compare_recipes(origin.methods, json.loads(json.dumps(list_methods(recipe))))
    if set(origin.recordings) != set(recordings):
        built, named = (", ".join(sorted(names)) for names in (origin.recordings, recordings))
        changes.append(f"recordings: built from {built}; the settings name {named}")
    changes += [
        f"recording {name!r}: is not the one that the set was built from"
        for name, sha256 in recordings.items()
        if sha256 is not None and origin.recordings.get(name, sha256) != sha256
    ]
    return [f"{folder}: {change}" for change in changes]


def _compare_recipes(
    built: Mapping[str, Any], wanted: Mapping[str, Any], *, table: str = ""
) -> Iterator[str]:
    for key in sorted({*built, *wanted}):
        old, new = built.get(key), wanted.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _compare_recipes(old, new, table=f"{table}{key}.")
        elif old != new:
            yield f"{table}{key}: built with {json.dumps(old)}; the settings say {json.dumps(new)}"
