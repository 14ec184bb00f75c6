"""Studies that are made once and copied for each test."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from feel321.study.folder import StudyFolder, create_study
from feel321.study.simulation import simulate_study
from feel321.study.workflow import build_study
from tests.study.conftest import SMALLEST_STUDY

if TYPE_CHECKING:
    from pathlib import Path

ASKING = '[[session.questions]]\nuse = "demographics"\n'


def now() -> datetime:
    return datetime.now(UTC)


def copy_study(made: StudyFolder, folder: Path) -> StudyFolder:
    shutil.copytree(made.path, folder)
    return StudyFolder(folder)


@pytest.fixture(scope="session")
def made_asking(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = create_study(tmp_path_factory.mktemp("made") / "study")
    study.settings.write_text(SMALLEST_STUDY + ASKING, encoding="utf-8")
    build_study(study)
    return study


@pytest.fixture(scope="session")
def made_held(made_asking: StudyFolder, tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = copy_study(made_asking, tmp_path_factory.mktemp("held") / "study")
    simulate_study(study, participants=2, seed=3, now=now)
    return study
