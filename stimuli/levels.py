"""Level arms: which gain brings a rendered stimulus to the level at which it is played.

- `as_is`: one physical gain for the whole set, so that energy which a reducer lost is felt as loss.
- `equal_intensity`: every stimulus at the same felt level (RMS weighted by the vibrotactile threshold), so that a high
  rating cannot be one of strength.

Automatic gains let the loudest stimulus of the arm reach the headroom; a gain is m/s² given per m/s² recorded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stimuli.recipe import Recipe
    from stimuli.render import Measured


def choose_gains(measured: Mapping[str, Measured], recipe: Recipe) -> dict[tuple[str, str], float]:
    """Choose the gain of every stimulus in every level arm.

    Parameters
    ----------
    measured : mapping
        Key of a rendered stimulus -> what was measured on it, for the whole set.
    recipe : Recipe
        Levels, headroom, full scale, and the gain of `as_is` if it is given.

    Returns
    -------
    dict
        (level, key) -> gain.

    Raises
    ------
    ValueError
        If the equal-intensity arm holds a stimulus that cannot be felt at any gain.
    """
    room = recipe.headroom * recipe.full_scale_m_s2
    gains: dict[tuple[str, str], float] = {}
    if "as_is" in recipe.levels:
        loudest = max(note.peak for note in measured.values())
        common = recipe.gain or (room / loudest if loudest else 1.0)
        gains.update((("as_is", key), common) for key in measured)
    if "equal_intensity" in recipe.levels:
        silent = sum(note.felt_level == 0.0 for note in measured.values())
        if silent:
            raise ValueError(
                f"equal_intensity: {silent} stimuli are silent between 20 and 1000 Hz and cannot be made as strong as "
                "the others; leave out this level, or the reducer or recording that is silent"
            )
        level = room / max(note.peak / note.felt_level for note in measured.values())
        gains.update((("equal_intensity", key), level / note.felt_level) for key, note in measured.items())
    return gains
