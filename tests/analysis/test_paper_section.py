"""The paper's questions open a report: a planted surprise is named first, and the paper's numbers stand beside ours."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.report import primary, write
from feel321.analysis.report.paper import tabulate_metrics
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
        patch.setattr(write, "SECTIONS", (primary.compute,))
        yield report(tmp_path_factory.mktemp("r") / "report", SURPRISE, PAPER)


def test_the_first_sentence_names_a_planted_surprise(surprised: Results) -> None:
    first = surprised.verdict[0]
    assert first.startswith("The paper's questions: the reducer mag321 was rated ")
    points = float(first.split("was rated ")[1].split(" points higher")[0])
    assert points == pytest.approx(SURPRISE, abs=5)
    assert "names it as an exception too" in first
    page = (surprised.path / "index.html").read_text(encoding="utf-8")
    answers = page.partition('<h2 id="on-paper">')[2]
    assert answers.split("<li>")[1].startswith("The reducer mag321 was rated")


def test_claims_are_answered_with_the_planted_slope_with_and_without_the_exception(
    surprised: Results,
) -> None:
    rows = pd.read_csv(surprised.path / "tables" / "paper_claims.csv").set_index("name")
    assert rows["verdict"].to_dict() == {
        "spectrum": "agrees", "table": "agrees", "missing": "not_estimable",
    }  # fmt: skip
    assert rows.loc["spectrum", "without"] == pytest.approx(4.0, abs=0.5)
    numbers = surprised.to_frame().set_index("name")["value"]
    assert numbers["claim.spectrum"] == pytest.approx(rows.loc["spectrum", "value"])
    assert any("dft999" in line for line in surprised.verdict)


def test_the_claims_are_in_the_results_as_the_schema_says(surprised: Results) -> None:
    schema = json.loads(
        (Path(write.__file__).parent / "results.schema.json").read_text(encoding="utf-8")
    )
    kinds = schema["properties"]["paper_claims"]["items"]["properties"]
    claims = json.loads((surprised.path / "results.json").read_text(encoding="utf-8"))[
        "paper_claims"
    ]
    assert [one["name"] for one in claims] == ["spectrum", "table", "missing"]
    assert all(set(one) == set(kinds) for one in claims)
    assert all(
        one[name] in kinds[name]["enum"]
        for one in claims
        for name in ("source", "expect", "verdict")
    )
    assert claims[2]["value"] is None


def test_the_papers_numbers_stand_beside_those_of_the_study(surprised: Results) -> None:
    found = pd.read_csv(surprised.path / "tables" / "paper_metrics.csv")
    assert len(found) == 5 * 7 * 2
    ours = make_tables(SURPRISE)[1].set_index("stimulus_id")["spectral_match"]
    row = found.set_index(["recording", "reducer", "metric"]).loc[
        ("s0", "dft321", "spectral_match")
    ]
    assert (row["paper"], row["value"]) == (0.97, pytest.approx(ours["s0-dft321"]))
    assert found["paper"].notna().sum() == 1


def test_mountings_are_joined_by_recording_reducer_and_metric() -> None:
    keys = {"recording": "s1", "reducer": "sax321", "metric": "temporal_match"}
    turned = pd.DataFrame([keys | {"mounting_mean": 0.5, "q05": 0.4, "q50": 0.5, "q95": 0.6}])
    paper = Paper("Someone 2010", "10.1/x", "full text", (), PUBLISHED, turned)
    found = tabulate_metrics(read_table(*make_tables(0.0)), paper).set_index(list(keys))
    assert found["q95"].notna().sum() == 1
    assert found.loc[tuple(keys.values()), "q95"] == 0.6
