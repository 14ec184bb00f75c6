"""Ratings over the bit rate: a planted curve is recovered, and what has no bit rate stands beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report import rate
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from feel321.analysis.table.items import Table

RATES = {f"codec{number}": 0.5 * 2.0**number for number in range(5)}
SLOPE = 8.0
"""Points per doubling of the bit rate."""


def make_table(rates: dict[str, float], *, recordings: int = 6, participants: int = 8) -> Table:
    rng = np.random.default_rng(3)
    names = [(f"r{number}", name) for number in range(recordings) for name in (*rates, "plain")]
    manifest = pd.DataFrame({
        "stimulus_id": [f"{recording}-{name}" for recording, name in names],
        "recording": [recording for recording, _ in names],
        "reducer": [name for _, name in names],
        "bit_rate_kbps": [rates.get(name, np.nan) for _, name in names],
        "temporal_match": rng.uniform(0.2, 0.9, len(names)),
    })
    quality = {name: 50 + SLOPE * np.log2(max(value, 0.1)) for name, value in rates.items()} | {
        "plain": 80.0
    }
    rows = [
        (f"p{who}", f"{recording}-{name}", "realism", quality[name] + rng.normal(0, 4))
        for who in range(participants)
        for recording, name in names
    ]
    ratings = pd.DataFrame(rows, columns=["participant", "stimulus_id", "scale", "rating"])
    return read_table(ratings, manifest, metrics=["temporal_match"])


def test_a_planted_curve_is_recovered_and_opens_the_report() -> None:
    section = rate.compute(make_table(RATES), Choices(draws=2))
    rows = section.tables["rates"].set_index("reducer")
    assert list(rows.index) == [*RATES, "plain"]
    assert rows.loc["codec0", "mean"] == pytest.approx(42.0, abs=2.5)
    assert ((rows["low"] < rows["mean"]) & (rows["mean"] < rows["high"])).all()
    reach = rows.loc["codec4", "mapped"] - rows.loc["codec0", "mapped"]
    assert reach == pytest.approx(4 * SLOPE, abs=3)
    assert np.isnan(rows.loc["plain", "mapped"])
    (mapping,) = section.tables["rate_mapping"].to_dict("records")
    assert (mapping["order"], mapping["n_items"]) == (3, 30)
    assert mapping["plcc_low"] > 0.9
    (line,) = section.verdict
    assert str(line).startswith("Realism, bit rate: mean rating ")
    assert all(part in line.text for part in ("at 0.5 kbit/s", "at 8 kbit/s", "without (plain)"))
    assert section.pictures[0].figure.axes[0].get_xlabel() == "Bit rate (kbit/s)"


def test_few_items_are_mapped_by_a_line() -> None:
    section = rate.compute(make_table(RATES, recordings=3), Choices(draws=2))
    assert section.tables["rate_mapping"]["order"].tolist() == [1]


def test_two_rates_make_no_curve_and_none_no_section() -> None:
    section = rate.compute(make_table({"a": 1.0, "b": 8.0}), Choices(draws=2))
    assert section.notes == (
        "realism, as_is, bit rates: left out. there must be 3 bit rates or more, got 2",
    )
    assert section.tables == {}
    nothing = rate.compute(make_table({}), Choices(draws=2))
    assert (nothing.notes, nothing.tables) == ((), {})


def test_a_bit_rate_must_be_above_zero() -> None:
    with pytest.raises(ValueError, match="bit_rate_kbps must be above 0, in kbit/s, or empty"):
        make_table({"a": 0.0, "b": 1.0})
