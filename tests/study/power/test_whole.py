"""Whole studies on paper: the same ratings as from the disk, the slopes that are planted, any number of workers."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.jobs import Workers
from feel321.study.folder import StudyFolder
from feel321.study.power import setup, whole
from feel321.study.ratings import read_judgements
from feel321.study.simulation import regress_planted, simulate_study

if TYPE_CHECKING:
    from feel321.study.power.setup import PowerTask
    from feel321.study.session.journal import Clock


@pytest.fixture(scope="module")
def paper(task: PowerTask) -> whole.PaperStudy:
    own = task.paper
    return whole.PaperStudy.draw(own.settings, own.folder, own.stimuli, participants=6)


def test_ratings_on_paper_are_those_from_the_disk(
    built: StudyFolder, task: PowerTask, tmp_path: Path, now: Clock
) -> None:
    shutil.copytree(built.path, tmp_path / "study")
    study = StudyFolder(tmp_path / "study")
    simulate_study(study, participants=2, seed=5, now=now)
    written = [
        row for one in study.participants for row in read_judgements(one, task.paper.stimuli)
    ]
    own = task.paper
    twice = whole.PaperStudy.draw(own.settings, own.folder, own.stimuli, participants=2)
    before = sorted(path.name for path in built.path.rglob("*"))
    pd.testing.assert_frame_equal(twice.simulate(5), pd.DataFrame(written))
    assert sorted(path.name for path in built.path.rglob("*")) == before  # nothing is written


def test_expected_ratings_have_the_slopes_that_the_observers_plant(task: PowerTask) -> None:
    planted = regress_planted(task.paper.settings, task.paper.stimuli).slopes
    regressed = setup.split_expected(task.paper)[1]
    assert regressed.loc["realism"].to_dict() == pytest.approx(planted)


def test_whole_studies_recover_the_planted_slopes(paper: whole.PaperStudy, task: PowerTask) -> None:
    fits = [paper.analyze(seed) for seed in range(4)]
    found = pd.concat([one.slopes for one in fits]).groupby(["part", "metric"])["estimate"]
    error = found.std() / np.sqrt(len(fits))
    wanted = np.ravel(setup.split_expected(task.paper)[1]) * 10  # in the order of parts and metrics
    assert (np.abs(found.mean() - wanted) < 6 * error + 3).all()
    assert all((one.slopes["p_holm"] >= one.slopes["p"]).all() for one in fits)


def test_workers_and_interruptions_change_nothing(paper: whole.PaperStudy, tmp_path: Path) -> None:
    counted: list[tuple[int, int]] = []
    one = whole.run_wholes(paper, 6, seed=3, workers=Workers(1), keep=tmp_path / "one")
    two = whole.run_wholes(paper, 6, seed=3, workers=Workers(2), keep=tmp_path / "two")
    pd.testing.assert_frame_equal(one.slopes, two.slopes)
    files = sorted((tmp_path / "one").rglob("*.json"))
    former = [file.read_bytes() for file in files]
    files[0].unlink()
    whole.run_wholes(
        paper, 6, seed=3, workers=Workers(1), keep=tmp_path / "one",
        progress=lambda done, total: counted.append((done, total)),
    )  # fmt: skip
    assert [file.read_bytes() for file in files] == former
    assert counted == [(2, 2)]  # one chunk only was run again


def test_kept_studies_are_those_of_these_metrics(paper: whole.PaperStudy, tmp_path: Path) -> None:
    more = [replace(one, temporal_match=one.temporal_match / 2) for one in paper.stimuli]
    other = replace(paper, stimuli=replace(paper.stimuli, stimuli=tuple(more)))
    ran = [
        whole.run_wholes(one, 1, seed=3, workers=Workers(1), keep=tmp_path).slopes["estimate"]
        for one in (paper, other)
    ]
    assert len(list(tmp_path.iterdir())) == 2
    assert ran[0].tolist() != ran[1].tolist()


def test_studies_without_a_model_are_told(
    task: PowerTask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup, "SAMPLE", 6)
    own = task.paper.settings
    idle = own.model_copy(
        update={"observer": own.observer.model_copy(update={"straight_liners": 1.0})}
    )
    paper = replace(task.paper, settings=idle, screening=("straight_lining",))
    sizes = setup.Sizes(6, task.design.recordings, task.design.reducers, 1, studies=0, whole=1)
    found = setup.plan_study(
        replace(task, paper=paper), sizes, keep=tmp_path, workers=Workers(1), progress=lambda _d, _a: None
    )  # fmt: skip
    assert "None of 1 whole studies has a model" in found.notes[-1]
