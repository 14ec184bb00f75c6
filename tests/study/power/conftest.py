from collections.abc import Callable
from pathlib import Path

import pytest

from feel321.study import power
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder, create_study

STUDY = """
[study]
seed = 7
[[recordings]]
scene = "bumps"
duration_s = 0.2
[[recordings]]
scene = "hard_taps"
duration_s = 0.2
[[recordings]]
scene = "constrained_drag"
duration_s = 0.2
[[recordings]]
scene = "circular_motion"
duration_s = 0.2
[stimuli]
reducers = ["sax321", "soc321", "mag321", "pca321", "dft321"]
anchors = false
below_threshold = "accept"
[session]
protocols = ["realism", "similarity"]
[session.rehearsal]
training = 1
practice = 0
"""


def make_study(folder: Path, text: str = STUDY) -> StudyFolder:
    """A study of four short scenes and five reducers, not built."""
    study = create_study(folder / "study")
    study.settings.write_text(text, encoding="utf-8")
    return study


@pytest.fixture(scope="session")
def built(make_once: Callable[[str, Callable[[Path], object]], Path]) -> StudyFolder:
    """The same, built once; tests read it, and write elsewhere."""
    folder = make_once("power", lambda path: build_study(make_study(path)))
    return StudyFolder(folder / "study")


@pytest.fixture(scope="session")
def task(built: StudyFolder) -> power.PowerTask:
    return power.set_up(built)
