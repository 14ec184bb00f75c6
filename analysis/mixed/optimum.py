"""The minimum of the profiled deviance, at the boundary too."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.mixed.slope import find_slope

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.mixed.profile import Profile, State

ZERO = 1e-4
"""A relative spread below this is none: what lme4 calls singular."""

LARGEST = 1e5
"""A spread so many times the residual means that there is no residual."""

PROBE, RESTART, ATTEMPTS = 0.02, 0.3, 4


def find_optimum(profile: Profile) -> State:
    """Minimise the deviance over theta.

    Parameters
    ----------
    profile : Profile
        The deviance and its slope.

    Returns
    -------
    State
        The equations at the best theta, spreads below 1e-4 set to 0 unless they are penalised.

    Raises
    ------
    ValueError
        If the random effects explain the response without residual, or no minimum is found.

    Notes
    -----
    L-BFGS from theta = 1 (off the diagonal 0), without bounds because the deviance does not change with a
    spread's sign. For the same reason 0 is always stationary; at every spread of 0 the deviance is therefore
    probed at a small positive value, which shows the sign of its derivative in theta², and the search resumed
    where that is lower. The penalty, -2 log (theta s), goes to infinity at 0.
    """
    start = profile.diagonal.astype(np.float64)
    best = _descend(profile, start)
    for _ in range(ATTEMPTS):
        resumed = _leave_boundary(profile, best)
        if resumed is None:
            break
        best = resumed
    return best


def _descend(profile: Profile, start: NDArray[np.float64]) -> State:
    from scipy.optimize import minimize

    def value(theta: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        state = profile.evaluate(theta)
        slope = find_slope(profile, state)
        slope[profile.penalised] -= 2 / theta[profile.penalised]
        return _find_target(profile, state), slope

    # Without bounds: the deviance is even in a spread, and a search that is stopped at 0 may rest there in vain.
    try:
        found = minimize(
            value, start, jac=True, method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-6, "maxiter": 1000, "maxls": 50},
        )  # fmt: skip
    except np.linalg.LinAlgError as error:
        raise ValueError(_NO_RESIDUAL) from error
    if np.abs(found.x).max() > LARGEST:
        raise ValueError(_NO_RESIDUAL)
    return _snap(profile, _turn(profile, found.x))


def _find_target(profile: Profile, state: State) -> float:
    """Add the penalty, -2 log of every spread it names, to the deviance: what is minimised."""
    spreads = state.theta[profile.penalised] ** 2 * state.rss / profile.weight
    return profile.deviance(state) - float(np.log(spreads).sum())


_NO_RESIDUAL = (
    "data: got a response that the random effects give exactly, without residual; "
    "allowed is one with scatter within groups, leave the finest group out of the formula"
)


def _turn(profile: Profile, theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Write theta with spreads of 0 or more; turning an effect's column around changes nothing."""
    turned = []
    for block in profile.blocks:
        lower = block.triangle(theta)
        lower = lower * np.where(np.diag(lower) < 0, -1.0, 1.0)
        turned.append(lower[block.rows, block.columns])
    return np.concatenate(turned)


def _snap(profile: Profile, theta: NDArray[np.float64]) -> State:
    """Set spreads that are zero but for the search's tolerance to zero."""
    none = profile.diagonal & (theta < ZERO) & ~profile.penalised
    return profile.evaluate(np.where(none, 0.0, theta))


def _leave_boundary(profile: Profile, state: State) -> State | None:
    """Find a better minimum where a spread of 0 is above 0, or None."""
    here = _find_target(profile, state)
    for place in np.flatnonzero(profile.diagonal & (state.theta == 0)):
        probe = state.theta.copy()
        probe[place] = PROBE
        if _find_target(profile, profile.evaluate(probe)) < here - 1e-9:
            probe[place] = RESTART
            better = _descend(profile, probe)
            return better if _find_target(profile, better) < here else None
    return None
