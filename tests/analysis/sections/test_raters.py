"""What the report says of flagged raters, and of the sets of raters that screening rules leave."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest

from feel321.analysis.primary.multiverse import run_multiverse
from feel321.analysis.report import raters, robustness
from feel321.analysis.report.parts import split_parts
from feel321.analysis.resampling import Choices
from feel321.analysis.screening.screen import screen_raters
from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.table.reading import Table


@pytest.fixture
def read(files: Callable[..., Any]) -> Callable[[str], Table]:
    """Read ratings of which two of six participants do not know the hidden reference again."""

    def read(protocol: str) -> Table:
        study = files(participants=6, recordings=3, scales=("comfort",))
        rows = pd.read_csv(study.ratings).assign(protocol=protocol)
        known = ~rows["participant"].isin(["p01", "p02"])
        rows.loc[rows["reducer"] == "original", "rating"] = known.map({True: 97.0, False: 60.0})
        rows.to_csv(study.ratings, index=False)
        return read_table(study.ratings, study.manifest)

    return read


def test_the_protocol_reaches_the_screening(read: Callable[[str], Table]) -> None:
    found = {
        name: screen_raters(read(name).rows, rules=["hidden_reference"])
        for name in ("mushra", "realism")
    }
    assert found["mushra"].hits["hidden_reference"] == ("p01", "p02")
    assert found["realism"].hits["hidden_reference"] == ()
    said = {name: raters._describe_flagged(screening) for name, screening in found.items()}
    flagged = "2 of 6 raters were flagged by screening rules (all by ITU-R BS.1534-3 rules). Nobody was removed."
    assert said["mushra"] == flagged
    none = "None of 6 raters were flagged by screening rules (the ITU-R BS.1534-3 rules do not apply to these ratings)."
    assert said["realism"] == f"{none} Nobody was removed."


def test_sets_of_raters_are_counted_and_not_combinations(read: Callable[[str], Table]) -> None:
    table = read("mushra")
    part = next(split_parts(table))
    rules = ["hidden_reference", "too_fast", "mid_anchor"]

    def say(fewest: int, rules: list[str] = rules) -> str:
        def estimate(rows: pd.DataFrame) -> tuple[float, float, float]:
            if rows["participant"].nunique() < fewest:
                raise ValueError("too few")
            return float(rows["participant"].nunique()), 1.0, 9.0

        found = run_multiverse(table.rows, estimate, rules=rules)
        return robustness._describe_universes("spectral_match", part, found)

    lead = "Slope of comfort ratings on spectral match: "
    sets = "2 distinct sets of raters from 8 combinations of screening rules"
    assert say(1) == f"{lead}4.00 to 6.00 points per +0.1 across {sets}."
    assert say(5).endswith(f"across 1 of {sets}; the others leave too few raters to fit the model.")
    alone = "the 2 combinations of screening rules leave 1 distinct set of raters, everyone"
    assert say(1, ["too_fast"]) == f"{lead}6.00 points per +0.1; {alone}."
    assert say(9) == f"{lead}no set of raters is large enough to fit the model."


def test_a_metric_without_a_slope_is_not_blamed_on_the_raters(read: Callable[[str], Table]) -> None:
    table = read("mushra")
    table.rows["temporal_match"] = 0.5
    part = next(split_parts(table))
    found = robustness._run_universes(table, part, Choices(draws=2))[part.lead, "temporal_match"]
    said = robustness._describe_universes("temporal_match", *found)
    lead = "Slope of comfort ratings on temporal match: "
    assert said == f"{lead}the metric does not differ within recordings."
