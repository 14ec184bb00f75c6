"""The examination of a built stimulus set before a study may start: every problem, one line each."""

from __future__ import annotations

import hashlib
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.wav import read_wav

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from feel321.stimuli.sets.manifest import Stimulus

# The temporal match of an anchor is 0 but for rounding; so may be that of a silent test stimulus.
_ROUNDING = 1e-9


def check_stimuli(folder: str | Path) -> list[str]:
    """Examine a built set: files, digests, clipping, and whether its anchors can serve as anchors.

    Parameters
    ----------
    folder : str or Path
        Where `build_stimuli` built it.

    Returns
    -------
    list of str
        Every problem in one line, with what to do; empty if there is none.
    """
    folder = Path(folder)
    try:
        stimuli = read_stimuli(folder).stimuli
    except (OSError, ValueError) as error:
        return [str(error)]
    problems = [problem for stimulus in stimuli for problem in _file_problems(stimulus, folder)]
    named = {stimulus.file for stimulus in stimuli}
    problems += [
        f"{path.name}: not in the manifest; move it away, or build the set again"
        for path in sorted(folder.glob("*.wav"))
        if path.name not in named
    ]
    ordered = sorted(stimuli, key=lambda stimulus: (stimulus.recording, stimulus.level))
    for _, together in groupby(ordered, key=lambda stimulus: (stimulus.recording, stimulus.level)):
        problems += _anchor_problems(list(together))
    return problems


def _file_problems(stimulus: Stimulus, folder: Path) -> Iterator[str]:
    path = folder / stimulus.file
    if not path.is_file():
        yield f"{stimulus.file}: missing; build the set again"
        return
    if hashlib.sha256(path.read_bytes()).hexdigest() != stimulus.sha256:
        yield f"{stimulus.file}: was changed after it was built (its SHA-256 differs); build the set again"
        return
    if stimulus.clipped:
        yield f"{stimulus.file}: {stimulus.clipped} samples clipped; lower the gain or raise full_scale_m_s2"
    samples, rate = read_wav(path)
    if samples.shape[-1] != stimulus.n_samples or rate != stimulus.rate_hz:
        yield f"{stimulus.file}: {samples.shape[-1]} samples at {rate} Hz, but the manifest says otherwise; build again"


def _anchor_problems(stimuli: Sequence[Stimulus]) -> Iterator[str]:
    """Demand that anchors score below every test stimulus of its recording, on both metrics."""
    tests = [stimulus for stimulus in stimuli if stimulus.role == "test"]
    for anchor in (stimulus for stimulus in stimuli if stimulus.role == "anchor"):
        for test in tests:
            better = anchor.spectral_match >= test.spectral_match
            better |= anchor.temporal_match > test.temporal_match + _ROUNDING
            if better:
                yield (
                    f"{anchor.stimulus_id}: spectral match {anchor.spectral_match:.3g}, "
                    f"temporal {anchor.temporal_match:.3g}, not below {test.stimulus_id} ({test.spectral_match:.3g}, "
                    f"{test.temporal_match:.3g}); an anchor must be worse than every test: leave out that recording "
                    "or that reducer, or set anchors = false"
                )
