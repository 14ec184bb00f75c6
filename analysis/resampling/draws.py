"""All bootstrap draws of a correlation: of participants and recordings, and of participants only."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.resampling.bootstrap import METHODS, correlate_draws, correlate_each, draw_counts, fisher_z

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.table.items import Items

BLOCK = 4_000_000
"""Numbers that an array of draws may hold: 32 MB, so that a million rows need no gigabytes."""


class Draws(NamedTuple):
    """The correlation with each metric, and Fisher's z of its draws.

    Parameters
    ----------
    point : ndarray, shape (n_metrics,)
        Correlation, no draw taken.
    two_way, participants : ndarray, shape (n_metrics, draws)
        Fisher's z with participants and recordings drawn, and with participants drawn only.
    of_recordings : ndarray, shape (n_metrics, n_recordings)
        Correlation within each recording, for the methods that average them; else without columns.
    """

    point: NDArray[np.float64]
    two_way: NDArray[np.float64]
    participants: NDArray[np.float64]
    of_recordings: NDArray[np.float64]


def draw_intervals(items: Items, method: str, *, draws: int, rng: np.random.Generator) -> Draws:
    """Draw participants and recordings with replacement, and correlate anew each time.

    Parameters
    ----------
    items : Items
        Ratings and metrics.
    method : str
        A name of `METHODS`.
    draws : int
        Number of draws.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Draws
        For every metric of the items.
    """
    everyone, everything = np.ones((1, items.n_participants)), np.ones((1, items.n_recordings))
    block = max(1, BLOCK // max(items.n_participants, items.n_items))
    sizes = [min(block, draws - start) for start in range(0, draws, block)]
    blocks = [_draw_block(items, method, draws=size, rng=rng) for size in sizes]
    within = METHODS[method].within
    return Draws(
        point=correlate_draws(items, method, participants=everyone, recordings=everything)[:, 0],
        two_way=fisher_z(np.concatenate([two_way for two_way, _ in blocks], axis=1)),
        participants=fisher_z(np.concatenate([participants for _, participants in blocks], axis=1)),
        of_recordings=correlate_each(items, method) if within else np.empty((len(items.metrics), 0)),
    )


def measure_lean(items: Items, method: str, drawn: Draws) -> NDArray[np.float64]:
    """How far a mean of Fisher's z over recordings leans away from zero, because each rests on few stimuli.

    Parameters
    ----------
    items : Items
        What was drawn from.
    method : str
        A name of `METHODS`.
    drawn : Draws
        The draws.

    Returns
    -------
    ndarray, shape (n_metrics,)
        Mean of r / (2 (n_r - 1)) over recordings (Hotelling 1953, doi 10.1111/j.2517-6161.1953.tb00135.x) for
        ``within``; 0 for the other methods, whose lean is small against their interval or not known.
    """
    how = METHODS[method]
    if how.ranked or not how.within:
        return np.zeros(len(items.metrics))
    sizes = np.bincount(items.recordings)
    leans = drawn.of_recordings / (2 * np.maximum(sizes - 1, 1))
    defined = np.isfinite(leans)
    mean: NDArray[np.float64] = np.where(defined, leans, 0.0).sum(axis=1) / np.maximum(defined.sum(axis=1), 1)
    return mean


def _draw_block(
    items: Items, method: str, *, draws: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Participants are drawn first and recordings second, so that both intervals share the same participants.
    people = draw_counts(items.n_participants, draws, rng=rng)
    # A source comes with all its recordings, or not at all.
    scenes = draw_counts(items.n_sources, draws, rng=rng)[:, items.of_source]
    return (
        correlate_draws(items, method, participants=people, recordings=scenes),
        correlate_draws(items, method, participants=people, recordings=np.ones_like(scenes)),
    )


def count_scarcest(items: Items, drawn: Draws) -> int:
    """Count the units that limit a two-way interval: whichever there are fewer of is known less well.

    Parameters
    ----------
    items : Items
        What was drawn from.
    drawn : Draws
        The draws; recordings in which a within method is not defined do not count.

    Returns
    -------
    int
        Participants, or sources of recordings.
    """
    if not drawn.of_recordings.size:
        return min(items.n_participants, items.n_sources)
    speaking = min(len(np.unique(items.of_source[np.isfinite(row)])) for row in drawn.of_recordings)
    return min(items.n_participants, speaking)
