"""The exact slope of the profiled deviance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.mixed.balanced import Balanced
from analysis.mixed.layout import scale_columns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.mixed.profile import Profile, State


def find_slope(profile: Profile, state: State, weight: float | None = None) -> NDArray[np.float64]:
    """Differentiate the deviance with respect to theta.

    Parameters
    ----------
    profile : Profile
        The equations' data.
    state : State
        The equations, factorised.
    weight : float, optional
        rss / s² for an s that is held; if left out, s is the best one for every theta.

    Returns
    -------
    ndarray, shape (n_theta,)
        The derivative.

    Notes
    -----
    The determinants of the leading parts of the dense matrix D are all there is: d log |D_k| =
    tr(D_k⁻¹ dD), and d log rss = z' dD z with z = (-coefficients, 1) / sqrt(rss).
    """
    weight = profile.weight if weight is None else weight
    if isinstance(profile, Balanced):
        return profile.find_slope(state, weight)
    lower = profile.blocks[0].triangle(state.theta)
    outer = _find_adjoint(profile, state, weight)
    # Through the dense part's own scale.
    half = profile.eliminate(lower @ state.inner @ lower.T)
    for place, other in profile.tail(state.theta):
        half[:, place] = scale_columns(half[:, place], other)
    tail = list(profile.tail(state.theta))
    found = [2 * _trace_blocks(half[place], outer[:, place], len(other)) for place, other in tail]
    for place, other in tail:
        outer[:, place] = scale_columns(outer[:, place], other.T)
    for place, other in tail:
        outer[place] = scale_columns(outer[place].T, other.T).T
    found.insert(0, _find_inner_slope(profile, state, outer))
    parts = zip(found, profile.blocks, strict=True)
    return np.concatenate([matrix[block.rows, block.columns] for matrix, block in parts])


def _find_adjoint(profile: Profile, state: State, weight: float) -> NDArray[np.float64]:
    """Differentiate the deviance with respect to the dense matrix."""
    from scipy.linalg.lapack import dpotri, dtrtrs

    size = profile.n_random + (profile.n_fixed if profile.reml else 0)
    adjoint = np.zeros_like(state.factor)
    if size:  # the full likelihood of a single grouping factor has no determinant but the eliminated one
        inverse = dpotri(state.factor[:size, :size], lower=1)[0]
        adjoint[:size, :size] = np.tril(inverse) + np.tril(inverse, -1).T
    last = np.zeros(len(state.factor))
    last[-1] = 1
    direction = dtrtrs(state.factor, last, lower=1, trans=1)[0]
    adjoint += weight * np.outer(direction, direction)
    return adjoint


def _find_inner_slope(profile: Profile, state: State, outer: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differentiate through the eliminated factor: its own determinant, and what it leaves."""
    lower = profile.blocks[0].triangle(state.theta)
    width = len(lower)
    through = profile.border @ outer
    seen = np.empty((profile.blocks[0].n_levels, width, width))
    for row in range(width):
        for column in range(width):
            seen[:, row, column] = profile.border[column::width].multiply(through[row::width]).sum(axis=1)
    back = state.inner @ lower.T
    kept = np.eye(width) - lower @ back @ profile.inner_products
    slope: NDArray[np.float64] = 2 * (back @ profile.inner_products - back @ seen @ kept).sum(axis=0).T
    return slope


def _trace_blocks(left: NDArray[np.float64], right: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Sum over levels of the blocks on the diagonal of left @ right."""
    rows = left.reshape(-1, width, left.shape[1])
    columns = right.T.reshape(-1, width, right.shape[0])
    found: NDArray[np.float64] = np.einsum("aik,ajk->ij", rows, columns)
    return found
