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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from feel321 import __version__
from feel321.doors import announce, as_path, describe, follow
from feel321.files import hold_lock, make_folder, move_files, replace_bytes, sweep
from feel321.jobs import Job, Workers, as_workers, run_jobs
from feel321.stimuli.condition import list_steps
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.recording import Recording, largest
from feel321.stimuli.sets import details, render
from feel321.stimuli.sets.anchors import sensation_level_db, to_db
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, describe_row, write_manifest
from feel321.stimuli.sets.recipe import Recipe, check_names, describe_recipe
from feel321.stimuli.sets.unread import Unread, read_given
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import PathLike, Progress

PARTS = ".parts"
FINISHED = "finished"

ROUNDS = 5
"""In which files are written again that another process replaced, before a build gives up."""

THREADS = 2
"""Of a process: transforms release the interpreter, and each file waits for the disk. A lab's own code gets one."""


@dataclass(frozen=True, slots=True)
class History:
    """Results of an earlier build, from `manifest.json`: they save work and are never trusted further.

    rows: by stimulus id; keys: stimulus id -> the key it was rendered under; measured: by key; ids: by recording.
    """

    rows: dict[str, Stimulus] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    measured: dict[str, render.Measured] = field(default_factory=dict)
    ids: dict[str, list[str]] = field(default_factory=dict)

    def select(self, recording: str) -> "History":
        """Select what is known of the stimuli of one recording."""
        ids = self.ids.get(recording, [])
        keys = {one: self.keys[one] for one in ids if one in self.keys}
        measured = {key: self.measured[key] for key in keys.values() if key in self.measured}
        return History({one: self.rows[one] for one in ids}, keys, measured)


def read_history(folder: Path) -> History:
    """Read the results of an earlier build; if the manifest is missing or damaged, all is built anew."""
    from pydantic import TypeAdapter

    found = History()
    try:
        further = list(details.read_head(folder).get("metrics", {}))
        read_row = TypeAdapter(Stimulus).validate_python
        read_note = TypeAdapter(render.Measured).validate_python
        for kind, key, value in details.iterate_tables(folder, "keys", "measured", "stimuli"):
            if kind == "keys":
                found.keys[key] = str(value)
            elif kind == "measured":
                found.measured[key] = read_note(value)
            else:
                _keep_row(found, read_row(_fold_row(value, further)))
    except details.MISREAD:
        return History()
    return found


def _keep_row(history: History, row: Stimulus) -> None:
    if PurePath(row.file).name == row.file == f"{row.stimulus_id}.wav":
        history.rows[row.stimulus_id] = row
        history.ids.setdefault(row.recording, []).append(row.stimulus_id)


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


@dataclass(frozen=True, slots=True)
class Facts:
    """What a build keeps of a recording: all but its samples. drafts: what is made of it."""

    name: str
    sha256: str
    rate_hz: float
    duration_s: float
    warnings: tuple[str, ...]
    drafts: tuple[render.Draft, ...] = ()

    @classmethod
    def find(cls, recording: Recording, drafts: Iterable[render.Draft] = ()) -> "Facts":
        """Take the facts of a recording."""
        one = recording
        return cls(
            one.name, one.sha256, one.rate_hz, one.duration_s, tuple(one.warnings), tuple(drafts)
        )


class Survey(NamedTuple):
    """Facts of a recording and the measurements of its stimuli by key, or why it cannot be used."""

    facts: Facts | None
    measured: Mapping[str, render.Measured]
    fault: str = ""


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
        if not isinstance(one, Recording | Unread):
            raise TypeError(f"recordings must each be a Recording, got {describe(one)}")
    recipe = replace(recipe or Recipe(), **changes)
    with follow(progress or False, "build") as move:
        return build_set(recordings, folder, recipe, workers=workers, move=move)[1]


def build_set(
    recordings: Sequence[Recording | Unread],
    folder: PathLike,
    recipe: Recipe,
    *,
    workers: int | Workers,
    move: Callable[[int, int], None],
) -> tuple[list[Facts], StimulusSet]:
    """Build a stimulus set as `build_stimuli` does; also gives the facts of the recordings."""
    check_names([recording.name for recording in recordings])
    folder = as_path(folder, "folder")
    make_folder(folder)
    busy = "another build is running here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy):
        crew = _Crew(recipe, folder, read_history(folder), as_workers(workers), move)
        facts, measured = _survey(recordings, crew)
        orders = _place({one.name: one.drafts for one in facts}, measured, recipe)
        given = {one.name: one for one in recordings}

        def order(name: str) -> tuple[Recording | Unread, list[Foreseen], History]:
            return given[name], orders[name], crew.history.select(name)

        jobs = ((_write_recording, order(name)) for name in given)
        stimuli = [row for rows in crew.run(jobs, len(given), before=1) for row in rows]

        def write_again(name: str) -> None:
            _write_recording(*order(name), recipe=recipe, parts=_make_parts_folder(folder))

        _move(stimuli, crew, write_again)
        return facts, _publish(stimuli, crew, _list_details(facts, orders, recipe))


@dataclass(frozen=True, slots=True)
class _Crew:
    """What all steps of a build have in common: where, by which recipe, what was there, and who does the work."""

    recipe: Recipe
    folder: Path
    history: History
    workers: Workers
    move: Callable[[int, int], None]

    def run(self, jobs: Iterable[tuple[Any, Any]], n: int, *, before: int) -> list[Any]:
        """Run n jobs, one per recording, after so many other rounds of two; returns their results in order."""
        found: list[Any] = [None] * n
        how = {"recipe": self.recipe, "parts": _make_parts_folder(self.folder)}
        whole: Iterable[Job] = ((*job, how) for job in jobs)
        threads = 1 if self.recipe.methods else THREADS
        done = count(before * n + 1)
        for place, result in run_jobs(whole, workers=self.workers, threads=threads):
            found[place] = result
            self.move(next(done), 2 * n)
        return found


def _survey(
    recordings: Sequence[Recording | Unread], crew: _Crew
) -> tuple[list[Facts], dict[str, render.Measured]]:
    """Survey all recordings; refuses with every one that cannot be used."""
    jobs = ((survey_recording, (one, crew.history.select(one.name).measured)) for one in recordings)
    return _gather(crew.run(jobs, len(recordings), before=0))


def _gather(surveyed: Iterable[Survey]) -> tuple[list[Facts], dict[str, render.Measured]]:
    facts: list[Facts] = []
    measured: dict[str, render.Measured] = {}
    faults: list[str] = []
    for one in surveyed:
        facts += [one.facts] if one.facts else []
        measured.update(one.measured)
        faults += [one.fault] if one.fault else []
    if faults:
        raise ValueError("\n".join(faults))
    return facts, measured


def survey_recording(
    given: Recording | Unread,
    known: Mapping[str, render.Measured],
    *,
    recipe: Recipe,
    parts: Path | None = None,
) -> Survey:
    """Read a recording, and measure its stimuli at unit gain but for those that are known; parts: to keep them."""
    try:
        recording = read_given(given)
    except (OSError, TypeError, ValueError) as error:
        return Survey(None, {}, f"recording {given.name!r}: {error}")
    drafts = render.list_drafts(recording, recipe)
    measured = {one.key: known[one.key] for one in drafts if one.key in known}
    new = [one for one in drafts if one.key not in measured]
    try:
        if parts is not None:
            measured |= render.render_recording(recording, new, recipe=recipe, parts=parts)
        elif new:
            announce(recording.name)
            measured |= render.measure_recording(recording, new, recipe=recipe)
    except ValueError as error:
        return Survey(None, {}, str(error))
    return Survey(Facts.find(recording, drafts), measured)


def foresee_stimuli(
    recordings: Iterable[Recording | Unread], folder: Path, *, recipe: Recipe
) -> list[Foreseen]:
    """Compute how strong the stimuli of a set will be; nothing is written."""
    history = read_history(folder)
    surveyed = (
        survey_recording(one, history.select(one.name).measured, recipe=recipe)
        for one in recordings
    )
    return place_surveyed(surveyed, recipe)


def find_copies(facts: Iterable[Facts]) -> list[str]:
    """Name recordings whose files hold the same, bytes for bytes: people would judge one of them twice as often."""
    names: dict[str, list[str]] = {}
    for one in facts:
        names.setdefault(one.sha256, []).append(one.name)
    return [
        f"recordings {' and '.join(same)} hold the same; leave one out, unless that is meant"
        for sha256, same in names.items()
        if sha256 and len(same) > 1
    ]


def place_surveyed(surveyed: Iterable[Survey], recipe: Recipe) -> list[Foreseen]:
    """Give stimuli their levels and gains."""
    facts, measured = _gather(surveyed)
    wanted = {one.name: one.drafts for one in facts}
    return [one for orders in _place(wanted, measured, recipe).values() for one in orders]


def _move(rows: Sequence[Stimulus], crew: _Crew, write_again: Callable[[str], None]) -> None:
    """Move finished files into the set, without a manifest meanwhile.

    Who was left over from a killed build may have replaced some since they were written: what was moved is looked at,
    for nobody else writes there.
    """
    folder, finished = crew.folder, crew.folder / PARTS / FINISHED
    for _ in range(ROUNDS):
        there = {path.name for path in finished.iterdir()}
        moved = [row for row in rows if row.file in there]
        if moved:
            (folder / "manifest.csv").unlink(missing_ok=True)
        move_files({finished / row.file: folder / row.file for row in moved})
        changed = {row.recording for row in moved if not _holds(folder / row.file, row.sha256)}
        if not changed:
            return
        for name in sorted(changed):
            write_again(name)
    raise BlockingIOError(
        f"{folder}: a process of an earlier build still writes here; end it and build again"
    )


def _publish(rows: Sequence[Stimulus], crew: _Crew, described: tuple[Any, Any]) -> StimulusSet:
    """Remove what is no longer wanted, without a manifest meanwhile, and write that of the new set."""
    folder = crew.folder
    stale = {row.file for row in crew.history.rows.values()} - {row.file for row in rows}
    if stale:
        (folder / "manifest.csv").unlink(missing_ok=True)
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    head, tables = described
    published = write_manifest(folder, rows, head=head, tables=tables)
    shutil.rmtree(folder / PARTS, ignore_errors=True)
    return published


def _make_parts_folder(folder: Path) -> Path:
    """Make the folder of unfinished work; what a killed build had done is kept, half-written files are not."""
    parts = folder / PARTS
    make_folder(parts / FINISHED)
    sweep(folder)
    return parts


def _place(
    wanted: Mapping[str, Sequence[render.Draft]],
    measured: Mapping[str, render.Measured],
    recipe: Recipe,
) -> dict[str, list[Foreseen]]:
    gains = render.choose_gains(measured, recipe, drafts=wanted)
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
    given: Recording | Unread,
    orders: Sequence[Foreseen],
    history: History,
    *,
    recipe: Recipe,
    parts: Path,
) -> list[Stimulus]:
    """Write the files of one recording that are not there already, and return all their rows.

    A killed build may have written some: a note beside the parts says of each what it holds. Parts that were used go.
    """
    known = {one.stimulus_id: _find_written(one, parts, history) for one in orders}
    changed = [one for one in orders if known[one.stimulus_id] is None]
    if changed:
        recording = read_given(given)
        render.render_recording(recording, changed, recipe=recipe, parts=parts, whole=True)
        for one in changed:
            if not render.part_path(
                parts, one.key
            ).exists():  # used by a recording that is the same
                render.render_recording(recording, [one], recipe=recipe, parts=parts, whole=True)
            row = known[one.stimulus_id] = _write(one, recording, recipe=recipe, parts=parts)
            note = {"key": one.key, "row": describe_row(row)}
            replace_bytes(_note_path(parts, one), json.dumps(note).encode())
    for one in orders:
        render.part_path(parts, one.key).unlink(missing_ok=True)
    return [row for row in known.values() if row is not None]


def _note_path(parts: Path, order: Foreseen) -> Path:
    return parts / f"{order.stimulus_id}.row"


def _find_written(order: Foreseen, parts: Path, history: History) -> Stimulus | None:
    """Find the row of a stimulus that an earlier build, or this one before it was killed, made just so."""
    name, folder = f"{order.stimulus_id}.wav", parts.parent
    row = history.rows.get(order.stimulus_id)
    is_same = history.keys.get(order.stimulus_id) == order.key
    if row and is_same and row.gain == order.gain and _holds(folder / name, row.sha256):
        (parts / FINISHED / name).unlink(missing_ok=True)
        return row
    try:
        note = json.loads(_note_path(parts, order).read_bytes())
        row = Stimulus(**_fold_row(note["row"], list(order.measured.metrics)))
    except details.MISREAD:
        return None
    if note["key"] != order.key or row.gain != order.gain:
        return None
    if _holds(parts / FINISHED / name, row.sha256):
        return row
    (parts / FINISHED / name).unlink(missing_ok=True)  # older; the right one may have been moved
    return row if _holds(folder / name, row.sha256) else None


def _holds(path: Path, sha256: str) -> bool:
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == sha256


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
        temporal_match_windowed=order.measured.temporal_match_windowed,
        band_high_hz=min(HIGHEST_HZ, recording.rate_hz / 2),
        metrics={
            name: math.nan if value is None else value
            for name, value in order.measured.metrics.items()
        },
    )


def _list_details(
    facts: Sequence[Facts], placed: Mapping[str, Sequence[Foreseen]], recipe: Recipe
) -> tuple[dict[str, Any], dict[str, Iterator[tuple[str, Any]]]]:
    """List the other entries of `manifest.json`: enough to rebuild the set and to find what has changed."""
    orders = [one for own in placed.values() for one in own]
    by_id = sorted(orders, key=lambda one: one.stimulus_id)
    by_key = sorted({one.key: one for one in orders}.values(), key=lambda one: one.key)
    rates = {one.name: one.rate_hz for one in facts}
    head = {
        "recipe": describe_recipe(recipe),
        **render.list_methods(recipe),
        "versions": {"feel321": __version__, **render.versions()},
    }
    return head, {
        "conditioning": (
            (name, list_steps(recipe.conditioning, rates[name])) for name in sorted(rates)
        ),
        "sensation_levels_db": ((one.stimulus_id, _describe_levels(one)) for one in by_id),
        "keys": ((one.stimulus_id, one.key) for one in by_id),
        "measured": ((one.key, asdict(one.measured)) for one in by_key),
    }


def _describe_levels(order: Foreseen) -> dict[str, float | None]:
    levels = order.sensation_levels_db.items()
    return {name: value if np.isfinite(value) else None for name, value in levels}
