"""Where each grouping factor stands in the equations, and its columns of Z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray
    from scipy.sparse import csr_array

    from analysis.mixed.design import Factor


@dataclass(frozen=True)
class Block:
    """A grouping factor's place in the equations.

    Parameters
    ----------
    factor : Factor
        Its levels and effects.
    scale : ndarray, shape (width,)
        Root mean square of its columns, which they were divided by.
    theta : slice
        Its share of the parameters.
    rows, columns : ndarray of int
        Where each of them stands in the factor's triangle.
    """

    factor: Factor
    scale: NDArray[np.float64]
    theta: slice
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @property
    def n_levels(self) -> int:
        """Number of levels."""
        return len(self.factor.levels)

    @property
    def width(self) -> int:
        """Effects per level."""
        return len(self.scale)

    def triangle(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Write a factor's parameters as a triangle.

        Parameters
        ----------
        theta : ndarray, shape (n_theta,)
            Parameters of all factors.

        Returns
        -------
        ndarray, shape (width, width)
            Relative spreads of one level's effects.
        """
        lower = np.zeros((self.width, self.width))
        lower[self.rows, self.columns] = theta[self.theta]
        return lower


def lay_out(factors: tuple[Factor, ...]) -> Iterator[Block]:
    """Place the factors, most effects first; parameters follow term by term, each a lower triangle.

    Parameters
    ----------
    factors : tuple of Factor
        Grouping factors, in the order of the formula.

    Yields
    ------
    Block
        A factor's place.
    """
    start = 0
    for factor in sorted(factors, key=lambda factor: -len(factor.levels) * factor.width):
        rows, columns, corner = [], [], 0
        for term in factor.terms:
            row, column = np.tril_indices(len(term.names))
            rows.append(row + corner)
            columns.append(column + corner)
            corner += len(term.names)
        size = sum(map(len, rows))
        scale = np.sqrt(np.mean(factor.columns**2, axis=0))
        yield Block(factor, scale, slice(start, start + size), np.concatenate(rows), np.concatenate(columns))
        start += size


def find_penalised(blocks: Sequence[Block], names: Sequence[str]) -> NDArray[np.bool_]:
    """Find the parameters whose logarithm is penalised: the spreads of the factors named.

    Parameters
    ----------
    blocks : sequence of Block
        The factors' places.
    names : sequence of str
        Factors.

    Returns
    -------
    ndarray of bool, shape (n_theta,)
        Which.

    Raises
    ------
    ValueError
        If a name is not a grouping factor, or its effects are correlated: they have no spreads of their own then.
    """
    if strangers := [name for name in names if name not in {block.factor.name for block in blocks}]:
        allowed = ", ".join(block.factor.name for block in blocks)
        raise ValueError(f"penalty: got {strangers[0]!r}, allowed are the formula's groups: {allowed}")
    chosen = [np.full(len(block.rows), block.factor.name in names) for block in blocks]
    if any(one.any() and (block.rows != block.columns).any() for one, block in zip(chosen, blocks, strict=True)):
        raise ValueError("penalty: got a group with correlated effects, allowed are uncorrelated ones: (1 + x || g)")
    return np.concatenate(chosen)


def spread_columns(block: Block) -> csr_array:
    """Build a factor's columns of Z, level by level.

    Parameters
    ----------
    block : Block
        The factor's place.

    Returns
    -------
    csr_array, shape (n_rows, n_levels * width)
        Scaled to unit mean square.
    """
    from scipy.sparse import csr_array

    values, width = block.factor.columns / block.scale, block.width
    places = block.factor.index[:, None] * width + np.arange(width)
    starts = np.arange(len(values) + 1) * width
    return csr_array((values.ravel(), places.ravel(), starts), shape=(len(values), block.n_levels * width))


def pick_blocks(first: csr_array, block: Block) -> NDArray[np.float64]:
    """Pick the blocks on the diagonal of a factor's cross products.

    Parameters
    ----------
    first : csr_array, shape (n_rows, n_levels * width)
        Its columns of Z.
    block : Block
        Its place.

    Returns
    -------
    ndarray, shape (n_levels, width, width)
        One block per level; all else is 0.
    """
    products = (first.T @ first).tocsr()
    starts = np.arange(block.n_levels) * block.width
    blocks = np.empty((block.n_levels, block.width, block.width))
    for row in range(block.width):
        for column in range(block.width):
            blocks[:, row, column] = products[starts + row, starts + column]
    return blocks


def scale_columns(matrix: NDArray[np.float64], lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply every level's columns by a triangle.

    Parameters
    ----------
    matrix : ndarray, shape (n, n_levels * width)
        Columns, level by level.
    lower : ndarray, shape (width, width)
        The triangle.

    Returns
    -------
    ndarray, shape (n, n_levels * width)
        Each level's columns times the triangle.
    """
    levels = matrix.reshape(len(matrix), -1, len(lower))
    scaled: NDArray[np.float64] = levels * lower[0, 0] if len(lower) == 1 else levels @ lower
    return scaled.reshape(matrix.shape)
