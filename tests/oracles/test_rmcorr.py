"""Repeated-measures correlation against R's rmcorr on Bland & Altman (1995)."""

import csv
import json
from pathlib import Path

import pytest

from feel321.analysis.classic import repeated_measures_correlation

ORACLE = Path(__file__).parents[3] / "shared" / "oracles" / "rmcorr_bland1995"


def test_rmcorr_is_reproduced() -> None:
    if not ORACLE.is_dir():
        pytest.skip(
            f"ORACLE NOT CHECKED: {ORACLE.name} is not beside this checkout, in shared/oracles"
        )
    expected = json.loads((ORACLE / "expected.json").read_text(encoding="utf-8"))
    with (ORACLE / "data.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    x, y = ([float(row[name]) for row in rows] for name in ("pH", "PaCO2"))
    result = repeated_measures_correlation(x, y, [row["Subject"] for row in rows])
    tolerance = expected["tol"]
    assert result.r == pytest.approx(expected["r"], abs=tolerance["r_abs"])
    assert result.df == expected["df"]
    assert result.p == pytest.approx(expected["p"], rel=tolerance["p_rel"])
    assert [result.low, result.high] == pytest.approx(expected["ci95"], abs=tolerance["ci_abs"])
