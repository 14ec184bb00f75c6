"""Golden vectors as files, for a reducer in another language: `feel321 port FOLDER`, your port, `--check`.

A folder holds each input twice, as `NAME.csv` (a row per sample, `x,y,z`) and `NAME.wav` (three channels, float32); a
port answers with `NAME.out.csv` (a number per line) or `NAME.out.wav` (one channel). `vectors.json` lists them, for a
stream with the blocks and gaps in which they are fed, and says which form is checked.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from feel321.doors import check_name
from feel321.files import make_folder, write_text
from feel321.stimuli import conform
from feel321.stimuli import conform_stream as streams
from feel321.stimuli.conform import FILE_TOLERANCE, RATE_HZ, Conformity, Judged
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import PathLike, Samples

_Vector: TypeAlias = conform.GoldenVector | streams.StreamVector

STREAMING = "streaming"
FORMS = (*conform.FORMS, STREAMING)
LIST, READ_ME = "vectors.json", "README.txt"

NOT_THERE = 999.0
"""What the files hold in a gap; it must not be used."""

ROUGH_TOLERANCE = 0.03
"""Of answers in files, where the axes almost cancel; the wrong phase is off by 2."""

_HOW = """Golden vectors of feel321 for {what}, at 1000 Hz.

Each input is here twice: NAME.csv (a row per sample: x,y,z) and NAME.wav (three channels, float32).
Answer each with NAME.out.csv (a number per line, no header) or NAME.out.wav (one channel, float32), of {length}.
{more}
Answers may be computed in 32 bits: 1e-5 of the peak is allowed, 0.03 where the axes almost cancel.
Then: feel321 port {folder} --check

MATLAB, with a function y = my_dft321(a, rate_hz) of your own, a of n x 3:

  for f = dir('*.csv')'
      if endsWith(f.name, '.out.csv'), continue, end
      y = my_dft321(readmatrix(f.name), 1000);
      writematrix(y(:), strrep(f.name, '.csv', '.out.csv'));
  end
"""
_WHOLE = (
    "Where the axes cancel at a frequency, equation 4 leaves the phase open: any phase agrees with the paper, and the\n"
    "check says how many vectors differ from feel321 for that reason only."
)
_FED = (
    "vectors.json says for each input in which blocks it is fed, and which samples (first, end) are missing and are\n"
    "to be held or silent (on_gap); the files hold 999 there."
)


def write_port(
    folder: PathLike, *, form: str = "whole", reducer: str = streams.OPEN_PHASE
) -> list[Path]:
    """Write the inputs, their list and how to answer them; returns the WAV files."""
    check_name(form, FORMS, "form")
    place = Path(folder)
    make_folder(place)
    vectors = list(_list_vectors(form, reducer))
    paths = [_write_input(place, vector) for vector in vectors]
    kind = {"form": form, "reducer": reducer} if form == STREAMING else {"form": form}
    content = {**kind, "rate_hz": RATE_HZ, "vectors": [_describe(vector) for vector in vectors]}
    write_text(place / LIST, json.dumps(content, indent=1) + "\n")
    what, length, more = (
        (f"the stream of {reducer}", "the input's length plus one latency, the same for all", _FED)
        if form == STREAMING
        else (f"DFT321 ({form})", "the same length", _WHOLE)
    )
    write_text(place / READ_ME, _HOW.format(what=what, length=length, more=more, folder=place.name))
    return paths


def check_port(
    folder: PathLike, *, form: str | None = None, reducer: str | None = None
) -> Conformity:
    """Raise unless the answers in a folder conform; form and reducer are those of its list if they are not given."""
    place = Path(folder)
    listed_form, listed = _read_list(place) if form is None else (form, None)
    form, reducer = check_name(listed_form, FORMS, "form"), reducer or listed or streams.OPEN_PHASE
    judged, lengths = list[Judged](), set[int]()
    for vector in _list_vectors(form, reducer):
        output = _read_answer(place, vector.name)
        if isinstance(output, str):
            judged.append(Judged(vector.name, (output,)))
        else:
            lengths.add(output.shape[-1])
            judged.append(_judge(vector, output, form=form, reducer=reducer))
    if form != STREAMING:
        return conform.conclude(judged, form=form)
    if len(lengths) > 1:
        text = f"the latency must be one number, got answers of {sorted(lengths)} samples"
        judged.append(Judged("latency", (text,)))
    return conform.conclude(judged, form=reducer, name=reducer)


def _write_input(folder: Path, vector: _Vector) -> Path:
    samples = np.nan_to_num(vector.acceleration, nan=NOT_THERE)
    path = folder / f"{vector.name}.wav"
    write_wav(path, samples, RATE_HZ)
    lines = (",".join(map(repr, row)) for row in samples.T.tolist())
    write_text(path.with_suffix(".csv"), "\n".join(lines) + "\n")
    return path


def _judge(vector: _Vector, output: Samples, *, form: str, reducer: str) -> Judged:
    if isinstance(vector, conform.GoldenVector):
        near = vector.name.startswith(
            "almost_anti_phase"
        )  # 32 bits leave 1 % of the sum of the axes
        allowed = ROUGH_TOLERANCE if near else FILE_TOLERANCE
        return conform.judge(vector, output, form=form, tolerance=allowed)
    latency = output.shape[-1] - streams.N_SAMPLES
    return streams.judge_stream(
        vector, output, latency=latency, allowed=FILE_TOLERANCE, reducer=reducer
    )


def _list_vectors(form: str, reducer: str) -> Iterator[_Vector]:
    if form == STREAMING:
        yield from streams.stream_vectors(reducer)
    else:
        yield from conform.golden_vectors("windowed" if form == "windowed" else "whole")


def _describe(vector: _Vector) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "input": f"{vector.name}.wav",
        "output": f"{vector.name}.out.wav",
        "n_samples": vector.acceleration.shape[1],
    }
    if isinstance(vector, streams.StreamVector):
        gaps = [] if vector.on_gap == "raise" else [list(gap) for gap in streams.MISSING]
        entry |= {"block": vector.block, "on_gap": vector.on_gap, "missing": gaps}
    return entry


def _read_list(folder: Path) -> tuple[str, str | None]:
    path = folder / LIST
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; write the vectors first: feel321 port {folder}"
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return str(content["form"]), content.get("reducer")
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(
            f"{path}: not a list that feel321 port wrote; write the vectors again"
        ) from None


def _read_answer(folder: Path, name: str) -> Samples | str:
    """Read one answer, or say what is wrong with it."""
    table, wav = folder / f"{name}.out.csv", folder / f"{name}.out.wav"
    if table.is_file() and wav.is_file():
        return f"{name}: answered twice, {table.name} and {wav.name}; remove one"
    try:
        if table.is_file():
            return np.atleast_1d(np.loadtxt(table, delimiter=",", dtype=np.float64, ndmin=1))
        return np.asarray(read_wav(wav)[0]) if wav.is_file() else f"{name}: {wav.name} is missing"
    except (OSError, ValueError) as error:
        return f"{name}: not readable ({str(error).splitlines()[0]})"
