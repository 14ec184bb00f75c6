"""The bundled park2019 with ratings that follow its four metrics, and 45 points more for vector magnitude."""

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.primary.model import fit_primary
from feel321.analysis.report import answer, primary
from feel321.analysis.resampling import Choices
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import Further, read_table
from feel321.analysis.words import render_words
from feel321.study.analyze import make_paper, measure_declared
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder, create_study
from feel321.study.settings.read import list_origins, read_settings

SLOPES, BONUS = np.array([40.0, -30.0, 20.0, -60.0]), 45.0


@pytest.fixture(scope="module")
def park(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyFolder, Further]:
    study = create_study(tmp_path_factory.mktemp("park") / "park2019", bundled="park2019")
    build_study(study)
    further = measure_declared(study, read_settings(study.settings))
    assert further is not None
    return study, further


def plant(park: tuple[StudyFolder, Further], seed: int) -> Table:
    """Plant slopes on the four metrics and a bonus for mag321 in the ratings of 16 people."""
    study, further = park
    settings, rng = read_settings(study.settings), np.random.default_rng(seed)
    manifest = pd.read_csv(study.manifest).set_index("stimulus_id")
    metrics = further.metrics[list(settings.analysis.metrics)]
    tests = manifest.loc[metrics.index]
    source = tests["recording"].map(list_origins(settings))
    alike = (source + tests["reducer"]).factorize()[0]
    felt = 30 + metrics.to_numpy() @ SLOPES + BONUS * (tests["reducer"] == "mag321").to_numpy()
    felt += rng.normal(0, 2, alike.max() + 1)[alike]
    reference = tests["recording"].map(
        manifest[manifest["role"] == "reference"]
        .reset_index()
        .set_index("recording")["stimulus_id"]
    )
    rows = [
        pd.DataFrame({
            "participant": f"p{who:02}", "stimulus_id": metrics.index, "scale": "similarity", "trial": range(len(felt)),
            "reference_id": reference.to_numpy(),
            "rating": np.clip(felt + rng.normal(0, 5) + rng.normal(0, 8, len(felt)), 0, 100),
        })
        for who in range(16)
    ]  # fmt: skip
    return read_table(
        pd.concat(rows), manifest.reset_index(), metrics=settings.analysis.metrics,
        sources=list_origins(settings), further=further,
    )  # fmt: skip


@pytest.mark.soak
def test_the_first_sentence_names_the_surprise_and_the_slopes_hold_their_plants(
    park: tuple[StudyFolder, Further],
) -> None:
    held, named, seeds = 0, 0, 5
    for seed in range(seeds):
        table, choices = plant(park, seed), Choices(draws=100, seed=seed)
        found = primary.compute(table, choices)
        paper = make_paper(read_settings(park[0].settings))
        assert paper is not None
        section = answer.compute_paper(table, choices, paper=paper, others={"primary": found})
        first = render_words("paper", **section.facts)[1]
        named += (
            "mag321 was rated" in first.lower() and "the paper names it as an exception" in first
        )
        others = fit_primary(
            table.rows[table.rows["reducer"] != "mag321"], table.metrics, explain=False
        )
        ends = others.slopes[["low", "high"]].to_numpy().T
        held += int(((ends[0] < SLOPES) & (ends[1] > SLOPES)).sum())
        assert len({row["metric"] for row in found.rows["slopes"]}) == len(SLOPES)
    assert named >= seeds - 1
    assert held >= 4 * seeds - 3
