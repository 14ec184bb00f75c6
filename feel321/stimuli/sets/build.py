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
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from feel321 import __version__, files
from feel321.arguments import as_path, describe, follow
from feel321.jobs import Workers, gather_results
from feel321.stimuli.condition import list_steps
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.recording import Recording, largest
from feel321.stimuli.sets import recipe as recipes
from feel321.stimuli.sets import render
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, write_manifest
from feel321.stimuli.sets.recipe import Recipe, Unread
from feel321.stimuli.thresholds import sensation_level_db, to_db
from feel321.stimuli.wav import encode_wav
from feel321.types import ANCHOR, WRITTEN, PathLike, Progress, Samples

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


def read_history(folder: Path) -> Mapping[str, Sequence[Built]]:
    """Read what the last build remembers, by recording; it saves work and is never trusted further."""
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
    recipes.check_names([recording.name for recording in recordings])
    folder = as_path(folder, "folder")
    files.make_folder(folder)
    busy = "another build is running here; let it finish or stop it first"
    with files.hold_lock(folder / ".lock", busy=busy):
        for left in folder.glob(f"{PARTS}*"):
            shutil.rmtree(left, ignore_errors=True)
        files.sweep(folder)
        # A process that was left over from a killed build does not know this name.
        parts = folder / f"{PARTS}-{secrets.token_hex(4)}"
        files.make_folder(parts)
        named: dict[str, Any] = {"recipe": recipe, "parts": parts}
        steps, total = count(1), 2 * len(recordings)
        run = partial(gather_results, workers=workers, done=lambda: move(next(steps), total))
        # A lab's own code need not bear more than one thread.
        run = partial(run, threads=1 if recipe.methods else THREADS)
        history = read_history(folder)
        known = [history.get(one.name, ()) for one in recordings]
        surveyed = zip(recordings, known, strict=True)
        facts: list[Facts] = run((survey_recording, one, named) for one in surveyed)
        placed = place_surveyed(facts, recipe)
        sources = zip(recordings, facts, known, strict=True)
        written = run(
            (_write_recording, source, named | {"orders": placed[source[1].name]})
            for source in sources
        )
        lines: list[Built] = [line for own in written for line in own]
        # What is remembered is in alphabetical order, the columns of a set are in that of its recipe.
        rows = [
            replace(line.row, metrics={name: line.row.metrics[name] for name in recipe.metrics})
            for line in lines
        ]
        finished = sorted(parts.glob("*.wav"))
        stale = {one.row.file for own in history.values() for one in own}
        stale -= {row.file for row in rows}
        if finished or stale:  # the set has no manifest meanwhile
            (folder / "manifest.csv").unlink(missing_ok=True)
        files.move_files({path: folder / path.name for path in finished})
        for name in stale:
            (folder / name).unlink(missing_ok=True)
        remembered = (json.dumps(asdict(line), sort_keys=True) for line in lines)
        files.write_text(folder / BUILT, "".join(f"{line}\n" for line in remembered))
        stimuli = write_manifest(folder, rows, details=_describe(facts, placed, recipe))
        shutil.rmtree(parts, ignore_errors=True)
    return facts, stimuli


def survey_recording(
    given: Recording | Unread, known: Iterable[Built], *, recipe: Recipe, parts: Path | None = None
) -> Facts:
    """Read a recording, and measure its stimuli at unit gain but for those that are known; parts: to keep them."""
    try:
        recording = recipes.read_given(given)
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
    """Give stimuli their levels and gains, by recording; refuses with every recording that cannot be used.

    What sets a common gain is the loudest stimulus that is no anchor; an anchor is weaker where it would not fit.
    """
    if faults := [one.fault for one in surveyed if one.fault]:
        raise ValueError("\n".join(faults))
    room, threshold = recipe.headroom * recipe.full_scale_m_s2, recipe.threshold
    given = {name: one["gain"] for name, one in recipe.exceptions.items() if "gain" in one}
    placed: dict[str, list[Foreseen]] = {one.name: [] for one in surveyed}
    for level in recipe.levels:
        is_equal = level != "as_is"
        groups: defaultdict[tuple[str, float | str], list[Facts]] = defaultdict(list)
        for one in surveyed:
            gain = recipe.gain if is_equal else given.get(one.name, recipe.gain)
            is_alone = recipe.gain == recipes.GAIN_PER_RECORDING or gain != recipe.gain
            groups[one.name * is_alone, gain].append(one)
        for (_, gain), group in groups.items():
            # Each with the level over the threshold that is made equal, at unit gain; as it is, with none.
            notes = [
                (draft, note, note.levels[threshold] if is_equal else 1.0)
                for own in group
                for draft in own.drafts
                for note in [own.measured[draft.key]]
            ]
            if silent := sum(strength == 0.0 for _, _, strength in notes):
                why = f"{silent} stimuli are silent between 20 and 1000 Hz and cannot be made as strong"
                raise ValueError(f"equal_intensity: {why}; leave out this level, or what is silent")
            peaks = [note.peak / each for draft, note, each in notes if draft.role != ANCHOR]
            loudest = max(peaks, default=0.0)
            common = room / loudest if loudest else 1.0
            common = common if is_equal or isinstance(gain, str) else gain
            for draft, note, each in notes:
                most = room / note.peak if draft.role == ANCHOR else math.inf
                chosen = min(common / each, most)
                made = Foreseen(**asdict(draft), measured=note, level=level, gain=chosen)
                placed[draft.recording].append(made)
    return placed


def _write_recording(
    given: Recording | Unread, facts: Facts, known: Iterable[Built], *, orders: Sequence[Foreseen],
    recipe: Recipe, parts: Path,
) -> list[Built]:  # fmt: skip
    """Write the files of one recording that are not there already; returns what is to be remembered of all."""
    wanted = {(one.stimulus_id, one.key, one.gain) for one in orders}
    rows = {
        one.row.stimulus_id: one.row
        for one in known
        if (one.row.stimulus_id, one.key, one.row.gain) in wanted
        and (path := parts.parent / one.row.file).is_file()
        and files.digest_file(path) == one.row.sha256
    }
    lacking: defaultdict[str, list[Foreseen]] = defaultdict(list)
    for order in orders:
        if order.stimulus_id not in rows:
            lacking[order.key].append(order)
    kept = [key for key, (one, *_) in lacking.items() if _part_path(parts, one).is_file()]
    missing = [one for key, (one, *_) in lacking.items() if key not in kept]  # rendered again
    stored = ((key, np.load(_part_path(parts, lacking[key][0]))) for key in kept)
    again = render.render_drafts(given, missing, recipe)
    rendered = ((draft.key, samples.astype(np.float32)) for draft, samples, _ in again)
    for key, samples in chain(stored, rendered):
        for order in lacking[key]:
            own = _write(order, samples.astype(np.float64), facts, recipe=recipe, parts=parts)
            rows[order.stimulus_id] = own
        _part_path(parts, lacking[key][0]).unlink(missing_ok=True)
    return [Built(one.recording, one.key, one.measured, rows[one.stimulus_id]) for one in orders]


def _write(
    order: Foreseen, rendered: Samples, facts: Facts, *, recipe: Recipe, parts: Path
) -> Stimulus:
    samples = rendered * (order.gain / recipe.full_scale_m_s2)
    clipped = int(np.count_nonzero(np.abs(samples) > 1.0))
    np.clip(samples, -1.0, 1.0, out=samples)
    content, n_samples = encode_wav(samples, recipe.rate_hz), int(samples.shape[-1])
    name = f"{order.stimulus_id}.wav"
    files.write_bytes(parts / name, content)
    mean_square = np.einsum("...n,...n->...", samples, samples).sum() / n_samples
    sensation = order.sensation_levels_db[recipe.threshold]
    if clipped:
        played = samples * recipe.full_scale_m_s2
        sensation = sensation_level_db(played, recipe.rate_hz, threshold=recipe.threshold)
    measured = order.measured
    matches: dict[str, Any] = {match: getattr(measured, match) for match in WRITTEN}
    return Stimulus(
        stimulus_id=order.stimulus_id, recording=order.recording, reducer=order.reducer, level=order.level,
        role=order.role, file=name, rate_hz=recipe.rate_hz, n_samples=n_samples, duration_s=n_samples / recipe.rate_hz,
        peak=largest(samples), rms_m_s2=float(np.sqrt(mean_square)) * recipe.full_scale_m_s2, gain=order.gain,
        clipped=clipped, sha256=hashlib.sha256(content).hexdigest(), recording_sha256=facts.sha256, **matches,
        sensation_level_db=sensation if np.isfinite(sensation) else math.nan,
        band_high_hz=min(HIGHEST_HZ, facts.rate_hz / 2),
        metrics={k: math.nan if v is None else v for k, v in measured.metrics.items()},
    )  # fmt: skip


def _describe(
    facts: Iterable[Facts], placed: Mapping[str, Sequence[Foreseen]], recipe: Recipe
) -> dict[str, Any]:
    """Describe what `manifest.json` holds besides the rows: enough to rebuild the set and to find what has changed."""
    levels = {}
    for order in (one for orders in placed.values() for one in orders):
        own = order.sensation_levels_db.items()
        levels[order.stimulus_id] = {name: v if np.isfinite(v) else None for name, v in own}
    return {
        "recipe": recipes.describe_recipe(recipe),
        **render.list_methods(recipe),
        "versions": {"feel321": __version__, **render.versions()},
        "conditioning": {
            one.name: list_steps(recipes.find_conditioning(recipe, one.name), one.rate_hz)
            for one in facts
        },
        "sensation_levels_db": levels,
    }
