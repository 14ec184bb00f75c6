"""What the report says of flagged raters, and of the sets of raters that screening rules leave."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest

from feel321.analysis.report import raters
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
