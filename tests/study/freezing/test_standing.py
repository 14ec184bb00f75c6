"""What an analysis is worth: its first sentence and its marks, in every case."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.report.section import Section
from feel321.analysis.report.standing import Hypothesis, Standing, mark_number, mark_section
from feel321.analysis.words import CONFIRMATORY, EXPLORATORY, Claim, make_number
from feel321.study.analyze import analyze_study
from feel321.study.freezing.freeze import freeze_study
from feel321.study.freezing.record import read_frozen, write_frozen
from feel321.study.freezing.standing import make_standing
from feel321.study.settings.read import read_settings
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.folder import StudyFolder

EARLY, LATE = (datetime(year, 1, 1, tzinfo=UTC) for year in (2025, 2027))
PLACE = ("realism", "as_is", "temporal_match")


def stand(study: StudyFolder, **asked: object) -> Standing:
    return make_standing(study, read_settings(study.settings), **asked)


def freeze(study: StudyFolder, when: datetime = EARLY, **options: object) -> None:
    freeze_study(study, now=lambda: when, **options)


def change(study: StudyFolder, text: str) -> None:
    with study.settings.open("a", encoding="utf-8") as file:
        file.write(text)


def test_without_a_freeze(smallest: StudyFolder, rate: Callable[..., None]) -> None:
    rate(smallest)
    found = stand(smallest)
    assert found.sentence.startswith(
        "No hypotheses were frozen before the data, so all results are exploratory"
    )
    assert found.judge(*PLACE) == (EXPLORATORY, "no hypotheses were frozen before the data")


def test_frozen_before(smallest: StudyFolder, rate: Callable[..., None]) -> None:
    freeze(smallest, participants=24)
    rate(smallest)
    found = stand(smallest)
    assert found.state == "before"
    assert (
        "frozen on 2025-01-01, before any person rated: the 2 declared slopes are confirmatory"
        in found.sentence
    )
    assert found.sentence.endswith("24 participants were planned, 1 have rated.")
    assert found.judge(*PLACE) == (CONFIRMATORY, "")
    for other in (
        ("similarity", *PLACE[1:]),
        ("realism", "equal_intensity", PLACE[2]),
        (*PLACE[:2], "spectral_match"),
    ):
        assert found.judge(*other) == (EXPLORATORY, "not among the frozen hypotheses")


def test_frozen_after(smallest: StudyFolder, rate: Callable[..., None]) -> None:
    rate(smallest)
    freeze(smallest, LATE, after_data=True)
    found = stand(smallest)
    assert (
        "frozen on 2027-01-01, after 2 judgements of 1 person, so all results are exploratory"
        in found.sentence
    )
    assert found.judge(*PLACE)[0] == EXPLORATORY


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[analysis]\nmetrics = ['temporal_match']\n", "spectral_match_bounded, temporal_match, now "),
        ("[analysis]\nmetrics = ['spectral_match_bounded', 'temporal_match', 'spectral_match']\n", "analysis.metrics"),
        ("[analysis]\nscreening = ['slow.py:slow']\n", "analysis.screening: was none, now slow"),
        ("[session.quality]\nmin_response_s = 1.0\n", "session.quality.min_response_s: was 0.2, now 1.0"),
    ],
    ids=["changed metric", "added metric", "screening", "data rule"],
)  # fmt: skip
def test_a_changed_choice_is_named_and_nothing_is_confirmatory(
    smallest: StudyFolder, text: str, named: str
) -> None:
    (smallest.path / "slow.py").write_text("def slow(ratings):\n    return {}\n", encoding="utf-8")
    freeze(smallest)
    change(smallest, text)
    found = stand(smallest)
    assert found.sentence.startswith(
        "All results are exploratory, because choices that were frozen on 2025-01-01"
    )
    assert named in found.sentence
    assert found.judge(*PLACE) == (EXPLORATORY, "choices were changed after they were frozen")


def test_a_metric_that_was_asked_for_on_the_command_line_counts(smallest: StudyFolder) -> None:
    freeze(smallest)
    assert "analysis.metrics" in stand(smallest, metrics=["temporal_match"]).sentence
    assert stand(smallest, metrics=["spectral_match_bounded", "temporal_match"]).reason == ""


def test_what_the_test_does_not_depend_on_is_named_and_leaves_it(smallest: StudyFolder) -> None:
    freeze(smallest)
    found = stand(smallest, draws=500)
    assert found.judge(*PLACE)[0] == CONFIRMATORY
    assert (
        "do not depend on what else has changed: analysis.draws: was 2000, now 500."
        in found.sentence
    )


def test_another_stimulus_set(smallest: StudyFolder) -> None:
    freeze(smallest)
    text = smallest.manifest.read_text(encoding="utf-8")
    smallest.manifest.write_text(text.replace("0.1,", "0.1000,", 1), encoding="utf-8")
    found = stand(smallest)
    assert "stimuli.set: was " in found.sentence
    assert found.judge(*PLACE)[0] == EXPLORATORY


def test_another_version_is_named_with_what_differs(smallest: StudyFolder) -> None:
    freeze(smallest)
    frozen = read_frozen(smallest)
    write_frozen(smallest, replace(frozen, versions={**frozen.versions, "feel321": "0.0.1"}))
    found = stand(smallest)
    assert "Other software than when it was frozen: feel321: was 0.0.1, now " in found.sentence
    assert found.judge(*PLACE)[0] == CONFIRMATORY


def test_an_edited_file_makes_nothing_confirmatory(smallest: StudyFolder) -> None:
    freeze(smallest)
    path = smallest.path / "frozen.json"
    path.write_text(path.read_text(encoding="utf-8").replace("2000", "2001"), encoding="utf-8")
    found = stand(smallest)
    assert found.state == "unsound"
    assert "cannot be trusted: it was changed after it was written" in found.sentence
    assert found.judge(*PLACE)[0] == EXPLORATORY


def test_claims_numbers_and_rows_are_marked_alike() -> None:
    standing = Standing("", "before", (Hypothesis(*PLACE),), reason="")
    other = (*PLACE[:2], "spectral_match")
    claims = [Claim(*place, "open", "", "") for place in (PLACE, other)]
    rows = pd.DataFrame({
        "attribute": ["realism, as_is"] * 2,
        "metric": [PLACE[2], other[2]],
        "p": [0.1, 0.2],
    })
    section = Section("primary", "", claims=claims, tables={"slopes": rows, "spreads": rows})
    marked = mark_section(section, standing)
    assert [one.status for one in marked.claims] == [CONFIRMATORY, EXPLORATORY]
    assert marked.tables["slopes"]["status"].tolist() == [CONFIRMATORY, EXPLORATORY]
    assert marked.tables["spreads"]["status"].tolist() == [EXPLORATORY] * 2
    names = {
        f"slope.realism.as_is.{PLACE[2]}.{end}": end in {"p_holm", "df"}
        for end in ("p_holm", "df", "centred", "p")
    }
    for name, declared in names.items():
        number = mark_number(make_number(name, 1.0, "", n=1, keys="scale level metric"), standing)
        assert (number.status == CONFIRMATORY) is declared, name


def test_the_report_of_a_frozen_study(
    smallest: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    from feel321.analysis.report import primary, reducers

    monkeypatch.setattr(
        "feel321.analysis.report.write.SECTIONS", (primary.compute, reducers.compute_profile)
    )
    monkeypatch.setattr("feel321.analysis.report.folder.save_figure", _save_nothing)
    freeze(smallest)
    simulate_study(smallest, participants=3, seed=1, now=lambda: LATE)
    found = analyze_study(smallest, draws=100)
    page = (smallest.report / "index.html").read_text(encoding="utf-8")
    assert f'<p class="standing">{found.standing.sentence}</p>' in page
    assert '<p class="status">Exploratory.</p>' in page
    content = json.loads((smallest.report / "results.json").read_text(encoding="utf-8"))
    assert content["standing"]["state"] == "before"
    assert {one["status"] for one in content["verdicts"]} == {CONFIRMATORY}
    tables = {one.stem: pd.read_csv(one) for one in (smallest.report / "tables").glob("*.csv")}
    assert set(tables.pop("slopes")["status"]) == {CONFIRMATORY}
    assert tables.pop("dictionary")["meaning"].notna().all()
    assert {word for rows in tables.values() for word in rows["status"]} == {EXPLORATORY}
    elsewhere = analyze_study(smallest, ratings=smallest.ratings, draws=100)
    assert elsewhere.standing.state == "elsewhere"


def _save_nothing(_figure: object, stem: object) -> None:
    from pathlib import Path

    for suffix, text in ((".svg", '<svg xmlns="http://www.w3.org/2000/svg"></svg>'), (".png", "")):
        Path(f"{stem}{suffix}").write_text(text, encoding="utf-8")
