"""A study as stations have it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.study.folder import create_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

TWO_TRIALS = """
[[recordings]]
scene = "bumps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "mag321"]
reference = "none"
anchors = false
[session]
protocols = ["realism"]
repeats = 2
[session.rehearsal]
training = 0
practice = 0
"""


@pytest.fixture(scope="session")
def built(make_once: Callable[..., Path]) -> Path:
    """A study of four trials, built."""

    def fill(folder: Path) -> None:
        study = create_study(folder / "study")
        study.settings.write_text(TWO_TRIALS, encoding="utf-8")
        build_study(study)

    return make_once("stations", fill) / "study"
