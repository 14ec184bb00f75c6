"""Codes in the place of stimulus names, wherever someone looks who should not know what is felt.

A stimulus is named by its recording and reducer. Plans and journals, and all that is read from them before the
analysis, hold codes instead. They are no secret, for the software turns them back; they keep those who lead a
session from learning by accident what a participant feels.
"""

from __future__ import annotations

import base64
import hashlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

LEAST_LETTERS = 6


def make_codes(stimulus_ids: Iterable[str], key: str) -> dict[str, str]:
    """Give every stimulus a code.

    Parameters
    ----------
    stimulus_ids : iterable of str
        Names of the stimuli, each once.
    key : str
        What the codes depend on besides: another key, other codes.

    Returns
    -------
    dict of str to str
        Stimulus -> code of letters and digits; no two are the same.

    Examples
    --------
    >>> make_codes(["oak-dft321"], "study 321")
    {'oak-dft321': '7K6ZGV'}
    """
    digests = {name: _write_letters(f"{key}\n{name}") for name in stimulus_ids}
    letters = LEAST_LETTERS
    while len({digest[:letters] for digest in digests.values()}) < len(digests):
        letters += 1
    return {name: digest[:letters] for name, digest in digests.items()}


def _write_letters(text: str) -> str:
    return base64.b32encode(hashlib.sha256(text.encode()).digest()).decode()
