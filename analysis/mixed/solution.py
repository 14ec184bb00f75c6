"""What the equations at one theta say of the effects: fixed, random, and residual."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.mixed.profile import Profile, State


def find_sigma(profile: Profile, state: State) -> float:
    """Residual standard deviation.

    Parameters
    ----------
    profile : Profile
        The equations' data.
    state : State
        The equations, factorised.

    Returns
    -------
    float
        sqrt(rss / (n - p)), or rss / n for the full likelihood; with k penalised spreads, k less.
    """
    return float(np.sqrt(state.rss / profile.weight))


def find_coefficients(profile: Profile, state: State) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solve for the fixed effects and their covariance in units of s².

    Parameters
    ----------
    profile : Profile
        The equations' data.
    state : State
        The equations, factorised.

    Returns
    -------
    ndarray, shape (n_fixed,)
        Best linear unbiased estimates.
    ndarray, shape (n_fixed, n_fixed)
        (X'V⁻¹X)⁻¹.
    """
    from scipy.linalg import solve_triangular

    place = slice(profile.n_random, -1)
    corner, last = state.factor[place, place], state.factor[-1, place]
    inverse = solve_triangular(profile.triangle_x, solve_triangular(corner, np.eye(profile.n_fixed), lower=True).T)
    shift = solve_triangular(profile.triangle_x, profile.offset)
    return shift + inverse @ last * profile.unit, inverse @ inverse.T


def find_modes(profile: Profile, state: State) -> list[NDArray[np.float64]]:
    """Predicted random effects of every factor, in the order of the blocks.

    Parameters
    ----------
    profile : Profile
        The equations' data.
    state : State
        The equations, factorised.

    Returns
    -------
    list of ndarray, shape (n_levels, width)
        Best linear unbiased predictions, of the columns as given.
    """
    from scipy.linalg import solve_triangular

    factor, last = state.factor[:-1, :-1], state.factor[-1, :-1]
    solved = solve_triangular(factor, last, lower=True, trans="T")
    tail = np.append(-solved, 1.0)
    found = []
    for (place, other), block in zip(profile.tail(state.theta), profile.blocks[1:], strict=True):
        effects = solved[place].reshape(-1, block.width) @ other.T
        tail[place] = -effects.ravel()
        found.append(effects)
    lower = profile.blocks[0].triangle(state.theta)
    seen = (profile.border @ tail).reshape(-1, profile.blocks[0].width)
    first = np.einsum("kij,kj->ki", lower @ state.inner @ lower.T, seen)
    return [
        effects * profile.unit / block.scale for effects, block in zip([first, *found], profile.blocks, strict=True)
    ]


def find_spreads(profile: Profile, state: State) -> list[NDArray[np.float64]]:
    """Covariances of the random effects in units of s², in the order of the blocks.

    Parameters
    ----------
    profile : Profile
        The equations' data.
    state : State
        The equations, factorised.

    Returns
    -------
    list of ndarray, shape (width, width)
        Of the columns as given.
    """
    lowers = [block.triangle(state.theta) / block.scale[:, None] for block in profile.blocks]
    return [lower @ lower.T for lower in lowers]
