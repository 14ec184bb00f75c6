"""Whether a stimulus set is what the settings ask for."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.stimuli.sets.manifest import read_details
from feel321.stimuli.sets.recipe import Recipe, describe_recipe
from feel321.stimuli.sets.render import list_methods
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
    built = read_details(folder)
    origins = {row.get("recording", ""): row.get("recording_sha256", "") for row in built.stimuli}
    wanted, own = json.loads(json.dumps([describe_recipe(recipe), list_methods(recipe)]))
    changes = list(_compare_recipes(built.recipe, wanted))
    # The lab's own methods, and further metrics, are there where there are any.
    methods = {kind: getattr(built, kind) for kind in ("reducers", "metrics")}
    changes += _compare_recipes({kind: one for kind, one in methods.items() if one}, own)
    if set(origins) != set(recordings):
        was, named = (", ".join(sorted(names)) for names in (origins, recordings))
        changes.append(f"recordings: built from {was}; the settings name {named}")
    changes += [
        f"recording {name!r}: is not the one that the set was built from"
        for name, sha256 in recordings.items()
        if sha256 is not None and origins.get(name, sha256) != sha256
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
