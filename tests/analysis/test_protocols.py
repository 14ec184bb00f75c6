"""What the session engine writes is what the analysis reads: every task at once."""

import re
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path

import pandas as pd
import pytest

from feel321.analysis.table.reading import read_table
from feel321.protocols.tasks import PROTOCOLS
from feel321.study.analyze import analyze_study
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder
from feel321.study.simulate import simulate_study

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
reducers = ["saz321", "mag321", "dft321"]
[session]
protocols = ["realism", "similarity", "dissimilarity", "mushra", "abx", "triplet", "preference"]
[tasks.similarity]
reference = "surface"
[tasks.mushra]
reference = "dft321"
[analysis]
draws = 100
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


def test_every_task_loads(lab: StudyFolder) -> None:
    table = read_table(lab.ratings, lab.manifest)
    assert len(table.rows) == len(pd.read_csv(lab.ratings))
    assert set(table.rows["scale"]) == set(PROTOCOLS)
    counts = table.rows.groupby(["scale", "role"]).size()
    # Three people, two recordings, three reducers.
    assert counts["realism"].to_dict() == {"anchor": 12, "reference": 6, "test": 18}
    assert counts["mushra"].to_dict() == {"anchor": 12, "reference": 12, "test": 12}
    assert counts["dissimilarity"].to_dict() == {"pair": 18, "reference": 6, "test": 18}
    assert counts["abx"].to_dict() == {"anchor": 12, "test": 18}
    # Three pairs and two catch trials; with the recording itself six pairs.
    assert counts["triplet"].to_dict() == {"pair": 3 * 2 * 5}
    assert counts["preference"].to_dict() == {"pair": 3 * 2 * 8}
    *notes, strength = table.notes
    assert notes == [
        "Scale 'mushra': 36 judgements were made against what 'dft321' made of the recording; the metrics compare with "
        "the recording: none enters an association or a slope.",
        "Scale 'similarity': 36 judgements were made against the real surface; the metrics compare with the recording.",
    ]
    assert strength.startswith(
        "Scale 'similarity': beside the real surface, stimuli were played at "
    )


def test_every_task_has_its_place_in_the_report(lab: StudyFolder) -> None:
    analyze_study(lab)
    folder = lab.report
    associations = pd.read_csv(folder / "tables" / "associations.csv")
    items = associations[associations["quantity"] == "n_items"]
    assert dict(zip(items["scale"], items["value"], strict=True)) == {
        "realism": 6,
        "similarity_to_original": 6,
        "similarity": 6,
    }
    page = re.sub(  # what is read: without figures and the data of the script
        r"<(svg|script).*?</\1>",
        "",
        (folder / "details.html").read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    assert not re.search(r"(?<!_)as_is", page)  # but in names of stimuli and files
    profiles = pd.read_csv(folder / "tables" / "profiles.csv")
    assert set(profiles["scale"]) == set(PROTOCOLS) - {"triplet", "preference"}
    people = profiles.query("role == 'test' and quantity == 'n_participants'")
    assert set(people["value"]) == {3}
