"""The manifest of a stimulus set: one row per stimulus, the recipe that made it, and a check of the files.

`manifest.csv` holds the rows; `manifest.json` the same, the recipe, the software's versions, and the unit of every
column. Both are written last, whole or not at all, so a set with a manifest is complete. Both are read through one
model each: one that is damaged is one line that names it.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.arguments import Registry, as_path
from feel321.files import digest_file, list_csv, open_text, read_bytes, word_fault, write_text
from feel321.records import Result
from feel321.stimuli.wav import read_wav, read_wav_header
from feel321.types import ANCHOR, PathLike, Samples

if TYPE_CHECKING:
    from pandas import DataFrame
    from pydantic import TypeAdapter


@dataclass(frozen=True, slots=True)
class Stimulus:
    """One row of the manifest; `COLUMN_UNITS` gives the meaning and unit of each field.

    Parameters
    ----------
    stimulus_id, recording, reducer, level, role, file : str
        What it is, and where.
    rate_hz : float
        Its rate.
    n_samples : int
        Its length per channel.
    duration_s, peak, rms_m_s2, gain, spectral_match, temporal_match : float
        How long and how strong it is, and how well it matches its recording; NaN where nothing could be compared.
    clipped : int
        How many samples were limited.
    sha256, recording_sha256 : str
        The digests of the file and of its source.
    spectral_match_bounded, sensation_level_db, temporal_match_windowed, band_high_hz : float
        Further numbers; the sensation level is NaN for silence.
    metrics : Mapping of str to float
        Further metrics, each a column of its own; NaN where nothing could be compared.
    """

    stimulus_id: str
    recording: str
    reducer: str
    level: str
    role: str
    file: str
    rate_hz: float
    n_samples: int
    duration_s: float
    peak: float
    rms_m_s2: float
    gain: float
    spectral_match: float
    temporal_match: float
    clipped: int
    sha256: str
    recording_sha256: str
    spectral_match_bounded: float = math.nan
    sensation_level_db: float = math.nan
    temporal_match_windowed: float = math.nan
    band_high_hz: float = math.nan
    metrics: Mapping[str, float] = field(default_factory=dict)


COLUMN_UNITS = {
    "stimulus_id": "name, unique in the set",
    "recording": "name",
    "reducer": "name of a reducer, 'original' for the three-axis recording, or name of an anchor",
    "level": "name of the level arm",
    "role": "test, reference or anchor",
    "file": "path relative to the manifest",
    "rate_hz": "Hz",
    "n_samples": "samples per channel",
    "duration_s": "s",
    "peak": "largest magnitude in the file, 1 = full scale",
    "rms_m_s2": "m/s^2, root mean square that the actuators are to give (of all channels together)",
    "gain": "m/s^2 played per m/s^2 recorded; per m/s^2 of an anchor that was made as strong as its recording (lower "
            "than its recording's where it would not fit the headroom)",
    "spectral_match": "1 = identical energy spectra; conditioned recording and reduced signal, before level and rate",
    "temporal_match": "1 = perfectly correlated with every axis (as for spectral_match)",
    "clipped": "samples limited at full scale",
    "sha256": "digest of the file",
    "recording_sha256": "digest of the recording's source",
    "spectral_match_bounded": "0 to 1, 1 = identical energy spectra; deviations relative to the stronger of the two",
    "sensation_level_db": "dB over the detection threshold of the recipe, as it will be played, in its loudest 200 ms",
    "temporal_match_windowed": "as temporal_match, in windows of about 0.1 s, averaged by the recording's energy",
    "band_high_hz": "Hz, upper edge of the band from 20 Hz in which the recording can be matched: 1000, or half its "
                    "rate if lower",
}  # fmt: skip
COLUMNS = tuple(COLUMN_UNITS)
DETAILS = "manifest.json"
FURTHER = COLUMNS[COLUMNS.index("recording_sha256") + 1 :]  # their cells may be empty
STRONG_GAIN = 100.0  # 40 dB: such a recording is mostly sensor noise, or its unit is wrong
ROUNDING = 1e-9  # in an anchor's temporal match, which is 0; so may a silent test stimulus's be


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class StimulusSet(Result):
    """A built set: it has a length, can be iterated over, and indexed by stimulus id.

    Parameters
    ----------
    folder : Path
        Where it is.
    stimuli : tuple of Stimulus
        Its stimuli, in the manifest's order.
    sha256 : str
        Digest of `manifest.csv`.
    """

    folder: Path
    stimuli: tuple[Stimulus, ...]
    sha256: str

    def __len__(self) -> int:
        """Count the stimuli."""
        return len(self.stimuli)

    def __iter__(self) -> Iterator[Stimulus]:
        """Iterate over the stimuli."""
        return iter(self.stimuli)

    def __getitem__(self, stimulus_id: str | int) -> Stimulus:
        """Return the stimulus of an id, or of a place in the manifest's order."""
        if isinstance(stimulus_id, int):
            return self.stimuli[stimulus_id]
        return Registry("stimulus_id", {row.stimulus_id: row for row in self})[stimulus_id]

    def __repr__(self) -> str:
        """Count the stimuli and say where they are."""
        return f"StimulusSet({len(self)} stimuli in {str(self.folder)!r})"

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each recording that is played more than 40 dB stronger than it was recorded."""
        felt = (row for row in self if row.role != ANCHOR)
        return find_raised((row.recording, row.level, row.gain) for row in felt)

    def to_frame(self) -> DataFrame:
        """Return the manifest as a table.

        Returns
        -------
        DataFrame
            A row per stimulus; the columns are those of `manifest.csv`.
        """
        import pandas as pd

        return pd.DataFrame([_flatten(row) for row in self])

    def read(self, stimulus_id: str) -> tuple[Samples, int]:
        """Read the samples of a stimulus.

        Parameters
        ----------
        stimulus_id : str
            Which one.

        Returns
        -------
        samples : ndarray of float64, shape (n_samples,) or (3, n_samples)
            Samples as shares of full scale.
        rate_hz : int
            Sampling rate in Hz.
        """
        return read_wav(self.folder / self[stimulus_id].file)


def find_raised(gains: Iterable[tuple[str, str, float]]) -> tuple[str, ...]:
    """Name recordings played over 40 dB stronger than recorded; gains: recording, arm, gain: the least counts."""
    least = defaultdict[str, defaultdict[str, float]](lambda: defaultdict(lambda: math.inf))
    for recording, level, gain in gains:
        least[recording][level] = min(gain, least[recording][level])
    raised = {recording: max(own.values()) for recording, own in least.items()}
    return tuple(
        f"{name}: played {20 * math.log10(gain):.0f} dB stronger than it was recorded (gain {gain:.3g}); is it "
        "more than sensor noise, and its unit right? If not, leave it out"
        for name, gain in raised.items()
        if gain > STRONG_GAIN
    )


def write_manifest(
    folder: Path, stimuli: Sequence[Stimulus], *, details: Mapping[str, Any]
) -> StimulusSet:
    """Write `manifest.json`, then `manifest.csv`, each whole or not at all; details: what else the first holds."""
    rows = [describe_row(one) for one in stimuli]
    table = "".join(list_csv((*COLUMNS, *stimuli[0].metrics), rows))
    built = StimulusSet(folder, tuple(stimuli), hashlib.sha256(table.encode()).hexdigest())
    own = {}
    for name, facts in details.get("metrics", {}).items():
        low, high = (facts.get(end) for end in ("low", "high"))
        ends = f"{'-inf' if low is None else low} to {'inf' if high is None else high}"
        unit = f" in {facts['unit']}" if facts.get("unit") else ""
        own[name] = f"{facts['label']}{unit}, {ends}; higher is {facts['higher']}"
    whole = {**details, "columns": COLUMN_UNITS | own, "stimuli": rows}
    if built.warnings:
        whole["warnings"] = built.warnings
    write_text(folder / DETAILS, f"{json.dumps(whole, indent=1, sort_keys=True)}\n")
    write_text(folder / "manifest.csv", table)
    return built


def describe_row(stimulus: Stimulus) -> dict[str, Any]:
    """Return a row as CSV and JSON hold it: a number that is not known is an empty cell, or null."""
    row = _flatten(stimulus)
    return row | {name: None for name in (*FURTHER, *stimulus.metrics) if math.isnan(row[name])}


def _flatten(stimulus: Stimulus) -> dict[str, Any]:
    """Return a row with its further metrics as columns."""
    row = asdict(stimulus)
    del row["metrics"]
    return row | dict(stimulus.metrics)


@dataclass(frozen=True, slots=True)
class Details:
    """What is read of `manifest.json`; reducers, metrics: the lab's own, and further metrics, by name."""

    recipe: dict[str, Any]
    stimuli: list[dict[str, Any]]
    reducers: dict[str, dict[str, Any]] = field(default_factory=dict)
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)


def read_details(folder: Path) -> Details:
    """Read `manifest.json`."""
    from pydantic import TypeAdapter

    path = folder / DETAILS
    try:
        return TypeAdapter(Details).validate_json(read_bytes(path))
    except (OSError, ValueError) as error:
        reason = type(error).__name__ if isinstance(error, OSError) else word_fault(error)
        do = "restore it from a copy, or, as long as no session was planned with this set, write it anew with"
        raise ValueError(f"{path}: is missing or damaged ({reason}); {do}: feel321 build") from None


def find_methods(folder: Path) -> dict[str, str]:
    """Find the lab's own reducers and metrics of a set, with the digests of their code; empty where none are known."""
    try:
        details = read_details(folder)
    except ValueError:
        return {}
    entries = details.reducers | details.metrics
    own = {name: one for name, one in entries.items() if one.get("method") != "feel321"}
    return {name: str(one.get("sha256")) for name, one in own.items()}


def read_stimuli(folder: PathLike) -> StimulusSet:
    """Read a built stimulus set.

    Parameters
    ----------
    folder : str or path
        Where `build_stimuli` built it.

    Returns
    -------
    StimulusSet
        Its stimuli, in the manifest's order.

    Raises
    ------
    FileNotFoundError
        If there is no manifest.
    ValueError
        If the manifest is damaged; the message names the line.
    """
    from pydantic import TypeAdapter

    path = as_path(folder, "folder") / "manifest.csv"
    if not path.is_file():
        do = "build the stimulus set first (feel321 build)"
        raise FileNotFoundError(f"{path}: there is no manifest; {do}")
    sha256, line = digest_file(path), 1
    model, stimuli = TypeAdapter(Stimulus), list[Stimulus]()
    try:
        with open_text(path) as text:
            for row in csv.DictReader(text, strict=True):
                line += 1
                stimuli.append(_read_row(row, model))
    except csv.Error as error:
        raise ValueError(f"{path}: not a CSV table ({error}); build the set again") from None
    except ValueError as error:
        said = word_fault(error).removeprefix(f"{path.name}: ")
        raise ValueError(f"{path}, line {line}: {said}; build the set again") from None
    if not stimuli:
        raise ValueError(f"{path}: holds no stimulus; build the set again")
    return StimulusSet(path.parent, tuple(stimuli), sha256)


def _read_row(row: dict[str, str], model: TypeAdapter[Stimulus]) -> Stimulus:
    """Read the cells of a line; empty ones of further metrics are not known."""
    own = {name: row.get(name) for name in COLUMNS if row.get(name) or name not in FURTHER}
    metrics = {name: cell or math.nan for name, cell in row.items() if name not in COLUMNS}
    found = model.validate_python(own | {"metrics": metrics})
    if Path(found.file).name != found.file:
        raise ValueError(f"file must be a name in the set's own folder, got {found.file!r}")
    return found


def check_stimuli(folder: PathLike) -> list[str]:
    """Check a built set before a study starts: files, digests, clipping, and whether its anchors can serve as anchors.

    Parameters
    ----------
    folder : str or path
        Where `build_stimuli` built it.

    Returns
    -------
    list of str
        Every problem in one line, with what to do; empty if there is none.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.check_stimuli("no_such_folder")
    ['no_such_folder/manifest.csv: there is no manifest; build the stimulus set first (feel321 build)']
    """
    try:
        built = read_stimuli(folder)
    except (OSError, ValueError) as error:
        return [str(error)]
    problems = [problem for stimulus in built for problem in _check_file(stimulus, built.folder)]
    strangers = {path.name for path in built.folder.glob("*.wav")} - {one.file for one in built}
    do = "not in the manifest; move it away, or build the set again"
    problems += [f"{name}: {do}" for name in sorted(strangers)]
    together = defaultdict(list)
    for stimulus in built:
        together[stimulus.recording, stimulus.level].append(stimulus)
    return problems + [one for _, rows in sorted(together.items()) for one in _check_anchors(rows)]


def _check_file(stimulus: Stimulus, folder: Path) -> Iterator[str]:
    name, path = stimulus.file, folder / stimulus.file
    if not path.is_file():
        yield f"{name}: missing; build the set again"
    elif digest_file(path) != stimulus.sha256:
        yield f"{name}: was changed after it was built (its SHA-256 differs); build the set again"
    else:
        if stimulus.clipped:
            yield f"{name}: {stimulus.clipped} samples clipped; lower the gain or raise full_scale_m_s2"
        try:
            header = read_wav_header(path)
        except ValueError as error:
            yield str(error)
            return
        n, rate = header.data_bytes // header.frame_bytes, header.rate_hz
        if n != stimulus.n_samples or rate != stimulus.rate_hz:
            yield f"{name}: {n} samples at {rate} Hz, but the manifest says otherwise; build again"


def _check_anchors(stimuli: Sequence[Stimulus]) -> Iterator[str]:
    """Anchors must score below every test stimulus of their recording, on both metrics."""
    tests = [stimulus for stimulus in stimuli if stimulus.role == "test"]
    do = "leave out that recording or that reducer, or set anchors = false"
    for anchor in (stimulus for stimulus in stimuli if stimulus.role == ANCHOR):
        own = f"spectral match {anchor.spectral_match:.3g}, temporal {anchor.temporal_match:.3g}"
        for test in tests:
            better = anchor.spectral_match >= test.spectral_match
            if better or anchor.temporal_match > test.temporal_match + ROUNDING:
                other = f"{test.spectral_match:.3g}, {test.temporal_match:.3g}"
                lead = f"{anchor.stimulus_id}: {own}, not below {test.stimulus_id} ({other})"
                yield f"{lead}; an anchor must be worse than every test: {do}"
