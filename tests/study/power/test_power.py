"""The verb `power`: the answer is true, the page holds the numbers of the JSON, bad values get one line."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest

from feel321.analysis.power.plan import SENTENCES, find_row
from feel321.jobs import ALONE
from feel321.study import cli
from feel321.study.folder import StudyFolder
from feel321.study.power import setup
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.power.page import StudyPower
    from feel321.study.power.setup import PowerTask
    from feel321.study.session.journal import Clock

METRICS = ("spectral_match_bounded", "temporal_match")
GRID = ["--participants", "6,12", "--recordings", "4,8", "--reducers", "5", "--repeats", "1"]


def run(capsys: pytest.CaptureFixture[str], *words_: object) -> tuple[int, str, str]:
    code = cli.main(["power", *map(str, words_)])
    found = capsys.readouterr()
    return code, found.out, found.err


def plan(task: PowerTask, folder: Path, points: float, **more: Any) -> StudyPower:
    """Plan for one slope of both metrics, in points per +0.1, in closed form unless said otherwise."""
    effects = task.effects.assign(points=points, source=setup.GIVEN)
    slopes = {f"{one}/{two}": points * 10 for one, two in task.design.hypotheses}
    planted = replace(task, effects=effects, truth=replace(task.truth, slopes=slopes))
    return plan_study(planted, folder, **{"participants": (8, 16, 32), "studies": 0, **more})


def plan_study(task: PowerTask, folder: Path, **sizes: Any) -> StudyPower:
    return setup.plan_study(
        task, setup.Sizes(**sizes), keep=folder, workers=ALONE, progress=lambda _d, _a: None
    )


def test_verb_writes_page_tables_and_json_that_agree(
    built: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    code, said, _ = run(capsys, built.path, *GRID, "--studies", 6, "--out", out)
    content = json.loads((out / "results.json").read_text("utf-8"))
    page = (out / "index.html").read_text("utf-8")
    assert (code, said.splitlines()[0]) == (0, content["answer"])
    assert said.splitlines()[-1] == str(out / "index.html")
    assert content["answer"].replace("> ", "&gt; ").replace(" %", "\N{NO-BREAK SPACE}%") in page
    assert content["schema_version"] == 1
    assert all((out / name).is_file() for name in content["files"])
    designs = pd.read_csv(out / "tables" / "designs.csv")
    assert designs["power"].tolist() == pytest.approx([one["power"] for one in content["designs"]])
    assert [one["metric"] for one in content["planted"]] == [*METRICS, *METRICS]
    meanings = pd.read_csv(out / "tables" / "dictionary.csv")
    assert not meanings["meaning"].isna().any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--participants", "8,x"], "whole numbers"),
        (["--participants", "0"], "whole numbers"),
        (["--participants", "2"], "participants must be 3 or more"),
        (["--effect", "temporal_match"], "METRIC=POINTS"),
        (["--effect", "temporal_match=much"], "METRIC=POINTS"),
        (["--effect", "temporal_mach=2"], "did you mean 'temporal_match'"),
        (["--effect", "temporal_match=2", "--effect", "temporal_match=3"], "twice"),
        (["--effect", "temporal_match=1e9"], "-100 to 100"),
        (["--effect", "/temporal_match=1"], "realism"),
        (["--effect", "roughness/temporal_match=2"], "realism"),
        (["--hypothesis", "temporal_match"], "realism/temporal_match"),
        (["--pilot", "no.csv"], "no such table"),
        (["--pilot", "study"], "no ratings yet"),
        (["--screening", "slow"], "screening must be one of"),
        (["--power", "1.5"], "0.06 to"),
        (["--power", "0.05"], "0.06 to"),
        (["--studies", "-1"], "0"),
        (["--seed", "-1"], "0"),
    ],
)
def test_bad_values_get_one_line(
    built: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    options: list[str], said: str,
) -> None:  # fmt: skip
    code, out, error = run(capsys, built.path, "--out", tmp_path / "out", *options)
    assert code in {1, 2}
    assert out == ""
    assert len(error.splitlines()) == 1
    assert said in error


@pytest.mark.parametrize("seed", [3, 1234])
def test_strong_slopes_need_few_people(task: PowerTask, tmp_path: Path, seed: int) -> None:
    found = plan(
        task, tmp_path, 15.0, studies=8, seed=seed, recordings=(12,), reducers=(5,), repeats=(1,)
    )
    best = found.plan.recommended
    assert best is not None
    assert found.answer.startswith(f"Plan {best.participants} participants, ")
    row = find_row(found.plan)
    assert row["simulated_low"] < 1 >= row["power"] >= found.plan.wanted


def test_weak_slopes_have_no_answer_but_a_reason(task: PowerTask, tmp_path: Path) -> None:
    found = plan(task, tmp_path, 0.3)
    assert found.plan.recommended is None
    assert found.plan.verdict in {"ceiling", "too small"}
    assert found.plan.table["power"].max() < found.plan.wanted
    row = find_row(found.plan)
    larger = plan(task, tmp_path, row["detectable"] * 0.1 * 1.05)
    assert larger.plan.table.query("kind == 'given'")["power"].iloc[0] > found.plan.wanted
    recordings = row["recordings_needed"]
    assert math.isnan(recordings) or f"{recordings:.0f} recordings would be" in found.answer


def test_every_verdict_has_a_sentence(task: PowerTask, tmp_path: Path) -> None:
    found = plan(task, tmp_path, 2.0)
    lost = dict.fromkeys(("power", "ceiling", "detectable", "width"), math.nan)
    powers = tuple(
        replace(one, table=one.table.assign(**lost, recordings_needed=math.nan))
        for one in found.plan.powers
    )
    unknown = replace(found.plan, table=found.plan.table.assign(**lost), powers=powers)
    for known in (found.plan, unknown):
        for verdict in SENTENCES:
            said = replace(found, plan=replace(known, verdict=verdict)).answer
            assert "nan" not in said.split()
            assert said.endswith(".")


def test_answer_is_for_the_given_slopes_and_one_scale_goes_first(
    built: StudyFolder, tmp_path: Path
) -> None:
    asked = {"realism/temporal_match": 9.0, "temporal_match": 8.0}
    task = setup.set_up(built, effects=asked)
    points = task.effects.set_index(["attribute", "metric"])["points"].to_dict()
    assert points == {
        ("realism", METRICS[0]): pytest.approx(4.5), ("similarity", METRICS[0]): pytest.approx(4.5),
        ("realism", METRICS[1]): 9.0, ("similarity", METRICS[1]): 8.0,
    }  # fmt: skip
    found = plan_study(task, tmp_path, participants=12, studies=0)
    assert found.plan.hypothesis == ("similarity", "temporal_match")
    assert any("Slopes without --effect" in note for note in found.notes)


@pytest.mark.parametrize("odd", [{"studies": -1}, {"participants": 12.5}, {"recordings": [0]}])
def test_odd_numbers_are_refused(odd: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(odd))} must be"):
        setup.Sizes(**odd)
    with pytest.raises(ValueError, match="6 or more, got 4"):
        setup.Sizes(participants=4).list_factors(2)


def test_no_slope_is_called_nothing(task: PowerTask, tmp_path: Path) -> None:
    found = plan(task, tmp_path, 0.0)
    assert found.plan.verdict == "nothing planted"
    assert found.plan.recommended is None


def test_pilot_recovers_the_planted_spreads(built: StudyFolder, tmp_path: Path, now: Clock) -> None:
    shutil.copytree(built.path, tmp_path / "pilot")
    pilot = StudyFolder(tmp_path / "pilot")
    noisy = "[observer]\nbias_sd = 12.0\ngain_sd = 0.0\nnoise_spread = 0.0\n"
    text = pilot.settings.read_text("utf-8").replace("[session]\n", "[session]\nrepeats = 2\n")
    pilot.settings.write_text(text + noisy, "utf-8")
    simulate_study(pilot, participants=30, seed=11, now=now)
    shutil.copyfile(pilot.ratings, tmp_path / "pilot.csv")
    found = setup.set_up(built, pilot=tmp_path / "pilot.csv", effects={"temporal_match": 2.0})
    assert found.truth.person_sd == pytest.approx(12.0, rel=0.35)
    assert found.truth.rating_sd == pytest.approx(8.0, rel=0.1)
    assert found.truth.item_sd < 2.0
    assert "30 people's ratings in pilot.csv" in found.truth.source
    assert any("not from people" in note for note in found.notes)
    assert found.truth.find_slope("realism", "temporal_match") == pytest.approx(20.0)
