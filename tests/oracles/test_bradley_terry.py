"""Bradley-Terry abilities against R's BradleyTerry2 on the citations of four journals."""

import json
from pathlib import Path

import pandas as pd
import pytest

from feel321.analysis.contrasts.bradley_terry import bradley_terry

ORACLE = Path(__file__).parents[3] / "shared" / "oracles" / "bradley_terry_citations"


def test_bradleyterry2_is_reproduced() -> None:
    if not ORACLE.is_dir():
        pytest.skip(
            f"ORACLE NOT CHECKED: {ORACLE.name} is not beside this checkout, in shared/oracles"
        )
    expected = json.loads((ORACLE / "expected.json").read_text(encoding="utf-8"))
    result = bradley_terry(pd.read_csv(ORACLE / "data.csv"), reference="Biometrika")
    tolerance = expected["tol"]
    assert result.fixed["estimate"].to_dict() == pytest.approx(
        expected["ability"], abs=tolerance["ability_abs"]
    )
    assert result.fixed["se"].to_dict() == pytest.approx(expected["se"], abs=tolerance["se_abs"])
    assert result.deviance == pytest.approx(expected["deviance"], abs=tolerance["deviance_abs"])
    assert result.log_likelihood == pytest.approx(expected["logLik"], abs=1e-8)
    assert result.df == expected["df"]
