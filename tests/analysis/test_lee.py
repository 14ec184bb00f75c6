"""Lee et al. 2022: the paper's claims answered from dissimilarities with planted effects."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.replication import Paper, PaperClaim, answer_claims
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from feel321.analysis.replication import PaperAnswer
    from feel321.analysis.table.items import Table

KEPT = {"saz321": 0.15, "mag321": 0.3, "soc321": 0.5, "pca321": 0.62, "dft321": 0.85, "original": 1.0}  # fmt: skip
"""Planted: dissimilarity is 60 points times the difference in this."""

LOST = {"saz321": 0.4, "mag321": 0.9, "soc321": 0.2, "pca321": 0.7, "dft321": 0.3, "original": 1.0}
"""In no relation to what was felt."""


def plant(*, far: float = 60.0, people: int = 8, seed: int = 0) -> Table:
    rng = np.random.default_rng(seed)
    rows, stimuli = [], []
    for recording in ("tap", "drag", "slide"):
        for name, kept in KEPT.items():
            role = "reference" if name == "original" else "test"
            stimuli.append((f"{recording}-{name}", recording, name, role, kept, LOST[name]))
        for one, two in combinations_with_replacement(KEPT, 2):
            if one != two or one == "original":
                felt = 5 + far * abs(KEPT[one] - KEPT[two]) + rng.normal(0, 4, people)
                ids = (f"{recording}-{one}", f"{recording}-{two}")
                rows += [(f"p{who}", *ids, rating) for who, rating in enumerate(felt.clip(0, 100))]
    ratings = pd.DataFrame(rows, columns=["participant", "stimulus_id", "reference_id", "rating"])
    ratings = ratings.assign(scale="dissimilarity", trial=range(1, len(rows) + 1))
    columns = ["stimulus_id", "recording", "reducer", "role", "spectral_match_bounded", "temporal_match"]  # fmt: skip
    return read_table(ratings, pd.DataFrame(stimuli, columns=columns).assign(level="as_is"))


def ask(table: Table, measure: str, **options: str) -> PaperAnswer:
    options = {"scale": "dissimilarity", **options}
    claim = PaperClaim("one", "a claim", "abstract", measure, options=options)
    (answer,) = answer_claims(table, Paper("a", "10.1", "abstract", (claim,)), Choices(draws=720))
    return answer


def test_the_least_clear_reducer_answers_whether_all_are_told_apart() -> None:
    answer = ask(plant(), "one_axis_against_three")
    assert answer.verdict == "agrees"
    assert answer.found is not None
    assert answer.found.low < 60 * (1 - KEPT["dft321"]) < answer.found.high
    assert "This is dft321, the least clear of 5 reducers" in answer.sentence
    alone = ask(plant(), "one_axis_against_three", reducer="saz321")
    assert alone.found is not None
    assert alone.found.low < 60 * (1 - KEPT["saz321"]) < alone.found.high


def test_nobody_who_feels_no_difference_agrees() -> None:
    assert ask(plant(far=0.0), "one_axis_against_three").verdict != "agrees"


def test_an_attribute_of_the_axes_is_told_from_one_that_is_not_and_from_too_few() -> None:
    table = plant()
    names = ("spectral_match_bounded", "temporal_match", "directions")
    found = {name: ask(table, "map_attribute", attribute=name) for name in names}
    assert {name: one.verdict for name, one in found.items()} == {
        "spectral_match_bounded": "agrees",
        "temporal_match": "open",
        "directions": "not_estimable",
    }
    assert "permutations of 6 stimuli give no p below 0.17" in found["directions"].sentence
    assert "attribute must be one of" in ask(table, "map_attribute", attribute="colour").sentence
