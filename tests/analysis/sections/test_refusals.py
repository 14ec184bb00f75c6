"""What a section does not do, and says so."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from feel321.analysis.report import pairs, parts, robustness
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table
from feel321.analysis.table.schema import ANSWERED

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

METRICS = ("spectral_match", "temporal_match")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"draws": 1}, "draws must be 2 or more, got 1"),
        ({"margin": 0.0}, "margin must be above 0.*got 0.0"),
        ({"margin": float("nan")}, "margin must be above 0.*got nan"),
        ({"margin": float("inf")}, "margin must be above 0.*got inf"),
    ],
)
def test_choices_that_cannot_be_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Choices(**changes)


def test_a_study_too_large_to_be_varied_is_told_with_its_size(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robustness, "MOST_CELLS", 6 * 4 * 9 - 1)
    section = robustness.compute_robustness(Table(tidy(), METRICS, ()), Choices(draws=2))
    (note,) = section.notes
    assert note.endswith(
        "They are left out for 216 participant x stimulus cells; up to 215 are varied."
    )
    assert (section.grids, section.pictures) == ((), ())


def test_ratings_too_many_for_one_fit_are_not_varied(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts, "MOST_DENSE", 3)
    (note,) = robustness.compute_robustness(Table(tidy(), METRICS, ()), Choices(draws=2)).notes
    assert note.endswith("They are left out, for these ratings are too many for one fit.")


def test_answers_that_are_neither_right_nor_wrong_are_not_evaluated(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    rows = tidy().assign(scale=ANSWERED)
    rows["rating"] = rows["rating"].gt(50) * 100.0
    rows.loc[rows.index[:3], "rating"] = 55.0
    section = pairs.compute_discrimination(Table(rows, METRICS, ()), Choices(draws=2))
    assert section.notes == (
        f"Scale '{ANSWERED}' is not evaluated: 3 answers are neither 100 (right) nor 0 (wrong).",
    )
    assert section.numbers == ()
