"""Cells that a spreadsheet would run: written so that it does not, read as they were."""

import csv
import io

import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from feel321.analysis.table.schema import restore_cells
from feel321.files import defuse, list_csv

CELLS = st.text(alphabet="'=+-@\t\r\n,\"a1.5e", max_size=8)


@given(CELLS)
def test_a_cell_comes_back_and_no_text_begins_as_a_formula(cell: str) -> None:
    lines = list_csv(["x", "y"], [{"x": cell, "y": "1"}])
    (row,) = csv.DictReader(io.StringIO("".join(lines), newline=""))
    assert restore_cells(pd.DataFrame([row], dtype=str))["x"].to_list() == [cell]
    if row["x"][:1] in {*"=+-@\t\r"}:
        float(row["x"])  # a number, which stays as it is


def test_numbers_stay_as_they_are() -> None:
    for number in (-3.5, "-3.5", "+1e3", -1, None, True):
        assert defuse(number) is number
