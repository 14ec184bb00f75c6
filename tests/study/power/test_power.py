"""The verb `power`: the answer is true, the page holds the numbers of the JSON, bad values get one line."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from feel321.analysis.power.design import SIZES
from feel321.study import cli, power
from feel321.study.folder import StudyFolder, create_study
from feel321.study.power import PowerTask, StudyPower
from feel321.study.session.journal import Clock
from feel321.study.simulate import simulate_study

METRICS = ("spectral_match_bounded", "temporal_match")
GRID = ["--participants", "6,12", "--recordings", "4,8", "--reducers", "5", "--repeats", "1"]


def plan(task: PowerTask, **more: Any) -> StudyPower:
    sizes = {name: more.pop(name) for name in SIZES if name in more}
    options = {"studies": 0, "workers": 1, "progress": lambda _d, _a: None, **more}
    return power.plan_study(task, sizes, **options)


def find_row(found: StudyPower) -> pd.Series:
    """Find what is known of the hypothesis that the answer is about, in the design that is shown."""
    shown = found.plan.shown
    return shown.table.iloc[shown.design.hypotheses.index(found.plan.hypothesis)]


def plant(task: PowerTask, points: float) -> PowerTask:
    """Plant one slope of both metrics, in points per +0.1."""
    effects = task.effects.assign(points=points, source=power.GIVEN)
    slopes = {f"{one}/{two}": points * 10 for one, two in task.design.hypotheses}
    truth = replace(task.design.truth, slopes=slopes)
    return replace(task, effects=effects, design=replace(task.design, truth=truth))


def test_verb_writes_page_tables_and_json_that_agree(
    built: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    code = cli.main(["power", str(built.path), *GRID, "--studies", "6", "--out", str(out)])
    said = capsys.readouterr().out
    content = json.loads((out / "results.json").read_text("utf-8"))
    page = (out / "index.html").read_text("utf-8")
    assert (code, said.splitlines()[0]) == (0, content["answer"])
    assert said.splitlines()[-1] == str(out / "index.html")
    assert content["answer"].replace("> ", "&gt; ").replace(" %", "\N{NO-BREAK SPACE}%") in page
    assert (
        "slopes of people on temporal match, per +0.1<" in page
    )  # which a pilot gives, or 3 points per SD
    assert "slope points" not in page
    assert all((out / name).is_file() for name in content["files"])
    designs = pd.read_csv(out / "tables" / "designs.csv")
    assert designs["power"].tolist() == pytest.approx([one["power"] for one in content["designs"]])
    assert [one["metric"] for one in content["planted"]] == [*METRICS, *METRICS]
    assert not pd.read_csv(out / "tables" / "dictionary.csv")["meaning"].isna().any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--participants 8,x", "whole numbers"),
        ("--participants 0", "whole numbers"),
        ("--participants 2", "participants must be 3 or more"),
        ("--effect temporal_match=much", "METRIC=POINTS"),
        ("--effect temporal_mach=2", "did you mean 'temporal_match'"),
        ("--effect temporal_match=2 --effect temporal_match=3", "twice"),
        ("--effect temporal_match=1e9", "-100 to 100"),
        ("--effect roughness/temporal_match=2", "realism"),
        ("--pilot no.csv", "no such table"),
        ("--pilot study", "no ratings yet"),
        ("--power 1.5", "0.06 to"),
        ("--studies -1", "0"),
    ],
)
def test_bad_values_get_one_line(
    built: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    options: str, said: str,
) -> None:  # fmt: skip
    code = cli.main(["power", str(built.path), "--out", str(tmp_path / "out"), *options.split()])
    found = capsys.readouterr()
    assert (code in {1, 2}, found.out, len(found.err.splitlines())) == (True, "", 1)
    assert said in found.err


def test_strong_slopes_need_few_people_and_weak_ones_have_a_reason(task: PowerTask) -> None:
    sizes = {"participants": (8, 16, 32), "recordings": (12,), "reducers": (5,), "repeats": (1,)}
    strong = plan(plant(task, 15.0), studies=8, seed=3, **sizes)
    best, row = strong.plan.recommended, find_row(strong)
    assert strong.answer.startswith(f"Plan {best.participants} participants, ")
    assert row["simulated_low"] < 1 >= row["power"] >= best.wanted
    weak = plan(plant(task, 0.3), participants=(8, 16, 32))
    assert weak.plan.recommended is None
    assert weak.plan.verdict in {"ceiling", "too small"}
    enough = plan(plant(task, find_row(weak)["detectable"] * 0.1 * 1.05))
    assert enough.plan.table.query("kind == 'given'")["power"].iloc[0] > task.design.wanted
    assert plan(plant(task, 0.0)).plan.verdict == "nothing planted"


def test_answer_is_for_the_given_slopes_and_one_scale_goes_first(built: StudyFolder) -> None:
    task = power.set_up(built, effects={"realism/temporal_match": 9.0, "temporal_match": 8.0})
    points = task.effects.set_index(["attribute", "metric"])["points"].to_dict()
    assert points == {
        ("realism", METRICS[0]): pytest.approx(4.5), ("similarity", METRICS[0]): pytest.approx(4.5),
        ("realism", METRICS[1]): 9.0, ("similarity", METRICS[1]): 8.0,
    }  # fmt: skip
    found = plan(task, participants=12)
    assert found.plan.hypothesis == ("similarity", "temporal_match")
    assert any("Slopes without --effect" in note for note in found.task.notes)


def test_a_study_without_stimuli_is_built_first(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="feel321 build"):
        power.set_up(create_study(tmp_path / "study"))


def test_pilot_recovers_the_planted_spreads(built: StudyFolder, tmp_path: Path, now: Clock) -> None:
    shutil.copytree(built.path, tmp_path / "pilot")
    pilot = StudyFolder(tmp_path / "pilot")
    noisy = "[observer]\nbias_sd = 12.0\ngain_sd = 0.0\nnoise_spread = 0.0\n"
    text = pilot.settings.read_text("utf-8").replace("[session]\n", "[session]\nrepeats = 2\n")
    pilot.settings.write_text(text + noisy, "utf-8")
    simulate_study(pilot, participants=30, seed=11, now=now)
    shutil.copyfile(pilot.ratings, tmp_path / "pilot.csv")
    found = power.set_up(built, pilot=tmp_path / "pilot.csv", effects={"temporal_match": 2.0})
    truth = found.design.truth
    assert truth.person_sd == pytest.approx(12.0, rel=0.35)
    assert truth.rating_sd == pytest.approx(8.0, rel=0.1)
    assert truth.item_sd < 2.0
    assert "30 people's ratings in pilot.csv" in truth.source
    assert any("not from people" in note for note in found.notes)
    assert truth.find_slope("realism", "temporal_match") == pytest.approx(20.0)
