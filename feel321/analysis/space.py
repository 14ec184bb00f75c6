"""Perceptual space: dissimilarities scaled to a map, its uncertainty, and what its axes mean.

Conventions: dissimilarities have shape (stimuli, stimuli), or (participants, stimuli, stimuli); 0 on the
diagonal, symmetric, NaN where a pair was not rated. Positions have shape (stimuli, dimensions), in the same order of
stimuli everywhere, are centred, and lie along their principal axes; only distances between them have a meaning, not
their direction. Attributes of stimuli are compared within recordings: with the map of every recording centred and
turned onto the map of all, what differs between recordings has no part.
"""

import math
from itertools import permutations as reorder
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas import DataFrame
from scipy.stats import chi2

from feel321.analysis.arrays import CONFIDENCE, FLAT, Values, read_array, read_numbers
from feel321.analysis.resampling import draw_counts
from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.items import Table, open_ratings
from feel321.analysis.table.schema import PAIRED
from feel321.arguments import as_rng
from feel321.records import Statistic
from feel321.types import METRIC_INFO, REDUCER_NAMES, Rng

FEWEST = 3  # Stimuli that make a shape
CUBE = 3  # Axes of a stack of matrices
PLANE = 2  # Dimensions of a map on paper, and the participants that a spread needs
STARTS = 8  # Random starts beside the classical one: SMACOF finds the nearest local minimum
ROUGH, FINE = (300, 1e-6), (1000, 1e-9)  # Steps at most, and the change of stress at which to stop


def fit_space(
    dissimilarities: ArrayLike, *, dimensions: int = 2, draws: int = 0, rng: Rng = 0
) -> Statistic:
    """Place stimuli so that distances agree with dissimilarities: of one person, or averaged over a group.

    Gives ``positions``, (n_stimuli, n_dimensions), in the unit of the dissimilarities; ``stress``, Kruskal's stress-1 =
    √(Σ (δ - d)² / Σ d²): 0 fits perfectly, .05 well, .1 fairly, .2 poorly; with draws of participants, of a map of two
    dimensions, ``ellipses``: see `_draw_ellipses`. SMACOF (scikit-learn) minimises Σ (δ_ij - d_ij)² over pairs.
    Averaging assumes that people share one map. Borg & Groenen (2005), doi 10.1007/0-387-28981-X; Kruskal (1964), doi
    10.1007/BF02289565.
    """
    target, rng = check_dissimilarities(dissimilarities), as_rng(rng)
    if not 1 <= dimensions < len(target):
        most = len(target) - 1
        raise ValueError(f"dimensions must be 1 to {most} for {most + 1} stimuli, got {dimensions}")
    if draws and dimensions != PLANE:
        raise ValueError(f"dimensions must be 2 for ellipses, got {dimensions}; leave draws out")
    # The classical solution first.
    centre = np.eye(len(target)) - 1 / len(target)
    values, vectors = np.linalg.eigh(-centre @ target**2 @ centre / 2)
    largest = np.argsort(values)[::-1][:dimensions]
    # A dimension without variance would stay flat for ever: SMACOF cannot leave it.
    spread = np.sqrt(np.maximum(values[largest], 1e-6 * values.max()))
    starts = [vectors[:, largest] * spread]
    starts += [target.max() * rng.uniform(-1, 1, (len(target), dimensions)) for _ in range(STARTS)]
    rough, _ = min((_scale(target, start, ROUGH) for start in starts), key=lambda fit: fit[1])
    positions, stress = _scale(target, rough, FINE)
    # The largest spread goes along the first axis, and the farthest stimulus to its positive side.
    centred = positions - positions.mean(axis=0)
    turned: Values = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    strongest = turned[np.abs(turned).argmax(axis=0), np.arange(dimensions)]
    places = turned * np.where(strongest < 0, -1.0, 1.0)
    ellipses = _draw_ellipses(dissimilarities, places, draws=draws, rng=rng) if draws else None
    return Statistic("Space", positions=places, stress=stress, ellipses=ellipses)


def _draw_ellipses(
    dissimilarities: object, places: Values, *, draws: int, rng: np.random.Generator
) -> Statistic:
    """Draw participants anew and see how far each stimulus moves on the group's map of two dimensions.

    ``half_axes``, (n_stimuli, 2), the longer first, and ``angle`` of the longer axis against the first dimension, in
    degrees. Every draw is scaled anew, from the group's map on, and aligned with it by Procrustes' rotation; what is
    left is the positions' covariance C. The 95 % ellipse is {x: (x - m)ᵀ C⁻¹ (x - m) <= χ²(.95, 2) P / (P - 1)} for P
    participants. Fitting to the group removes some of the movement: with few stimuli ellipses are somewhat small. Pairs
    that nobody in a draw has rated keep the group's mean.
    """
    stack = read_numbers(dissimilarities, what="dissimilarities")
    if stack.ndim == PLANE or len(stack) < PLANE:
        raise ValueError("ellipses need dissimilarities of two participants or more, got one")
    if draws <= PLANE:
        raise ValueError(f"draws must be 3 or more, got {draws}; use 200")
    n, seen, group = len(stack), np.isfinite(stack), check_dissimilarities(stack)
    weights = draw_counts(n, draws, rng=rng)
    votes = np.einsum("dp,pij->dij", weights, seen)
    sums = np.einsum("dp,pij->dij", weights, np.where(seen, stack, 0))
    means = np.divide(sums, votes, out=np.broadcast_to(group, sums.shape).copy(), where=votes > 0)
    scaled = (_scale(check_dissimilarities(mean), places, ROUGH)[0] for mean in means)
    placed = [_align(one, places) for one in scaled]
    moved = np.stack(placed) - np.mean(placed, axis=0)
    covariance = np.einsum("dni,dnj->nij", moved, moved) / (draws - 1)
    values, vectors = np.linalg.eigh(covariance)
    scale = float(chi2.ppf(CONFIDENCE, PLANE)) * n / (n - 1)
    half_axes = np.sqrt(scale * np.maximum(values[:, ::-1], 0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])) % 180
    return Statistic("Ellipses", half_axes=half_axes, angle=angle, draws=draws, n_participants=n)


def stress_by_dimension(dissimilarities: ArrayLike, *, rng: Rng = 0) -> tuple[float, ...]:
    """Stress-1 of maps with 1, 2, ... dimensions, up to 5 or stimuli - 1, to see how many are enough."""
    target, rng = check_dissimilarities(dissimilarities), as_rng(rng)
    numbers = range(1, min(5, len(target) - 1) + 1)
    return tuple(fit_space(target, dimensions=n, rng=rng).stress for n in numbers)


def gather_dissimilarities(ratings: Table | DataFrame) -> tuple[tuple[str, ...], Values]:
    """Average each participant's ratings of every pair of reducers, over recordings and both orders."""
    rows = open_ratings(ratings)
    rows = rows[(rows["scale"] == PAIRED) & (rows["reference_reducer"] != "")]
    rows = rows[rows["reducer"] != rows["reference_reducer"]]
    if rows.empty:
        raise ValueError("No judgement names two stimuli of different reducers (reference_id).")
    back = rows.rename(columns={"reducer": "reference_reducer", "reference_reducer": "reducer"})
    keys = ["participant", "reducer", "reference_reducer"]
    both = pd.concat([rows, back])
    names = order_reducers(both["reducer"])
    people = sorted(rows["participant"].unique())
    cells = pd.MultiIndex.from_product([people, names, names], names=keys)
    means = both.groupby(keys, observed=True)["rating"].mean().reindex(cells)
    matrices = means.to_numpy(np.float64).reshape(len(people), len(names), len(names)).copy()
    matrices[:, np.arange(len(names)), np.arange(len(names))] = 0
    return tuple(names), matrices


def check_dissimilarities(dissimilarities: object) -> Values:
    """Check dissimilarities and average them over participants, to (stimuli, stimuli)."""
    given = read_numbers(dissimilarities, what="dissimilarities")
    stack = given[None] if given.ndim == PLANE else given
    people, *sides = stack.shape if stack.ndim == CUBE else (0, 0, 0)
    wrong = ""
    if not people or sides[0] != sides[1] or sides[0] < FEWEST:
        shape = "(stimuli, stimuli) or (participants, stimuli, stimuli)"
        wrong = f"have shape {shape}, with {FEWEST} stimuli or more, got shape {given.shape}"
    elif np.isinf(stack).any() or (stack < 0).any():
        wrong = "be 0 or more, NaN where missing, got a negative or infinite value"
    elif np.nansum(np.diagonal(stack, axis1=1, axis2=2)):
        wrong = "be 0 on the diagonal, got a stimulus unlike itself"
    elif not np.allclose(stack, stack.transpose(0, 2, 1), equal_nan=True):
        wrong = "be symmetric, got a matrix that is not; average both orders of a pair first"
    if wrong:
        raise ValueError(f"dissimilarities must {wrong}")
    rated = np.isfinite(stack).sum(axis=0) + np.eye(stack.shape[1], dtype=np.int64)
    if not rated.all():
        first, second = np.argwhere(rated == 0)[0]
        got = f"got no rating of stimuli {first} and {second}; leave one out"
        raise ValueError(f"dissimilarities must hold every pair, {got}")
    mean: Values = np.where(np.isfinite(stack), stack, 0).sum(axis=0) / rated
    if not mean.any():
        got = "got 0 for every pair: there is no map"
        raise ValueError(f"dissimilarities must differ from 0, {got}")
    return mean


def _scale(target: Values, start: Values, steps: tuple[int, float]) -> tuple[Values, float]:
    """Scale dissimilarities from a start on: positions and stress-1."""
    from sklearn.manifold import smacof

    most, close = steps
    positions, _ = smacof(
        target, n_components=start.shape[1], init=start, n_init=1, max_iter=most, eps=close, normalized_stress=False
    )  # fmt: skip
    pairs = np.triu_indices(len(target), 1)
    distances = np.sqrt(((positions[:, None] - positions) ** 2).sum(axis=-1))[pairs]
    stress = np.sqrt(((target[pairs] - distances) ** 2).sum() / (distances**2).sum())
    return positions, float(stress)


def align_spaces(
    positions: ArrayLike, reference: ArrayLike, *, permutations: int = 2000, rng: Rng = 0
) -> Statistic:
    """Compare a map with a physical configuration of the same stimuli, both (stimuli, dimensions).

    Gives ``disparity``, Procrustes' m² = 1 - (Σ σ)², σ the singular values of AᵀB, both centred and of unit size: the
    share of the reference's variance not met; ``correlation`` √(1 - m²); ``p``, the share of random pairings of stimuli
    that agree as well or better (PROTEST: Peres-Neto & Jackson 2001, doi 10.1007/s004420100720); ``aligned``, the map
    fitted to the reference and in its unit.
    """
    if permutations < 1:
        raise ValueError(f"permutations must be 1 or more, got {permutations}; use 2000")
    one, other = (
        read_array(given, what=name, axes=("stimuli", "dimensions"))
        for name, given in (("positions", positions), ("reference", reference))
    )
    for name, place in (("positions", one), ("reference", other)):
        if len(place) < FEWEST:
            raise ValueError(f"{name} must be of 3 stimuli or more, got shape {place.shape}")
        if ((place - place.mean(axis=0)) ** 2).sum() <= FLAT * (place**2).sum():
            raise ValueError(f"{name} must have a shape, got all stimuli in one place")
    if len(one) != len(other):
        got = f"got {len(other)} stimuli"
        raise ValueError(f"reference must be of the same {len(one)} stimuli, {got}")
    width, rng = max(one.shape[1], other.shape[1]), as_rng(rng)
    one, other = (np.pad(place, ((0, 0), (0, width - place.shape[1]))) for place in (one, other))
    agreement = _agree(one, other)
    tried = np.array([_agree(one[rng.permutation(len(one))], other) for _ in range(permutations)])
    p = float((1 + (tried >= agreement - FLAT**0.5).sum()) / (1 + permutations))
    disparity = max(0.0, 1 - agreement**2)
    return Statistic(
        "Alignment", disparity=disparity, correlation=float(np.sqrt(1 - disparity)), p=p,
        aligned=_align(one, other), permutations=permutations,
    )  # fmt: skip


def _normalise(place: Values) -> Values:
    centred: Values = place - place.mean(axis=0)
    return centred / np.linalg.norm(centred)


def _agree(one: Values, other: Values) -> float:
    """Sum the singular values: the correlation after the best rotation."""
    return float(np.linalg.svd(_normalise(one).T @ _normalise(other), compute_uv=False).sum())


def _align(one: Values, other: Values) -> Values:
    """Shift, turn, mirror and scale one configuration onto another."""
    centre = other.mean(axis=0)
    left, stretch, right = np.linalg.svd(_normalise(one).T @ (other - centre))
    aligned: Values = _normalise(one) @ left @ right * stretch.sum() + centre
    return aligned


# Attribute that every stimulus has: the number of directions in which it vibrates, 3 for the original and else 1.
DIRECTIONS = "directions"
ENOUGH = 10  # points for each attribute that a regression wants
ROUNDING = 1e-9
ALL_ORDERS = math.factorial(6)  # permutations up to which each is tried


def gather_points(
    rows: DataFrame, stimuli: DataFrame | None, *, rng: np.random.Generator
) -> tuple[Values, dict[str, Values]]:
    """Map every recording by itself, turned onto the map of all, and gather every number known of its stimuli.

    Returns places, (n_maps, n_stimuli, 2), and attributes by name, (n_maps, n_stimuli), NaN where there is no number.
    """
    if stimuli is None:
        raise ValueError("Nothing is known of the stimuli.")
    names, matrices = gather_dissimilarities(rows)
    whole = fit_space(matrices, rng=rng).positions
    rows = rows[rows["scale"] == PAIRED]
    # The original matches itself by definition: it would lie at the end of every metric, as it lies at the edge of
    # every map, and make any metric seem to contribute. It has no matches here.
    is_whole = (stimuli["role"] == "reference") & ~stimuli["reducer"].isin(REDUCER_NAMES)
    numbers = stimuli.select_dtypes("number").assign(**{DIRECTIONS: np.where(is_whole, 3.0, 1.0)})
    numbers.loc[is_whole, numbers.columns.intersection([*METRIC_INFO])] = np.nan
    own = numbers[stimuli["level"].isin(rows["level"].unique())]
    keys = [stimuli.loc[own.index, name] for name in ("recording", "reducer")]
    means, places, values = own.groupby(keys).mean(), [], []
    for recording, part in rows.groupby("recording", observed=True):
        try:
            found, matrices = gather_dissimilarities(part)
            place = fit_space(matrices, rng=rng).positions
        except ValueError:
            continue
        if found == names:
            place = place - place.mean(axis=0)
            left, _, right = np.linalg.svd(place.T @ (whole - whole.mean(axis=0)))
            places.append(place @ left @ right)
            values.append(means.loc[recording].reindex(names).to_numpy(np.float64))
    if not places:
        raise ValueError("No recording has ratings of every pair.")
    varying: dict[str, Values] = {}
    for name, one in zip(means, np.moveaxis(np.stack(values), -1, 0), strict=True):
        # Enough stimuli must have a number, and those of a recording differ in it.
        known = one[:, np.isfinite(one).all(axis=0)]
        spread = known.std(axis=1) if known.shape[1] > FEWEST else np.zeros(1)
        if (spread > ROUNDING * np.abs(known).max(initial=0)).any():
            varying[str(name)] = one
    return np.stack(places), varying


def regress_points(
    places: Values, attributes: dict[str, Values], *, draws: int, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Regress every attribute on the axes of the maps, within recordings.

    p: share of permutations of the stimuli (one for all maps, because a reducer is the same in each) that explain as
    much: all of them, or `draws` where there are more. p_least: the smallest that this attribute could have had.
    chance, chance_low, chance_high: mean, 5 % and 95 % quantiles of R² of the permutations.
    """
    rows = []
    for name, values in attributes.items():
        known = np.isfinite(values).all(axis=0)
        pair = (one[:, known] for one in (places, values))
        design, kept = (one - one.mean(axis=1, keepdims=True) for one in pair)
        design, n = design.reshape(-1, 2), int(known.sum())
        if math.factorial(n) <= max(draws, ALL_ORDERS):
            orders = [np.array(order) for order in reorder(range(n))]
        else:
            orders = [np.arange(n), *(rng.permutation(n) for _ in range(draws))]
        r2, slope = _explain(kept.ravel(), design)
        tried = np.array([_explain(kept[:, order].ravel(), design)[0] for order in orders])
        alike = np.array([np.allclose(kept[:, order], kept) for order in orders])
        one, two = slope / (float(np.hypot(*slope)) or 1.0)
        low, high = np.quantile(tried, [0.05, 0.95])
        rows.append({
            "property": name, "r2": r2, "p": float((tried >= r2 - ROUNDING).mean()), "p_least": float(alike.mean()),
            "axis_1": one, "axis_2": two, "n": kept.size, "permutations": len(orders), "chance": float(tried.mean()),
            "chance_low": float(low), "chance_high": float(high),
        })  # fmt: skip
    return rows


def _explain(values: Values, design: Values) -> tuple[float, Values]:
    """Explain centred values by least squares: R² and the slopes."""
    slope = np.linalg.lstsq(design, values, rcond=None)[0]
    left: Values = values - design @ slope
    return 1 - float(left @ left) / float(values @ values), np.asarray(slope, dtype=np.float64)
