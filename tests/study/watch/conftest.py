"""A small study with two simulated participants, built once."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from feel321.study.check import build_study
from feel321.study.folder import StudyFolder
from feel321.study.session import journal as journals
from feel321.study.simulate import simulate_study

STUDY = """
[study]
name = "Pilot"
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.3
[stimuli]
reducers = ["sax321", "mag321"]
[session.rehearsal]
practice = 0
"""


@pytest.fixture(scope="session")
def made(make_once: Callable[..., Path]) -> Path:
    def fill(folder: Path) -> None:
        (folder / "study.toml").write_text(STUDY, encoding="utf-8")
        build_study(StudyFolder(folder))
        simulate_study(StudyFolder(folder), participants=2, seed=1, now=journals.utc_now)

    return make_once("monitor", fill)


@pytest.fixture
def copied(made: Path, tmp_path: Path) -> StudyFolder:
    return StudyFolder(Path(shutil.copytree(made, tmp_path / "lab one")))
