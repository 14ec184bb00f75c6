"""Build a stimulus set: measure in a first pass, write with the gains in a second, remember what was done.

Both passes go over the recordings in parallel. *Measure* renders what is not remembered at unit gain, keeps it as a
part in m/s² and measures it; *write* gives every stimulus the gain of its level. Between them stands the only thing
that needs the whole set: the gain. Finished files wait in a folder of their own until all are there; then the old
manifest goes, the files move in, and the new manifest comes last. So a set that has a manifest is complete; what a
killed build left unfinished is begun anew.

What a build remembers is `built.jsonl`, a line per stimulus; a damaged line, or one whose file does not hold what it
says, is a stimulus that is made again.
"""

import hashlib
import json
import math
import secrets
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from feel321 import __version__
from feel321.doors import as_path, describe, follow
from feel321.files import (
    digest_file,
    hold_lock,
    make_folder,
    move_files,
    sweep,
    write_bytes,
    write_text,
)
from feel321.jobs import Workers, as_workers, run_jobs
from feel321.stimuli.condition import list_steps
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.recording import Recording, largest
from feel321.stimuli.sets import render
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, write_manifest
from feel321.stimuli.sets.recipe import (
    Recipe,
    Unread,
    check_names,
    describe_recipe,
    find_conditioning,
    read_given,
)
from feel321.stimuli.thresholds import sensation_level_db, to_db
from feel321.stimuli.wav import encode_wav
from feel321.types import PathLike, Progress, Samples

BUILT = "built.jsonl"
PARTS = ".parts"
THREADS = 2  # of a process: transforms release the interpreter, files wait for the disk


@dataclass(frozen=True, slots=True)
class Built:
    """A line of `built.jsonl`: what was measured of a draft, and the row of its file."""

    recording: str
    key: str
    measured: render.Measured
    row: Stimulus


History = Mapping[str, Sequence[Built]]  # what the last build remembers, by recording


def read_history(folder: Path) -> History:
    """Read what the last build remembers; it saves work and is never trusted further."""
    from pydantic import TypeAdapter

    read_line = TypeAdapter(Built).validate_json
    found: defaultdict[str, list[Built]] = defaultdict(list)
    path = folder / BUILT
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            one = read_line(line)
        except ValueError:
            continue
        if one.row.file == Path(one.row.file).name == f"{one.row.stimulus_id}.wav":
            found[one.recording].append(one)
    return found


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
    """What a build keeps of a recording: all but its samples.

    drafts: what is made of it; measured: of each draft, by key; fault: why it cannot be used.
    """

    name: str
    sha256: str = ""
    rate_hz: float = math.nan
    duration_s: float = math.nan
    warnings: tuple[str, ...] = ()
    drafts: tuple[render.Draft, ...] = ()
    measured: Mapping[str, render.Measured] = field(default_factory=dict)
    fault: str = ""

    @classmethod
    def find(cls, one: Recording) -> "Facts":
        """Take the facts of a recording."""
        return cls(one.name, one.sha256, one.rate_hz, one.duration_s, tuple(one.warnings))


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
    recordings: Sequence[Recording | Unread], folder: PathLike, recipe: Recipe, *, workers: int | Workers,
    move: Callable[[int, int], None],
) -> tuple[list[Facts], StimulusSet]:  # fmt: skip
    """Build a stimulus set as `build_stimuli` does; also gives the facts of the recordings."""
    check_names([recording.name for recording in recordings])
    folder, workers = as_path(folder, "folder"), as_workers(workers)
    make_folder(folder)
    busy = "another build is running here; let it finish or stop it first"
    with hold_lock(folder / ".lock", busy=busy):
        for left in folder.glob(f"{PARTS}*"):
            shutil.rmtree(left, ignore_errors=True)
        sweep(folder)
        # A process that was left over from a killed build does not know this name.
        parts = folder / f"{PARTS}-{secrets.token_hex(4)}"
        make_folder(parts)
        steps = count(1)
        threads = 1 if recipe.methods else THREADS  # a lab's own code need not bear more

        def run(work: Callable[..., Any], given: Iterable[tuple[Any, ...]]) -> list[Any]:
            """Do the work for each recording, and return what it gave, in their order."""
            found: dict[int, Any] = {}
            jobs = ((work, one, {"recipe": recipe, "parts": parts}) for one in given)
            for place, result in run_jobs(jobs, workers=workers, threads=threads):
                found[place] = result
                move(next(steps), 2 * len(recordings))
            return [found[place] for place in sorted(found)]

        history = read_history(folder)
        known = [history.get(one.name, ()) for one in recordings]
        facts: list[Facts] = run(survey_recording, zip(recordings, known, strict=True))
        placed = place_surveyed(facts, recipe)
        sources = list(zip(recordings, facts, strict=True))
        orders = [placed[one.name] for one in facts]
        written = run(_write_recording, zip(sources, orders, known, strict=True))
        lines = [line for own in written for line in own]
        stale = {one.row.file for own in history.values() for one in own}
        details = _describe(facts, placed, recipe)
        return facts, _publish(folder, parts, lines, stale=stale, details=details)


def survey_recording(
    given: Recording | Unread, known: Iterable[Built], *, recipe: Recipe, parts: Path | None = None
) -> Facts:
    """Read a recording, and measure its stimuli at unit gain but for those that are known; parts: to keep them."""
    try:
        recording = read_given(given)
    except (OSError, TypeError, ValueError) as error:
        return Facts(given.name, fault=f"recording {given.name!r}: {error}")
    drafts = render.list_drafts(recording, recipe)
    before = {one.key: one.measured for one in known}
    measured = {one.key: before[one.key] for one in drafts if one.key in before}
    new = [one for one in drafts if one.key not in measured]
    try:
        for draft, samples, note in render.render_drafts(recording, new, recipe):
            measured[draft.key] = note
            if parts is not None:
                np.save(_part_path(parts, draft), samples.astype(np.float32))
    except ValueError as error:
        return Facts(given.name, fault=str(error))
    return replace(Facts.find(recording), drafts=drafts, measured=measured)


def _part_path(parts: Path, draft: render.Draft) -> Path:
    return parts / f"{draft.recording}-{draft.key}.npy"


def place_surveyed(surveyed: Sequence[Facts], recipe: Recipe) -> dict[str, list[Foreseen]]:
    """Give stimuli their levels and gains, by recording; refuses with every recording that cannot be used."""
    if faults := [one.fault for one in surveyed if one.fault]:
        raise ValueError("\n".join(faults))
    measured = {key: note for one in surveyed for key, note in one.measured.items()}
    gains = render.choose_gains(measured, recipe, drafts={one.name: one.drafts for one in surveyed})
    return {
        own.name: [
            Foreseen(**asdict(one), measured=measured[one.key], level=level, gain=gains[level, one.key])
            for level in recipe.levels
            for one in own.drafts
        ]
        for own in surveyed
    }  # fmt: skip


def find_copies(facts: Iterable[Facts]) -> list[str]:
    """Name recordings whose files hold the same, bytes for bytes: people would judge one of them twice as often."""
    names: defaultdict[str, list[str]] = defaultdict(list)
    for one in facts:
        names[one.sha256].append(one.name)
    alike = [" and ".join(same) for sha256, same in names.items() if sha256 and len(same) > 1]
    do = "leave one out, unless that is meant"
    return [f"recordings {same} hold the same; {do}" for same in alike]


def _write_recording(
    source: tuple[Recording | Unread, Facts], orders: Sequence[Foreseen], known: Iterable[Built], *, recipe: Recipe,
    parts: Path,
) -> list[Built]:  # fmt: skip
    """Write the files of one recording that are not there already; returns what is to be remembered of all."""
    given, facts = source
    wanted = {(one.stimulus_id, one.key, one.gain) for one in orders}
    rows = {
        one.row.stimulus_id: one.row
        for one in known
        if (one.row.stimulus_id, one.key, one.row.gain) in wanted
        and (path := parts.parent / one.row.file).is_file()
        and digest_file(path) == one.row.sha256
    }
    lacking: defaultdict[str, list[Foreseen]] = defaultdict(list)
    for order in orders:
        if order.stimulus_id not in rows:
            lacking[order.key].append(order)

    def write(key: str, samples: Samples) -> None:
        for order in lacking[key]:
            rows[order.stimulus_id] = _write(order, samples, facts, recipe=recipe, parts=parts)

    missing = []  # nothing was kept of them: they are rendered again
    for key, (first, *_) in lacking.items():
        if (path := _part_path(parts, first)).is_file():
            write(key, np.load(path).astype(np.float64))
            path.unlink()
        else:
            missing.append(first)
    for draft, samples, _ in render.render_drafts(given, missing, recipe):
        write(draft.key, samples.astype(np.float32).astype(np.float64))
    return [Built(one.recording, one.key, one.measured, rows[one.stimulus_id]) for one in orders]


def _write(
    order: Foreseen, rendered: Samples, facts: Facts, *, recipe: Recipe, parts: Path
) -> Stimulus:
    samples = rendered * (order.gain / recipe.full_scale_m_s2)
    clipped = int(np.count_nonzero(np.abs(samples) > 1.0))
    np.clip(samples, -1.0, 1.0, out=samples)
    content, n_samples = encode_wav(samples, recipe.rate_hz), int(samples.shape[-1])
    name = f"{order.stimulus_id}.wav"
    write_bytes(parts / name, content)
    mean_square = np.einsum("...n,...n->...", samples, samples).sum() / n_samples
    sensation = order.sensation_levels_db[recipe.threshold]
    if clipped:
        played = samples * recipe.full_scale_m_s2
        sensation = sensation_level_db(played, recipe.rate_hz, threshold=recipe.threshold)
    measured = order.measured
    return Stimulus(
        stimulus_id=order.stimulus_id, recording=order.recording, reducer=order.reducer, level=order.level,
        role=order.role, file=name, rate_hz=recipe.rate_hz, n_samples=n_samples, duration_s=n_samples / recipe.rate_hz,
        peak=largest(samples), rms_m_s2=float(np.sqrt(mean_square)) * recipe.full_scale_m_s2, gain=order.gain,
        clipped=clipped, sha256=hashlib.sha256(content).hexdigest(), recording_sha256=facts.sha256,
        spectral_match=measured.spectral_match, temporal_match=measured.temporal_match,
        spectral_match_bounded=measured.spectral_match_bounded,
        temporal_match_windowed=measured.temporal_match_windowed,
        sensation_level_db=sensation if np.isfinite(sensation) else math.nan,
        band_high_hz=min(HIGHEST_HZ, facts.rate_hz / 2),
        metrics={k: math.nan if v is None else v for k, v in measured.metrics.items()},
    )  # fmt: skip


def _publish(
    folder: Path, parts: Path, lines: Sequence[Built],
    *, stale: set[str], details: Mapping[str, Any],
) -> StimulusSet:  # fmt: skip
    """Move finished files into the set and remove what is no longer wanted, without a manifest meanwhile."""
    rows = [line.row for line in lines]
    stale = stale - {row.file for row in rows}
    finished = sorted(parts.glob("*.wav"))
    if finished or stale:
        (folder / "manifest.csv").unlink(missing_ok=True)
    move_files({path: folder / path.name for path in finished})
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    remembered = (json.dumps(asdict(line), sort_keys=True) for line in lines)
    write_text(folder / BUILT, "".join(f"{line}\n" for line in remembered))
    published = write_manifest(folder, rows, details=details)
    shutil.rmtree(parts, ignore_errors=True)
    return published


def _describe(
    facts: Iterable[Facts], placed: Mapping[str, Sequence[Foreseen]], recipe: Recipe
) -> dict[str, Any]:
    """Describe what `manifest.json` holds besides the rows: enough to rebuild the set and to find what has changed."""
    levels = {}
    for order in (one for orders in placed.values() for one in orders):
        own = order.sensation_levels_db.items()
        levels[order.stimulus_id] = {name: v if np.isfinite(v) else None for name, v in own}
    return {
        "recipe": describe_recipe(recipe),
        **render.list_methods(recipe),
        "versions": {"feel321": __version__, **render.versions()},
        "conditioning": {
            one.name: list_steps(find_conditioning(recipe, one.name), one.rate_hz) for one in facts
        },
        "sensation_levels_db": levels,
    }
