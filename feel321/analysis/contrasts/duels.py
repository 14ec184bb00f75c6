"""Paired comparisons as counts: who met whom in which order, and who won how often.

Conventions: a row is a pair in the order in which it was presented. Four forms are understood: trials, with the
columns ``first``, ``second`` and ``winner``; counts, whose first two columns name the pair and whose next two count
the wins of each; and, without an order of presentation, trials with the columns ``winner`` and ``loser``, and a square
table that counts how often the item of the row beat the item of the column.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    Values = NDArray[np.float64]

TRIAL = ("first", "second", "winner")
TIES = ("refuse", "half")
COUNTED = 4
"""Columns of the other form."""


@dataclass(frozen=True, slots=True, eq=False)
class Duels:
    """Wins by pair.

    first, second: (n_rows,); wins: (n_rows, 2).
    """

    items: tuple[str, ...]
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    wins: Values
    n_ties: int
    ordered: bool = True

    def contrasts(self) -> Values:
        """Write each row as +1 for the first item and -1 for the second.

        Returns (n_rows, n_items).
        """
        rows = np.arange(len(self.first))
        design = np.zeros((len(rows), len(self.items)))
        design[rows, self.first] = 1
        design[rows, self.second] = -1
        return design


def count_duels(pairs: DataFrame, *, ties: str = "refuse") -> Duels:
    """Read paired comparisons, as trials or as counts."""
    from pandas import DataFrame

    if not isinstance(pairs, DataFrame):
        raise TypeError(
            f"pairs: got {type(pairs).__name__}, allowed is a pandas DataFrame, one row per pair or trial"
        )
    if ties not in TIES:
        raise ValueError(f"ties: got {ties!r}, allowed is one of {', '.join(TIES)}")
    if pairs.empty:
        raise ValueError("pairs: got no row, allowed is at least one comparison")
    first, second, wins, n_ties = _read_pairs(pairs, ties=ties)
    if (first == second).any():
        raise ValueError(
            f"pairs: got '{first[first == second][0]}' against itself; leave such rows out"
        )
    met = wins.sum(axis=1) > 0  # a pair that never met says nothing
    if not met.any():
        raise ValueError("pairs: got no win in any row, allowed is at least one comparison")
    items, numbers = np.unique(np.concatenate([first[met], second[met]]), return_inverse=True)
    ordered = "loser" not in pairs and not _is_square(pairs)
    one, other = numbers[: met.sum()], numbers[met.sum() :]
    duels = Duels(tuple(items.tolist()), one, other, wins[met], n_ties, ordered)
    return _gather(duels) if "winner" in pairs else duels


def _read_pairs(
    pairs: DataFrame, *, ties: str
) -> tuple[NDArray[np.str_], NDArray[np.str_], Values, int]:
    """Read whichever form it is: names of the first and the second, their wins, and the number of ties."""
    if _is_square(pairs):
        return *_read_square(pairs), 0
    if "winner" in pairs and "loser" in pairs:
        sides = np.stack([_read_names(pairs, "winner"), _read_names(pairs, "loser")], axis=1)
        names = np.sort(sides, axis=1)
        return names[:, 0], names[:, 1], (names == sides[:, :1]).astype(np.float64), 0
    if "winner" in pairs:
        missing = [name for name in TRIAL if name not in pairs]
        if missing:
            raise ValueError(
                f"pairs: column {', '.join(missing)} is missing; trials need {', '.join(TRIAL)}"
            )
        first, second = _read_names(pairs, "first"), _read_names(pairs, "second")
        return first, second, *_read_winners(pairs, first, second, ties=ties)
    if pairs.shape[1] < COUNTED:
        got = ", ".join(map(str, pairs.columns))
        raise ValueError(
            f"pairs: got columns {got}; allowed is {', '.join(TRIAL)}, or two names and two counts"
        )
    first, second = (_read_names(pairs, name) for name in pairs.columns[:2])
    return first, second, _read_counts(pairs.iloc[:, 2:COUNTED]), 0


def _is_square(pairs: DataFrame) -> bool:
    numbers = pairs.select_dtypes("number").shape == pairs.shape
    return numbers and list(map(str, pairs.index)) == list(map(str, pairs.columns))


def _read_square(pairs: DataFrame) -> tuple[NDArray[np.str_], NDArray[np.str_], Values]:
    names = pairs.columns.astype(str).to_numpy(dtype=np.str_)
    counts = _read_counts(pairs.where(pairs.notna(), 0))
    if np.diag(counts).any() or len(set(names)) < len(names):
        raise ValueError(
            "pairs: got a square table with an item twice or against itself, allowed is 0 on its diagonal"
        )
    one, other = np.triu_indices(len(names), 1)
    return names[one], names[other], np.stack([counts[one, other], counts[other, one]], axis=1)


def _read_names(pairs: DataFrame, column: str) -> NDArray[np.str_]:
    missing = int(pairs[column].isna().sum())
    if missing:
        raise ValueError(
            f"pairs: got {missing} rows without a name in column '{column}'; name or leave them out"
        )
    return pairs[column].astype(str).to_numpy(dtype=np.str_)


def _read_winners(
    pairs: DataFrame, first: NDArray[np.str_], second: NDArray[np.str_], *, ties: str
) -> tuple[Values, int]:
    winner = (
        pairs["winner"]
        .astype(object)
        .where(pairs["winner"].notna(), "tie")
        .astype(str)
        .to_numpy(dtype=np.str_)
    )
    wins = np.stack([winner == first, winner == second], axis=1).astype(np.float64)
    undecided = ~wins.any(axis=1)
    strangers = winner[undecided & (winner != "tie")]
    if strangers.size:
        raise ValueError(
            f"pairs: got the winner '{strangers[0]}', allowed is the row's first or second, or 'tie'"
        )
    if undecided.any() and ties == "refuse":
        raise ValueError(
            f"pairs: got {int(undecided.sum())} ties; leave them out, or count them with ties='half'"
        )
    wins[undecided] = 0.5
    return wins, int(undecided.sum())


def _read_counts(columns: DataFrame) -> Values:
    try:
        wins = columns.to_numpy(dtype=np.float64)
    except (TypeError, ValueError):
        names = " and ".join(map(str, columns.columns))
        raise ValueError(f"pairs: got text in columns {names}, allowed is counts of wins") from None
    if not (np.isfinite(wins) & (wins >= 0)).all():
        raise ValueError(
            "pairs: got a count of wins that is negative or not finite, allowed is 0 or more"
        )
    return wins


def _gather(duels: Duels) -> Duels:
    codes = duels.first * len(duels.items) + duels.second
    pairs, row = np.unique(codes, return_inverse=True)
    wins = np.stack([np.bincount(row, duels.wins[:, side]) for side in (0, 1)], axis=1).astype(
        np.float64
    )
    return Duels(
        duels.items,
        pairs // len(duels.items),
        pairs % len(duels.items),
        wins,
        duels.n_ties,
        duels.ordered,
    )
