"""What a search for a refined metric found, as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.resampling.bootstrap import bootstrap_margin, fisher_z

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from analysis.refined.candidates import Basis
    from analysis.refined.score import Outcome


def list_candidates(basis: Basis, whole: Outcome) -> DataFrame:
    """List what might have been chosen.

    Parameters
    ----------
    basis : Basis
        Candidates.
    whole : Outcome
        Of all data.

    Returns
    -------
    DataFrame
        name, parameters, value, rmse, chosen.
    """
    import pandas as pd

    counts = np.bincount(whole.chosen.ravel(), minlength=len(basis.candidates))
    return pd.DataFrame({
        "name": [one.name for one in basis.candidates],
        "parameters": [one.parameters for one in basis.candidates],
        "value": whole.correlations[1:, 0],
        "rmse": whole.errors[1:, 0],
        "chosen": counts / counts.sum(),
    })


def list_gains(basis: Basis, whole: Outcome, drawn: Outcome, *, n_units: int) -> DataFrame:
    """Compare the refined metric with each plain one.

    Parameters
    ----------
    basis : Basis
        Candidates; the plain metrics are named like their one column.
    whole, drawn : Outcome
        Of all data, and of every draw.
    n_units : int
        Units of the scarcest kind that were drawn from.

    Returns
    -------
    DataFrame
        metric, plain, value, low, high, z_value, z_low, z_high, rmse; gains are refined minus plain.
    """
    import pandas as pd

    rows = []
    z, drawn_z = fisher_z(whole.correlations[0])[0], fisher_z(drawn.correlations[0])
    for place, name in _list_plain(basis):
        plain, drawn_plain = fisher_z(whole.as_it_is[place])[0], fisher_z(drawn.as_it_is[place])
        margin = bootstrap_margin(drawn_z - drawn_plain, n_units)
        gain = z - plain + np.array([0.0, -margin, margin])
        # As differences of correlations about the same mean z, as for `compare_metrics`.
        value, low, high = np.tanh((z + plain + gain) / 2) - np.tanh((z + plain - gain) / 2)
        rows.append({
            "metric": name, "plain": float(np.tanh(plain)), "value": value, "low": low, "high": high,
            **dict(zip(("z_value", "z_low", "z_high"), gain, strict=True)), "rmse": whole.errors[1 + place, 0],
        })  # fmt: skip
    return pd.DataFrame(rows)


def list_weights(basis: Basis, whole: Outcome, chosen: int, *, fit: NDArray[np.float64]) -> DataFrame:
    """Tell the weights of what was chosen, and how they change from fold to fold.

    Parameters
    ----------
    basis : Basis
        Columns.
    whole : Outcome
        Fits of all outer folds.
    chosen : int
        Place of the candidate.
    fit : ndarray, shape (n_columns + 2,)
        Its coefficients on all data.

    Returns
    -------
    DataFrame
        term, weight, lowest, highest, per_unit.
    """
    import pandas as pd

    columns = list(basis.candidates[chosen].columns)
    weights = fit[1:-1][columns]
    over_folds = whole.fits[chosen, 0][..., 1:-1][..., columns].reshape(-1, len(columns))
    return pd.DataFrame({
        "term": [basis.names[column] for column in columns],
        "weight": weights, "lowest": over_folds.min(axis=0), "highest": over_folds.max(axis=0),
        "per_unit": weights / basis.scales[columns],
    })  # fmt: skip


def _list_plain(basis: Basis) -> list[tuple[int, str]]:
    from analysis.refined.candidates import EQUAL

    single = [(place, one) for place, one in enumerate(basis.candidates) if one.parameters == 1]
    return [(place, one.name) for place, one in single if one.name != EQUAL]
