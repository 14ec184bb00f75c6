"""Who is left out with whom, and what everyone else says: mean ratings by group of people, per draw."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.table.items import Items

    Values = NDArray[np.float64]

GROUPS = 4
"""Groups that people are split into, each left out in turn."""

FOLDS = 10
"""Sources of recordings are left out one by one; more than this, in as many groups: the time grows with its square."""


class Split(NamedTuple):
    """Groups that are left out together.

    Parameters
    ----------
    people : ndarray of int, shape (n_participants,)
        Group of each participant.
    items : ndarray of int, shape (n_items,)
        Fold of each item, that of its recording's source.
    """

    people: NDArray[np.intp]
    items: NDArray[np.intp]


class Means(NamedTuple):
    """Mean ratings of each item, per draw and group of people.

    Parameters
    ----------
    others, own : ndarray, shape (draws, groups, n_items)
        By all people outside the group, and by the group; 0 where there is none.
    known : ndarray of bool, shape (draws, groups, n_items)
        Whether anyone outside the group rated the item.
    share : ndarray, shape (draws, groups, n_items)
        Part of the item's ratings that the group gave.
    """

    others: Values
    own: Values
    known: NDArray[np.bool_]
    share: Values


def make_split(items: Items, rng: np.random.Generator) -> Split:
    """Split people and recordings at random.

    Parameters
    ----------
    items : Items
        What was rated by whom.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Split
        At most `GROUPS` groups of people and `FOLDS` folds of sources, as equal in size as can be.
    """
    people = rng.permutation(items.n_participants) % min(items.n_participants, GROUPS)
    folds = rng.permutation(items.n_sources) % min(items.n_sources, FOLDS)
    return Split(people, folds[items.of_source[items.recordings]])


def average_groups(items: Items, split: Split, counts: Values, *, within: bool) -> Means:
    """Average the ratings of each group, and of everyone outside it.

    Parameters
    ----------
    items : Items
        Ratings.
    split : Split
        Groups.
    counts : ndarray, shape (draws, n_participants)
        How often each participant was drawn.
    within : bool
        Whether each recording's mean is taken off.

    Returns
    -------
    Means
        About the grand mean of the ratings.
    """
    seen = np.isfinite(items.ratings)
    ratings = np.where(seen, items.ratings - items.ratings[seen].mean(), 0.0)
    member = split.people == np.arange(split.people.max() + 1)[:, None]
    weights = counts[:, None] * member
    votes, sums = weights @ seen.astype(np.float64), weights @ ratings
    all_votes, all_sums = votes.sum(axis=1, keepdims=True), sums.sum(axis=1, keepdims=True)
    own, others = _divide(sums, votes), _divide(all_sums - sums, all_votes - votes)
    known = all_votes > votes
    if within:
        own, others = _center(own, votes > 0, items.recordings), _center(others, known, items.recordings)
    return Means(others, own, known, _divide(votes, np.broadcast_to(all_votes, votes.shape)))


def _divide(sums: Values, votes: Values) -> Values:
    return np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0)


def _center(means: Values, known: NDArray[np.bool_], recordings: NDArray[np.intp]) -> Values:
    belongs = (recordings[:, None] == np.arange(recordings.max() + 1)).astype(np.float64)
    centre = _divide((means * known) @ belongs, known @ belongs)
    return np.where(known, means - centre[..., recordings], 0.0)
