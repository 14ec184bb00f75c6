"""What a rule found of each participant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame, Index, Series


def tell_shares(bad: Series, participant: Series, *, participants: Index, limit: float) -> DataFrame:
    """Count how often each participant did what a rule forbids, and compare the share with its limit.

    Parameters
    ----------
    bad : Series of bool
        One per judgement that the rule is about.
    participant : Series
        Whose it is.
    participants : Index
        Everyone to be reported.
    limit : float
        Largest share allowed.

    Returns
    -------
    DataFrame
        Indexed by participant: count, n, share (NaN without judgements), limit, hit.
    """
    grouped = bad.groupby(participant.to_numpy(), observed=True)
    count = grouped.sum().reindex(participants, fill_value=0)
    n = grouped.size().reindex(participants, fill_value=0)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def tell_values(
    count: Series, n: Series, share: Series, *, limit: float | NDArray[np.float64], below: bool = False
) -> DataFrame:
    """Compare a value of each participant with its limit.

    Parameters
    ----------
    count, n, share : Series
        Indexed by participant; n is what count is out of; a share that is NaN hits nobody.
    limit : float or ndarray, shape (n_participants,)
        Where hits begin, for all or for each.
    below : bool
        Whether values below the limit are hits, instead of those above.

    Returns
    -------
    DataFrame
        Indexed by participant: count, n, share, limit, hit.
    """
    import pandas as pd

    values, limits = share.to_numpy(np.float64), np.broadcast_to(np.asarray(limit, dtype=np.float64), share.shape)
    # 3 of 20 is 15 %, not more; a hair of rounding must not tell otherwise.
    clear = np.abs(values - limits) > 1e-12  # noqa: PLR2004 - rounding of one division
    hit = clear & ((values < limits) if below else (values > limits))
    columns = {"count": count.astype(int), "n": n.astype(int), "share": values, "limit": limits, "hit": hit}
    return pd.DataFrame(columns, index=share.index)
