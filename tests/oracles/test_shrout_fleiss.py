"""Intraclass correlations against Shrout & Fleiss (1979, Psychological Bulletin 86, 420-428) and R's psych."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from feel321.analysis.agreement import intraclass

ORACLES = Path(__file__).parents[3] / "shared" / "oracles" / "icc_shrout_fleiss"
NAMES = {
    "icc_1_1": "ICC1",
    "icc_a_1": "ICC2",
    "icc_c_1": "ICC3",
    "icc_1_k": "ICC1k",
    "icc_a_k": "ICC2k",
    "icc_c_k": "ICC3k",
}

TABLE_2 = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
"""Their table 2: six targets, four judges."""

TABLE_4 = {
    "icc_1_1": 0.17,
    "icc_a_1": 0.29,
    "icc_c_1": 0.71,
    "icc_1_k": 0.44,
    "icc_a_k": 0.62,
    "icc_c_k": 0.91,
}
"""Their table 4, as printed."""


@pytest.mark.parametrize("name", NAMES)
def test_published_table_is_reproduced(name: str) -> None:
    assert getattr(intraclass(TABLE_2), name) == pytest.approx(TABLE_4[name], abs=0.005)


@pytest.mark.parametrize("name", NAMES)
def test_psych_is_reproduced(name: str) -> None:
    if not ORACLES.is_dir():
        pytest.skip(
            f"ORACLE NOT CHECKED: {ORACLES.name} is not beside this checkout, in shared/oracles"
        )
    expected = json.loads((ORACLES / "expected.json").read_text(encoding="utf-8"))
    with (ORACLES / "data.csv").open(encoding="utf-8", newline="") as file:
        table = np.array([[float(cell) for cell in row[1:]] for row in list(csv.reader(file))[1:]])
    icc, printed = intraclass(table), expected["icc"][NAMES[name]]
    assert getattr(icc, name) == pytest.approx(printed["ICC"], abs=expected["tol"]["icc_abs"])
    limits = [getattr(icc, f"{name}_{end}") for end in ("low", "high")]
    # psych's own interval is exact too: far closer than the tolerance of ../shared
    assert limits == pytest.approx([printed["lower bound"], printed["upper bound"]], abs=1e-9)
