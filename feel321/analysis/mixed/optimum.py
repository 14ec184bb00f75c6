"""The minimum of the deviance: its derivative, and the shortcut of balanced designs.

With P participants and n rows each, the covariance of all rows is I ⊗ A + J ⊗ B: A holds what is one person's own
(level, slopes, own recordings, residual), B what everybody shares (stimuli, recordings, reducers). The mean over
participants, times √P, has the covariance M = A + P B, and the P - 1 directions orthogonal to it A each. Fixed effects
are the same for everybody and stand in the mean alone. The restricted likelihood then needs two small matrices only,
whatever P is; it is the same function of theta as `Profile`'s, to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.mixed.design import find_penalised, lay_out, scale_columns
from feel321.analysis.mixed.profile import Profile, State

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from feel321.analysis.mixed.design import Block, Design, Factor

# The profiled deviance of a balanced design, in which every participant rated every stimulus equally often.


class Place(NamedTuple):
    """Where a factor stands.

    columns: (n_each, n_levels * width).
    """

    columns: NDArray[np.float64]
    shared: bool


@dataclass(frozen=True, slots=True)
class Frame:
    """A design's rows in the order participant by participant.

    order: (n_people, n_each); places: factor's name -> where it stands.
    """

    order: NDArray[np.intp]
    places: dict[str, Place]


def find_frame(design: Design) -> Frame | None:
    """Order the rows of a design participant by participant, alike for all."""
    if any(len(term.names) > 1 for factor in design.factors for term in factor.terms):
        return None
    frames = (_order_by(design, factor) for factor in design.factors)
    return next((frame for frame in frames if frame is not None), None)


def _order_by(design: Design, who: Factor) -> Frame | None:
    people, n_rows = len(who.levels), len(who.index)
    if n_rows % people or (np.bincount(who.index) != n_rows // people).any():
        return None
    keys = [*design.fixed.T, *(factor.index for factor in design.factors), who.index]
    order = np.lexsort(keys).reshape(people, -1)
    if not _is_same(design.fixed[order]):
        return None
    places = {factor.name: _find_place(factor, order) for factor in design.factors}
    known = {name: place for name, place in places.items() if place is not None}
    return Frame(order, known) if len(known) == len(places) else None


def _is_same(values: NDArray[np.generic]) -> bool:
    return bool((values == values[0]).all())


def _find_place(factor: Factor, order: NDArray[np.intp]) -> Place | None:
    """Read the columns of one participant's rows; None if they differ, or levels are neither own nor everybody's."""
    levels = factor.index[order]
    shared = _is_same(levels)
    own = [np.unique(one, return_inverse=True)[1] for one in levels]
    if not shared and (
        len(factor.levels) != len(order) * (own[0].max() + 1) or not _is_same(np.array(own))
    ):
        return None
    values = factor.columns[order]
    if not _is_same(values):
        return None
    marks = np.eye(own[0].max() + 1)[own[0]]
    columns = (marks[:, :, None] * values[0][:, None, :]).reshape(len(marks), -1)
    return Place(columns, shared)


class Balanced(Profile):
    """The deviance as a function of theta, for a balanced design."""

    def __init__(
        self, design: Design, frame: Frame, *, reml: bool, penalty: Sequence[str] = ()
    ) -> None:
        self.design, self.reml, self.frame = design, reml, frame
        self.n_rows, self.n_fixed = design.fixed.shape
        self.n_people, self.n_each = frame.order.shape
        self.freedom = self.n_rows - self.n_fixed if reml else self.n_rows
        self.blocks = tuple(lay_out(design.factors))
        self.penalised = find_penalised(self.blocks, penalty)
        self.weight = self.freedom - int(self.penalised.sum())
        own = [block for block in self.blocks if not frame.places[block.factor.name].shared]
        common = [block for block in self.blocks if frame.places[block.factor.name].shared]
        # One level for every row of a participant: a multiple of the identity, not worth columns.
        self.each = next(
            (block for block in common if _is_identity(frame.places[block.factor.name])), None
        )
        self._read_columns(own, [block for block in common if block is not self.each])
        self._reduce_rows()

    def _read_columns(self, own: list[Block], common: list[Block]) -> None:
        def spread(block: Block) -> NDArray[np.float64]:
            columns = self.frame.places[block.factor.name].columns
            scaled: NDArray[np.float64] = columns / np.tile(
                block.scale, columns.shape[1] // block.width
            )
            return scaled

        def point(block: Block) -> NDArray[np.intp]:
            levels = self.frame.places[block.factor.name].columns.shape[1] // block.width
            return np.tile(np.arange(block.theta.start, block.theta.stop), levels)

        self.n_own = sum(self.frame.places[block.factor.name].columns.shape[1] for block in own)
        parts = [*map(spread, own), *(np.sqrt(self.n_people) * spread(block) for block in common)]
        self.columns = np.hstack([np.empty((self.n_each, 0)), *parts])
        self.parameters = np.concatenate([np.empty(0, np.intp), *map(point, [*own, *common])])
        self.n_random = len(self.parameters)

    def _reduce_rows(self) -> None:
        """Keep the mean over participants and what deviates from it as cross products."""
        values = self.design.response[self.frame.order]
        mean = values.mean(axis=0)
        basis, triangle = np.linalg.qr(self.design.fixed[self.frame.order[0]])
        self.triangle_x = triangle * np.sqrt(self.n_people)
        centre = mean * np.sqrt(self.n_people)
        self.offset = basis.T @ centre
        rest, deviation = centre - basis @ self.offset, values - mean
        scatter = float((deviation**2).sum())
        self.unit = float(np.sqrt((rest @ rest + scatter) / self.n_rows))
        self.scatter = scatter / self.unit**2
        seen = deviation @ self.columns[:, : self.n_own] / self.unit
        self.own_scatter = seen.T @ seen
        dense = np.column_stack([self.columns, basis, rest / self.unit])
        self.products = dense.T @ dense

    def evaluate(self, theta: NDArray[np.float64]) -> State:
        """Factorise both matrices at theta.

        theta: (n_theta,).
        """
        from scipy.linalg.lapack import dpotrf, dpotri

        spreads, ratio = self._find_spreads(theta)
        own, size = spreads[: self.n_own], np.arange(self.n_random)
        blocks = self.products[: self.n_own, : self.n_own] * (own[:, None] * own)
        blocks[size[: self.n_own], size[: self.n_own]] += 1
        root, failed = dpotrf(blocks, lower=1, clean=1)
        half = dpotri(root, lower=1)[0]
        inner = half + np.tril(half, -1).T
        scaled = self.products * (spreads[:, None] * (spreads / ratio))
        scaled[size, size] += 1
        # The residual of what deviates goes along with that of the mean, which may be nothing but rounding.
        scaled[-1, -1] += self.scatter - float(own @ (inner * self.own_scatter) @ own)
        factor, failed_too = dpotrf(scaled, lower=1, clean=1)
        if failed or failed_too:
            raise np.linalg.LinAlgError("the residual is lost in rounding")
        logs, log_own = 2 * np.log(factor.diagonal()), 2 * float(np.log(root.diagonal()).sum())
        return State(
            theta=theta,
            log_random=float(
                (self.n_people - 1) * log_own
                + self.n_each * np.log(ratio)
                + logs[: self.n_random].sum()
            ),
            log_fixed=float(
                logs[self.n_random : -1].sum() + 2 * np.log(np.abs(np.diag(self.triangle_x))).sum()
            ),
            rss=float(factor[-1, -1] ** 2) * self.unit**2,
            factor=factor,
            inner=inner,
        )

    def _find_spreads(self, theta: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Spread of every column, 1 for the fixed ones and y, and the variance of a mean's own row beside residual."""
        spreads = np.concatenate([theta[self.parameters], np.ones(self.n_fixed + 1)])
        each = 0.0 if self.each is None else float(theta[self.each.theta][0])
        return spreads, 1 + self.n_people * each**2

    def find_slope(self, state: State, weight: float) -> NDArray[np.float64]:
        """Differentiate the deviance with respect to theta.

        Returns (n_theta,).
        """
        from scipy.linalg.lapack import dtrtri

        spreads, ratio = self._find_spreads(state.theta)
        share = weight / state.rss * self.unit**2
        # Of the mean: log |D| of the leading rows, and the residual; D = products spreads spreads' / ratio + I.
        size = self.n_random + (self.n_fixed if self.reml else 0)
        half = dtrtri(state.factor, lower=1)[0]
        direction = half[-1] * state.factor[-1, -1]
        adjoint = share * (direction[:, None] * direction)
        adjoint[:size, :size] += half[:size, :size].T @ half[:size, :size]
        adjoint *= self.products
        along = adjoint @ spreads / ratio
        slope = 2 * along[: self.n_random]
        # Of what deviates from it.
        own, inner = spreads[: self.n_own], state.inner
        met = inner @ (self.own_scatter * (own[:, None] * own)) @ inner
        through = self.products[: self.n_own, : self.n_own] * (
            (self.n_people - 1) * inner + share * met
        )
        slope[: self.n_own] += 2 * (through - share * inner * self.own_scatter) @ own
        found = np.zeros(len(state.theta))
        np.add.at(found, self.parameters, slope)
        if self.each is not None:
            wider = (self.n_each - float(spreads @ along)) / ratio
            found[self.each.theta] += wider * 2 * self.n_people * state.theta[self.each.theta]
        return found


def _is_identity(place: Place) -> bool:
    rows, levels = place.columns.shape
    return (
        rows == levels
        and bool((np.abs(np.diag(place.columns)) == np.abs(place.columns[0, 0])).all())
        and (np.count_nonzero(place.columns) == rows)
    )


# The exact slope of the profiled deviance.


def find_slope(profile: Profile, state: State, weight: float | None = None) -> NDArray[np.float64]:
    """Differentiate the deviance with respect to theta.

    Returns (n_theta,).

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
    # The full likelihood of a single grouping factor has no determinant but the eliminated one.
    if size:
        inverse = dpotri(state.factor[:size, :size], lower=1)[0]
        adjoint[:size, :size] = np.tril(inverse) + np.tril(inverse, -1).T
    last = np.zeros(len(state.factor))
    last[-1] = 1
    direction = dtrtrs(state.factor, last, lower=1, trans=1)[0]
    adjoint += weight * np.outer(direction, direction)
    return adjoint


def _find_inner_slope(
    profile: Profile, state: State, outer: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Differentiate through the eliminated factor: its own determinant, and what it leaves."""
    lower = profile.blocks[0].triangle(state.theta)
    width = len(lower)
    through = profile.border @ outer
    seen = np.empty((profile.blocks[0].n_levels, width, width))
    for row in range(width):
        for column in range(width):
            seen[:, row, column] = (
                profile.border[column::width].multiply(through[row::width]).sum(axis=1)
            )
    back = state.inner @ lower.T
    kept = np.eye(width) - lower @ back @ profile.inner_products
    slope: NDArray[np.float64] = (
        2 * (back @ profile.inner_products - back @ seen @ kept).sum(axis=0).T
    )
    return slope


def _trace_blocks(
    left: NDArray[np.float64], right: NDArray[np.float64], width: int
) -> NDArray[np.float64]:
    """Sum over levels of the blocks on the diagonal of left @ right."""
    rows = left.reshape(-1, width, left.shape[1])
    columns = right.T.reshape(-1, width, right.shape[0])
    found: NDArray[np.float64] = np.einsum("aik,ajk->ij", rows, columns)
    return found


# The minimum of the profiled deviance, at the boundary too.

ZERO = 1e-4
"""A relative spread below this is none: what lme4 calls singular."""

LARGEST = 1e5
"""A spread so many times the residual means that there is no residual."""

PROBE, RESTART, ATTEMPTS = 0.02, 0.3, 4


def find_optimum(profile: Profile) -> State:
    """Minimise the deviance over theta.

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
            value,
            start,
            jac=True,
            method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-6, "maxiter": 1000, "maxls": 50},
        )
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
