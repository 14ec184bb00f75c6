"""The paper's questions open a report: a planted surprise is named first, and the paper's numbers stand beside ours."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.report import write
from feel321.analysis.report.answer import tabulate_metrics
from feel321.analysis.report.section import find_row
from feel321.analysis.table.reading import read_table
from feel321.results import Paper, PaperClaim, Results

METRICS = {
    "sax321": (0.3, 0.4), "say321": (0.5, 0.45), "saz321": (0.2, 0.35), "soc321": (0.7, 0.55), "mag321": (0.1, 0.05),
    "pca321": (0.6, 0.6), "dft321": (1.0, 0.5),
}  # fmt: skip
SURPRISE = 45.0
SLOPE = PaperClaim(
    "spectrum", "The spectrum is felt", "ours", "slope", exceptions=("mag321",),
    options={"metric": "spectral_match_bounded"},
)  # fmt: skip
HIGHEST = PaperClaim(
    "table", "DFT321 has the highest spectral match", "full text", "metric_of_reducer", "highest",
    options={"metric": "spectral_match", "reducer": "dft321"},
)  # fmt: skip
MISSING = PaperClaim(
    "missing", "Nobody rated it", "abstract", "rating_of_reducer", "highest", options={"reducer": "dft999"}
)  # fmt: skip
PUBLISHED = pd.DataFrame([
    {"recording": "s0", "shown": "Figure 3", "table": "Table 1", "source": "full text", "metric": "spectral_match",
     "reducer": "dft321", "paper": 0.97},
])  # fmt: skip
PAPER = Paper("Someone 2010", "10.1/x", "full text", (SLOPE, HIGHEST, MISSING), PUBLISHED)


def make_tables(surprise: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rate stimuli by their metrics (4 points per +0.1 of the spectral, 2 of the temporal match), mag321 above them."""
    rng, stimuli, ratings = np.random.default_rng(5), [], []
    for scene in range(5):
        for reducer, (spectral, temporal) in METRICS.items():
            moved = rng.uniform(-0.05, 0.05, 2)
            both = {
                "spectral_match": min(spectral + moved[0], 1.0),
                "temporal_match": temporal + moved[1],
            }
            bounded = {"spectral_match_bounded": both["spectral_match"]}
            names = {"recording": f"s{scene}", "reducer": reducer, "level": "as_is", "role": "test"}
            stimuli.append({"stimulus_id": f"s{scene}-{reducer}", **names, **both, **bounded})
    for person in range(8):
        for one in stimuli:
            felt = 20 + 40 * one["spectral_match"] + 20 * one["temporal_match"]
            felt += surprise * (one["reducer"] == "mag321") + rng.normal(0, 4)
            who = {
                "participant": f"p{person}",
                "stimulus_id": one["stimulus_id"],
                "scale": "realism",
            }
            ratings.append(who | {"trial": len(ratings), "rating": float(np.clip(felt, 0, 100))})
    return pd.DataFrame(ratings), pd.DataFrame(stimuli)


def report(folder: Path, surprise: float, paper: Paper | None) -> Results:
    return analysis.write_report(*make_tables(surprise), folder, draws=20, paper=paper)


@pytest.fixture(scope="module")
def surprised(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Results]:
    """Write a report of the first two sections only, which is quicker."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write, "SECTIONS", [one for one in write.SECTIONS if one.key == "primary"])
        yield report(tmp_path_factory.mktemp("r") / "report", SURPRISE, PAPER)


def test_the_first_sentence_names_a_planted_surprise(surprised: Results) -> None:
    counts, first, *_ = surprised.answers["paper"]
    assert counts.startswith("Of 3 questions about the paper (Someone 2010; full text; 1 of them")
    assert first.startswith("The reducer mag321 was rated ")
    points = float(first.split("was rated ")[1].split(" points higher")[0])
    assert points == pytest.approx(SURPRISE, abs=5)
    assert "names it as an exception too" in first
    page = (surprised.path / "index.html").read_text(encoding="utf-8")
    assert page.index('<h2 id="paper">') < page.index('<h2 id="predict">')


def test_claims_are_answered_with_the_planted_slope_with_and_without_the_exception(
    surprised: Results,
) -> None:
    rows = pd.read_csv(surprised.path / "tables" / "paper_claims.csv").to_dict("records")
    verdicts = {row["claim"]: row["note"] for row in rows if row["quantity"] == "verdict"}
    assert verdicts == {"spectrum": "agrees", "table": "agrees", "missing": "not estimable"}
    assert find_row(rows, "without", claim="spectrum")["value"] == pytest.approx(4.0, abs=0.5)
    assert find_row(rows, "here", claim="missing") is None
    assert any("dft999" in line for line in surprised.answers["paper"])


def test_the_papers_numbers_stand_beside_those_of_the_study(surprised: Results) -> None:
    found = pd.read_csv(surprised.path / "tables" / "paper_metrics.csv")
    assert (found["quantity"] == "match").sum() == 5 * 7 * 2
    ours = make_tables(SURPRISE)[1].set_index("stimulus_id")["spectral_match"]
    keys = {"recording": "s0", "reducer": "dft321", "metric": "spectral_match"}
    here = find_row(found.to_dict("records"), "match", **keys)
    assert here["value"] == pytest.approx(ours["s0-dft321"])
    (paper,) = found[found["quantity"] == "paper"].to_dict("records")
    assert (paper["value"], paper["note"]) == (0.97, "Figure 3 (Table 1, full text)")


def test_mountings_are_joined_by_recording_reducer_and_metric() -> None:
    keys = {"recording": "s1", "reducer": "sax321", "metric": "temporal_match"}
    turned = pd.DataFrame([keys | {"mounting_mean": 0.5, "q05": 0.4, "q50": 0.5, "q95": 0.6}])
    paper = Paper("Someone 2010", "10.1/x", "full text", (), PUBLISHED, turned)
    found = tabulate_metrics(read_table(*make_tables(0.0)), paper).set_index(list(keys))
    assert found["q95"].notna().sum() == 1
    assert found.loc[tuple(keys.values()), "q95"] == 0.6
