"""Tidy tables in memory: rejected judgements do not count, and the stimulus has one name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association import compare_metrics, correlate
from feel321.analysis.contrasts.compare import profile_reducers, stimulus_means
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.sensitivity import vary_primary
from feel321.analysis.screening import screen_raters
from feel321.analysis.table.items import find_sources, leave_rejected, make_items, split_tests

METRICS = ["spectral_match", "temporal_match"]
TOLD = "2 judgements marked as rejected are left out."


@pytest.fixture
def rated(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return tidy(participants=3, recordings=3, anchors=False)


@pytest.fixture
def marked(rated: pd.DataFrame) -> pd.DataFrame:
    """Two rows more, without a rating and rejected."""
    lost = rated.head(2).assign(rating=[np.nan, 17.0], repeat=9, rejected=True)
    return pd.concat([lost, rated.assign(rejected=False)], ignore_index=True)


def count(rows: pd.DataFrame, metric: str) -> Any:
    return correlate(rows, metric, draws=20, rng=np.random.default_rng(0))


def test_correlations_leave_rejected_judgements_out_and_say_so(
    rated: pd.DataFrame, marked: pd.DataFrame
) -> None:
    one, other = count(rated, METRICS[0]), count(marked, METRICS[0])
    assert other.notes == (TOLD, *one.notes)
    assert (other.value, other.low, other.high) == (one.value, one.low, one.high)
    assert TOLD in compare_metrics(marked, *METRICS, draws=20, rng=np.random.default_rng(0)).notes


def test_models_leave_rejected_judgements_out_and_say_so(
    rated: pd.DataFrame, marked: pd.DataFrame
) -> None:
    one, other = fit_primary(rated, METRICS), fit_primary(marked, METRICS)
    pd.testing.assert_frame_equal(one.slopes, other.slopes)
    assert other.notes == (TOLD, *one.notes)
    assert (
        vary_primary(marked[marked["recording"] != "rec2"], METRICS)["reason"]
        .str.startswith(TOLD)
        .all()
    )


def test_screening_and_means_leave_rejected_judgements_out(
    rated: pd.DataFrame, marked: pd.DataFrame
) -> None:
    assert TOLD in screen_raters(marked).notes
    pd.testing.assert_frame_equal(screen_raters(marked).table, screen_raters(rated).table)
    pd.testing.assert_frame_equal(profile_reducers(marked), profile_reducers(rated))
    pd.testing.assert_frame_equal(stimulus_means(marked), stimulus_means(rated))


@pytest.mark.parametrize(
    "marks",
    [
        [True, False, False],
        ["TRUE", "false", ""],
        [1, 0, 0],
        [1.0, np.nan, 0.0],
        ["yes", None, "no"],
    ],
)
def test_marks_as_tables_hold_them(marks: list[object]) -> None:
    rows, notes = leave_rejected(pd.DataFrame({"rating": [1, 2, 3], "rejected": marks}))
    assert rows["rating"].tolist() == [2, 3]
    assert notes == ("1 judgement marked as rejected is left out.",)


def test_marks_refused() -> None:
    with pytest.raises(
        ValueError,
        match="ratings: column 'rejected' must be true, false, 1, 0, yes, no or empty, got",
    ):
        leave_rejected(pd.DataFrame({"rejected": ["no", "perhaps"]}))
    with pytest.raises(ValueError, match="all 2 judgements are marked as rejected"):
        leave_rejected(pd.DataFrame({"rejected": [True, True]}))


@pytest.mark.parametrize("called", ["stimulus", "item"])
def test_a_stimulus_may_be_called_otherwise(rated: pd.DataFrame, called: str) -> None:
    plain = rated.drop(columns=["reducer", "level"])
    other = plain.rename(columns={"stimulus_id": called})
    assert count(other, METRICS[0]) == count(plain, METRICS[0])
    pd.testing.assert_frame_equal(
        fit_primary(other, METRICS).slopes, fit_primary(plain, METRICS).slopes
    )
    pd.testing.assert_frame_equal(screen_raters(other).table, screen_raters(plain).table)


def test_recording_and_reducer_name_the_items_of_a_model(rated: pd.DataFrame) -> None:
    unnamed = rated.drop(columns="stimulus_id")
    assert fit_primary(unnamed, METRICS).n_items == fit_primary(rated, METRICS).n_items
    pd.testing.assert_frame_equal(
        fit_primary(unnamed, METRICS).slopes, fit_primary(rated, METRICS).slopes
    )


@pytest.mark.parametrize("column", ["stimulus_id", "recording", "participant", "level"])
def test_rows_without_a_name_are_refused_not_dropped(rated: pd.DataFrame, column: str) -> None:
    lost = rated.assign(**{column: rated[column].where(rated.index > 1)})
    message = f"ratings must name a {column} in each row, got 2 without"
    with pytest.raises(ValueError, match=message):
        make_items(lost, METRICS) if column != "level" else list(split_tests(lost))


def test_repeats_are_averaged_whatever_the_order_of_rows(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(participants=3, recordings=3, repeats=3)
    rows = table[table["role"] == "test"].iloc[5:]
    means = rows.pivot_table("rating", "participant", "stimulus_id")
    for changed in (rows, rows.sample(frac=1, random_state=1), rows.drop(columns="stimulus_id")):
        items = make_items(changed, METRICS)
        assert items.ratings.shape == means.shape
        order = [name.replace("/", "_") for name in items.names]
        np.testing.assert_allclose(items.ratings, means[order], rtol=1e-14)
        assert items.n_recordings == 3


def test_a_recording_without_a_source_is_its_own() -> None:
    table = pd.DataFrame({"recording": ["c", "a", "b", "a"], "source": [None, "x", "", "x"]})
    assert find_sources(table).to_dict() == {"a": "x", "b": "b", "c": "c"}
    assert find_sources(table[["recording"]]).to_dict() == {"a": "a", "b": "b", "c": "c"}
