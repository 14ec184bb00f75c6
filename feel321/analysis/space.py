"""Perceptual space: dissimilarities scaled to a map, its uncertainty, and what its axes mean.

Conventions: dissimilarities have shape (stimuli, stimuli), or (participants, stimuli, stimuli); 0 on the
diagonal, symmetric, NaN where a pair was not rated. Positions have shape (stimuli, dimensions), are centred, and
lie along their principal axes; only distances between them have a meaning, not their direction.

Conventions: positions have shape (stimuli, dimensions), in the same order of stimuli everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import read_numbers
from feel321.analysis.resampling import FLAT, draw_counts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray
    from pandas import DataFrame

    Values = NDArray[np.float64]

# What people tell apart, as a map: multidimensional scaling of dissimilarity ratings and what its axes mean.

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
    dissimilarities: ArrayLike,
    *,
    dimensions: int = 2,
    ordinal: bool = False,
    rng: np.random.Generator,
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
        raise ValueError(
            f"dimensions: got {dimensions}, allowed is 1 to {len(target) - 1} for {len(target)} stimuli"
        )
    starts = [_place_classically(target, dimensions)]
    starts += [target.max() * rng.uniform(-1, 1, (len(target), dimensions)) for _ in range(STARTS)]
    rough = min(
        (_scale(target, start, ordinal=ordinal, steps=ROUGH) for start in starts),
        key=lambda fit: fit[1],
    )
    positions, stress = _scale(target, rough[0], ordinal=ordinal, steps=FINE)
    return Space(_turn_to_axes(positions), stress, ordinal)


def refit_space(dissimilarities: ArrayLike, space: Space) -> Space:
    """Fit other dissimilarities of the same stimuli, starting from a map."""
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
    return tuple(
        fit_space(target, dimensions=number, ordinal=ordinal, rng=rng).stress for number in numbers
    )


def check_dissimilarities(dissimilarities: ArrayLike) -> Values:
    """Check dissimilarities and average them over participants.

    dissimilarities: (stimuli, stimuli); returns (stimuli, stimuli).
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
        raise ValueError(
            "dissimilarities: got a negative or infinite value, allowed is 0 or more, NaN where missing"
        )
    if np.nansum(np.diagonal(stack, axis1=1, axis2=2)):
        raise ValueError(
            "dissimilarities: got a stimulus unlike itself, allowed is 0 on the diagonal"
        )
    if not np.allclose(stack, stack.transpose(0, 2, 1), equal_nan=True):
        raise ValueError(
            "dissimilarities: got a matrix that is not symmetric; average both orders of a pair first"
        )
    rated = np.isfinite(stack).sum(axis=0) + np.eye(stack.shape[1], dtype=np.int64)
    if not rated.all():
        first, second = np.argwhere(rated == 0)[0]
        raise ValueError(
            f"dissimilarities: got no rating of stimuli {first} and {second}; leave one of them out"
        )
    mean: Values = np.where(np.isfinite(stack), stack, 0).sum(axis=0) / rated
    if not mean.any():
        raise ValueError(
            "dissimilarities: got 0 for every pair; stimuli that nobody tells apart have no map"
        )
    return mean


def _place_classically(target: Values, dimensions: int) -> Values:
    centre = np.eye(len(target)) - 1 / len(target)
    values, vectors = np.linalg.eigh(-centre @ target**2 @ centre / 2)
    largest = np.argsort(values)[::-1][:dimensions]
    # A dimension without variance would stay flat for ever: SMACOF cannot leave it.
    spread = np.sqrt(np.maximum(values[largest], 1e-6 * values.max()))
    placed: Values = vectors[:, largest] * spread
    return placed


def _scale(
    target: Values, start: Values, *, ordinal: bool, steps: tuple[int, float]
) -> tuple[Values, float]:
    from sklearn.isotonic import IsotonicRegression
    from sklearn.manifold import smacof

    positions, _ = smacof(
        target,
        metric=not ordinal,
        n_components=start.shape[1],
        init=start,
        n_init=1,
        max_iter=steps[0],
        eps=steps[1],
        normalized_stress=ordinal,
    )
    pairs = np.triu_indices(len(target), 1)
    distances = np.sqrt(((positions[:, None] - positions) ** 2).sum(axis=-1))[pairs]
    # SMACOF's own stress of an ordinal map is of a transform scaled to a fixed size, and so above Kruskal's.
    wanted = (
        IsotonicRegression().fit_transform(target[pairs], distances) if ordinal else target[pairs]
    )
    return positions, float(np.sqrt(((wanted - distances) ** 2).sum() / (distances**2).sum()))


def _turn_to_axes(positions: Values) -> Values:
    """Centre, turn the largest spread onto the first axis, and fix the signs."""
    centred = positions - positions.mean(axis=0)
    turned: Values = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    strongest = turned[np.abs(turned).argmax(axis=0), np.arange(turned.shape[1])]
    signed: Values = turned * np.where(strongest < 0, -1.0, 1.0)
    return signed


# What the map of stimuli means: set against measurements, attributes, and other participants.

CONFIDENCE = 0.95
PLANE = 2
"""Dimensions of a map on paper, and the participants that a spread needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How well a map agrees with another after shifting, turning, mirroring and scaling.

    Parameters
    ----------
    disparity : float
        Procrustes' m²: share of the reference's variance not met, 0 to 1.
    correlation : float
        √(1 - m²).
    p : float
        Share of random pairings of stimuli that agree as well or better.
    aligned : ndarray, shape (n_stimuli, n_dimensions)
        The map, fitted to the reference and in its unit.
    permutations : int
        Random pairings tried.
    """

    disparity: float
    correlation: float
    p: float
    aligned: Values
    permutations: int


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """Where stimuli would lie with other participants: 95 % bootstrap ellipses.

    Parameters
    ----------
    space : Space
        The group's map, two-dimensional.
    half_axes : ndarray, shape (n_stimuli, 2)
        Half the longer and the shorter axis of each ellipse.
    angle : ndarray, shape (n_stimuli,)
        Of the longer axis against the first dimension, in degrees, 0 to 180.
    draws, n_participants : int
        Draws, and participants drawn from.
    """

    space: Space
    half_axes: Values
    angle: Values
    draws: int
    n_participants: int


def align_spaces(
    positions: ArrayLike,
    reference: ArrayLike,
    *,
    permutations: int = 2000,
    rng: np.random.Generator,
) -> Alignment:
    """Set a map against a physical configuration of the same stimuli.

    Parameters
    ----------
    positions : array_like, shape (stimuli, dimensions)
        The map of what people felt.
    reference : array_like, shape (stimuli, dimensions)
        The same stimuli by measurements, in units that may be compared (standardise them first). The one with
        fewer dimensions is filled with zeros.
    permutations : int
        Random pairings, at least 1.
    rng : Generator
        Source of the pairings.

    Returns
    -------
    Alignment
        Agreement, its p, and the map laid over the reference.

    Raises
    ------
    ValueError
        If shapes do not fit, a value is not finite, all stimuli are in one place, or no permutation is asked
        for.

    Notes
    -----
    m² = 1 - (Σ σ)², σ the singular values of AᵀB, both centred and of unit size. m² is small for few stimuli
    even by chance; only the permutation test (PROTEST) says whether it is smaller than that. p = (1 + number
    of pairings with m² as small) / (1 + permutations).

    References
    ----------
    Gower (1975), Psychometrika 40, 33-51, doi 10.1007/BF02291478.
    Peres-Neto & Jackson (2001), Oecologia 129, 169-178, doi 10.1007/s004420100720.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> map_ = rng.normal(size=(8, 2))
    >>> mirrored = 3 * map_[:, ::-1] + 7
    >>> result = align_spaces(map_, mirrored, rng=rng)
    >>> round(result.correlation, 6), result.p < 0.01
    (1.0, True)
    """
    if permutations < 1:
        raise ValueError(f"permutations: got {permutations}, allowed is 1 or more; use 2000")
    one, other = _check_positions(positions, "positions"), _check_positions(reference, "reference")
    if len(one) != len(other):
        raise ValueError(
            f"reference: got {len(other)} stimuli for {len(one)} positions; give the same ones"
        )
    width = max(one.shape[1], other.shape[1])
    one, other = _widen(one, width), _widen(other, width)
    agreement = _agree(one, other)
    tried = np.array([_agree(one[rng.permutation(len(one))], other) for _ in range(permutations)])
    p = float((1 + (tried >= agreement - FLAT**0.5).sum()) / (1 + permutations))
    disparity = max(0.0, 1 - agreement**2)
    return Alignment(
        disparity, float(np.sqrt(1 - disparity)), p, _lay_over(one, other), permutations
    )


def regress_attributes(positions: ArrayLike, attributes: Mapping[str, ArrayLike]) -> DataFrame:
    """Find the direction of the map along which each attribute grows.

    Parameters
    ----------
    positions : array_like, shape (stimuli, dimensions)
        The map.
    attributes : Mapping of str to array_like, shape (stimuli,)
        Mean ratings or measurements: roughness, level, a metric.

    Returns
    -------
    DataFrame, indexed by attribute
        ``r2``, ``f``, ``df``, ``p`` of the regression on all dimensions, and the unit vector ``axis_1``,
        ``axis_2``, ... in which it grows.

    Raises
    ------
    ValueError
        If an attribute has another length, a value that is not finite, or is constant, or there are too few
        stimuli.

    Notes
    -----
    Ordinary least squares of the attribute on the positions ("property fitting"). Dimensions of a map may be
    turned freely, so that only the direction and R² have a meaning, not single coefficients. With S stimuli
    and D dimensions R² is D / (S - 1) by chance; p is for one attribute: apply Holm to several.

    References
    ----------
    Borg & Groenen (2005), Modern Multidimensional Scaling, chapter 4, doi 10.1007/0-387-28981-X.

    Examples
    --------
    >>> map_ = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [2, 1.5]])
    >>> regress_attributes(map_, {"rough": [10, 22, 9, 19, 31]}).round(2)
            r2       f  df    p  axis_1  axis_2
    rough  1.0  219.53   2  0.0    0.99   -0.14
    """
    import statsmodels.api as sm
    from pandas import DataFrame

    place = _check_positions(positions, "positions")
    n, width = place.shape
    if n < width + 2:
        raise ValueError(
            f"positions: got {n} stimuli in {width} dimensions, a regression needs {width + 2} or more"
        )
    rows = {}
    for name, given in attributes.items():
        values = read_numbers(given, what=f"attribute '{name}'")
        if values.shape != (n,) or not np.isfinite(values).all():
            raise ValueError(
                f"attributes: '{name}' is not {n} finite numbers, one per stimulus; got {values.shape}"
            )
        if ((values - values.mean()) ** 2).sum() <= FLAT * (values**2).sum():
            raise ValueError(f"attributes: '{name}' is the same for all stimuli; leave it out")
        if np.linalg.matrix_rank(place - place.mean(axis=0)) < width:
            raise ValueError(
                f"positions: got {width} dimensions, one of which follows from the others; leave it out"
            )
        fit = sm.OLS(values, sm.add_constant(place, has_constant="add")).fit()
        axis = fit.params[1:] / np.linalg.norm(fit.params[1:])
        axes = {f"axis_{number}": part for number, part in enumerate(axis, start=1)}
        tests = {"r2": fit.rsquared, "f": fit.fvalue, "df": int(fit.df_resid), "p": fit.f_pvalue}
        rows[name] = {**tests, **axes}
    return DataFrame.from_dict(rows, orient="index")


def bootstrap_space(
    dissimilarities: ArrayLike, *, ordinal: bool = False, draws: int = 200, rng: np.random.Generator
) -> Ellipses:
    """Draw participants anew and see how far each stimulus moves on the group's map.

    Parameters
    ----------
    dissimilarities : array_like, shape (participants, stimuli, stimuli)
        One matrix per person, at least two; NaN where a pair was not rated.
    ordinal : bool
        As for `fit_space`.
    draws : int
        Number of bootstrap draws, at least 3.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Ellipses
        The two-dimensional group map and a 95 % ellipse per stimulus.

    Raises
    ------
    ValueError
        As for `fit_space`, or if there are fewer than two participants or three draws.

    Notes
    -----
    Every draw is scaled anew, from the group's map on, and laid over it by Procrustes' rotation, because maps
    have no direction of their own; what is left is the positions' covariance C. The ellipse is {x: (x - m)ᵀ C⁻¹
    (x - m) <= χ²(.95, 2) P / (P - 1)} for P participants. Fitting to the group takes some of the movement away:
    with few stimuli ellipses are somewhat small. Pairs that nobody in a draw has rated keep the group's mean.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> place = rng.normal(size=(6, 2))
    >>> apart = np.sqrt(((place[:, None] - place) ** 2).sum(axis=-1))
    >>> people = np.stack([apart * rng.uniform(0.8, 1.2) for _ in range(5)])
    >>> bootstrap_space(people, draws=20, rng=rng).half_axes.shape
    (6, 2)
    """
    from scipy.stats import chi2

    group = check_dissimilarities(dissimilarities)
    stack = read_numbers(dissimilarities, what="dissimilarities")
    if stack.ndim == PLANE or len(stack) < PLANE:
        raise ValueError(
            "dissimilarities: got one participant, allowed is two or more; one map has no ellipse"
        )
    if draws <= PLANE:
        raise ValueError(f"draws: got {draws}, allowed is 3 or more; use 200")
    space = fit_space(group, ordinal=ordinal, rng=rng)
    seen = np.isfinite(stack)
    weights = draw_counts(len(stack), draws, rng=rng)
    votes = np.einsum("dp,pij->dij", weights, seen)
    sums = np.einsum("dp,pij->dij", weights, np.where(seen, stack, 0))
    means = np.where(
        votes > 0, np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0), group
    )
    placed = [_lay_over(refit_space(mean, space).positions, space.positions) for mean in means]
    moved = np.stack(placed) - np.mean(placed, axis=0)
    covariance = np.einsum("dni,dnj->nij", moved, moved) / (draws - 1)
    values, vectors = np.linalg.eigh(covariance)
    scale = float(chi2.ppf(CONFIDENCE, PLANE)) * len(stack) / (len(stack) - 1)
    half_axes = np.sqrt(scale * np.maximum(values[:, ::-1], 0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])) % 180
    return Ellipses(space, half_axes, angle, draws, len(stack))


def _check_positions(given: ArrayLike, name: str) -> Values:
    place = read_numbers(given, what=name)
    if place.ndim != 2 or len(place) <= PLANE:  # noqa: PLR2004 - stimuli x dimensions
        raise ValueError(
            f"{name}: got shape {place.shape}, allowed is (stimuli, dimensions), 3 stimuli or more"
        )
    if not np.isfinite(place).all():
        raise ValueError(
            f"{name}: got {int((~np.isfinite(place)).sum())} values that are not finite; leave them out"
        )
    centred = place - place.mean(axis=0)
    if (centred**2).sum() <= FLAT * (place**2).sum():
        raise ValueError(f"{name}: got all stimuli in one place, which has no shape")
    return place


def _widen(place: Values, width: int) -> Values:
    return np.pad(place, ((0, 0), (0, width - place.shape[1])))


def _normalise(place: Values) -> Values:
    centred: Values = place - place.mean(axis=0)
    return centred / np.linalg.norm(centred)


def _agree(one: Values, other: Values) -> float:
    """Sum the singular values: the correlation after the best rotation."""
    return float(np.linalg.svd(_normalise(one).T @ _normalise(other), compute_uv=False).sum())


def _lay_over(one: Values, other: Values) -> Values:
    centre = other.mean(axis=0)
    left, stretch, right = np.linalg.svd(_normalise(one).T @ (other - centre))
    laid: Values = _normalise(one) @ left @ right * stretch.sum() + centre
    return laid
