"""The profiled deviance of a linear mixed model, and its slope.

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

from analysis.mixed.layout import lay_out, pick_blocks, spread_columns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from analysis.mixed.design import Design


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
    """

    def __init__(self, design: Design, *, reml: bool) -> None:
        self.design, self.reml = design, reml
        self.n_rows, self.n_fixed = design.fixed.shape
        self.freedom = self.n_rows - self.n_fixed if reml else self.n_rows
        self.blocks = tuple(lay_out(design.factors))
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
        self.n_random = tail.shape[1] - self.n_fixed - 1
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

    def turn(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Write theta with spreads of 0 or more; turning an effect's column around changes nothing.

        Parameters
        ----------
        theta : ndarray, shape (n_theta,)
            Relative spreads of either sign.

        Returns
        -------
        ndarray, shape (n_theta,)
            The same model.
        """
        turned = []
        for block in self.blocks:
            lower = block.triangle(theta)
            lower = lower * np.where(np.diag(lower) < 0, -1.0, 1.0)
            turned.append(lower[block.rows, block.columns])
        return np.concatenate(turned)

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
        scaled = self._scale(self._eliminate(lower @ inner @ lower.T), theta)
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

    def _eliminate(self, middle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the first factor out of the others' cross products."""
        from scipy.sparse import bsr_array

        count = len(middle)
        spread = bsr_array((middle, np.arange(count), np.arange(count + 1))).tocsr()
        left: NDArray[np.float64] = self.outer - (self.border.T @ (spread @ self.border)).toarray()
        return left

    def _scale(self, products: NDArray[np.float64], theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """L' products L, in place."""
        for place, lower in self._tail(theta):
            products[:, place] = _right(products[:, place], lower)
        for place, lower in self._tail(theta):
            products[place] = _right(products[place].T, lower).T
        return products

    def _tail(self, theta: NDArray[np.float64]) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        """Places of the factors that are not eliminated, with their triangles."""
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
        spread = 1 + np.log(2 * np.pi * state.rss / self.freedom)
        return float(state.log_random + self.reml * state.log_fixed + self.freedom * spread)

    def slope(self, state: State, weight: float | None = None) -> NDArray[np.float64]:
        """Differentiate the deviance with respect to theta.

        Parameters
        ----------
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
        lower = self.blocks[0].triangle(state.theta)
        outer = self._adjoint(state, self.freedom if weight is None else weight)
        # Through the dense part's own scale.
        half = self._eliminate(lower @ state.inner @ lower.T)
        for place, other in self._tail(state.theta):
            half[:, place] = _right(half[:, place], other)
        tail = list(self._tail(state.theta))
        found = [2 * _trace_blocks(half[place], outer[:, place], len(other)) for place, other in tail]
        for place, other in tail:
            outer[:, place] = _right(outer[:, place], other.T)
        for place, other in tail:
            outer[place] = _right(outer[place].T, other.T).T
        found.insert(0, self._inner_slope(state, lower, outer))
        parts = zip(found, self.blocks, strict=True)
        return np.concatenate([matrix[block.rows, block.columns] for matrix, block in parts])

    def _adjoint(self, state: State, weight: float) -> NDArray[np.float64]:
        """Differentiate the deviance with respect to the dense matrix."""
        from scipy.linalg.lapack import dpotri, dtrtrs

        size = self.n_random + (self.n_fixed if self.reml else 0)
        adjoint = np.zeros_like(state.factor)
        if size:  # the full likelihood of a single grouping factor has no determinant but the eliminated one
            inverse = dpotri(state.factor[:size, :size], lower=1)[0]
            adjoint[:size, :size] = np.tril(inverse) + np.tril(inverse, -1).T
        last = np.zeros(len(state.factor))
        last[-1] = 1
        direction = dtrtrs(state.factor, last, lower=1, trans=1)[0]
        adjoint += weight * np.outer(direction, direction)
        return adjoint

    def _inner_slope(self, state: State, lower: NDArray[np.float64], outer: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differentiate through the eliminated factor: its own determinant, and what it leaves."""
        width = self.blocks[0].width
        through = self.border @ outer
        seen = np.empty((self.blocks[0].n_levels, width, width))
        for row in range(width):
            for column in range(width):
                seen[:, row, column] = self.border[column::width].multiply(through[row::width]).sum(axis=1)
        back = state.inner @ lower.T
        kept = np.eye(width) - lower @ back @ self.inner_products
        slope: NDArray[np.float64] = 2 * (back @ self.inner_products - back @ seen @ kept).sum(axis=0).T
        return slope

    def sigma(self, state: State) -> float:
        """Residual standard deviation.

        Parameters
        ----------
        state : State
            The equations, factorised.

        Returns
        -------
        float
            sqrt(rss / (n - p)), or rss / n for the full likelihood.
        """
        return float(np.sqrt(state.rss / self.freedom))

    def coefficients(self, state: State) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Solve for the fixed effects and their covariance in units of s².

        Parameters
        ----------
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

        place = slice(self.n_random, -1)
        corner, last = state.factor[place, place], state.factor[-1, place]
        inverse = solve_triangular(self.triangle_x, solve_triangular(corner, np.eye(self.n_fixed), lower=True).T)
        shift = solve_triangular(self.triangle_x, self.offset)
        return shift + inverse @ last * self.unit, inverse @ inverse.T

    def modes(self, state: State) -> list[NDArray[np.float64]]:
        """Predicted random effects of every factor, in the order of the blocks.

        Parameters
        ----------
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
        for (place, other), block in zip(self._tail(state.theta), self.blocks[1:], strict=True):
            effects = solved[place].reshape(-1, block.width) @ other.T
            tail[place] = -effects.ravel()
            found.append(effects)
        lower = self.blocks[0].triangle(state.theta)
        seen = (self.border @ tail).reshape(-1, self.blocks[0].width)
        first = np.einsum("kij,kj->ki", lower @ state.inner @ lower.T, seen)
        return [effects * self.unit / block.scale for effects, block in zip([first, *found], self.blocks, strict=True)]

    def spreads(self, state: State) -> list[NDArray[np.float64]]:
        """Covariances of the random effects in units of s², in the order of the blocks.

        Parameters
        ----------
        state : State
            The equations, factorised.

        Returns
        -------
        list of ndarray, shape (width, width)
            Of the columns as given.
        """
        lowers = [block.triangle(state.theta) / block.scale[:, None] for block in self.blocks]
        return [lower @ lower.T for lower in lowers]


def _right(matrix: NDArray[np.float64], lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply every level's columns by the triangle."""
    levels = matrix.reshape(len(matrix), -1, len(lower))
    scaled: NDArray[np.float64] = levels * lower[0, 0] if len(lower) == 1 else levels @ lower
    return scaled.reshape(matrix.shape)


def _trace_blocks(left: NDArray[np.float64], right: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Sum over levels of the blocks on the diagonal of left @ right."""
    rows = left.reshape(-1, width, left.shape[1])
    columns = right.T.reshape(-1, width, right.shape[0])
    found: NDArray[np.float64] = np.einsum("aik,ajk->ij", rows, columns)
    return found
