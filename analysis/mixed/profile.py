"""The profiled deviance of a linear mixed model.

Model: y = X b + Z L u + e, with u ~ N(0, s² I), e ~ N(0, s² I) and L block-diagonal, holding for every level
of a grouping factor the same lower triangle of relative spreads, theta. Given theta, b and s have closed forms;
what is left to minimise is a function of theta alone (Bates et al. 2015, doi 10.18637/jss.v067.i01, eq. 38-42).

Layout (as in MixedModels.jl): columns of the factor with the most effects come first. Its part of L'Z'ZL + I
falls into one small block per level, which are eliminated at once; what remains is small and dense, with X and y
as its last rows, so that one Cholesky factor holds the determinants, the coefficients and the residual.

Columns are scaled first: Z's to unit mean square, X to orthonormal columns, y to what X leaves over. The
deviance is that of the data as given; results are scaled back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from analysis.mixed.layout import find_penalised, lay_out, pick_blocks, scale_columns, spread_columns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from analysis.mixed.design import Design


MOST_LEVELS = 10_000
"""Effects beside the largest factor's: with more, the dense equations alone need gigabytes."""


@dataclass(frozen=True)
class State:
    """Everything known at one theta.

    Parameters
    ----------
    theta : ndarray, shape (n_theta,)
        Relative spreads.
    log_random : float
        log |L'Z'ZL + I|.
    log_fixed : float
        log |X'V⁻¹X| with V in units of s², of the columns as given.
    rss : float
        The penalised residual sum of squares.
    factor : ndarray
        Cholesky factor of the dense part, y last.
    inner : ndarray, shape (n_levels, width, width)
        Inverse blocks of the eliminated factor.
    """

    theta: NDArray[np.float64]
    log_random: float
    log_fixed: float
    rss: float
    factor: NDArray[np.float64]
    inner: NDArray[np.float64]


class Profile:
    """The deviance as a function of theta, for one design.

    Parameters
    ----------
    design : Design
        Response, fixed columns and grouping factors.
    reml : bool
        Restricted likelihood, or the full one.
    penalty : sequence of str
        Grouping factors whose spreads are kept away from zero.
    """

    def __init__(self, design: Design, *, reml: bool, penalty: Sequence[str] = ()) -> None:
        self.design, self.reml = design, reml
        self.n_rows, self.n_fixed = design.fixed.shape
        self.freedom = self.n_rows - self.n_fixed if reml else self.n_rows
        self.blocks = tuple(lay_out(design.factors))
        self.penalised = find_penalised(self.blocks, penalty)
        # Every spread whose logarithm is penalised takes one residual's along, for spreads are in units of it.
        self.weight = self.freedom - int(self.penalised.sum())
        self.n_random = sum(block.n_levels * block.width for block in self.blocks[1:])
        if self.n_random > MOST_LEVELS:
            raise ValueError(
                f"data: got {self.n_random} effects beside those of {self.blocks[0].factor.name}, allowed are "
                f"{MOST_LEVELS}, for memory; average repeated rows, or leave out a group with many levels"
            )
        self._reduce_data()

    def _reduce_data(self) -> None:
        """Keep only the cross products; rows are not needed again."""
        from scipy.sparse import csr_array, hstack

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

    @property
    def n_theta(self) -> int:
        """Number of parameters."""
        return len(self.diagonal)

    @cached_property
    def diagonal(self) -> NDArray[np.bool_]:
        """Which parameters are spreads, 0 or more, rather than what ties two effects together."""
        return np.concatenate([block.rows == block.columns for block in self.blocks])

    def evaluate(self, theta: NDArray[np.float64]) -> State:
        """Factorise the equations at theta.

        Parameters
        ----------
        theta : ndarray, shape (n_theta,)
            Relative spreads.

        Returns
        -------
        State
            Determinants, residual and factors.
        """
        from scipy.linalg import cholesky

        lower = self.blocks[0].triangle(theta)
        blocks = lower.T @ self.inner_products @ lower + np.eye(len(lower))
        inner = np.linalg.inv(blocks).astype(np.float64, copy=False)
        scaled = self._scale(self.eliminate(lower @ inner @ lower.T), theta)
        place = np.arange(self.n_random)
        scaled[place, place] += 1
        factor = cholesky(scaled, lower=True, overwrite_a=True, check_finite=False)
        logs = 2 * np.log(np.diag(factor))
        return State(
            theta=theta,
            log_random=float(np.linalg.slogdet(blocks)[1].sum() + logs[: self.n_random].sum()),
            log_fixed=float(logs[self.n_random : -1].sum() + 2 * np.log(np.abs(np.diag(self.triangle_x))).sum()),
            rss=float(factor[-1, -1] ** 2) * self.unit**2,
            factor=factor, inner=inner,
        )  # fmt: skip

    def eliminate(self, middle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the first factor out of the others' cross products.

        Parameters
        ----------
        middle : ndarray, shape (n_levels, width, width)
            L (L'Z'ZL + I)⁻¹ L' of the first factor, level by level.

        Returns
        -------
        ndarray
            What is left of the dense part, before it is scaled.
        """
        from scipy.sparse import bsr_array

        count = len(middle)
        spread = bsr_array((middle, np.arange(count), np.arange(count + 1))).tocsr()
        left: NDArray[np.float64] = self.outer - (self.border.T @ (spread @ self.border)).toarray()
        return left

    def _scale(self, products: NDArray[np.float64], theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """L' products L, in place."""
        for place, lower in self.tail(theta):
            products[:, place] = scale_columns(products[:, place], lower)
        for place, lower in self.tail(theta):
            products[place] = scale_columns(products[place].T, lower).T
        return products

    def tail(self, theta: NDArray[np.float64]) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        """List the factors that are not eliminated.

        Parameters
        ----------
        theta : ndarray, shape (n_theta,)
            Relative spreads.

        Yields
        ------
        slice
            A factor's place in the dense part.
        ndarray, shape (width, width)
            Its triangle.
        """
        start = 0
        for block in self.blocks[1:]:
            stop = start + block.n_levels * block.width
            yield slice(start, stop), block.triangle(theta)
            start = stop

    def deviance(self, state: State) -> float:
        """-2 log likelihood with the best b and s for this theta.

        Parameters
        ----------
        state : State
            The equations, factorised.

        Returns
        -------
        float
            What lme4 calls the REML criterion, or the deviance.
        """
        spread = np.log(2 * np.pi * state.rss / self.weight)
        return float(state.log_random + self.reml * state.log_fixed + self.freedom * spread + self.weight)
