"""The report's section about choices: what it says of planted, null, reversed and tiny studies, and what it writes."""

from __future__ import annotations

import json
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.association import correlate
from feel321.analysis.page import render_words
from feel321.analysis.report.answer import find_row
from feel321.analysis.report.pairs import compute_choices as compute
from feel321.analysis.resampling import Choices

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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


def test_a_reducer_on_which_the_answer_hinges_is_named(plant: Plant) -> None:
    """All of the effect is in the pairs with one reducer: the others are chosen by chance."""
    planted = plant(weights=(0.0, 0.0), recordings=12)
    stimuli = planted.stimuli.assign(**{
        BEST: planted.stimuli[BEST].where(planted.stimuli["reducer"] != "mag321", -1.0)
    })
    bad = [planted.votes[name].str.endswith("mag321") for name in ("stimulus_id", "other_id")]
    votes = planted.votes.assign(rating=planted.votes["rating"].mask(bad[0], 0).mask(bad[1], 100))
    said = answer(planted._replace(votes=votes, stimuli=stimuli))
    assert "Without mag321, this is not shown for bounded spectral match." in said


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


def test_a_reducer_that_always_wins_has_a_shrunken_ability_and_no_interval(plant: Plant) -> None:
    planted = plant(participants=4, recordings=3)
    best = [planted.votes[name].str.endswith("dft321") for name in ("stimulus_id", "other_id")]
    votes = planted.votes.assign(rating=planted.votes["rating"].mask(best[0], 100).mask(best[1], 0))
    section = compute(planted._replace(votes=votes).read(), QUICK)
    rows = section.rows["choices_abilities"]
    abilities = [row for row in rows if row["quantity"] == "ability"]
    assert max(abilities, key=lambda row: row["value"])["reducer"] == "dft321"
    assert find_row(rows, "share_chosen", reducer="dft321")["value"] == 1
    assert all(np.isnan(row["low"]) and np.isnan(row["high"]) for row in abilities)
    assert any("abilities are shrunken" in note for note in section.notes)


def test_several_references_give_abilities_of_the_recording_alone(plant: Plant) -> None:
    """Reducers lie on a line; what is nearer to the reference is chosen, with noise."""
    planted = plant(participants=12, recordings=2)
    names = ["original", "sax321", "mag321", "soc321", "dft321"]
    rng = np.random.default_rng(0)
    rows = [
        (f"p{p}", f"r{r}-{names[a]}", f"r{r}-{names[b]}", f"r{r}-{names[h]}",
         100 * (rng.random() < 1 / (1 + np.exp(0.3 * (abs(a - h) ** 2 - abs(b - h) ** 2)))))
        for p in range(12) for r in range(2) for h in range(5)
        for a, b in combinations([k for k in range(5) if k != h], 2)
    ]  # fmt: skip
    columns = ["participant", "stimulus_id", "other_id", "reference_id", "rating"]
    votes = pd.DataFrame(rows, columns=columns).assign(scale="triplet", trial=range(len(rows)))
    section = compute(planted._replace(votes=votes).read(), QUICK)
    rows = [row for row in section.rows["choices_abilities"] if row["quantity"] == "ability"]
    assert {row["n"] for row in rows} == {12 * 2 * 3}
    abilities = pd.Series({row["reducer"]: row["value"] for row in rows})
    assert abilities.reindex(names[1:]).is_monotonic_decreasing


def test_a_report_of_choices_alone_opens_with_them_and_holds_its_numbers(
    plant: Plant, tmp_path: Path
) -> None:
    planted = plant(weights=(5.0, 0.0), recordings=12)
    results = analysis.write_report(planted.votes, planted.stimuli, tmp_path / "report", draws=50)
    assert results.headline.startswith("Bounded spectral match (7")
    stored = json.loads((tmp_path / "report" / "results.json").read_text(encoding="utf-8"))
    share = find_row(stored["numbers"], "share", scale="triplet", metric=BEST)
    predicted = analysis.predict_votes(planted.read()).shares.loc[BEST]
    assert [share[key] for key in ("value", "low", "high")] == pytest.approx(
        predicted[["share", "low", "high"]].tolist()
    )
    table = pd.read_csv(tmp_path / "report" / "tables" / "choices_predicted.csv")
    shares = table[table["quantity"] == "share"]
    assert shares["metric"].tolist()[-2:] == ["majority_of_others", "majority_of_all"]
    assert (tmp_path / "report" / "figures" / "choices_triplet_as_is.svg").is_file()


def test_choices_beside_ratings_change_no_association(tidy: Callable[..., pd.DataFrame]) -> None:
    ratings = tidy(scales=("realism",))
    stimuli = ratings.drop_duplicates("stimulus_id")[
        ["stimulus_id", "recording", "reducer", "level", "role", "spectral_match", "temporal_match"]
    ]
    rows = ratings[["participant", "stimulus_id", "scale", "rating"]].assign(
        trial=range(len(ratings))
    )
    tests = stimuli[stimuli["role"] == "test"]
    recording = tests["recording"].iloc[0]
    one, other = tests[tests["recording"] == recording]["stimulus_id"].iloc[:2]
    votes = rows.drop_duplicates("participant").assign(
        stimulus_id=one, other_id=other, scale="preference", rating=100, trial=99_999
    )
    both = pd.concat([rows.assign(other_id=""), votes])
    plain, mixed = (analysis.read_table(given, stimuli) for given in (rows, both))
    first, second = (
        correlate.tabulate_correlations(table, draws=50, rng=1) for table in (plain, mixed)
    )
    pd.testing.assert_frame_equal(first, second)
