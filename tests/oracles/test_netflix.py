"""Real ratings of video quality against lme4: metrics that are not ours, in a table that is not ours."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from feel321.analysis.mixed.model import fit_mixed
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.table.reading import read_table

METRICS = ["log_bitrate", "height"]

# lme4 stopped where its criterion is 0.0002 above ours, on a likelihood flat in the spread of w1: variances, and with
# them standard errors and degrees of freedom, then differ in the fifth digit (measured: up to 4.3e-5 and 8.3e-5).
CLOSE, CLOSE_DF, CRITERION = 1e-4, 2e-4, 1e-3


@pytest.mark.parametrize("name", ["netflix_public", "netflix_public_outliers"])
def test_slopes_are_those_of_lme4(
    open_oracle: Callable[..., tuple[Path, dict[str, Any]]], name: str
) -> None:
    folder, oracle = open_oracle("ratings", name, "lme4.json")
    table = read_table(folder / "ratings.csv", folder / "manifest.csv", metrics=METRICS)
    found = fit_primary(table, reducers=False, explain=False)
    assert found.n_rows == oracle["observations"]
    assert (found.n_participants, found.n_recordings, found.n_items) == tuple(
        oracle[key] for key in ("participants", "recordings", "stimuli")
    )
    assert "(1 + log_bitrate_w + height_w || recording)" in found.formula
    # The oracle's model has no slopes of recordings; the frame is the primary model's.
    formula = oracle["formula"].replace("stimulus_id", "item")
    for part in ("w", "b"):
        for number, metric in enumerate(METRICS, start=1):
            formula = formula.replace(f"{part}{number}", f"{metric}_{part}")
    fit = fit_mixed(formula, found.model_frame)
    for part in ("w", "b"):
        for number, metric in enumerate(METRICS, start=1):
            term = f"{part}{number}"
            expected, row = oracle["fixed"][term], fit.fixed.loc[f"{metric}_{part}"]
            assert row["estimate"] == pytest.approx(expected["estimate"], rel=CLOSE), term
            assert row["se"] == pytest.approx(expected["se"], rel=CLOSE), term
            assert row["df"] == pytest.approx(expected["df"], rel=CLOSE_DF), term
    above = fit.criterion - oracle["REML criterion"]
    assert -CRITERION < above < CRITERION / 10
