from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.report import raters
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.table.reading import Table


@pytest.fixture
def table(files: Callable[..., object]) -> Table:
    """Only one of three raters knows the hidden reference again: without the others, one is left."""
    study = files(participants=3, recordings=3, repeats=1, scales=("realism",))
    rows = pd.read_csv(study.ratings)
    rows.loc[(rows["participant"] == "p00") & (rows["reducer"] == "original"), "rating"] = 97.0
    rows["protocol"] = "mushra"
    rows.to_csv(study.ratings, index=False)
    return read_table(study.ratings, study.manifest)


def test_one_rater_left_of_several_gives_no_slope(table: Table) -> None:
    slopes = raters.compute(table, Choices(draws=10)).tables["slopes_without_hits"]
    alone = slopes[slopes["panel"] == "standard"]
    assert alone["n_people"].tolist() == [1, 1]
    assert alone["tenth"].isna().all()
    assert alone["reason"].str.startswith("One rater of 3 is left").all()
    assert slopes.loc[slopes["panel"] == "everyone", "tenth"].notna().all()
