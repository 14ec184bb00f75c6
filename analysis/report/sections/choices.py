"""What whoever analyses a study may choose, and where randomness comes from."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from analysis.numbers import name_path


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices that were made before the ratings were seen.

    Parameters
    ----------
    draws : int
        Bootstrap draws per interval and random pairings per permutation test, at least 2.
    margin : float or None
        Difference in points that does not matter; None: half the spread with which people repeat their ratings.
    seed : int
        Of all randomness.
    """

    draws: int = 2000
    margin: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.draws < 2:  # noqa: PLR2004 - a spread needs two
            raise ValueError(f"draws: got {self.draws}, allowed is 2 or more; use 2000 for results to be published")
        if self.margin is not None and not 0 < self.margin < np.inf:
            raise ValueError(f"margin: got {self.margin}, allowed is above 0, in points of the scale, or none")

    def make_rng(self, *names: str) -> np.random.Generator:
        """Make the source of randomness of one result.

        Parameters
        ----------
        *names : str
            What the result is called.

        Returns
        -------
        Generator
            Its own: a further metric or section does not change the intervals of the others.
        """
        return np.random.default_rng([self.seed, zlib.crc32(name_path(*names).encode())])
