from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from study.folder import StudyFolder
from study.journal import create_journal
from study.ratings import COLUMNS, read_judgements, write_ratings

if TYPE_CHECKING:
    from collections.abc import Callable
    from datetime import datetime
    from pathlib import Path

    from stimuli.manifest import StimulusSet
    from study.plan import Plan

    Present = Callable[..., list[Any]]


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_columns_are_those_that_were_promised() -> None:
    assert ", ".join(COLUMNS) == (
        "participant, session, protocol, block, trial, repeat, stimulus_id, recording, reducer, level, reference_id, "
        "scale, rating, response_time_s, onset_s, underruns, rejected, simulated"
    )


def test_one_row_per_judgement_with_what_the_plan_and_the_set_say(
    present: Present, scripted: type, plan: Plan, stimuli: StimulusSet, tmp_path: Path
) -> None:
    present(scripted())
    study = StudyFolder(tmp_path)
    assert write_ratings(study, stimuli) == 20
    rows = read(study.ratings)
    assert [int(row["trial"]) for row in rows] == list(range(1, 21))
    by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
    for row, trial in zip(rows, plan.trials, strict=True):
        assert (row["stimulus_id"], row["protocol"]) == (trial.stimulus_id, trial.protocol)
        assert row["reference_id"] == (trial.reference_id or "")
        assert row["reducer"] == by_id[trial.stimulus_id].reducer
    constant = {"participant": "p01", "session": "1", "level": "as_is", "rating": "50.0", "response_time_s": "2.0"}
    constant |= {"underruns": "0", "rejected": "false", "simulated": "true", "repeat": "1"}
    assert all(row | constant == row for row in rows)


def test_onset_is_that_of_the_test_as_felt_last_and_underruns_add_up(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path
) -> None:
    records = present(scripted(replays=1, underruns=2))
    played = [r.data for r in records if r.event == "played"]
    rows = read_judgements(tmp_path / "sessions" / "p01" / "session-01.jsonl", stimuli)
    assert [row["underruns"] for row in rows] == [4] + [2] * 9 + [4] * 10
    assert rows[0]["onset_s"] == played[1]["onset_s"]
    assert rows[-1]["onset_s"] == played[-1]["onset_s"] != played[-2]["onset_s"]
    assert all(row["rejected"] == "true" for row in rows)


def test_unfinished_sessions_count_and_the_table_is_the_same_every_time(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    study = StudyFolder(tmp_path)
    assert write_ratings(study, stimuli) == 3
    first = study.ratings.read_bytes()
    study.ratings.unlink()
    write_ratings(study, stimuli)
    assert study.ratings.read_bytes() == first
    assert not list(tmp_path.glob(".*.part"))


def test_a_journal_that_never_began_gives_no_rows(
    tmp_path: Path, stimuli: StimulusSet, now: Callable[[], datetime]
) -> None:
    create_journal(tmp_path / "session-01.jsonl", now=now)
    assert read_judgements(tmp_path / "session-01.jsonl", stimuli) == []


def test_a_journal_of_another_stimulus_set_is_refused(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path
) -> None:
    present(scripted())
    with pytest.raises(ValueError, match="was written with stimulus set 555555555555, the folder holds 666666666666"):
        write_ratings(StudyFolder(tmp_path), replace(stimuli, sha256="6" * 64))


@pytest.mark.parametrize("name", ["session-01.old.jsonl", "session-01 (copy).jsonl", "session-01a.jsonl"])
def test_copies_of_a_journal_under_other_names_do_not_count(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path, name: str
) -> None:
    present(scripted())
    folder = tmp_path / "sessions" / "p01"
    shutil.copy(folder / "session-01.jsonl", folder / name)
    assert write_ratings(StudyFolder(tmp_path), stimuli) == 20


@pytest.mark.parametrize("copy", ["p01 backup/session-01.jsonl", "p01/session-02.jsonl"])
def test_a_journal_that_lies_elsewhere_than_it_was_written_is_refused(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path, copy: str
) -> None:
    present(scripted())
    target = tmp_path / "sessions" / copy
    target.parent.mkdir(exist_ok=True)
    shutil.copy(tmp_path / "sessions" / "p01" / "session-01.jsonl", target)
    with pytest.raises(ValueError, match=f"{copy}: is session 1 of 'p01', it was copied here; move the copy out"):
        write_ratings(StudyFolder(tmp_path), stimuli)
