"""Build a stimulus set: measure in a first pass, write with the gains in a second, remember what was done.

A build runs in two passes over the recordings, each in parallel: *measure* renders what is not remembered and measures
it at unit gain, *write* gives every stimulus the gain of its level arm. Between them stands the only thing that needs
the whole set: the gain. Finished files wait in a folder of their own until all are there; then the old manifest goes,
the files move in, and the new manifest comes last. So a set that has a manifest is complete, and a build that was
killed, or found the disk full, is continued by the next.
"""

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from feel321 import __version__
from feel321.doors import announce, as_path, describe, follow
from feel321.files import hold_lock
from feel321.jobs import Job, Workers, as_workers, run_jobs
from feel321.stimuli.condition import list_steps
from feel321.stimuli.recording import Recording, largest
from feel321.stimuli.sets import render
from feel321.stimuli.sets.anchors import sensation_level_db, to_db
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, write_manifest
from feel321.stimuli.sets.recipe import Recipe, check_names, describe_recipe
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import PathLike, Progress

PARTS = ".parts"
FINISHED = "finished"

THREADS = 2
"""Of a process: transforms release the interpreter, and each file waits for the disk. A lab's own code gets one."""


@dataclass(frozen=True, slots=True)
class History:
    """Results of an earlier build, from `manifest.json`: they save work and are never trusted further.

    rows: by stimulus id; keys: stimulus id -> the key it was rendered under; measured: by key.
    """

    rows: dict[str, Stimulus] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    measured: dict[str, render.Measured] = field(default_factory=dict)


def read_history(folder: Path) -> History:
    """Read the results of an earlier build; if the manifest is missing or damaged, all is built anew."""
    from pydantic import TypeAdapter

    try:
        details = json.loads((folder / "manifest.json").read_bytes())
        further = list(details.get("metrics", {}))
        known = [_fold_row(row, further) for row in details["stimuli"]]
        whole = TypeAdapter(tuple[list[Stimulus], dict[str, str], dict[str, render.Measured]])
        given = (known, details["keys"], details["measured"])
        stimuli, keys, measured = whole.validate_python(given)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return History()
    own = {
        row.stimulus_id: row
        for row in stimuli
        if PurePath(row.file).name == row.file == f"{row.stimulus_id}.wav"
    }
    return History(own, keys, measured)


def _fold_row(row: Mapping[str, Any], further: Sequence[str]) -> dict[str, Any]:
    """Return a row of `manifest.json` as the fields of a Stimulus: what is null is left to their defaults."""
    metrics = {name: math.nan if row[name] is None else row[name] for name in further}
    own = {name: cell for name, cell in row.items() if cell is not None and name not in metrics}
    return own | {"metrics": metrics}


@dataclass(frozen=True, slots=True)
class Foreseen(render.Draft):
    """A stimulus as a build makes it: a draft with its measurements, its level arm and its gain."""

    measured: render.Measured
    level: str
    gain: float

    @property
    def stimulus_id(self) -> str:
        """Id, which is also the name of its file."""
        made = "reference" if self.role == "reference" else self.reducer
        return f"{self.recording}__{made}__{self.level}"

    @property
    def peak_m_s2(self) -> float:
        """Largest magnitude that is played, in m/s²."""
        return self.measured.peak * self.gain

    @property
    def sensation_levels_db(self) -> dict[str, float]:
        """By threshold curve, as it will be played; minus infinity for silence."""
        return {name: to_db(level * self.gain) for name, level in self.measured.levels.items()}


def build_stimuli(
    recordings: Recording | Sequence[Recording],
    folder: PathLike,
    recipe: Recipe | None = None,
    *,
    workers: int | Workers = 1,
    progress: Progress | None = None,
    **changes: Any,  # noqa: ANN401 - fields of a recipe, checked there
) -> StimulusSet:
    """Build a stimulus set, or bring one up to date.

    Parameters
    ----------
    recordings : Recording, or sequence of Recording
        One or more, each with a name of its own that can stand in a file name.
    folder : str or path
        Where to; made if missing. Files of an earlier build that are no longer wanted are removed.
    recipe : Recipe, optional
        What is made of every recording; `Recipe()` if left out.
    workers : int or Workers
        Number of processes, or who else does the work. The result does not depend on it.
    progress : bool or callable, optional
        True for a progress bar, or what is called with (steps done, steps in all) after each step.
    **changes
        Fields of the recipe that are to be different, such as `reducers=["dft321"]`.

    Returns
    -------
    StimulusSet
        What `manifest.csv` holds; its `warnings` name recordings that are played much stronger than recorded.

    Raises
    ------
    ValueError
        If names clash, or a recording cannot be used; nothing already built is harmed.
    BlockingIOError
        If another build is running in the folder.

    Examples
    --------
    >>> import tempfile
    >>> from feel321 import stimuli
    >>> scene = stimuli.make_scene("bumps", duration_s=0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     built = stimuli.build_stimuli(scene, folder, reducers=["say321", "dft321"])
    ...     samples, rate_hz = built.read("bumps__dft321__as_is")
    >>> [stimulus.role for stimulus in built], samples.shape, rate_hz
    (['test', 'test', 'reference', 'anchor', 'anchor'], (24000,), 48000)
    """
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    for one in recordings:
        if not isinstance(one, Recording):
            raise TypeError(f"recordings must each be a Recording, got {describe(one)}")
    recipe = replace(recipe or Recipe(), **changes)
    check_names([recording.name for recording in recordings])
    folder = as_path(folder, "folder")
    folder.mkdir(parents=True, exist_ok=True)
    busy = "another build is running here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy), follow(progress or False, "build") as move:
        return _build(recordings, folder, recipe=recipe, workers=as_workers(workers), move=move)


def _build(
    recordings: Sequence[Recording],
    folder: Path,
    *,
    recipe: Recipe,
    workers: Workers,
    move: Callable[[int, int], None],
) -> StimulusSet:
    parts = _make_parts_folder(folder)
    history = read_history(folder)
    wanted = {recording.name: render.list_drafts(recording, recipe) for recording in recordings}
    new = [r for r in recordings if any(c.key not in history.measured for c in wanted[r.name])]
    total, done = len(new) + len(recordings), count(1)
    measured = dict(history.measured)
    jobs: list[Job] = [
        (render.render_recording, (r, wanted[r.name]), {"recipe": recipe, "parts": parts})
        for r in new
    ]
    threads = 1 if recipe.methods else THREADS
    for _, found in run_jobs(jobs, workers=workers, threads=threads):
        measured.update(found)
        move(next(done), total)
    orders = _place(wanted, measured, recipe)
    how = {"recipe": recipe, "folder": folder, "history": history}
    written: dict[str, Stimulus] = {}
    jobs = [(_write_recording, (r, orders[r.name]), how) for r in recordings]
    for _, rows in run_jobs(jobs, workers=workers.stay_here(), threads=threads):
        written.update((row.stimulus_id, row) for row in rows)
        move(next(done), total)
    in_order = [order for recording in recordings for order in orders[recording.name]]
    details = _list_details(in_order, recipe, recordings)
    stimuli = [written[order.stimulus_id] for order in in_order]
    return _publish(stimuli, folder, history=history, details=details)


def foresee_stimuli(
    recordings: Sequence[Recording],
    folder: Path,
    *,
    recipe: Recipe,
    progress: Callable[[int, int], None] | None = None,
) -> list[Foreseen]:
    """Compute how strong the stimuli of a set will be; nothing is written."""
    measured = dict(read_history(folder).measured)
    wanted = {recording.name: render.list_drafts(recording, recipe) for recording in recordings}
    for done, recording in enumerate(recordings, start=1):
        new = [draft for draft in wanted[recording.name] if draft.key not in measured]
        if new:
            announce(recording.name)
        measured.update(render.measure_recording(recording, new, recipe=recipe))
        if progress:
            progress(done, len(recordings))
    return [one for orders in _place(wanted, measured, recipe).values() for one in orders]


def _publish(
    rows: Sequence[Stimulus], folder: Path, *, history: History, details: Mapping[str, Any]
) -> StimulusSet:
    """Move finished files into the set and remove what is no longer wanted, without a manifest meanwhile."""
    finished = sorted((folder / PARTS / FINISHED).iterdir())
    stale = {row.file for row in history.rows.values()} - {row.file for row in rows}
    if finished or stale:
        (folder / "manifest.csv").unlink(missing_ok=True)
    for path in finished:
        path.replace(folder / path.name)
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    published = write_manifest(folder, rows, details=details)
    shutil.rmtree(folder / PARTS)
    return published


def _make_parts_folder(folder: Path) -> Path:
    """Make the folder of unfinished work; what a killed build had rendered is kept, half-written files are not."""
    parts = folder / PARTS
    shutil.rmtree(parts / FINISHED, ignore_errors=True)
    (parts / FINISHED).mkdir(parents=True)
    for unfinished in [*folder.glob(".*.part"), *parts.glob(".*.part")]:
        unfinished.unlink(missing_ok=True)
    return parts


def _place(
    wanted: Mapping[str, Sequence[render.Draft]],
    measured: Mapping[str, render.Measured],
    recipe: Recipe,
) -> dict[str, list[Foreseen]]:
    keys = {name: [one.key for one in drafts] for name, drafts in wanted.items()}
    gains = render.choose_gains(measured, recipe, recordings=keys)
    return {
        name: [
            Foreseen(
                **asdict(one), measured=measured[one.key], level=level, gain=gains[level, one.key]
            )
            for level in recipe.levels
            for one in drafts
        ]
        for name, drafts in wanted.items()
    }


def _write_recording(
    recording: Recording,
    orders: Sequence[Foreseen],
    *,
    recipe: Recipe,
    folder: Path,
    history: History,
) -> list[Stimulus]:
    """Write the files of one recording that are not there already, and return all their rows."""
    kept = {
        order.stimulus_id: history.rows[order.stimulus_id]
        for order in orders
        if _is_there(order, folder, history)
    }
    changed = [order for order in orders if order.stimulus_id not in kept]
    render.render_recording(recording, changed, recipe=recipe, parts=folder / PARTS)
    written = [_write(one, recording, recipe=recipe, parts=folder / PARTS) for one in changed]
    return [*kept.values(), *written]


def _is_there(order: Foreseen, folder: Path, history: History) -> bool:
    """Whether the earlier build made just this, and its file still holds it."""
    row = history.rows.get(order.stimulus_id)
    key = history.keys.get(order.stimulus_id)
    if row is None or key != order.key or row.gain != order.gain:
        return False
    path = folder / row.file
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == row.sha256


def _write(order: Foreseen, recording: Recording, *, recipe: Recipe, parts: Path) -> Stimulus:
    samples, _ = read_wav(render.part_path(parts, order.key))
    samples *= order.gain / recipe.full_scale_m_s2
    clipped = int(np.count_nonzero(np.abs(samples) > 1.0))
    np.clip(samples, -1.0, 1.0, out=samples)
    path = parts / FINISHED / f"{order.stimulus_id}.wav"
    write_wav(path, samples, recipe.rate_hz)
    mean_square = np.einsum("...n,...n->...", samples, samples).sum() / samples.shape[-1]
    sensation = order.sensation_levels_db[recipe.threshold]
    if clipped:
        played = samples * recipe.full_scale_m_s2
        sensation = sensation_level_db(played, recipe.rate_hz, threshold=recipe.threshold)
    return Stimulus(
        stimulus_id=order.stimulus_id,
        recording=recording.name,
        reducer=order.reducer,
        level=order.level,
        role=order.role,
        file=path.name,
        rate_hz=recipe.rate_hz,
        n_samples=int(samples.shape[-1]),
        duration_s=samples.shape[-1] / recipe.rate_hz,
        peak=largest(samples),
        rms_m_s2=float(np.sqrt(mean_square)) * recipe.full_scale_m_s2,
        gain=order.gain,
        spectral_match=order.measured.spectral_match,
        temporal_match=order.measured.temporal_match,
        clipped=clipped,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        recording_sha256=recording.sha256,
        spectral_match_bounded=order.measured.spectral_match_bounded,
        sensation_level_db=sensation if np.isfinite(sensation) else math.nan,
        metrics={
            name: math.nan if value is None else value
            for name, value in order.measured.metrics.items()
        },
    )


def _list_details(
    orders: Sequence[Foreseen], recipe: Recipe, recordings: Sequence[Recording]
) -> dict[str, Any]:
    """List the other entries of `manifest.json`: enough to rebuild the set and to find what has changed."""
    return {
        "recipe": describe_recipe(recipe),
        **render.list_methods(recipe),
        "conditioning": {r.name: list_steps(recipe.conditioning, r.rate_hz) for r in recordings},
        "versions": {"feel321": __version__, **render.versions()},
        "sensation_levels_db": {
            order.stimulus_id: {
                name: value if np.isfinite(value) else None
                for name, value in order.sensation_levels_db.items()
            }
            for order in orders
        },
        "keys": {order.stimulus_id: order.key for order in orders},
        "measured": {order.key: asdict(order.measured) for order in orders},
    }
