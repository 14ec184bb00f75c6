"""The profiled deviance of a linear mixed model, and its minimum.

Model: y = X b + Z L u + e, with u ~ N(0, s² I), e ~ N(0, s² I) and L block-diagonal, holding for every level
of a grouping factor the same lower triangle of relative spreads, theta. Given theta, b and s have closed forms;
what is left to minimise is a function of theta alone (Bates et al. 2015, doi 10.18637/jss.v067.i01, eq. 38-42).

Rows enter as cross products only. One factor, the unit, and all factors nested in it (a person, and what is that
person's own) fall into one block per unit, and these are eliminated at once; what remains is small and dense, with X
and y as its last rows, so that one Cholesky factor holds the determinants, the coefficients and the residual. Units
whose rows are alike, as all people's are in a balanced study, share a block: only the sums of their y differ.

Columns are scaled first: Z's to unit mean square, X to orthonormal columns, y to what X leaves over. The
deviance is that of the data as given; results are scaled back.

The limit of a linear algebra library's threads holds for the whole process. Of fits that run at the same time in
several threads one sets it and restores it, the others leave it alone.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.mixed.design import Factor, MixedDesign
from feel321.types import Samples

Codes = NDArray[np.intp]

MOST_LEVELS = 10_000
"""Effects beside those of the unit: with more, the dense equations alone need gigabytes."""

LARGE = 600
"""Rows of a dense matrix from which two threads are worth their while; on smaller ones they wait for each other."""

HELD = Lock()
"""Taken by whoever set the limit; the process has one limit, and so has this module."""

ZERO = 1e-4
"""A relative spread below this is none: what lme4 calls singular."""

LARGEST = 1e5
"""A spread so many times the residual means that there is no residual."""

PROBE, RESTART, ATTEMPTS = 0.02, 0.3, 4

NEAR = 0.1
"""Least spread that a search starts from: at 0 it would rest."""


@dataclass(frozen=True)
class Block:
    """A factor's scale, (width,), and its triangle of spreads: entries [rows, columns] are theta[theta]."""

    factor: Factor
    scale: Samples
    theta: slice
    rows: Codes
    columns: Codes

    def triangle(self, theta: Samples) -> Samples:
        """Write the parameters as a triangle, (width, width)."""
        lower = np.zeros((len(self.scale),) * 2)
        lower[self.rows, self.columns] = theta[self.theta]
        return lower


def place_factors(factors: Sequence[Factor]) -> Iterator[Block]:
    """Place the parameters: factor by factor and term by term, each term a lower triangle."""
    start = 0
    for factor in factors:
        corner, places = 0, []
        for term in factor.terms:
            places.append(np.array(np.tril_indices(len(term.names))) + corner)
            corner += len(term.names)
        rows, columns = np.hstack(places)
        scale = np.sqrt(np.mean(factor.columns**2, axis=0))
        yield Block(factor, scale, slice(start, start + len(rows)), rows, columns)
        start += len(rows)


class Spread:
    """L of some blocks' columns, and where these stand: L[rows, columns] = theta[places], 1 for the extra columns."""

    def __init__(self, blocks: Sequence[Block], counts: Sequence[int], *, extra: int = 0) -> None:
        self.n_effects, self.first, parts = 0, dict[str, Codes](), [(np.empty(0, np.intp),) * 3]
        for block, count in zip(blocks, counts, strict=True):
            start = self.n_effects + len(block.scale) * np.arange(count)
            self.n_effects += len(block.scale) * count
            self.first[block.factor.name] = start
            places = np.arange(block.theta.start, block.theta.stop)
            rows, columns = (start[:, None] + one for one in (block.rows, block.columns))
            parts.append((rows.ravel(), columns.ravel(), np.tile(places, count)))
        self.rows, self.columns, self.places = map(np.concatenate, zip(*parts, strict=True))
        self.size, straight = self.n_effects + extra, self.rows == self.columns
        self.own, self.scales = self.rows[straight], self.places[straight]
        self.ties = [
            (place, self.rows[at], self.columns[at])
            for place in np.unique(self.places[~straight])
            for at in [self.places == place]
        ]

    def times(self, matrix: Samples, theta: Samples, *, turned: bool = False) -> Samples:
        """Multiply matrices, (..., size), by L; turned: by L'."""
        found: Samples = matrix * self._find_scales(theta)
        for place, rows, columns in self.ties:
            before, after = (columns, rows) if turned else (rows, columns)
            found[..., after] += theta[place] * matrix[..., before]
        return found

    def around(self, matrix: Samples, theta: Samples, *, turned: bool = False) -> Samples:
        """Compute L' M L of symmetric matrices, (..., size, size); turned: L M L'."""
        if not self.ties:
            scales = self._find_scales(theta)
            return matrix * (scales[:, None] * scales)
        half = self.times(matrix, theta, turned=turned)
        return self.times(half.swapaxes(-1, -2), theta, turned=turned)

    def _find_scales(self, theta: Samples) -> Samples:
        scales = np.ones(self.size)
        scales[self.own] = theta[self.scales]
        return scales


@dataclass(frozen=True)
class State:
    """Everything known at one theta; factor and left: (size, size), inner and kept: (n_kinds, n_own, n_own)."""

    theta: Samples
    log_random: float
    log_fixed: float
    rss: float
    factor: Samples
    left: Samples
    inner: Samples
    kept: Samples


class Profile:
    """The deviance as a function of theta, for one design."""

    def __init__(self, design: MixedDesign, *, reml: bool, penalty: Sequence[str] = ()) -> None:
        self.design, self.reml = design, reml
        self.n_rows, self.n_fixed = design.fixed.shape
        self.freedom = self.n_rows - self.n_fixed if reml else self.n_rows
        self.blocks = tuple(place_factors(design.factors))
        self.diagonal = np.concatenate([block.rows == block.columns for block in self.blocks])
        self.penalised = _find_penalised(self.blocks, penalty)
        # Every spread whose logarithm is penalised takes one residual's along, for spreads are in units of it.
        self.weight = self.freedom - int(self.penalised.sum())
        self._place_columns()
        self._reduce_rows()

    def _place_columns(self) -> None:
        """Give every level its first column: unit by unit for what is a unit's own, then what units share."""
        self.unit_factor, self.nested = _choose_unit(self.design.factors)
        own = [one for one in self.blocks if one.factor.name in self.nested]
        shared = [one for one in self.blocks if one.factor.name not in self.nested]
        counts = [int(self.nested[one.factor.name].place.max()) + 1 for one in own]
        levels = [len(one.factor.levels) for one in shared]
        self.own, self.shared = Spread(own, counts), Spread(shared, levels, extra=self.n_fixed + 1)
        self.n_random, self.n_units = self.shared.n_effects, len(self.unit_factor.levels)
        if self.n_random > MOST_LEVELS:
            raise ValueError(
                f"data must have at most {MOST_LEVELS} effects beside those of {self.unit_factor.name}, for memory, "
                f"got {self.n_random}; average repeated rows, or leave out a group with many levels"
            )
        tail = self.n_units * self.own.size
        self.places = {name: tail + first for name, first in self.shared.first.items()}
        for name, first in self.own.first.items():
            unit, place = self.nested[name]
            self.places[name] = unit * self.own.size + first[place]

    def list_columns(self, block: Block) -> Codes:
        """List the columns of every level of a factor, (n_levels, width)."""
        columns: Codes = self.places[block.factor.name][:, None] + np.arange(len(block.scale))
        return columns

    def _reduce_rows(self) -> None:
        """Keep only the cross products, of units that are alike once."""
        from scipy.sparse import csr_array

        basis, self.triangle_x = np.linalg.qr(self.design.fixed)
        self.log_x = float(2 * np.log(np.abs(np.diag(self.triangle_x))).sum())
        self.offset = basis.T @ self.design.response
        rest = self.design.response - basis @ self.offset
        self.unit = float(np.linalg.norm(rest) / np.sqrt(self.n_rows))
        width = self.n_units * self.own.size + self.shared.size
        last = np.broadcast_to(
            np.arange(width - self.n_fixed - 1, width), (self.n_rows, self.n_fixed + 1)
        )
        columns = [self.list_columns(block)[block.factor.index] for block in self.blocks]
        values = [block.factor.columns / block.scale for block in self.blocks]
        entries = np.hstack([*values, basis, rest[:, None] / self.unit])
        starts = np.arange(self.n_rows + 1) * entries.shape[1]
        whole = csr_array(
            (entries.ravel(), np.hstack([*columns, last]).ravel(), starts),
            shape=(self.n_rows, width),
        )
        self._split_products((whole.T @ whole).tocsr())

    def _split_products(self, products: Any) -> None:  # noqa: ANN401 - a sparse matrix
        """Divide the cross products into those of units, of units with what they share, and of the latter."""
        size, tail = self.own.size, self.n_units * self.own.size
        _, index, self.kind = np.unique(
            _find_kinds(self.design, self.unit_factor, self.nested),
            return_index=True,
            return_inverse=True,
        )
        self.counts = np.bincount(self.kind).astype(np.float64)
        blocks = products[:tail, :tail].tocoo()
        inner = np.zeros((self.n_units, size, size))
        inner[blocks.row // size, blocks.row % size, blocks.col % size] = blocks.data
        border = products[:tail, tail:].toarray().reshape(self.n_units, size, -1)
        self.inner, self.border, self.seen = inner[index], border[index, :, :-1], border[:, :, -1]
        alike = [self.seen[self.kind == number] for number in range(len(index))]
        self.weighted = (self.counts[:, None, None] * self.border).reshape(-1, self.shared.size - 1)
        self.sums = np.stack([one.sum(axis=0) for one in alike])
        self.squares = np.stack([one.T @ one for one in alike])
        self.outer = products[tail:, tail:].toarray()

    def evaluate(self, theta: Samples) -> State:
        """Factorise the equations at theta, (n_theta,)."""
        from scipy.linalg.lapack import dpotrf

        blocks = self.own.around(self.inner, theta) + np.eye(self.own.size)
        roots = np.linalg.cholesky(blocks).diagonal(axis1=1, axis2=2)
        inner = np.linalg.inv(blocks).astype(np.float64, copy=False)
        kept = self.own.around(inner, theta, turned=True)
        through = (kept @ self.border).reshape(-1, self.shared.size - 1)
        left = self.outer.copy()
        left[:-1, :-1] -= self.weighted.T @ through
        cross = self.sums.ravel() @ through
        left[-1, :-1] -= cross
        left[:-1, -1] -= cross
        left[-1, -1] -= float((kept * self.squares).sum())
        scaled = self.shared.around(left, theta)
        diagonal = np.arange(self.n_random)
        scaled[diagonal, diagonal] += 1
        factor, failed = dpotrf(scaled, lower=1, clean=1)
        if failed:
            raise np.linalg.LinAlgError("the residual is lost in rounding")
        logs = 2 * np.log(factor.diagonal())
        own = 2 * float(self.counts @ np.log(roots).sum(axis=1))
        return State(
            theta=theta, log_random=own + float(logs[: self.n_random].sum()),
            log_fixed=float(logs[self.n_random : -1].sum()) + self.log_x,
            rss=float(factor[-1, -1] ** 2) * self.unit**2, factor=factor, left=left, inner=inner, kept=kept,
        )  # fmt: skip

    def deviance(self, state: State) -> float:
        """-2 log likelihood with the best b and s for this theta."""
        spread = np.log(2 * np.pi * state.rss / self.weight)
        return float(
            state.log_random + self.reml * state.log_fixed + self.freedom * spread + self.weight
        )

    def find_slope(self, state: State, weight: float | None = None) -> Samples:
        """Differentiate the deviance with respect to theta, (n_theta,).

        The determinants of the leading parts of the dense matrix D, and those of the units' blocks, are all there is:
        d log |D_k| = tr(D_k⁻¹ dD), and d log rss = z' dD z with z = (-coefficients, 1) / sqrt(rss).
        """
        from scipy.linalg.lapack import dtrtri

        theta, rows, columns = state.theta, self.shared.rows, self.shared.columns
        size = self.n_random + (self.n_fixed if self.reml else 0)
        half = dtrtri(state.factor, lower=1)[0]
        adjoint = half[:size].T @ half[:size]
        last = half[-1] * np.sqrt(self.weight if weight is None else weight)
        adjoint += last[:, None] * last
        along = (self.shared.times(state.left, theta)[rows] * adjoint[columns]).sum(axis=1)
        outside = self.shared.around(adjoint, theta, turned=True)
        counts = self.counts[:, None, None]
        mixed = (self.border @ outside[:-1, -1])[:, :, None] * self.sums[:, None, :]
        seen = counts * (self.border @ outside[:-1, :-1] @ self.border.swapaxes(1, 2))
        seen += mixed + mixed.swapaxes(1, 2) + outside[-1, -1] * self.squares
        change = counts * self.inner - seen + self.inner @ state.kept @ seen
        inside = (self.own.times(change, theta) @ state.inner).sum(axis=0)
        inside = inside[self.own.rows, self.own.columns]
        slope = np.bincount(self.own.places, inside, len(theta))
        slope = slope + np.bincount(self.shared.places, along, len(theta))
        return 2 * slope.astype(np.float64, copy=False)


def _find_penalised(blocks: Sequence[Block], names: Sequence[str]) -> NDArray[np.bool_]:
    """Mark the parameters, (n_theta,), whose logarithm is penalised: the spreads of the factors named."""
    known = [block.factor.name for block in blocks]
    if strangers := [name for name in names if name not in known]:
        raise ValueError(
            f"penalty must name groups of the formula ({', '.join(known)}), got {strangers[0]!r}"
        )
    if any((block.rows != block.columns).any() for block in blocks if block.factor.name in names):
        raise ValueError(
            "penalty must name groups with uncorrelated effects, got correlated ones; write (1 + x || g)"
        )
    return np.concatenate([
        np.full(len(block.rows), block.factor.name in names) for block in blocks
    ])


class Nested(NamedTuple):
    """The unit of every level of a factor, and its number among the unit's levels, (n_levels,) each."""

    unit: Codes
    place: Codes


def _choose_unit(factors: Sequence[Factor]) -> tuple[Factor, dict[str, Nested]]:
    """Choose the factor that is cheapest to eliminate, with all that is nested in it."""
    found = []
    for unit in factors:
        nested = {factor.name: where for factor in factors if (where := _nest(factor, unit))}
        own = sum(
            int(nested[one.name].place.max() + 1) * one.width
            for one in factors
            if one.name in nested
        )
        shared = sum(len(one.levels) * one.width for one in factors if one.name not in nested)
        cost = len(unit.levels) * float(own) ** 2 * (own + shared) + float(shared) ** 3
        found.append((cost, unit, nested))
    return min(found, key=lambda one: one[0])[1:]


def _nest(factor: Factor, unit: Factor) -> Nested | None:
    """Find the unit of every level of a factor; None where one belongs to several."""
    owner = np.empty(len(factor.levels), np.intp)
    owner[factor.index] = unit.index
    if (owner[factor.index] != unit.index).any():
        return None
    sizes, place = np.bincount(owner), np.empty(len(owner), np.intp)
    first = np.repeat(np.cumsum(sizes) - sizes, sizes)
    place[np.argsort(owner, kind="stable")] = np.arange(len(owner)) - first
    return Nested(owner, place)


def _find_kinds(design: MixedDesign, unit: Factor, nested: dict[str, Nested]) -> list[int]:
    """Give one number to units with the same rows, but for y and for the names of what is their own."""
    parts: list[NDArray[Any]] = [design.fixed]
    for factor in design.factors:
        where = nested.get(factor.name)
        index = where.place[factor.index] if where else factor.index
        parts += [factor.columns, index[:, None]]
    rows = np.hstack(parts) + 0.0  # no -0, whose bytes differ
    rows = rows[np.lexsort([*rows.T, unit.index])]
    known: dict[bytes, int] = {}
    bounds = np.cumsum(np.bincount(unit.index))[:-1]
    return [known.setdefault(part.tobytes(), len(known)) for part in np.split(rows, bounds)]


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
    """Predict the random effects of every factor, (n_levels, width), in the order of the formula."""
    from scipy.linalg import solve_triangular

    solved = solve_triangular(state.factor[:-1, :-1], state.factor[-1, :-1], lower=True, trans="T")
    shared = profile.shared.times(np.append(solved, 0.0), state.theta, turned=True)[:-1]
    left = profile.seen - profile.border[profile.kind] @ shared
    own = np.einsum("uij,uj->ui", state.kept[profile.kind], left)
    effects = np.concatenate([own.ravel(), shared])
    return [
        effects[profile.list_columns(block)] * profile.unit / block.scale
        for block in profile.blocks
    ]


def find_spreads(profile: Profile, state: State) -> list[Samples]:
    """Covariances of the random effects, (width, width), in units of s², in the order of the formula."""
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


def find_optimum(profile: Profile, *, start: Samples | None = None) -> State:
    """Minimise the deviance over theta; start: where a fit to nearly the same data ended.

    Notes
    -----
    L-BFGS from theta = 1 (off the diagonal 0), without bounds because the deviance does not change with a
    spread's sign. For the same reason 0 is always stationary; at every spread of 0 the deviance is therefore
    probed at a small positive value, which shows the sign of its derivative in theta², and the search resumed
    where that is lower. The penalty, -2 log (theta s), goes to infinity at 0.
    """
    begin = profile.diagonal.astype(np.float64)
    if start is not None:
        begin = np.where(profile.diagonal, np.maximum(start, NEAR), start)
    best = _descend(profile, begin)
    for _ in range(ATTEMPTS):
        resumed = _leave_boundary(profile, best)
        if resumed is None:
            break
        best = resumed
    return best


def _descend(profile: Profile, start: Samples) -> State:
    from scipy.optimize import minimize

    held = profile.penalised

    def value(theta: Samples) -> tuple[float, Samples]:
        state = profile.evaluate(theta)
        slope = profile.find_slope(state)
        slope[held] -= 2 / theta[held]
        return _find_target(profile, state), slope

    try:
        found = minimize(
            value, start, jac=True, method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-6, "maxiter": 1000, "maxls": 50},
        ).x  # fmt: skip
    except np.linalg.LinAlgError:
        found = np.full(len(start), np.inf)
    if not np.abs(found).max() <= LARGEST:
        raise ValueError(
            "data must have scatter within groups, got a response that the random effects give exactly, without "
            "residual; leave the finest group out of the formula"
        )
    settled = np.empty_like(found)
    for block in profile.blocks:
        lower = block.triangle(found)
        lower = lower * np.where(
            np.diag(lower) < 0, -1.0, 1.0
        )  # a column turned around changes nothing
        settled[block.theta] = lower[block.rows, block.columns]
    settled[profile.diagonal & (settled < ZERO) & ~held] = 0.0
    return profile.evaluate(settled)


def _find_target(profile: Profile, state: State) -> float:
    """Add the penalty, -2 log of every spread it names, to the deviance: what is minimised."""
    spreads = state.theta[profile.penalised] ** 2 * state.rss / profile.weight
    return profile.deviance(state) - float(np.log(spreads).sum())


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
