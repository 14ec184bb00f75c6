"""Blind codes: the names of stimuli in plans, in journals, and in all that is read from them before the analysis.

A stimulus's own name holds its recording and reducer. Codes are no secret, for the software turns them back; they keep
experimenters from learning by accident what a participant feels.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet

LEAST_LETTERS = 6
"""Letters of a blind code; more where two codes would be the same."""


def list_codes(stimuli: StimulusSet, *, seed: int) -> dict[str, str]:
    """Give every stimulus of a study its blind code."""
    return make_codes((row.stimulus_id for row in stimuli.stimuli), f"{stimuli.sha256} {seed}")


def list_by_code(stimuli: StimulusSet, *, seed: int) -> dict[str, Stimulus]:
    """List the stimuli of a study by blind code."""
    codes = list_codes(stimuli, seed=seed)
    return {codes[row.stimulus_id]: row for row in stimuli.stimuli}


def make_codes(stimulus_ids: Iterable[str], key: str) -> dict[str, str]:
    """Give every stimulus a code of letters and digits.

    Examples
    --------
    >>> make_codes(["oak-dft321"], "study 321")
    {'oak-dft321': '7K6ZGV'}
    """
    digests = {
        name: base64.b32encode(hashlib.sha256(f"{key}\n{name}".encode()).digest()).decode()
        for name in stimulus_ids
    }
    letters = LEAST_LETTERS
    while len({text[:letters] for text in digests.values()}) < len(digests):
        letters += 1
    return {name: text[:letters] for name, text in digests.items()}
