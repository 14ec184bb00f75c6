"""Freezing: what counts, what does not, what is refused, and what an edited file looks like."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from feel321.study.cli import main
from feel321.study.freezing.counted import count_ratings
from feel321.study.freezing.freeze import compare_now, freeze_study
from feel321.study.freezing.record import describe_frozen, find_faults, read_frozen
from feel321.study.freezing.standing import make_standing
from feel321.study.freezing.text import write_state
from feel321.study.settings.read import read_settings
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.folder import StudyFolder

EARLY, LATE = (datetime(year, 1, 1, tzinfo=UTC) for year in (2025, 2027))


def freeze(study: StudyFolder, when: datetime = EARLY, **options: object) -> list[str]:
    return freeze_study(study, now=lambda: when, **options)[1]


def change(study: StudyFolder, text: str) -> None:
    with study.settings.open("a", encoding="utf-8") as file:
        file.write(text)


def list_changes(study: StudyFolder) -> list[str]:
    return list(compare_now(study).changes)


def test_what_does_not_change_a_choice(smallest: StudyFolder) -> None:
    freeze(smallest)
    text = smallest.settings.read_text(encoding="utf-8")
    written_out = (
        "\n[analysis]\ndraws = 2000\n[study]\nname = 'another name'\n[observer]\nspectral = 5.0\n"
    )
    smallest.settings.write_text("# a comment\n" + text + written_out, encoding="utf-8")
    assert list_changes(smallest) == []
    moved = smallest.path.rename(smallest.path.with_name("moved"))
    assert list_changes(type(smallest)(moved)) == []


def test_each_changed_choice_is_named_in_plain_words(smallest: StudyFolder) -> None:
    freeze(smallest)
    (smallest.path / "slow.py").write_text("def slow(ratings):\n    return {}\n", encoding="utf-8")
    change(smallest, "[session.quality]\nmin_response_s = 0.5\n")
    change(
        smallest,
        "[analysis]\nscreening = ['slow.py:slow']\nmetrics = ['spectral_match_bounded']\nmargin = 4.0\n",
    )
    named = {one.partition(":")[0]: one for one in list_changes(smallest)}
    assert named["analysis.screening"] == "analysis.screening: was none, now slow"
    assert named["analysis.margin"] == "analysis.margin: was not set, now 4.0"
    assert (
        named["session.quality.min_response_s"]
        == "session.quality.min_response_s: was 0.2, now 0.5"
    )
    assert named["analysis.metrics"].endswith(
        "was spectral_match_bounded, temporal_match, now spectral_match_bounded"
    )
    assert named["code.screening_rule.slow"].startswith(
        "code.screening_rule.slow: was not set, now "
    )


def test_code_counts_and_not_where_it_lies(smallest: StudyFolder) -> None:
    code, moved = smallest.path / "slow.py", smallest.path / "rules" / "slow.py"
    moved.parent.mkdir()
    code.write_text("def slow(ratings):\n    return {}\n", encoding="utf-8")
    change(smallest, "[analysis]\nscreening = ['slow.py:slow']\n")
    freeze(smallest)
    code.rename(moved)
    text = smallest.settings.read_text(encoding="utf-8")
    smallest.settings.write_text(text.replace("slow.py:", "rules/slow.py:"), encoding="utf-8")
    assert list_changes(smallest) == []
    moved.write_text("def slow(ratings):\n    return {1: 2}\n", encoding="utf-8")
    assert [one.partition(":")[0] for one in list_changes(smallest)] == ["code.screening_rule.slow"]


def test_amending_needs_a_reason_and_keeps_the_former_state(smallest: StudyFolder) -> None:
    freeze(smallest)
    assert freeze(smallest) == []
    assert read_frozen(smallest).history == ()
    change(smallest, "[analysis]\nmargin = 4.0\n")
    with pytest.raises(ValueError, match=r"analysis.margin: was not set, now 4.0.*--because"):
        freeze(smallest)
    assert freeze(smallest, because="a pilot", participants=12) != []
    state = read_frozen(smallest)
    assert (state.because, state.participants, len(state.history)) == ("a pilot", 12, 1)
    assert state.history[0].choices["analysis.margin"] is None
    change(smallest, "[session.breaks]\nrest_s = 77\n")
    freeze(smallest, because="rest")
    assert [one.because for one in read_frozen(smallest).history] == ["", "a pilot"]
    assert read_frozen(smallest).participants == 12
    assert describe_frozen(smallest).endswith("before any rating, amended 2 times")
    assert find_faults(smallest) == []


def test_refused_once_people_have_rated(
    smallest: StudyFolder, rate: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    simulate_study(smallest, participants=2, seed=1, now=lambda: EARLY)
    assert count_ratings(smallest).judgements == 0
    rate(smallest, number=3)
    with pytest.raises(ValueError, match="2 judgements of 1 person came before"):
        freeze(smallest, LATE)
    assert main(["freeze", str(smallest.path), "--after-data"]) == 0
    printed = capsys.readouterr().out
    assert "2 judgements of 1 person came before, so every result is exploratory" in printed
    assert read_frozen(smallest).is_late
    assert find_faults(smallest) == []


def test_ratings_that_were_removed_still_count(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    from shutil import rmtree

    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.ratings import write_ratings

    rate(smallest)
    write_ratings(smallest, read_stimuli(smallest.stimuli))
    rmtree(smallest.sessions)
    with pytest.raises(ValueError, match="2 judgements of 1 person"):
        freeze(smallest, LATE)


@pytest.mark.parametrize("edit", ["choice", "history", "time", "empty"])
def test_an_edited_file_is_seen(smallest: StudyFolder, edit: str) -> None:
    freeze(smallest)
    change(smallest, "[analysis]\nmargin = 4.0\n")
    freeze(smallest, because="a pilot")
    path = smallest.path / "frozen.json"
    entry = json.loads(path.read_bytes())
    match edit:
        case "choice":
            entry["choices"]["analysis.draws"] = 5000
        case "history":
            entry["history"] = []
        case "time":
            entry["utc"] = "2020-01-01T00:00:00+00:00"
        case "empty":
            entry = {}
    path.write_text(json.dumps(entry), encoding="utf-8")
    assert "frozen.json: changed after it was written" in find_faults(smallest)[0]
    assert "cannot be trusted" in describe_frozen(smallest)
    with pytest.raises(ValueError, match="restore it from a copy"):
        freeze(smallest)


def test_a_file_made_later_does_not_pass_for_an_earlier_one(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    # With the sessions out of the way and the clock set back, a new file is whole in itself; the journals know better.
    rate(smallest)
    aside = smallest.sessions.rename(smallest.path / "aside")
    freeze(smallest)
    assert find_faults(smallest) == []
    aside.rename(smallest.sessions)
    assert find_faults(smallest)[0].endswith("whose header knows of no frozen file")
    (smallest.path / "frozen.json").unlink()
    aside = smallest.sessions.rename(aside)
    freeze(smallest, LATE)
    aside.rename(smallest.sessions)
    assert "but a person had rated by 2026-01-01" in find_faults(smallest)[0]


def test_sessions_name_the_file_that_they_were_run_under(
    smallest: StudyFolder, rate: Callable[..., None]
) -> None:
    freeze(smallest)
    rate(smallest)
    assert find_faults(smallest) == []
    (smallest.path / "frozen.json").unlink()
    (missing,) = find_faults(smallest)
    assert "is not there, though sessions/" in missing
    assert "names it in its header" in missing
    standing = make_standing(smallest, read_settings(smallest.settings))
    assert standing.state == "unsound"
    assert "it is not there, though sessions/" in standing.sentence
    assert "is missing" in write_state(compare_now(smallest))
    change(smallest, "[analysis]\nmargin = 4.0\n")
    aside = smallest.sessions.rename(smallest.path / "aside")
    freeze(smallest)
    aside.rename(smallest.sessions)
    assert "is not the one that sessions/p01/session-01.jsonl names" in find_faults(smallest)[0]


def test_the_text_of_a_registration(
    smallest: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    change(smallest, "[analysis]\nhypotheses = ['Everybody prefers mag321.']\n")
    assert main(["freeze", str(smallest.path), "--text", "--participants", "24"]) == 0
    draft = capsys.readouterr().out
    assert "nothing is frozen yet" in draft
    assert not (smallest.path / "frozen.json").exists()
    assert main(["freeze", str(smallest.path), "--participants", "24"]) == 0
    assert main(["freeze", str(smallest.path), "--text"]) == 0
    text = capsys.readouterr().out
    for said in (
        "24 participants.", "3. Everybody prefers mag321.", "get higher realism ratings (level as is)",
        "(1 | participant:reducer)", "Holm's method", "Support: the adjusted p", "faster than 0.2 s",
        "SHA-256 of the frozen",
    ):  # fmt: skip
        assert said in text
    assert main(["freeze", str(smallest.path), "--show", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["frozen"]["participants"] == 24
    assert shown["changes"] == []


def test_without_a_stimulus_set_there_is_nothing_to_freeze(
    study: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["freeze", str(study.path)]) == 1
    assert "build it first: feel321 build" in capsys.readouterr().err


def test_check_status_and_audit_say_in_a_line_what_is_frozen(
    smallest: StudyFolder, rate: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    freeze(smallest)
    rate(smallest)
    for verb in ("check", "status", "audit"):
        main([verb, str(smallest.path), "--quiet"])
        lines = capsys.readouterr().out.splitlines()
        assert [one for one in lines if one.startswith("frozen")] == [
            "frozen: 2025-01-01 00:00 UTC, before any rating"
        ]
    (smallest.path / "frozen.json").write_text("{}", encoding="utf-8")
    assert main(["audit", str(smallest.path)]) == 1
    assert "frozen.json: changed after it was written" in capsys.readouterr().out
