"""Whatever is missing, the report says so in a line and shows what is left."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from itertools import count
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.report.write import write_report
from feel321.protocols.tasks import PROTOCOLS
from feel321.study.folder import StudyFolder
from feel321.study.simulation import simulate_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.analysis.report.write import Results

STUDY = """
[study]
seed = 6
[[recordings]]
scene = "bumps"
duration_s = 0.5
sample = "the board"
[[recordings]]
scene = "hard_taps"
duration_s = 0.5
sample = "the plastic"
[stimuli]
reducers = ["saz321", "mag321", "pca321", "dft321"]
[session]
protocols = ["realism", "similarity", "dissimilarity", "mushra", "abx", "triplet", "preference"]
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """Three simulated participants did every task."""
    folder: Path = tmp_path_factory.mktemp("lab")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    study, ticks = StudyFolder(folder), count()
    build_study(study)
    now = lambda: datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=next(ticks))  # noqa: E731 - one line, one use
    simulate_study(study, participants=3, seed=None, now=now)
    return study


def report_on(rows: pd.DataFrame, manifest: Path, folder: Path) -> Results:
    rows.to_csv(folder / "some.csv", index=False)
    results = write_report(folder / "some.csv", manifest, folder / "report", draws=20, rng=0)
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).replace("nanometre", "")
    return results


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_protocol_alone_is_a_report(lab: StudyFolder, tmp_path: Path, protocol: str) -> None:
    rows = pd.read_csv(lab.ratings).query("protocol == @protocol")
    results = report_on(rows, lab.manifest, tmp_path)
    assert results.headline
    chosen = dict.fromkeys(("triplet", "preference"), "choices")
    shown = ({"dissimilarity": "space", "abx": "discrimination"} | chosen).get(protocol, "slope")
    assert any(shown in name for name in [*results.figures, *results.numbers["table"]])
    told = " ".join(results.answers.get("metrics", ()))
    assert ("do not show whether the metrics predict" in told) == (protocol == "abx")


CASES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "one participant": lambda rows: rows[rows["participant"] == rows["participant"].iloc[0]],
    "one recording": lambda rows: rows[rows["recording"] == rows["recording"].iloc[0]],
    "one of each": lambda rows: rows[
        (rows["participant"] == rows["participant"].iloc[0])
        & (rows["recording"] == rows["recording"].iloc[0])
    ],
    "one reducer": lambda rows: rows[rows["reducer"] == "mag321"],
    "one judgement": lambda rows: rows[
        (rows["scale"] == "realism") & (rows["reducer"] == "mag321")
    ].head(1),
    "constant": lambda rows: rows.assign(rating=50.0),
    "constant per rater": lambda rows: rows.assign(
        rating=10.0 * rows["participant"].astype("category").cat.codes
    ),
    "gaps": lambda rows: rows.drop(rows.index[::3]),
}


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("case", CASES)
def test_what_is_missing_is_said(lab: StudyFolder, tmp_path: Path, case: str) -> None:
    rows = pd.read_csv(lab.ratings)
    rated = rows[rows["protocol"].isin(["realism", "dissimilarity"])]
    results = report_on(CASES[case](rated), lab.manifest, tmp_path)
    assert results.headline
    assert results.notes
    assert all(note.strip() == note and "\n" not in note for note in results.notes)
