"""The report's section about choices: what it says of planted, null, reversed and tiny studies, and what it writes."""

from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

from feel321.analysis.report.pairs import compute_choices as compute
from feel321.analysis.resampling import Choices
from feel321.analysis.words import render_words

Plant = Callable[..., Any]

QUICK = Choices(draws=100)
BEST = "spectral_match_bounded"


def answer(planted: Any) -> str:
    said = render_words("choices", **compute(planted.read(), QUICK).facts)[0]
    return said.replace("\u00a0", " ")


def test_a_planted_metric_is_named_with_its_share_the_ceiling_and_the_comparison(
    plant: Plant,
) -> None:
    said = answer(plant(weights=(5.0, 0.0), recordings=12))
    assert said.startswith("Bounded spectral match (7")
    assert "predicts which of two stimuli feels more like the reference (chance 50 %)" in said
    assert "the majority of the other participants predicts 7" in said
    assert "Bounded spectral match predicts more choices than temporal match." in said


def test_nothing_is_claimed_of_noise(plant: Plant) -> None:
    """Of both metrics in six studies, at 5 % together."""
    said = [answer(plant(seed=seed, weights=(0.0, 0.0), participants=6)) for seed in range(6)]
    silent = [one.startswith("Neither metric is shown to predict which of two") for one in said]
    assert sum(silent) >= 5
    assert not any("predicts more choices than temporal" in one for one in said)


def test_a_reversed_metric_is_not_said_to_predict(plant: Plant) -> None:
    said = answer(plant(weights=(-7.0, 0.0), recordings=12))
    assert "Neither metric is shown to predict" in said
    assert "Stimuli with the better value of bounded spectral match (2" in said
    assert said.endswith("were chosen less often.")


def test_a_tiny_study_says_what_it_lacks(plant: Plant) -> None:
    said = answer(plant(participants=2))
    assert said == (
        "Whether a metric predicts which of two stimuli feels more like the reference cannot be estimated with "
        "2 participants and 8 recordings."
    )


def test_abilities_and_catch_trials_are_counted(plant: Plant) -> None:
    planted = plant(scale="preference", participants=6)
    catch = planted.votes.groupby("participant").head(2).assign(
        stimulus_id="r0-original", other_id="r0-low", rating=100, trial=range(9000, 9012)
    )  # fmt: skip
    catch.iloc[0, catch.columns.get_loc("rating")] = 0
    votes = pd.concat([planted.votes, catch], ignore_index=True)
    section = compute(planted._replace(votes=votes).read(), QUICK)
    assert "preference, as_is: an anchor was chosen in 1 of 12 catch trials." in section.notes
    rows = section.rows["choices_abilities"]
    assert {row["reducer"] for row in rows} == {"sax321", "mag321", "soc321", "dft321", "pca321"}
    for row in (row for row in rows if row["quantity"] == "share_chosen"):
        names = (
            planted.votes["stimulus_id"].str.split("-").str[1],
            planted.votes["other_id"].str.split("-").str[1],
        )
        won = names[0].where(planted.votes["rating"] == 100, names[1]) == row["reducer"]
        met = (names[0] == row["reducer"]) | (names[1] == row["reducer"])
        assert row["value"] == pytest.approx(won[met].mean())
