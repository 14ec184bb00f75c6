from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.table.reading import Table
from feel321.analysis.tradeoff.advise.scene import Context, judge_ratings

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.tradeoff.advise.choice import SceneAdvice
    from feel321.stimuli.recording import Recording

ALIKE = {"sax321": 30.0, "pca321": 70.0, "dft321": 70.0}


def make_table(
    means: dict[str, float], *, people: int = 16, spread: float = 4.0, scales: int = 1
) -> Table:
    """Everybody rates every reducer of one recording twice."""
    rng = np.random.default_rng(5)
    rows = [
        {
            "participant": f"P{person:02d}",
            "stimulus_id": f"oak-{reducer}",
            "reference_id": "",
            "recording": "oak",
            "reducer": reducer,
            "level": "as_is",
            "role": "test",
            "scale": f"scale{scale}",
            "repeat": str(repeat),
            "rating": mean + spread * rng.standard_normal(),
            "simulated": True,
        }
        for person in range(people)
        for scale in range(scales)
        for reducer, mean in means.items()
        for repeat in (1, 2)
    ]
    return Table(pd.DataFrame(rows), (), ())


def test_equivalence_must_be_shown() -> None:
    said = judge_ratings(make_table(ALIKE, people=40), margin=3.0)["oak"]
    best = said["pca321"].best
    assert best in {"pca321", "dft321"}
    assert said[best].is_best
    assert said["pca321"].suffices
    assert said["dft321"].suffices
    assert not said["sax321"].suffices
    assert said["sax321"].p > 0.9


def test_no_difference_found_is_no_equivalence() -> None:
    # Three people who repeat themselves well: the means are alike, but so few cannot show it.
    said = judge_ratings(make_table({"pca321": 70.0, "dft321": 70.0}, people=3), margin=3.0)["oak"]
    other = next(rated for rated in said.values() if not rated.is_best)
    assert other.p > 0.05
    assert not other.suffices


def test_a_reducer_must_pass_on_every_scale() -> None:
    table = make_table(ALIKE, people=40, scales=2)
    weak = (table.rows["scale"] == "scale1") & (table.rows["reducer"] == "pca321")
    rows = table.rows.assign(rating=table.rows["rating"] - 25.0 * weak)
    said = judge_ratings(Table(rows, (), ()), margin=3.0)["oak"]
    assert said["dft321"].suffices
    assert not said["pca321"].suffices


def test_the_best_on_one_scale_must_pass_on_the_others_too() -> None:
    table = make_table(ALIKE, people=40, scales=2)
    more = np.where(table.rows["scale"] == "scale0", 15.0, -25.0)
    shift = np.where(table.rows["reducer"] == "pca321", more, 0.0)
    said = judge_ratings(
        Table(table.rows.assign(rating=table.rows["rating"] + shift), (), ()), margin=3.0
    )
    assert not any(rated.suffices for rated in said["oak"].values())


def test_without_a_margin_that_somebody_chose_nothing_is_judged() -> None:
    table = make_table(ALIKE, people=40)
    assert judge_ratings(table) == {}
    assert sum(rated.suffices for rated in judge_ratings(table, margin=0.01)["oak"].values()) == 1


def test_one_reducer_is_like_no_other() -> None:
    assert judge_ratings(make_table({"dft321": 50.0}), margin=3.0) == {}


def test_one_judge_of_one_reducer_each_leaves_nothing_to_test() -> None:
    said = judge_ratings(make_table(ALIKE, people=1), margin=3.0)["oak"]
    assert sum(rated.suffices for rated in said.values()) == 1


def test_ratings_without_any_spread_leave_no_error_to_test_with() -> None:
    said = judge_ratings(make_table(ALIKE, spread=0.0), margin=5.0)["oak"]
    assert np.isnan([rated.p for rated in said.values()]).all()
    assert [name for name, rated in said.items() if rated.suffices] == ["dft321"]


def test_ratings_overrule_metrics_that_let_pass(
    tell: Callable[..., SceneAdvice], wave: np.ndarray
) -> None:
    from feel321.stimuli.recording import Recording

    line = Recording(np.array([wave, wave, 0 * wave]), 4000.0, "oak")
    assert tell(line).answer == "pca321"
    said = judge_ratings(make_table({"pca321": 40.0, "dft321": 80.0}), margin=3.0)["oak"]
    heard = tell(line, Context(), ratings=said)
    assert (heard.answer, heard.runner_up) == ("dft321", None)
    assert "pca321, is not shown to feel like dft321" in heard.line
    assert "simulated participants agree" in heard.line


def test_nothing_suffices_where_people_and_metrics_disagree(
    tell: Callable[..., SceneAdvice], wave: np.ndarray
) -> None:
    from feel321.stimuli.recording import Recording

    line: Recording = Recording(np.array([wave, wave, 0 * wave]), 4000.0, "oak")
    said = judge_ratings(make_table({"sax321": 80.0, "mag321": 40.0}), margin=3.0)["oak"]
    advice = tell(line, Context(), ratings=said)
    assert advice.answer is None
    assert advice.closest == "sax321"
    assert advice.margin < 0
    assert "nothing suffices" in advice.line
    assert (
        "the ratings show for no reducer within the tolerances of the metrics that it feels like the best"
        in advice.line
    )


def test_what_was_rated_is_closer_than_what_was_not(
    tell: Callable[..., SceneAdvice], wave: np.ndarray
) -> None:
    from feel321.stimuli.recording import Recording

    line: Recording = Recording(np.array([wave, wave, 0 * wave]), 4000.0, "oak")
    said = judge_ratings(make_table({"sax321": 80.0, "pca321": 40.0}), margin=3.0)["oak"]
    del said["sax321"]
    advice = tell(line, Context(), ratings=said)
    assert (advice.answer, advice.closest) == (None, "pca321")
    assert "it is not shown to feel like sax321" in advice.line


@pytest.mark.parametrize("role", ["reference", "anchor"])
def test_references_and_anchors_are_no_candidates(role: str) -> None:
    table = make_table({**ALIKE, "original": 95.0})
    roles = np.where(table.rows["reducer"] == "original", role, "test")
    assert (
        "original"
        not in judge_ratings(Table(table.rows.assign(role=roles), (), ()), margin=3.0)["oak"]
    )
