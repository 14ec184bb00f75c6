"""The rater model against SUREAL 0.9.0 on real ratings."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from feel321.analysis.agreement import rater_model

CLOSE = 1e-6
"""SUREAL stops where the norm of the change of all qualities is below 1e-8, on votes from 1 to 5."""

PLANTED = {"netflix_public": set(), "netflix_public_outliers": {"s26", "s27", "s28", "s29"}}


@pytest.mark.parametrize("name", list(PLANTED))
def test_rater_model_is_that_of_sureal(
    open_oracle: Callable[..., tuple[Path, dict[str, Any]]], name: str
) -> None:
    folder, oracle = open_oracle("ratings", name, "sureal.json")
    ratings = pd.read_csv(folder / "ratings.csv")
    model = rater_model(ratings.assign(rating=ratings["rating"] / 25 + 1))
    expected, plain = (oracle["models"][key] for key in ("MLE_CO_AP2", "MLE_CO_AP"))
    for found, key, of in (
        (model.raters["bias"], "observer_bias", expected),
        (model.raters["bias_se"], "observer_bias_std", expected),
        (model.raters["inconsistency"], "observer_inconsistency", expected),
        (model.raters["inconsistency_se"], "observer_inconsistency_std", expected),
        (model.stimuli["quality"], "quality_scores", expected),
        (model.stimuli["se"], "quality_scores_std", expected),
        (model.stimuli["se_raters"], "quality_scores_std", plain),
    ):
        assert found.to_dict() == pytest.approx(of[key], abs=CLOSE), key
    for key in ("loglikelihood", "aic", "bic"):
        assert getattr(model, key) == pytest.approx(expected[key], abs=CLOSE), key
    assert set(model.apart) == PLANTED[name]
