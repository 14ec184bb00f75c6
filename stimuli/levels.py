"""Level arms: which gain brings a rendered stimulus to the level at which it is played.

- `as_is`: one physical gain, so that energy which a reducer lost is felt as loss.
- `equal_intensity`: every stimulus at the same sensation level, that of its loudest 200 ms, so that a high rating
  cannot be one of strength. Silence around an event changes nothing.

A gain is m/s² played per m/s² recorded. Automatic gains let the loudest stimulus reach the headroom: of the whole set,
or, with a gain per recording, of each recording with its reductions, reference and anchors. One gain for the set keeps
the differences between recordings, but then the highest peak of any recording decides how strong all others are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.perception import to_db
from stimuli.recipe import GAIN_PER_RECORDING

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from stimuli.recipe import Recipe
    from stimuli.render import Measured


def choose_gains(
    measured: Mapping[str, Measured], recipe: Recipe, *, recordings: Mapping[str, Collection[str]]
) -> dict[tuple[str, str], float]:
    """Choose the gain of every stimulus in every level arm.

    Parameters
    ----------
    measured : mapping
        Key of a rendered stimulus -> what was measured on it, for the whole set.
    recipe : Recipe
        Levels, headroom, full scale, threshold curve and gain.
    recordings : mapping of str to collection of str
        Name of a recording -> keys of its stimuli.

    Returns
    -------
    dict
        (level, key) -> gain.

    Raises
    ------
    ValueError
        If the equal-intensity arm holds a stimulus that cannot be felt at any gain.
    """
    together = recordings.values() if recipe.gain == GAIN_PER_RECORDING else [set().union(*recordings.values())]
    gains: dict[tuple[str, str], float] = {}
    for keys in together:
        notes = {key: measured[key] for key in keys}
        if "as_is" in recipe.levels:
            gains.update((("as_is", key), gain) for key, gain in _keep(notes, recipe).items())
        if "equal_intensity" in recipe.levels:
            gains.update((("equal_intensity", key), gain) for key, gain in _equalise(notes, recipe).items())
    return gains


def find_headroom_cost(peaks: Mapping[str, float]) -> tuple[str, float]:
    """Find the recording with the highest peak, and by how many dB a common gain is lower for it.

    Parameters
    ----------
    peaks : mapping of str to float
        Largest magnitude at unit gain of each recording, reductions, reference and anchors included.

    Returns
    -------
    recording : str
        Whose peak sets a gain for the whole set.
    cost_db : float
        Gain that all other recordings would have without it, over the one that they have; 0 if there is no other.
    """
    first, *others = sorted(peaks, key=lambda name: -peaks[name])
    return first, to_db(peaks[first] / peaks[others[0]]) if others and peaks[others[0]] else 0.0


def _keep(notes: Mapping[str, Measured], recipe: Recipe) -> dict[str, float]:
    loudest = max(note.peak for note in notes.values())
    room = recipe.headroom * recipe.full_scale_m_s2
    automatic = room / loudest if loudest else 1.0
    return dict.fromkeys(notes, automatic if isinstance(recipe.gain, str) else recipe.gain)


def _equalise(notes: Mapping[str, Measured], recipe: Recipe) -> dict[str, float]:
    levels = {key: note.levels[recipe.threshold] for key, note in notes.items()}
    if silent := sum(level == 0.0 for level in levels.values()):
        raise ValueError(
            f"equal_intensity: {silent} stimuli are silent between 20 and 1000 Hz and cannot be made as strong as "
            "the others; leave out this level, or the reducer or recording that is silent"
        )
    common = recipe.headroom * recipe.full_scale_m_s2 / max(note.peak / levels[key] for key, note in notes.items())
    return {key: common / level for key, level in levels.items()}
