"""The methods section: every number in it is one of the journals, the settings or `results.json`."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest

from feel321.study.analyze import analyze_study
from feel321.study.export import count_flow, write_methods
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal
from feel321.study.session.plan import require_plan
from tests.study.export.conftest import PLANTED


@pytest.fixture(scope="module")
def report(studied: StudyFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("narrative") / "report"
    analyze_study(studied, out=folder)
    write_methods(studied, folder)
    return folder


def test_the_flow_is_that_of_the_journals(studied: StudyFolder) -> None:
    """Counted anew from the bare lines: three were registered, one withdrew, the program does not count."""
    flow, rated, finished = count_flow(studied), 0, 0
    for name in (PLANTED["code"], PLANTED["other code"]):
        folder = studied.sessions / name
        trials = {one.number: one for one in require_plan(folder / "plan.json").trials}
        records = read_journal(folder / "session-01.jsonl").records
        answers = [one for one in records if one.event == "rated"]
        rated += sum(len(trials[one.data["trial"]].judgements) for one in answers)
        finished += any(one.event == "finished" for one in records)
    assert len(flow.pop("minutes")) == 2
    assert flow == {
        "simulated": False, "registered": 3, "withdrew": 1, "began": 2, "finished": finished,
        "analysed": 2, "judgements": rated, "rejected": 0, "counted": rated,
    }  # fmt: skip


def test_every_number_is_one_that_is_recorded(studied: StudyFolder, report: Path) -> None:
    text = (report / "methods.md").read_text(encoding="utf-8")
    results = json.loads((report / "results.json").read_text(encoding="utf-8"))
    flow, manifest = count_flow(studied), pd.read_csv(studied.manifest)
    for sentence in results["how"]:
        assert f"- {sentence}" in text
        text = text.replace(f"- {sentence}", "")
    levels = manifest.loc[manifest["role"] == "test", "sensation_level_db"]
    known = {
        *(str(value) for name, value in flow.items() if name != "minutes"),
        *(f"{one:.0f}" for one in flow["minutes"]),
        *(f"{one:.1f}" for one in (levels.min(), levels.max(), levels.median())),
        *(f"{one:.2f}" for one in (manifest["duration_s"].min(), manifest["duration_s"].max())),
        *map(str, (len(manifest), manifest["recording"].nunique(), 3)),  # three reducers
        *map(str, manifest["role"].value_counts()),
        *("20", "1000", "48000", "200"),  # conditioning, rig, and the window of the threshold
        *(results["inputs"][name] for name in ("draws", "seed")),
        *("2", "1", "0", "30", "20", "60"),  # tasks, repeats, rehearsal, breaks: the study's settings
        "2026-17", "17", "2026",
        *re.findall(r"[\d.]+", " ".join(results["versions"].values())),
        *re.findall(r"[\d.]+", "10.5281 123456 4.0 321"),
    }  # fmt: skip
    strange = [one for one in re.findall(r"\d+(?:\.\d+)*", text) if one not in known]
    assert strange == []


def test_what_is_not_known_is_left_in_brackets(report: Path) -> None:
    text = (report / "methods.md").read_text(encoding="utf-8")
    assert "| invited | [number] | |" in " ".join(text.replace("|  |", "| |").split("\n"))
    assert "[actuator, amplifier, stylus]" in text
    assert "Board 2026-17" in text
    assert "were not frozen beforehand" in text
    assert not any(planted in text for planted in PLANTED.values())
