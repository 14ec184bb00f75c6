"""The profiled deviance of a linear mixed model, and its minimum.

Model: y = X b + Z L u + e, with u ~ N(0, s² I), e ~ N(0, s² I) and L block-diagonal, holding for every level
of a grouping factor the same lower triangle of relative spreads, theta. Given theta, b and s have closed forms;
what is left to minimise is a function of theta alone (Bates et al. 2015, doi 10.18637/jss.v067.i01, eq. 38-42).

Rows enter as cross products only. One factor, the unit, and all factors nested in it (a person, and what is that
person's own) fall into one block per unit, and these are eliminated at once; what remains is small and dense, with X
and y as its last rows, so that one Cholesky factor holds the determinants, the coefficients and the residual. Units
whose rows are alike share a block: only the sums of their y differ.

Columns are scaled first: Z's to unit mean square, X to orthonormal columns, y to what X leaves over. The
deviance is that of the data as given; results are scaled back.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import minimize
from scipy.sparse import csr_array
from threadpoolctl import ThreadpoolController

from feel321.analysis.mixed.design import Factor, MixedDesign
from feel321.types import Samples

Codes = NDArray[np.intp]
MOST_LEVELS = 10_000  # Effects beside the unit's: with more, the dense equations need gigabytes
LARGE = 600  # Rows of a dense matrix from which on two threads do not wait for each other
HELD = Lock()  # Taken by whoever set the limit of threads, which holds for the whole process
POOLS = ThreadpoolController()  # Of the libraries imported above: looking takes as long as a step
ZERO = 1e-4  # A relative spread below this is none: what lme4 calls singular
LARGEST = 1e5  # A spread so many times the residual means that there is no residual
PROBE, RESTART, ATTEMPTS = 0.02, 0.3, 4
STEP = 1e-4  # Share of a relative spread, or of 1 if that is more, by which it is moved


@dataclass(frozen=True)
class Block:
    """A factor's scale, (width,), and its lower triangle of spreads: entries [rows, columns] are theta[theta].

    unit: the unit of each of its levels, and place: its number there, (n_levels,); None where it is not nested.
    """

    factor: Factor
    scale: Samples
    theta: slice
    rows: Codes
    columns: Codes
    unit: Codes
    place: Codes | None


def place_factors(factors: Sequence[Factor], unit: Factor) -> Iterator[Block]:
    """Place the parameters: factor by factor and term by term, each term a lower triangle."""
    start = 0
    for factor in factors:
        corner, places = 0, []
        for term in factor.terms:
            places.append(np.array(np.tril_indices(len(term.names))) + corner)
            corner += len(term.names)
        rows, columns = np.hstack(places)
        scale = np.sqrt(np.mean(factor.columns**2, axis=0))
        theta = slice(start, start := start + len(rows))
        yield Block(factor, scale, theta, rows, columns, *nest(factor, unit))


def nest(factor: Factor, unit: Factor) -> tuple[Codes, Codes | None]:
    """Find the unit of every level of a factor, and its number there; None where one belongs to several."""
    owner = np.empty(factor.n_levels, np.intp)
    owner[factor.index] = unit.index
    if (owner[factor.index] != unit.index).any():
        return owner, None
    sizes, place = np.bincount(owner), np.empty(len(owner), np.intp)
    first = np.repeat(np.cumsum(sizes) - sizes, sizes)
    place[np.argsort(owner, kind="stable")] = np.arange(len(owner)) - first
    return owner, place


class Spread:
    """L of some blocks' columns, and where these stand: L[rows, columns] = theta[places], 1 for the extra columns."""

    def __init__(self, blocks: Sequence[Block], *, extra: int = 0) -> None:
        self.n_effects, self.first, parts = 0, dict[str, Codes](), [(np.empty(0, np.intp),) * 3]
        for block in blocks:
            count = block.factor.n_levels if block.place is None else int(block.place.max()) + 1
            start = self.n_effects + len(block.scale) * np.arange(count)
            self.n_effects += len(block.scale) * count
            self.first[block.factor.name] = start
            places = np.arange(block.theta.start, block.theta.stop)
            rows, columns = (start[:, None] + one for one in (block.rows, block.columns))
            parts.append((rows.ravel(), columns.ravel(), np.tile(places, count)))
        self.rows, self.columns, self.places = map(np.concatenate, zip(*parts, strict=True))
        self.size, self.straight = self.n_effects + extra, bool((self.rows == self.columns).all())

    def _find_scales(self, theta: Samples) -> Samples:
        scales = np.ones(self.size)
        scales[self.rows] = theta[self.places]
        return scales

    def times(self, matrix: Samples, theta: Samples, *, turned: bool = False) -> Samples:
        """Multiply matrices, (..., size), by L; turned: by L'."""
        if self.straight:
            return matrix * self._find_scales(theta)
        lower = np.eye(self.size)
        lower[self.rows, self.columns] = theta[self.places]
        found: Samples = matrix @ (lower.T if turned else lower)
        return found

    def around(self, matrix: Samples, theta: Samples, *, turned: bool = False) -> Samples:
        """Compute L' M L of symmetric matrices, (..., size, size); turned: L M L'."""
        if self.straight:
            scales = self._find_scales(theta)
            return matrix * (scales[:, None] * scales)
        half = self.times(matrix, theta, turned=turned)
        return self.times(half.swapaxes(-1, -2), theta, turned=turned)

    def gather(self, one: Samples, other: Samples, n_theta: int) -> Samples:
        """Add up what stands at the entries of each parameter in the products of matrices, (n, size, size)."""
        along = np.einsum("kij,kji->i", one[:, self.rows], other[:, :, self.columns])
        return np.bincount(self.places, along, n_theta).astype(np.float64, copy=False)


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
        unit = _choose_unit(design.factors)
        self.n_units = unit.n_levels
        self.blocks = tuple(place_factors(design.factors, unit))
        # Of every parameter, the spread of its column of the triangle.
        ends = [np.flatnonzero(block.rows == block.columns) for block in self.blocks]
        each = zip(self.blocks, ends, strict=True)
        self.of_spread = np.concatenate([one.theta.start + end[one.columns] for one, end in each])
        self.diagonal = self.of_spread == np.arange(len(self.of_spread))
        known = [one.factor.name for one in self.blocks if (one.rows == one.columns).all()]
        if not set(penalty) <= set(known):
            must = f"groups of the formula with uncorrelated effects ({', '.join(sorted(known))})"
            got = f"got {', '.join(penalty)}; write (1 + x || g)"
            raise ValueError(f"penalty must name {must}, {got}")
        held = [np.full(len(one.rows), one.factor.name in penalty) for one in self.blocks]
        self.penalised = np.concatenate(held)
        # Every spread whose logarithm is penalised takes one residual's along, for spreads are in units of it.
        self.weight = self.freedom - int(self.penalised.sum())
        self.own = Spread([one for one in self.blocks if one.place is not None])
        shared = [one for one in self.blocks if one.place is None]
        self.shared = Spread(shared, extra=self.n_fixed + 1)
        if self.n_random > MOST_LEVELS:
            must = f"at most {MOST_LEVELS} effects beside those of {unit.name}, for memory"
            do = "average repeated rows, or leave out a group with many levels"
            raise ValueError(f"data must have {must}, got {self.n_random}; {do}")
        basis, self.triangle_x = np.linalg.qr(design.fixed)
        self.log_x = float(2 * np.log(np.abs(np.diag(self.triangle_x))).sum())
        self.offset = basis.T @ design.response
        rest = design.response - basis @ self.offset
        self.scale = float(np.sqrt(rest @ rest / self.n_rows))
        self._reduce_rows(unit, np.column_stack([basis, rest / self.scale]))

    @property
    def n_random(self) -> int:
        """Effects in the dense matrix."""
        return self.shared.n_effects

    def list_columns(self, block: Block) -> Codes:
        """List the columns of every level of a factor, (n_levels, width), those of the units first."""
        name = block.factor.name
        if block.place is None:
            first = self.n_units * self.own.size + self.shared.first[name]
        else:
            first = block.unit * self.own.size + self.own.first[name][block.place]
        columns: Codes = first[:, None] + np.arange(len(block.scale))
        return columns

    def _reduce_rows(self, unit: Factor, ends: Samples) -> None:
        """Keep only the cross products, of units that are alike once; ends: X and y, (n_rows, n_fixed + 1)."""
        size, tail = self.own.size, self.n_units * self.own.size
        width = tail + self.shared.size
        columns = [self.list_columns(block)[block.factor.index] for block in self.blocks]
        last = np.arange(width - ends.shape[1], width)
        places = np.hstack([*columns, np.broadcast_to(last, ends.shape)])
        values = [block.factor.columns / block.scale for block in self.blocks]
        entries = np.hstack([*values, ends])
        starts = np.arange(self.n_rows + 1) * entries.shape[1]
        rows = csr_array((entries.ravel(), places.ravel(), starts), shape=(self.n_rows, width))
        products = (rows.T @ rows).tocsr()
        blocks = products[:tail, :tail].tocoo()
        inner = np.zeros((self.n_units, size, size))
        inner[blocks.row // size, blocks.row % size, blocks.col % size] = blocks.data
        border = products[:tail, tail:].toarray().reshape(self.n_units, size, -1)
        self.outer, self.seen = products[tail:, tail:].toarray(), border[:, :, -1].copy()
        # Units are alike whose rows are, but for y and for the names of what is their own.
        relative = places - size * unit.index[:, None] * (places < tail)
        keys = np.hstack([self.design.fixed, *values, relative]) + 0.0  # no -0, whose bytes differ
        keys, known = keys[np.lexsort([*keys.T, unit.index])], dict[bytes, int]()
        each = np.split(keys, np.cumsum(np.bincount(unit.index))[:-1])
        self.kind = np.array([known.setdefault(one.tobytes(), len(known)) for one in each])
        self.counts = np.bincount(self.kind).astype(np.float64)
        first = np.unique(self.kind, return_index=True)[1]
        roots = np.sqrt(self.counts)[:, None]
        self.inner, self.border = inner[first], border[first] * roots[:, None]
        # With the mean of their y in the border, what is left of it is the scatter of those alike.
        groups = [self.seen[self.kind == number] for number in range(len(first))]
        self.border[:, :, -1] = np.stack([one.mean(axis=0) for one in groups]) * roots
        around = [one - one.mean(axis=0) for one in groups]
        self.scatter = np.stack([one.T @ one for one in around])

    def evaluate(self, theta: Samples) -> State:
        """Factorise the equations at theta, (n_theta,)."""
        blocks = self.own.around(self.inner, theta) + np.eye(self.own.size)
        roots = np.linalg.cholesky(blocks).diagonal(axis1=1, axis2=2)
        inner = np.linalg.inv(blocks).astype(np.float64, copy=False)
        kept = self.own.around(inner, theta, turned=True)
        flat = self.border.reshape(-1, self.shared.size)
        left = self.outer - flat.T @ (kept @ self.border).reshape(-1, self.shared.size)
        left[-1, -1] -= float((kept * self.scatter).sum())
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
            rss=float(factor[-1, -1] ** 2) * self.scale**2, factor=factor, left=left, inner=inner, kept=kept,
        )  # fmt: skip

    def deviance(self, state: State) -> float:
        """-2 log likelihood with the best b and s for this theta."""
        spread = np.log(2 * np.pi * state.rss / self.weight)
        logs = state.log_random + self.reml * state.log_fixed
        return float(logs + self.freedom * spread + self.weight)

    def target(self, state: State) -> float:
        """Add the penalty, -2 log of every spread it names, to the deviance: what is minimised."""
        spreads = state.theta[self.penalised] ** 2 * state.rss / self.weight
        return self.deviance(state) - float(np.log(spreads).sum())

    def find_slope(self, state: State, weight: float | None = None) -> Samples:
        """Differentiate the deviance with respect to theta, (n_theta,).

        The determinants of the leading parts of the dense matrix D, and those of the units' blocks, are all there is:
        d log |D_k| = tr(D_k⁻¹ dD), and d log rss = z' dD z with z = (-coefficients, 1) / sqrt(rss).
        """
        theta, n_theta = state.theta, len(state.theta)
        size = self.n_random + (self.n_fixed if self.reml else 0)
        half = dtrtri(state.factor, lower=1)[0]
        adjoint = half[:size].T @ half[:size]
        last = half[-1] * np.sqrt(self.weight if weight is None else weight)
        adjoint += last[:, None] * last
        # What each parameter moves: half the derivative of tr(adjoint L' M L).
        moved = self.shared.times(state.left, theta)
        slope = self.shared.gather(moved[None], adjoint[None], n_theta)
        outside = self.shared.around(adjoint, theta, turned=True)
        seen = self.border @ outside @ self.border.swapaxes(1, 2) + outside[-1, -1] * self.scatter
        change = self.counts[:, None, None] * self.inner - seen + self.inner @ state.kept @ seen
        return 2 * (slope + self.own.gather(self.own.times(change, theta), state.inner, n_theta))

    def differentiate(self, state: State) -> tuple[Samples, Samples]:
        """Differentiate the penalised deviance f(theta, log s) twice, in units of the spreads; and X'V⁻¹X's inverse.

        (n_theta + 1, n_theta + 1) and (n_theta + 1, n_fixed, n_fixed). Derivatives along theta are central differences
        of the exact slope. A penalty of -2 log theta adds 2 / theta².
        """
        sigma, size = self.find_sigma(state), len(state.theta)
        unit = np.maximum(np.abs(state.theta), 1)
        hessian = np.zeros((size + 1, size + 1))
        slopes = np.zeros((size + 1, self.n_fixed, self.n_fixed))
        is_even = (state.theta == 0) & self.own.straight & self.shared.straight
        for place, shift in enumerate(np.diag(STEP * unit)):
            # Both sides of a spread of 0 are alike, and nothing else changes along it.
            if is_even[place]:
                end = self.evaluate(state.theta + shift)
                rise = self.find_slope(end, end.rss / sigma**2)[place]
                hessian[place, place] = rise * unit[place] / STEP
                continue
            ends = [self.evaluate(state.theta + sign * shift) for sign in (1, -1)]
            rise = np.subtract(*(self.find_slope(end, end.rss / sigma**2) for end in ends))
            hessian[place, :size] = rise * unit / (2 * STEP)
            more = -(ends[0].rss - ends[1].rss) / STEP / sigma**2
            hessian[place, size] = hessian[size, place] = more
            wider = np.subtract(*(self.find_coefficients(end)[1] for end in ends))
            slopes[place] = wider * sigma**2 / (2 * STEP)
        held = np.flatnonzero(self.penalised)
        hessian[held, held] += 2 * (unit[held] / state.theta[held]) ** 2
        hessian[size, size] = 4 * self.weight
        slopes[size] = 2 * self.find_coefficients(state)[1] * sigma**2
        return (hessian + hessian.T) / 2, slopes

    def find_sigma(self, state: State) -> float:
        """Residual standard deviation."""
        return float(np.sqrt(state.rss / self.weight))

    def find_coefficients(self, state: State) -> tuple[Samples, Samples]:
        """Solve for the fixed effects, (n_fixed,), and their covariance in units of s²."""
        place = slice(self.n_random, -1)
        corner, last = state.factor[place, place], state.factor[-1, place]
        half = solve_triangular(corner, np.eye(self.n_fixed), lower=True).T
        inverse = solve_triangular(self.triangle_x, half)
        shift = solve_triangular(self.triangle_x, self.offset)
        return shift + inverse @ last * self.scale, inverse @ inverse.T

    def find_modes(self, state: State) -> list[Samples]:
        """Predict the random effects of every factor, (n_levels, width), in the order of the formula."""
        factor = state.factor
        solved = solve_triangular(factor[:-1, :-1], factor[-1, :-1], lower=True, trans="T")
        shared = self.shared.times(np.append(solved, 0.0), state.theta, turned=True)[:-1]
        border = self.border[:, :, :-1] / np.sqrt(self.counts)[:, None, None]
        left = self.seen - (border @ shared)[self.kind]
        own = np.einsum("uij,uj->ui", state.kept[self.kind], left)
        effects = np.concatenate([own.ravel(), shared]) * self.scale
        return [effects[self.list_columns(block)] / block.scale for block in self.blocks]

    def find_spreads(self, state: State) -> list[Samples]:
        """Covariances of the random effects, (width, width), in units of s², in the order of the formula."""
        found = []
        for block in self.blocks:
            lower = np.zeros((len(block.scale),) * 2)
            lower[block.rows, block.columns] = state.theta[block.theta]
            lower /= block.scale[:, None]
            found.append(lower @ lower.T)
        return found


def _choose_unit(factors: Sequence[Factor]) -> Factor:
    """Choose the factor that is cheapest to eliminate, with all that is nested in it."""

    def find_cost(unit: Factor) -> float:
        own = shared = 0.0
        for factor in factors:
            place, width = nest(factor, unit)[1], sum(len(term.names) for term in factor.terms)
            own += 0 if place is None else (int(place.max()) + 1) * width
            shared += factor.n_levels * width if place is None else 0
        return unit.n_levels * own**2 * (own + shared) + shared**3

    return min(factors, key=find_cost)


@contextmanager
def hold_threads(size: int) -> Iterator[None]:
    """Keep linear algebra to one thread while in the context, if matrices are small and nobody else does."""
    if size >= LARGE or not HELD.acquire(blocking=False):
        yield
        return
    try:
        with POOLS.limit(limits=1, user_api="blas"):
            yield
    finally:
        HELD.release()


def find_optimum(profile: Profile, near: Samples | None = None) -> State:
    """Minimise the deviance over theta; near: what it is of much the same data, where the search may begin.

    L-BFGS from there or from theta = 1 (off the diagonal 0), without bounds because the deviance does not change with a
    spread's sign. For the same reason 0 is always stationary; at every spread of 0 the deviance is therefore
    probed at a small positive value, which shows the sign of its derivative in theta², and the search resumed
    where that is lower. The penalty, -2 log (theta s), goes to infinity at 0.
    """
    start = profile.diagonal.astype(np.float64)
    if near is not None:
        start = np.where(profile.diagonal & (near == 0), RESTART, near)
    best = _descend(profile, start)
    for _ in range(ATTEMPTS):
        here, theta = profile.target(best), best.theta
        for place in np.flatnonzero(profile.diagonal & (theta == 0)):
            beside = np.arange(len(theta)) == place
            probe = profile.evaluate(np.where(beside, PROBE, theta))
            if profile.target(probe) < here - 1e-9:
                better = _descend(profile, np.where(beside, RESTART, theta))
                break
        else:
            return best
        if profile.target(better) >= here:
            return best
        best = better
    return best


def _descend(profile: Profile, start: Samples) -> State:
    held = profile.penalised

    def value(theta: Samples) -> tuple[float, Samples]:
        state = profile.evaluate(theta)
        slope = profile.find_slope(state)
        slope[held] -= 2 / theta[held]
        return profile.target(state), slope

    try:
        found = minimize(
            value, start, jac=True, method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-6, "maxiter": 1000, "maxls": 50},
        ).x  # fmt: skip
    except np.linalg.LinAlgError:
        found = np.full(len(start), np.inf)
    if not np.abs(found).max() <= LARGEST:
        got = "got a response that the random effects give exactly, without residual"
        do = "leave the finest group out of the formula"
        raise ValueError(f"data must have scatter within groups, {got}; {do}")
    # A column turned around changes nothing.
    settled = found * np.where(found[profile.of_spread] < 0, -1.0, 1.0)
    settled[profile.diagonal & (settled < ZERO) & ~held] = 0.0
    return profile.evaluate(settled)
