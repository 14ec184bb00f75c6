"""Freezing: what counts, what does not, what is refused, how an edited file looks, and what a report says of it."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from shutil import rmtree

import pandas as pd
import pytest

from feel321.analysis.report.section import make_row
from feel321.analysis.report.standing import Hypothesis, Standing
from feel321.analysis.words import CONFIRMATORY, EXPLORATORY
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.analyze import analyze_study
from feel321.study.cli import main
from feel321.study.evidence.freeze import (
    describe_frozen,
    find_changes,
    find_faults,
    freeze_study,
    list_settings,
    make_standing,
    read_frozen,
)
from feel321.study.folder import StudyFolder
from feel321.study.ratings import write_ratings
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Clock
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Stale, create_plan, make_plan
from feel321.study.settings.read import make_design, make_identity, read_settings
from feel321.study.simulate import simulate_study

EARLY, LATE = (datetime(year, 1, 1, tzinfo=UTC) for year in (2025, 2027))
PLACE = ("realism", "as_is", "temporal_match")


@pytest.fixture
def rate(scripted: type, now: Clock) -> Callable[..., None]:
    """Let a person, who is not simulated, rate all trials of a study."""

    def run(study: StudyFolder, participant: str = "p01", *, number: int = 1) -> None:
        settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
        design = make_design(settings)
        plan = make_plan(design, stimuli, participant, number=number, simulated=False)
        identity = make_identity(settings, study.path, {"simulated": False})
        folder = study.sessions / participant
        folder.mkdir(parents=True, exist_ok=True)
        create_plan(folder / "plan.json", plan)
        with open_session(folder, plan, identity=identity, now=now, stale=Stale()) as (
            own,
            journal,
        ):
            run_session(own, scripted(), stimuli=stimuli, journal=journal)

    return run


def freeze(study: StudyFolder, when: datetime = EARLY) -> dict[str, str]:
    return freeze_study(study, now=lambda: when)[1]


def change(study: StudyFolder, text: str) -> None:
    with study.settings.open("a", encoding="utf-8") as file:
        file.write(text)


def compare(study: StudyFolder) -> dict[str, str]:
    named = list_settings(study, read_settings(study.settings))
    return find_changes(read_frozen(study).settings, named)


def stand(study: StudyFolder, **asked: object) -> Standing:
    return make_standing(study, read_settings(study.settings), **asked)


# What counts.


def test_what_does_not_change_a_setting(smallest: StudyFolder) -> None:
    freeze(smallest)
    text = smallest.settings.read_text(encoding="utf-8")
    written_out = (
        "\n[analysis]\ndraws = 2000\n[study]\nname = 'another name'\n[observer]\nspectral = 5.0\n"
        "[publication]\ntitle = 'a title'\n"
    )
    smallest.settings.write_text("# a comment\n" + text + written_out, encoding="utf-8")
    assert compare(smallest) == {}
    moved = smallest.path.rename(smallest.path.with_name("moved"))
    assert compare(type(smallest)(moved)) == {}


def test_a_key_that_is_not_set_is_no_change() -> None:
    """Another version of feel321 may know it, or no longer."""
    now = {"session.questions": [{"name": "age", "low": 5.0}]}
    before = {"session.questions": [{"name": "age", "low": 5.0, "use": None, "more": {"a": None}}]}
    assert find_changes(before, now) == find_changes(now, before) == {}
    assert [*find_changes(before, {"session.questions": [{"name": "age"}]})] == [*now]


FLAT = "def flat(acceleration, reduced, rate_hz):\n    return "


def test_each_changed_setting_is_named_in_plain_words(smallest: StudyFolder) -> None:
    freeze(smallest)
    (smallest.path / "flat.py").write_text(f"{FLAT}1.0\n", encoding="utf-8")
    change(smallest, "[session.quality]\nmin_response_s = 0.5\n")
    change(
        smallest,
        "[metrics.flat]\nuse = 'flat.py:flat'\n[analysis]\nmetrics = ['spectral_match_bounded']\nmargin = 4.0\n",
    )
    named = compare(smallest)
    assert named["analysis.margin"] == "analysis.margin: was not set, now 4.0"
    rule = "session.quality.min_response_s"
    assert named[rule] == f"{rule}: was 0.2, now 0.5"
    assert named["analysis.metrics"].endswith(
        "was spectral_match_bounded, temporal_match, now spectral_match_bounded"
    )
    assert named["code.metric.flat"].startswith("code.metric.flat: was not set, now ")


def test_code_counts_and_not_where_it_lies(smallest: StudyFolder) -> None:
    code, moved = smallest.path / "flat.py", smallest.path / "own" / "flat.py"
    moved.parent.mkdir()
    code.write_text(f"{FLAT}1.0\n", encoding="utf-8")
    change(smallest, "[metrics.flat]\nuse = 'flat.py:flat'\n")
    freeze(smallest)
    code.rename(moved)
    text = smallest.settings.read_text(encoding="utf-8")
    smallest.settings.write_text(text.replace("flat.py:", "own/flat.py:"), encoding="utf-8")
    assert compare(smallest) == {}
    moved.write_text(f"{FLAT}2.0\n", encoding="utf-8")
    assert [*compare(smallest)] == ["code.metric.flat"]


def test_what_a_primary_metric_declares_counts(smallest: StudyFolder) -> None:
    change(
        smallest,
        "[analysis]\nmetrics = ['spectral_match_bounded', 'peak']\n[metrics.peak]\nhigher = 'worse'\nlabel = 'top'\n",
    )
    freeze(smallest)
    hypotheses = {one.metric: one.higher for one in read_frozen(smallest).hypotheses}
    assert hypotheses == {"spectral_match_bounded": "better", "peak": "worse"}
    text = smallest.settings.read_text(encoding="utf-8")
    smallest.settings.write_text(text.replace("'top'", "'other'"), encoding="utf-8")
    assert compare(smallest) == {}
    smallest.settings.write_text(text.replace("'worse'", "'better'"), encoding="utf-8")
    assert [*compare(smallest)] == ["metrics.peak.higher"]


def test_freezing_again_before_the_first_session_says_what_changed(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    assert freeze(smallest) == freeze(smallest) == {}
    change(smallest, "[analysis]\nmargin = 4.0\n")
    assert [*freeze(smallest)] == ["analysis.margin"]
    change(smallest, "[session.breaks]\nrest_s = 77\n")
    assert [*freeze(smallest)] == ["session.breaks.rest_s"]
    assert describe_frozen(smallest).endswith("before any session")
    rate(smallest)
    assert find_faults(smallest) == []
    assert "frozen on 2025-01-01, before anybody came" in stand(smallest).sentence


def test_refused_once_people_have_rated(
    smallest: StudyFolder, rate: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    simulate_study(smallest, participants=2, seed=1, now=lambda: EARLY)
    freeze(smallest)
    (smallest.path / "frozen.json").unlink()
    rate(smallest, number=3)
    assert main(["freeze", str(smallest.path)]) == 1
    assert "p01 has begun already, so it is too late to freeze" in capsys.readouterr().err
    assert not (smallest.path / "frozen.json").exists()


@pytest.mark.parametrize("edit", ["setting", "time", "empty"])
def test_an_edited_file_is_seen(smallest: StudyFolder, edit: str) -> None:
    freeze(smallest)
    change(smallest, "[analysis]\nmargin = 4.0\n")
    freeze(smallest)
    path = smallest.path / "frozen.json"
    entry = json.loads(path.read_bytes())
    match edit:
        case "setting":
            entry["settings"]["analysis.draws"] = 5000
        case "time":
            entry["utc"] = "2020-01-01T00:00:00+00:00"
        case "empty":
            entry = {}
    path.write_text(json.dumps(entry), encoding="utf-8")
    assert "frozen.json: changed after it was written" in find_faults(smallest)[0]
    assert "cannot be trusted" in describe_frozen(smallest)
    with pytest.raises(ValueError, match="restore it from a copy"):
        freeze(smallest)
    found = stand(smallest)
    assert found.state == "unsound"
    assert "cannot be trusted: it was changed after it was written" in found.sentence
    assert found.judge(*PLACE)[0] == EXPLORATORY


def test_a_file_made_later_does_not_pass_for_an_earlier_one(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    # With the sessions out of the way and the clock set back, a new file is whole in itself; the journals know better.
    rehearsals = replace(smallest, is_rehearsal=True)
    rate(rehearsals)
    rate(smallest)
    aside = smallest.sessions.rename(smallest.path / "aside")
    freeze(smallest)
    assert find_faults(smallest) == []
    aside.rename(smallest.sessions)
    assert find_faults(smallest)[0].endswith("whose header knows of no frozen file")
    assert find_faults(rehearsals) == []


def test_sessions_name_the_file_that_they_were_run_under(
    smallest: StudyFolder, rate: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    freeze(smallest)
    rate(smallest)
    assert find_faults(smallest) == []
    (smallest.path / "frozen.json").unlink()
    (missing,) = find_faults(smallest)
    assert "is not there, though sessions/" in missing
    assert "names it in its header" in missing
    standing = stand(smallest)
    assert standing.state == "unsound"
    assert "it is not there, though sessions/" in standing.sentence
    assert main(["freeze", str(smallest.path), "--show"]) == 0
    assert "is not there, though sessions/" in capsys.readouterr().err
    change(smallest, "[analysis]\nmargin = 4.0\n")
    aside = smallest.sessions.rename(smallest.path / "aside")
    freeze(smallest)
    aside.rename(smallest.sessions)
    assert "is not the one that sessions/p01/session-01.jsonl names" in find_faults(smallest)[0]


def test_what_is_frozen_is_shown(smallest: StudyFolder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["freeze", str(smallest.path), "--show"]) == 0
    assert "nothing is frozen" in capsys.readouterr().out
    change(smallest, "[analysis]\nhypotheses = ['Everybody prefers mag321.']\n")
    assert main(["freeze", str(smallest.path)]) == 0
    assert f"SHA-256 {read_frozen(smallest).sha256}" in capsys.readouterr().out
    change(smallest, "margin = 4.0\n")
    assert main(["freeze", str(smallest.path), "--show"]) == 0
    text = capsys.readouterr().out
    for said in (
        "Everybody prefers mag321.", "metric temporal_match", "(1 | participant:reducer)",
        "  analysis.margin: was not set, now 4.0",
    ):  # fmt: skip
        assert said in text
    assert main(["freeze", str(smallest.path), "--show", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["frozen"]["settings"]["analysis.draws"] == 2000
    assert shown["changes"] == ["analysis.margin: was not set, now 4.0"]


def test_check_status_and_audit_say_in_a_line_what_is_frozen(
    smallest: StudyFolder, rate: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    freeze(smallest)
    rate(smallest)
    for verb in ("check", "status", "audit"):
        main([verb, str(smallest.path), "--quiet"])
        lines = capsys.readouterr().out.splitlines()
        assert [one for one in lines if one.startswith("frozen")] == [
            "frozen: 2025-01-01 00:00 UTC, before any session"
        ]
    (smallest.path / "frozen.json").write_text("{}", encoding="utf-8")
    assert main(["audit", str(smallest.path)]) == 1
    assert "frozen.json: changed after it was written" in capsys.readouterr().out


# What it makes of an analysis.


def test_what_was_frozen_before_any_rating_is_confirmatory(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    assert stand(smallest).judge(*PLACE)[0] == EXPLORATORY
    freeze(smallest)
    rate(smallest)
    found = stand(smallest)
    assert found.state == "before"
    assert found.judge(*PLACE) == (CONFIRMATORY, "")
    for other in (("similarity", *PLACE[1:]), (*PLACE[:2], "spectral_match")):
        assert found.judge(*other) == (EXPLORATORY, "not among the frozen hypotheses")
    write_ratings(smallest, read_stimuli(smallest.stimuli))
    rmtree(smallest.sessions)  # ratings that were removed still count
    with pytest.raises(ValueError, match="p01 has begun already"):
        freeze(smallest, LATE)


def test_a_changed_choice_ends_it_unless_the_test_does_not_depend_on_it(
    smallest: StudyFolder,
) -> None:
    freeze(smallest)
    found = stand(smallest, draws=500)
    assert found.judge(*PLACE)[0] == CONFIRMATORY
    assert "what else has changed: analysis.draws: was 2000, now 500." in found.sentence
    found = stand(smallest, metrics=["temporal_match"])
    assert "analysis.metrics" in found.sentence
    assert found.judge(*PLACE) == (EXPLORATORY, "settings were changed after they were frozen")
    text = smallest.manifest.read_text(encoding="utf-8")
    smallest.manifest.write_text(text.replace("0.1,", "0.1000,", 1), encoding="utf-8")
    assert "stimuli.set: was " in stand(smallest).sentence


@pytest.mark.parametrize(
    ("table", "quantity", "metric", "declared"),
    [
        ("slopes", "slope", PLACE[2], True),
        ("slopes", "df", PLACE[2], True),
        ("slopes", "slope_centred", PLACE[2], False),
        ("slopes", "slope", "spectral_match", False),
        ("influence", "slope", PLACE[2], False),
    ],
)
def test_rows_of_the_declared_test_are_marked(
    table: str, quantity: str, metric: str, *, declared: bool
) -> None:
    standing = Standing("", "before", (Hypothesis(*PLACE),), reason="")
    row = make_row(quantity, 1.0, scale=PLACE[0], level=PLACE[1], metric=metric)
    assert (standing.mark(table, row) == CONFIRMATORY) is declared


def test_the_report_of_a_frozen_study(
    smallest: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    from feel321.analysis.report import write

    few = [one for one in write.SECTIONS if one.key in {"primary", "reducers"}]
    monkeypatch.setattr(write, "SECTIONS", few)
    monkeypatch.setattr("feel321.analysis.report.folder.save_figure", _save_nothing)
    freeze(smallest)
    simulate_study(smallest, participants=3, seed=1, now=lambda: LATE)
    found = analyze_study(smallest, draws=100)
    page = (smallest.report / "index.html").read_text(encoding="utf-8")
    assert f'<p class="standing">{found.standing.sentence}</p>' in page
    content = json.loads((smallest.report / "results.json").read_text(encoding="utf-8"))
    assert content["standing"]["state"] == "before"
    assert {one["status"] for one in content["verdicts"]} == {CONFIRMATORY}
    tables = {one.stem: pd.read_csv(one) for one in (smallest.report / "tables").glob("*.csv")}
    slopes = tables.pop("slopes")
    tested = slopes["quantity"].isin(["slope", "slope_quartile", "df"])
    assert set(slopes[tested]["status"]) == {CONFIRMATORY}
    assert set(slopes[~tested]["status"]) == {EXPLORATORY}
    assert tables.pop("dictionary")["meaning"].notna().all()
    assert {word for rows in tables.values() for word in rows["status"]} == {EXPLORATORY}
    elsewhere = analyze_study(smallest, ratings=smallest.ratings, draws=100)
    assert elsewhere.standing.state == "elsewhere"


def _save_nothing(_figure: object, stem: object) -> None:
    from pathlib import Path

    for suffix, text in ((".svg", '<svg xmlns="http://www.w3.org/2000/svg"></svg>'), (".png", "")):
        Path(f"{stem}{suffix}").write_text(text, encoding="utf-8")
