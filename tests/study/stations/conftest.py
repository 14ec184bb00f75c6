"""A study as stations have it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from feel321.study.check import build_study
from feel321.study.folder import create_study
from tests.study.conftest import make_settings


@pytest.fixture(scope="session")
def built(make_once: Callable[..., Path]) -> Path:
    """A study of four trials, built."""

    def fill(folder: Path) -> None:
        study = create_study(folder / "study")
        settings = make_settings("bumps", session="repeats = 2\n")
        study.settings.write_text(settings, encoding="utf-8")
        build_study(study)

    return make_once("stations", fill) / "study"
