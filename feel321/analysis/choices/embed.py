"""Ordinal embedding: positions of stimuli such that the one chosen lies nearer to the reference than the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import Values, check_columns
from feel321.doors import as_rng, describe
from feel321.records import Result

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Rng

    Triplets = NDArray[np.intp]

TRIPLET = ("reference", "chosen", "other")
STARTS = 8
RIDGE = 1e-3
"""Weight of the mean square of positions, which keeps what nothing holds near the middle."""

FOLDS = 5
FEWEST_REFERENCES = 3


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Embedding(Result):
    """Positions of stimuli from triplets.

    Parameters
    ----------
    names : tuple of str
        The stimuli.
    positions : ndarray, shape (n_stimuli, n_dimensions)
        Centred, on their principal axes; only distances have a meaning. One unit of squared distance changes the log
        odds of a choice by one.
    agreement : float
        Share of the triplets that the positions reproduce.
    held_out : float
        Share of triplets reproduced by positions that were fitted without any choice between these three stimuli, in
        five folds; NaN for fewer than 50 triplets.
    log_likelihood : float
        Bernoulli.
    n_triplets, n_references : int
        Triplets, and how many stimuli were the reference of any.
    notes : tuple of str
        What is to be read with care.
    """

    names: tuple[str, ...]
    positions: Values
    agreement: float
    held_out: float
    log_likelihood: float
    n_triplets: int
    n_references: int
    notes: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return the positions as a table.

        Returns
        -------
        DataFrame
            A row per stimulus: its name and its coordinates.
        """
        import pandas as pd

        columns = [f"axis_{number}" for number in range(1, self.positions.shape[1] + 1)]
        frame = pd.DataFrame(self.positions, columns=columns)
        frame.insert(0, "stimulus", list(self.names))
        return frame


def embed_triplets(triplets: DataFrame, *, dimensions: int = 2, rng: Rng = 0) -> Embedding:
    """Find positions of stimuli from choices which of two is more like a reference.

    Parameters
    ----------
    triplets : DataFrame
        One row per choice, with the columns ``reference``, ``chosen`` and ``other``.
    dimensions : int
        Number of dimensions, at least 1 and less than the number of stimuli.
    rng : int or Generator
        Seed, or source of randomness, of starting positions and folds.

    Returns
    -------
    Embedding
        Positions, and how well they reproduce the choices.

    Raises
    ------
    ValueError
        If a column or a name is missing, a row names a stimulus twice, or there are too few stimuli.

    Notes
    -----
    Stochastic triplet embedding [1]_: P(chosen) = 1 / (1 + exp(d²(reference, chosen) - d²(reference, other))), by
    maximum likelihood with a small penalty on the size of the map; L-BFGS from 8 random starts, the best of them.
    Where all triplets have the same reference, only distances from it can be known: a map needs several references
    (``reference = "every"`` of the triplet task). The package cblearn has more such methods; it is not used, because it
    needs numba and an older NumPy.

    References
    ----------
    .. [1] van der Maaten, L., & Weinberger, K. (2012). Stochastic triplet embedding. IEEE International Workshop on
       Machine Learning for Signal Processing. doi:10.1109/MLSP.2012.6349720

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> places = {"a": 0.0, "b": 1.0, "c": 3.0, "d": 6.0}
    >>> rows = [(r, *sorted({*places} - {r, x}, key=lambda n: abs(places[n] - places[r])))
    ...     for r in places for x in set(places) - {r}]
    >>> found = analysis.embed_triplets(pd.DataFrame(rows, columns=["reference", "chosen", "other"]), dimensions=1)
    >>> found.agreement
    1.0
    """
    names, codes = _read_triplets(triplets)
    if not 1 <= dimensions < len(names):
        raise ValueError(
            f"dimensions must be from 1 to {len(names) - 1}, one less than there are stimuli, got {dimensions}"
        )
    generator = as_rng(rng)
    positions, log_likelihood = fit_positions(codes, len(names), dimensions, rng=generator)
    n_references = len(np.unique(codes[:, 0]))
    notes = []
    if n_references < FEWEST_REFERENCES:
        notes.append(
            f"{n_references} of the stimuli {'was' if n_references == 1 else 'were'} the reference: distances from it "
            "are known, a map of the others is not."
        )
    return Embedding(
        names=names, positions=_align(positions), agreement=_reproduce(positions, codes),
        held_out=_cross_validate(codes, len(names), dimensions, rng=generator), log_likelihood=log_likelihood,
        n_triplets=len(codes), n_references=n_references, notes=tuple(notes),
    )  # fmt: skip


def _read_triplets(triplets: DataFrame) -> tuple[tuple[str, ...], Triplets]:
    from pandas import DataFrame

    if not isinstance(triplets, DataFrame):
        raise TypeError(
            f"triplets must be a DataFrame, one row per choice, got {describe(triplets)}"
        )
    check_columns(triplets, TRIPLET, "triplets")
    cells = triplets[list(TRIPLET)]
    if cells.empty or cells.isna().any(axis=None):
        raise ValueError(
            "triplets must name three stimuli in every row, got an empty table or cell; leave such rows out"
        )
    names, codes = np.unique(cells.astype(str).to_numpy().ravel(), return_inverse=True)
    codes = codes.reshape(-1, 3).astype(np.intp)
    if twice := int(((codes == np.roll(codes, 1, axis=1)).any(axis=1)).sum()):
        raise ValueError(
            f"triplets must name three different stimuli, got {twice} rows with one twice; leave them out"
        )
    return tuple(names.tolist()), codes


def fit_positions(
    codes: Triplets,
    n_items: int,
    dimensions: int,
    *,
    rng: np.random.Generator,
    starts: int = STARTS,
) -> tuple[Values, float]:
    """Fit positions, (n_items, dimensions), to triplets of numbers; also the log likelihood."""
    from scipy.optimize import minimize

    found = [
        minimize(
            _weigh, rng.normal(0, 1, n_items * dimensions), args=(codes, (n_items, dimensions)), jac=True,
            method="L-BFGS-B", options={"maxiter": 500},
        )
        for _ in range(starts)
    ]  # fmt: skip
    best = min(found, key=lambda one: one.fun)
    positions: Values = best.x.reshape(n_items, dimensions)
    return positions, float(-np.logaddexp(0, -_compare(positions, codes)).sum())


def _compare(positions: Values, codes: Triplets) -> Values:
    """Compute the log odds of each choice: by how much the other is farther than the chosen, squared."""
    reference, chosen, other = (positions[column] for column in codes.T)
    odds: Values = ((reference - other) ** 2 - (reference - chosen) ** 2).sum(axis=1)
    return odds


def _weigh(flat: Values, codes: Triplets, shape: tuple[int, int]) -> tuple[float, Values]:
    """Compute the penalised negative log likelihood and its gradient."""
    positions = flat.reshape(shape)
    odds = _compare(positions, codes)
    missed = 1 / (1 + np.exp(np.clip(odds, -500, 500)))
    reference, chosen, other = (positions[column] for column in codes.T)
    gradient = 2 * RIDGE * len(codes) / shape[0] * positions
    parts = (2 * (chosen - other), 2 * (reference - chosen), -2 * (reference - other))
    for column, part in zip(codes.T, parts, strict=True):
        for axis in range(shape[1]):
            pull = np.bincount(column, missed * part[:, axis], minlength=shape[0])
            gradient[:, axis] -= pull
    penalty = RIDGE * len(codes) / shape[0] * (positions**2).sum()
    return float(np.logaddexp(0, -odds).sum() + penalty), gradient.ravel()


def _align(positions: Values) -> Values:
    """Centre positions and turn them onto their principal axes; the largest coordinate of each is positive."""
    centred = positions - positions.mean(axis=0)
    turned: Values = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    largest = turned[np.abs(turned).argmax(axis=0), np.arange(turned.shape[1])]
    aligned: Values = turned * np.where(largest < 0, -1, 1)
    return aligned


def _reproduce(positions: Values, codes: Triplets) -> float:
    return float((_compare(positions, codes) > 0).mean())


def _cross_validate(
    codes: Triplets, n_items: int, dimensions: int, *, rng: np.random.Generator
) -> float:
    if len(codes) < 10 * FOLDS:
        return float("nan")
    # A question that several people answered is left out as a whole.
    asked = np.column_stack([codes[:, 0], np.sort(codes[:, 1:], axis=1)])
    question = np.unique(asked, axis=0, return_inverse=True)[1].ravel()
    fold = (rng.permutation(question.max() + 1) % FOLDS)[question]
    hits = 0.0
    for number in range(FOLDS):
        rest = codes[fold != number]
        positions, _ = fit_positions(rest, n_items, dimensions, rng=rng, starts=2)
        hits += (_compare(positions, codes[fold == number]) > 0).sum()
    return float(hits / len(codes))
