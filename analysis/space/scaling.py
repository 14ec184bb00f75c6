"""What people tell apart, as a map: multidimensional scaling of dissimilarity ratings and what its axes mean.

Conventions: dissimilarities have shape (stimuli, stimuli), or (participants, stimuli, stimuli); 0 on the
diagonal, symmetric, NaN where a pair was not rated. Positions have shape (stimuli, dimensions), are centred, and
lie along their principal axes; only distances between them have a meaning, not their direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Values = NDArray[np.float64]

FEWEST = 3
"""Stimuli that make a shape."""

CUBE = 3
"""Axes of a stack of matrices."""

STARTS = 8
"""Random starts beside the classical one; SMACOF finds the nearest hollow, not the deepest."""

ROUGH, FINE = (300, 1e-6), (1000, 1e-9)
"""Steps at most, and the change of stress at which to stop."""


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """A map of stimuli.

    Parameters
    ----------
    positions : ndarray, shape (n_stimuli, n_dimensions)
        In the unit of the dissimilarities; of ordinal maps, in a unit of their own.
    stress : float
        Kruskal's stress-1: 0 fits perfectly, .05 well, .1 fairly, .2 poorly; of few stimuli in many
        dimensions it is small whatever the ratings.
    ordinal : bool
        Whether only the order of the dissimilarities was used.
    """

    positions: Values
    stress: float
    ordinal: bool


def fit_space(
    dissimilarities: ArrayLike, *, dimensions: int = 2, ordinal: bool = False, rng: np.random.Generator
) -> Space:
    """Place stimuli so that distances agree with dissimilarities.

    Parameters
    ----------
    dissimilarities : array_like, shape (stimuli, stimuli) or (participants, stimuli, stimuli)
        One person's ratings for an individual map; a stack of them is averaged for the group's map.
    dimensions : int
        Of the map, 1 to stimuli - 1.
    ordinal : bool
        Use only the order of the dissimilarities (non-metric scaling).
    rng : Generator
        Source of the random starts.

    Returns
    -------
    Space
        The best of the classical and several random starts.

    Raises
    ------
    ValueError
        If a shape is wrong, a value is negative or infinite, the matrix is not symmetric or 0 on its
        diagonal, a pair was rated by nobody, all are alike, or the dimensions do not fit the stimuli.

    Notes
    -----
    SMACOF (scikit-learn) minimises Σ (δ_ij - d_ij)² over pairs. Stress-1 = √(Σ (δ̂ - d)² / Σ d²), where δ̂ is
    δ, or in ordinal maps its best monotone transform, the same for equal δ. Averaging assumes that people share one
    map; look at the individual ones before.

    References
    ----------
    Borg & Groenen (2005), Modern Multidimensional Scaling, doi 10.1007/0-387-28981-X.
    Kruskal (1964), Psychometrika 29, 1-27, doi 10.1007/BF02289565.

    Examples
    --------
    >>> square = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    >>> distances = np.sqrt(((square[:, None] - square) ** 2).sum(axis=-1))
    >>> bool(fit_space(distances, rng=np.random.default_rng(1)).stress < 1e-3)
    True
    """
    target = check_dissimilarities(dissimilarities)
    if not 1 <= dimensions < len(target):
        raise ValueError(f"dimensions: got {dimensions}, allowed is 1 to {len(target) - 1} for {len(target)} stimuli")
    starts = [_place_classically(target, dimensions)]
    starts += [target.max() * rng.uniform(-1, 1, (len(target), dimensions)) for _ in range(STARTS)]
    rough = min((_scale(target, start, ordinal=ordinal, steps=ROUGH) for start in starts), key=lambda fit: fit[1])
    positions, stress = _scale(target, rough[0], ordinal=ordinal, steps=FINE)
    return Space(_turn_to_axes(positions), stress, ordinal)


def refit_space(dissimilarities: ArrayLike, space: Space) -> Space:
    """Fit other dissimilarities of the same stimuli, starting from a map.

    Parameters
    ----------
    dissimilarities : array_like
        As for `fit_space`.
    space : Space
        Where to start; its dimensions and level of measurement are kept.

    Returns
    -------
    Space
        The nearest map, much faster than from many starts; not turned to its own axes.

    Raises
    ------
    ValueError
        As for `fit_space`.
    """
    target = check_dissimilarities(dissimilarities)
    positions, stress = _scale(target, space.positions, ordinal=space.ordinal, steps=ROUGH)
    return Space(positions, stress, space.ordinal)


def stress_by_dimension(
    dissimilarities: ArrayLike, *, most: int = 5, ordinal: bool = False, rng: np.random.Generator
) -> tuple[float, ...]:
    """Compute the stress of maps of one dimension and more, to see how many are enough.

    Parameters
    ----------
    dissimilarities : array_like
        As for `fit_space`.
    most : int
        Largest number of dimensions; cut to stimuli - 1.
    ordinal : bool
        As for `fit_space`.
    rng : Generator
        Source of the random starts.

    Returns
    -------
    tuple of float
        Stress-1 with 1, 2, ... dimensions.

    Raises
    ------
    ValueError
        As for `fit_space`.
    """
    target = check_dissimilarities(dissimilarities)
    if most < 1:
        raise ValueError(f"most: got {most}, allowed is 1 or more")
    numbers = range(1, min(most, len(target) - 1) + 1)
    return tuple(fit_space(target, dimensions=number, ordinal=ordinal, rng=rng).stress for number in numbers)


def check_dissimilarities(dissimilarities: ArrayLike) -> Values:
    """Check dissimilarities and average them over participants.

    Parameters
    ----------
    dissimilarities : array_like, shape (stimuli, stimuli) or (participants, stimuli, stimuli)
        As for `fit_space`.

    Returns
    -------
    ndarray, shape (stimuli, stimuli)
        Each pair's mean over those who rated it.

    Raises
    ------
    ValueError
        As for `fit_space`.
    """
    given = read_numbers(dissimilarities, what="dissimilarities")
    stack = given[None] if given.ndim == 2 else given  # noqa: PLR2004 - one participant's matrix
    people, *sides = stack.shape if stack.ndim == CUBE else (0, 0, 0)
    if not people or sides[0] != sides[1] or sides[0] < FEWEST:
        raise ValueError(
            f"dissimilarities: got shape {given.shape}, allowed is (stimuli, stimuli) or (participants, stimuli, "
            f"stimuli), with {FEWEST} stimuli or more"
        )
    if np.isinf(stack).any() or (stack < 0).any():
        raise ValueError("dissimilarities: got a negative or infinite value, allowed is 0 or more, NaN where missing")
    if np.nansum(np.diagonal(stack, axis1=1, axis2=2)):
        raise ValueError("dissimilarities: got a stimulus unlike itself, allowed is 0 on the diagonal")
    if not np.allclose(stack, stack.transpose(0, 2, 1), equal_nan=True):
        raise ValueError("dissimilarities: got a matrix that is not symmetric; average both orders of a pair first")
    rated = np.isfinite(stack).sum(axis=0) + np.eye(stack.shape[1], dtype=np.int64)
    if not rated.all():
        first, second = np.argwhere(rated == 0)[0]
        raise ValueError(f"dissimilarities: got no rating of stimuli {first} and {second}; leave one of them out")
    mean: Values = np.where(np.isfinite(stack), stack, 0).sum(axis=0) / rated
    if not mean.any():
        raise ValueError("dissimilarities: got 0 for every pair; stimuli that nobody tells apart have no map")
    return mean


def _place_classically(target: Values, dimensions: int) -> Values:
    centre = np.eye(len(target)) - 1 / len(target)
    values, vectors = np.linalg.eigh(-centre @ target**2 @ centre / 2)
    largest = np.argsort(values)[::-1][:dimensions]
    # A dimension without variance would stay flat for ever: SMACOF cannot leave it.
    spread = np.sqrt(np.maximum(values[largest], 1e-6 * values.max()))
    placed: Values = vectors[:, largest] * spread
    return placed


def _scale(target: Values, start: Values, *, ordinal: bool, steps: tuple[int, float]) -> tuple[Values, float]:
    from sklearn.isotonic import IsotonicRegression
    from sklearn.manifold import smacof

    positions, _ = smacof(
        target, metric=not ordinal, n_components=start.shape[1], init=start, n_init=1,
        max_iter=steps[0], eps=steps[1], normalized_stress=ordinal,
    )  # fmt: skip
    pairs = np.triu_indices(len(target), 1)
    distances = np.sqrt(((positions[:, None] - positions) ** 2).sum(axis=-1))[pairs]
    # SMACOF's own stress of an ordinal map is of a transform scaled to a fixed size, and so above Kruskal's.
    wanted = IsotonicRegression().fit_transform(target[pairs], distances) if ordinal else target[pairs]
    return positions, float(np.sqrt(((wanted - distances) ** 2).sum() / (distances**2).sum()))


def _turn_to_axes(positions: Values) -> Values:
    """Centre, turn the largest spread onto the first axis, and fix the signs."""
    centred = positions - positions.mean(axis=0)
    turned: Values = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    strongest = turned[np.abs(turned).argmax(axis=0), np.arange(turned.shape[1])]
    signed: Values = turned * np.where(strongest < 0, -1.0, 1.0)
    return signed
