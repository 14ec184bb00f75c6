"""Krippendorff's alpha against his own table (2011) as R's irr prints it."""

import json
from pathlib import Path

import numpy as np
import pytest

from feel321.analysis.agreement import LEVELS, krippendorff_alpha

ORACLE = Path(__file__).parents[3] / "shared" / "oracles" / "krippendorff_alpha"


@pytest.mark.parametrize("level", LEVELS)
def test_irr_is_reproduced(level: str) -> None:
    if not ORACLE.is_dir():
        pytest.skip(
            f"ORACLE NOT CHECKED: {ORACLE.name} is not beside this checkout, in shared/oracles"
        )
    expected = json.loads((ORACLE / "expected.json").read_text(encoding="utf-8"))
    by_observer = np.genfromtxt(
        ORACLE / "data.csv", delimiter=",", skip_header=1, missing_values="NA"
    )
    alpha = krippendorff_alpha(by_observer.T, level=level)
    assert alpha == pytest.approx(expected["alpha"][level], abs=expected["tol"]["alpha_abs"])
