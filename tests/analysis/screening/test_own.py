"""A lab's own screening rules are applied beside feel321's, and what is wrong with them is one line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report.write import write_report
from feel321.analysis.screening.screen import screen_raters

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SLOW = """
def slow(ratings):
    return (ratings["response_time_s"] > 20).groupby(ratings["participant"], observed=True).mean()

slow.limit, slow.says = 0.25, "more than {limit:.0%} of answers after 20 s"
"""


@pytest.fixture
def ratings() -> pd.DataFrame:
    """Three raters; the second takes long for 30 % of 20 answers, the third for 25 % of them."""
    rng = np.random.default_rng(3)
    who = np.repeat(["ann", "bob", "cyd"], 20)
    seconds = np.where(np.tile(np.arange(20), 3) < np.repeat([0, 6, 5], 20), 25.0, 4.0)
    return pd.DataFrame({
        "participant": who, "stimulus_id": np.tile([f"s{n}" for n in range(20)], 3), "recording": "r",
        "reducer": np.tile([f"m{n}" for n in range(20)], 3), "role": "test", "scale": "realism", "level": "as_is",
        "rating": rng.uniform(20, 80, 60).round(1), "response_time_s": seconds,
    })  # fmt: skip


def test_a_rule_in_a_file_flags_whom_it_should_and_changes_no_other(
    ratings: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(SLOW)
    monkeypatch.chdir(tmp_path)
    found, plain = screen_raters(ratings, own=["mine.py:slow"]), screen_raters(ratings)
    assert found.hits["slow"] == ("bob",)
    mine = found.table[found.table["rule"] == "slow"].set_index("participant")
    np.testing.assert_allclose(mine["share"], [0.0, 0.3, 0.25])
    pd.testing.assert_frame_equal(found.table[found.table["rule"] != "slow"], plain.table)
    assert found.hits["slow"] == ("bob",)


def test_a_rule_changes_the_report_by_its_own_rows_and_is_recorded(
    files: Callable[..., Any], tmp_path: Path
) -> None:
    def all_but_one(rows: pd.DataFrame) -> dict[object, float]:
        return {one: float(n == 0) for n, one in enumerate(rows["participant"].unique())}

    vars(all_but_one).update(limit=0.5)
    study = files(scales=("realism",))
    results = write_report(
        study.ratings, study.manifest, tmp_path / "out", draws=20, rules=[all_but_one]
    )
    assert results.inputs["rule_all_but_one_sha256"]
    hits = pd.read_csv(tmp_path / "out" / "tables" / "screening.csv")
    flags = hits[(hits["rule"] == "all_but_one") & (hits["quantity"] == "flagged")]
    assert (flags["note"] == "yes").sum() == 1
    assert "all but one" in (tmp_path / "out" / "details.html").read_text(encoding="utf-8")


def use(**changed: object) -> Callable[[pd.DataFrame], object]:
    def mine(_ratings: pd.DataFrame) -> object:
        return changed["told"]

    vars(mine).update({"limit": 0.5, "says": "mine"} | changed)
    return mine


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (use(told={"dan": 0.1}), "must return a number per participant of the ratings, got one for 'dan'"),
        (use(told=None), "must return a number per participant, got None; does it return anything?"),
        (use(told={}, says="{limit.foo}"), "says must be words, with {limit} for the limit"),
        (use(told="much"), "must return a number per participant, got 'much'"),
        (use(told={"ann": float("inf")}), "must return one finite number per participant"),
        (use(told={}, limit="a"), "limit must be a number, got 'a'; write mine.limit = 0.15"),
        (use(told={}, says="{more}"), "says must be words, with {limit} for the limit, got '{more}'"),
        ("nowhere.py:mine", "there is no file nowhere.py"),
    ],
)  # fmt: skip
def test_a_rule_that_is_wrong_is_one_line(
    ratings: pd.DataFrame, rule: object, message: str
) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        screen_raters(ratings, own=[rule])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
