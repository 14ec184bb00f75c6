"""The profiled deviance of a linear mixed model, its minimum, and the shortcut of balanced designs.

Model: y = X b + Z L u + e, with u ~ N(0, s² I), e ~ N(0, s² I) and L block-diagonal, holding for every level
of a grouping factor the same lower triangle of relative spreads, theta. Given theta, b and s have closed forms;
what is left to minimise is a function of theta alone (Bates et al. 2015, doi 10.18637/jss.v067.i01, eq. 38-42).

Layout (as in MixedModels.jl): columns of the factor with the most effects come first. Its part of L'Z'ZL + I
falls into one small block per level, which are eliminated at once; what remains is small and dense, with X and y
as its last rows, so that one Cholesky factor holds the determinants, the coefficients and the residual.

Columns are scaled first: Z's to unit mean square, X to orthonormal columns, y to what X leaves over. The
deviance is that of the data as given; results are scaled back.

With a study's hundred or so levels, two threads spend most of their time waiting for each other: on two busy cores the
same fit took 10 times as long as with one, and 10 times as much work.

The limit of a linear algebra library holds for the whole process. Of fits that run at the same time in several threads
one sets it and restores it, the others leave it alone: each on its own would restore what another had set, and the
process would be left at one thread.

With P participants and n rows each, the covariance of all rows is I ⊗ A + J ⊗ B: A holds what is one person's own
(level, slopes, own recordings, residual), B what everybody shares (stimuli, recordings, reducers). The mean over
participants, times √P, has the covariance M = A + P B, and the P - 1 directions orthogonal to it A each. Fixed effects
are the same for everybody and stand in the mean alone. The restricted likelihood then needs two small matrices only,
whatever P is; it is the same function of theta as `Profile`'s, to rounding.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.mixed.design import (
    Factor,
    MixedDesign,
    find_penalised,
    pick_blocks,
    place_factors,
    scale_columns,
    spread_columns,
)
from feel321.types import Samples

MOST_LEVELS = 10_000
"""Effects beside the largest factor's: with more, the dense equations alone need gigabytes."""

LARGE = 600
"""Rows of a dense matrix from which two threads are worth their while."""

HELD = Lock()
"""Taken by whoever set the limit; the process has one limit, and so has this module."""


@dataclass(frozen=True)
class State:
    """Everything known at one theta; theta: (n_theta,), inner: (n_levels, width, width)."""

    theta: Samples
    log_random: float
    log_fixed: float
    rss: float
    factor: Samples
    inner: Samples


class Profile:
    """The deviance as a function of theta, for one design."""

    n_random: int
    triangle_x: Samples
    offset: Samples
    unit: float

    def __init__(self, design: MixedDesign, *, reml: bool, penalty: Sequence[str] = ()) -> None:
        self.design, self.reml = design, reml
        self.n_rows, self.n_fixed = design.fixed.shape
        self.freedom = self.n_rows - self.n_fixed if reml else self.n_rows
        self.blocks = tuple(place_factors(design.factors))
        self.diagonal = np.concatenate([block.rows == block.columns for block in self.blocks])
        self.penalised = find_penalised(self.blocks, penalty)
        # Every spread whose logarithm is penalised takes one residual's along, for spreads are in units of it.
        self.weight = self.freedom - int(self.penalised.sum())
        self._reduce_data()

    def _reduce_data(self) -> None:
        """Keep only the cross products; rows are not needed again."""
        from scipy.sparse import csr_array, hstack

        self.n_random = sum(block.n_levels * block.width for block in self.blocks[1:])
        if self.n_random > MOST_LEVELS:
            raise ValueError(
                f"data must have at most {MOST_LEVELS} effects beside those of {self.blocks[0].factor.name}, for "
                f"memory, got {self.n_random}; average repeated rows, or leave out a group with many levels"
            )
        basis, self.triangle_x = np.linalg.qr(self.design.fixed)
        self.offset = basis.T @ self.design.response
        rest = self.design.response - basis @ self.offset
        self.unit = float(np.linalg.norm(rest) / np.sqrt(self.n_rows))
        dense = np.column_stack([basis, rest / self.unit])
        first, *others = [spread_columns(block) for block in self.blocks]
        tail = hstack([*others, csr_array(dense)], format="csr")
        self.inner_products = pick_blocks(first, self.blocks[0])
        self.border = (first.T @ tail).tocsr()
        self.outer = (tail.T @ tail).toarray()

    @cached_property
    def log_x(self) -> float:
        """The determinant of X'X, as a logarithm."""
        return float(2 * np.log(np.abs(np.diag(self.triangle_x))).sum())

    def evaluate(self, theta: Samples) -> State:
        """Factorise the equations at theta, (n_theta,)."""
        from scipy.linalg import cholesky

        lower = self.blocks[0].triangle(theta)
        blocks = lower.T @ self.inner_products @ lower + np.eye(len(lower))
        inner = np.linalg.inv(blocks).astype(np.float64, copy=False)
        scaled = self.eliminate(lower @ inner @ lower.T)
        for place, other in self.tail(theta):
            scaled[:, place] = scale_columns(scaled[:, place], other)
        for place, other in self.tail(theta):
            scaled[place] = scale_columns(scaled[place].T, other).T
        diagonal = np.arange(self.n_random)
        scaled[diagonal, diagonal] += 1
        factor = cholesky(scaled, lower=True, overwrite_a=True, check_finite=False)
        log_blocks = float(np.linalg.slogdet(blocks)[1].sum())
        return self._make_state(theta, log_blocks, factor=factor, inner=inner)

    def _make_state(
        self, theta: Samples, log_others: float, *, factor: Samples, inner: Samples
    ) -> State:
        logs = 2 * np.log(factor.diagonal())
        return State(
            theta=theta,
            log_random=float(log_others + logs[: self.n_random].sum()),
            log_fixed=float(logs[self.n_random : -1].sum()) + self.log_x,
            rss=float(factor[-1, -1] ** 2) * self.unit**2,
            factor=factor,
            inner=inner,
        )

    def eliminate(self, middle: Samples) -> Samples:
        """Take the first factor out of the others' cross products; middle: (n_levels, width, width)."""
        from scipy.sparse import bsr_array

        count = len(middle)
        spread = bsr_array((middle, np.arange(count), np.arange(count + 1))).tocsr()
        left: Samples = self.outer - (self.border.T @ (spread @ self.border)).toarray()
        return left

    def tail(self, theta: Samples) -> Iterator[tuple[slice, Samples]]:
        """List where the factors that are not eliminated stand, and their triangles, (width, width)."""
        start = 0
        for block in self.blocks[1:]:
            stop = start + block.n_levels * block.width
            yield slice(start, stop), block.triangle(theta)
            start = stop

    def deviance(self, state: State) -> float:
        """-2 log likelihood with the best b and s for this theta."""
        spread = np.log(2 * np.pi * state.rss / self.weight)
        return float(
            state.log_random + self.reml * state.log_fixed + self.freedom * spread + self.weight
        )


def find_sigma(profile: Profile, state: State) -> float:
    """Residual standard deviation."""
    return float(np.sqrt(state.rss / profile.weight))


def find_coefficients(profile: Profile, state: State) -> tuple[Samples, Samples]:
    """Solve for the fixed effects, (n_fixed,), and their covariance in units of s²."""
    from scipy.linalg import solve_triangular

    place = slice(profile.n_random, -1)
    corner, last = state.factor[place, place], state.factor[-1, place]
    inverse = solve_triangular(
        profile.triangle_x, solve_triangular(corner, np.eye(profile.n_fixed), lower=True).T
    )
    shift = solve_triangular(profile.triangle_x, profile.offset)
    return shift + inverse @ last * profile.unit, inverse @ inverse.T


def find_modes(profile: Profile, state: State) -> list[Samples]:
    """Predict the random effects of every factor, (n_levels, width), in the order of the blocks."""
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
        effects * profile.unit / block.scale
        for effects, block in zip([first, *found], profile.blocks, strict=True)
    ]


def find_spreads(profile: Profile, state: State) -> list[Samples]:
    """Covariances of the random effects, (width, width), in units of s², in the order of the blocks."""
    lowers = [block.triangle(state.theta) / block.scale[:, None] for block in profile.blocks]
    return [lower @ lower.T for lower in lowers]


@contextmanager
def hold_threads(size: int) -> Iterator[None]:
    """Keep linear algebra to one thread while in the context, if matrices are small and nobody else does."""
    from threadpoolctl import threadpool_limits

    if size >= LARGE or not HELD.acquire(blocking=False):
        yield
        return
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        HELD.release()


ZERO = 1e-4
"""A relative spread below this is none: what lme4 calls singular."""

LARGEST = 1e5
"""A spread so many times the residual means that there is no residual."""

PROBE, RESTART, ATTEMPTS = 0.02, 0.3, 4


class Stand(NamedTuple):
    """Where a factor stands among one participant's rows; columns: (n_each, n_levels * width)."""

    columns: Samples
    shared: bool


@dataclass(frozen=True, slots=True)
class BalancedRows:
    """A design's rows participant by participant, (n_people, n_each), and where each factor stands."""

    order: NDArray[np.intp]
    stands: dict[str, Stand]


def find_balance(design: MixedDesign) -> BalancedRows | None:
    """Order the rows of a design participant by participant, alike for all."""
    if any(len(term.names) > 1 for factor in design.factors for term in factor.terms):
        return None
    found = (_order_by(design, factor) for factor in design.factors)
    return next((balance for balance in found if balance is not None), None)


def _order_by(design: MixedDesign, who: Factor) -> BalancedRows | None:
    people, n_rows = len(who.levels), len(who.index)
    if n_rows % people or (np.bincount(who.index) != n_rows // people).any():
        return None
    keys = [*design.fixed.T, *(factor.index for factor in design.factors), who.index]
    order = np.lexsort(keys).reshape(people, -1)
    if not _is_same(design.fixed[order]):
        return None
    stands = {}
    for factor in design.factors:
        stand = find_stand(factor, order)
        if stand is None:
            return None
        stands[factor.name] = stand
    return BalancedRows(order, stands)


def _is_same(values: NDArray[np.generic]) -> bool:
    return bool((values == values[0]).all())


def find_stand(factor: Factor, order: NDArray[np.intp]) -> Stand | None:
    """Read the columns of one participant's rows; None if they differ, or levels are neither own nor everybody's."""
    levels, values = factor.index[order], factor.columns[order]
    shared = _is_same(levels)
    own = np.array([np.unique(one, return_inverse=True)[1] for one in levels])
    size = int(own[0].max()) + 1
    if not shared and (len(factor.levels) != len(order) * size or not _is_same(own)):
        return None
    if not _is_same(values):
        return None
    marks = np.eye(size)[own[0]]
    columns = (marks[:, :, None] * values[0][:, None, :]).reshape(len(marks), -1)
    return Stand(columns, shared)


class Balanced(Profile):
    """The deviance as a function of theta, for a balanced design."""

    def __init__(
        self, design: MixedDesign, balance: BalancedRows, *, reml: bool, penalty: Sequence[str] = ()
    ) -> None:
        self.balance = balance
        self.n_people, self.n_each = balance.order.shape
        super().__init__(design, reml=reml, penalty=penalty)

    def _reduce_data(self) -> None:
        """Keep the mean over participants and what deviates from it as cross products."""
        self._read_columns()
        values = self.design.response[self.balance.order]
        mean = values.mean(axis=0)
        basis, triangle = np.linalg.qr(self.design.fixed[self.balance.order[0]])
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

    def _read_columns(self) -> None:
        """Put the columns of what is one person's own first, then what everybody shares."""
        stands = self.balance.stands
        shared = [block for block in self.blocks if stands[block.factor.name].shared]
        # One level for every row of a participant: a multiple of the identity, not worth columns.
        self.each = next((one for one in shared if _is_identity(stands[one.factor.name])), None)
        parts, places = [np.empty((self.n_each, 0))], [np.empty(0, np.intp)]
        for block in sorted(self.blocks, key=lambda block: stands[block.factor.name].shared):
            if block is not self.each:
                columns, is_shared = stands[block.factor.name]
                levels = columns.shape[1] // block.width
                factor = np.sqrt(self.n_people) if is_shared else 1.0
                parts.append(factor * (columns / np.tile(block.scale, levels)))
                places.append(np.tile(np.arange(block.theta.start, block.theta.stop), levels))
        own = [stand.columns.shape[1] for stand in stands.values() if not stand.shared]
        self.n_own = sum(own)
        self.columns, self.parameters = np.hstack(parts), np.concatenate(places)
        self.n_random = len(self.parameters)

    def evaluate(self, theta: Samples) -> State:
        """Factorise both matrices at theta, (n_theta,)."""
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
        log_own = 2 * float(np.log(root.diagonal()).sum())
        logs = (self.n_people - 1) * log_own + self.n_each * np.log(ratio)
        return self._make_state(theta, logs, factor=factor, inner=inner)

    def _find_spreads(self, theta: Samples) -> tuple[Samples, float]:
        """Spread of every column, 1 for the fixed ones and y, and the variance of a mean's own row beside residual."""
        spreads = np.concatenate([theta[self.parameters], np.ones(self.n_fixed + 1)])
        each = 0.0 if self.each is None else float(theta[self.each.theta][0])
        return spreads, 1 + self.n_people * each**2

    def find_slope(self, state: State, weight: float) -> Samples:
        """Differentiate the deviance with respect to theta, (n_theta,)."""
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


def _is_identity(stand: Stand) -> bool:
    """Check that every row has a level of its own, in whatever order; a row has one level of each factor."""
    sizes = np.abs(stand.columns[stand.columns != 0])
    square = len(sizes) == len(stand.columns) == stand.columns.shape[1]
    return bool(square and (sizes == sizes[0]).all())


def find_slope(profile: Profile, state: State, weight: float | None = None) -> Samples:
    """Differentiate the deviance with respect to theta, (n_theta,).

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


def _find_adjoint(profile: Profile, state: State, weight: float) -> Samples:
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


def _find_inner_slope(profile: Profile, state: State, outer: Samples) -> Samples:
    """Differentiate through the eliminated factor: its own determinant, and what it leaves."""
    lower = profile.blocks[0].triangle(state.theta)
    width = len(lower)
    through = profile.border @ outer
    seen = np.empty((profile.blocks[0].n_levels, width, width))
    for row, column in np.ndindex(width, width):
        products = profile.border[column::width].multiply(through[row::width])
        seen[:, row, column] = products.sum(axis=1)
    back = state.inner @ lower.T
    kept = np.eye(width) - lower @ back @ profile.inner_products
    slope: Samples = (back @ profile.inner_products - back @ seen @ kept).sum(axis=0)
    return 2 * slope.T


def _trace_blocks(left: Samples, right: Samples, width: int) -> Samples:
    """Sum over levels of the blocks on the diagonal of left @ right."""
    rows = left.reshape(-1, width, left.shape[1])
    columns = right.T.reshape(-1, width, right.shape[0])
    found: Samples = np.einsum("aik,ajk->ij", rows, columns)
    return found


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


def _descend(profile: Profile, start: Samples) -> State:
    from scipy.optimize import minimize

    def value(theta: Samples) -> tuple[float, Samples]:
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
        ).x
    except np.linalg.LinAlgError as error:
        raise ValueError(_NO_RESIDUAL) from error
    if np.abs(found).max() > LARGEST:
        raise ValueError(_NO_RESIDUAL)
    return profile.evaluate(_settle_signs(profile, found))


def _find_target(profile: Profile, state: State) -> float:
    """Add the penalty, -2 log of every spread it names, to the deviance: what is minimised."""
    spreads = state.theta[profile.penalised] ** 2 * state.rss / profile.weight
    return profile.deviance(state) - float(np.log(spreads).sum())


_NO_RESIDUAL = (
    "data must have scatter within groups, got a response that the random effects give exactly, without residual; "
    "leave the finest group out of the formula"
)


def _settle_signs(profile: Profile, theta: Samples) -> Samples:
    """Write spreads as 0 or more, for turning an effect's column around changes nothing, and tiny ones as 0."""
    settled = np.empty_like(theta)
    for block in profile.blocks:
        lower = block.triangle(theta)
        lower = lower * np.where(np.diag(lower) < 0, -1.0, 1.0)
        settled[block.theta] = lower[block.rows, block.columns]
    settled[profile.diagonal & (settled < ZERO) & ~profile.penalised] = 0.0
    return settled


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
