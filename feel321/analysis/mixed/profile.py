"""The profiled deviance of a linear mixed model, and the effects that belong to it.

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
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.mixed.design import (
    find_penalised,
    pick_blocks,
    place_factors,
    scale_columns,
    spread_columns,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from feel321.analysis.mixed.design import MixedDesign
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
