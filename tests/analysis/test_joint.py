"""The mixed model's joint test of reducers, against sums of squares done by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.contrasts.compare import compare_terms, fit_reducers


def test_the_mixed_models_test_is_the_anovas_where_the_design_is_balanced() -> None:
    # One recording, no spread of stimuli: people, and people's own residual, are all that is random.
    rng = np.random.default_rng(5)
    means = 50 + rng.normal(0, 8, (12, 1)) + np.array([0, 2, 5, 3.0]) + rng.normal(0, 4, (12, 4))
    rows = pd.DataFrame(
        [(f"p{who}", f"r{one}", means[who, one]) for who, one in np.ndindex(means.shape)],
        columns=["participant", "reducer", "rating"],
    ).assign(recording="one")
    rows = rows.assign(item=rows["reducer"])
    fit, terms, _ = fit_reducers(rows, ["r0", "r1", "r2", "r3"])
    found = compare_terms(fit, list(terms.values()))
    reducers = means.mean(axis=0) - means.mean()
    left = means - means.mean(axis=1, keepdims=True) - reducers
    f = 12 * (reducers**2).sum() / 3 / ((left**2).sum() / 33)
    assert found.df_1 == 3
    assert found.statistic == pytest.approx(f, rel=1e-3)
    assert found.df_2 == pytest.approx(33, rel=1e-2)
