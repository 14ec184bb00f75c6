import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import RATING_COLUMNS, StudyFolder
from feel321.study.ratings import list_judgements, write_ratings
from feel321.study.session.journal import START, digest, write_line
from feel321.study.session.plan import (
    Design,
    Plan,
    Stale,
    create_plan,
    list_by_code,
    make_plan,
    read_dossier,
)
from feel321.study.session.ports import Confirm, Feel, Playback

Present = Callable[..., list[Any]]


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def read_judgements(folder: Path, stimuli: StimulusSet) -> list[dict[str, Any]]:
    return list_judgements(read_dossier(folder), stimuli)


def test_one_row_per_judgement_with_what_the_plan_and_the_set_say(
    present: Present, scripted: type, plan: Plan, stimuli: StimulusSet, tmp_path: Path
) -> None:
    present(scripted())
    study = StudyFolder(tmp_path)
    assert write_ratings(study, stimuli) == 20
    rows = read(study.ratings)
    assert [int(row["trial"]) for row in rows] == list(range(1, 21))
    by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
    by_code = list_by_code(stimuli, seed=plan.seed)
    codes = {row.stimulus_id: code for code, row in by_code.items()}
    for row, trial in zip(rows, plan.trials, strict=True):
        (judgement,) = trial.judgements
        assert (codes[row["stimulus_id"]], row["protocol"]) == (
            judgement.stimulus_id,
            trial.protocol,
        )
        assert codes.get(row["reference_id"]) == judgement.reference_id
        assert row["reducer"] == by_id[row["stimulus_id"]].reducer
    constant = {
        "participant": "p01",
        "session": "1",
        "level": "as_is",
        "rating": "50.0",
        "response_time_s": "1.5",
    }
    constant |= {"underruns": "0", "rejected": "false", "simulated": "true", "repeat": "1"}
    assert all(row | constant == row for row in rows)


@pytest.mark.parametrize(("is_felt_again", "onset_s"), [(True, 4.5), (False, 2.5)])
def test_onset_is_that_of_what_is_judged_as_felt_last_and_underruns_add_up(
    present: Present,
    scripted: type,
    stimuli: StimulusSet,
    tmp_path: Path,
    *,
    is_felt_again: bool,
    onset_s: float,
) -> None:
    again = [Feel(0.0), Confirm(0.0, {"test": 50.0}, 1.5)]
    dry = [
        Playback(1.0, 1.0, underruns=2),
        Playback(2.0, 2.5),
        Playback(3.0, 3.5, underruns=1, completed=is_felt_again),
        Playback(4.0, 4.5),
    ]
    present(scripted(acts={(11, 1): again}, playbacks={(11, 1): dry}))
    rows = read_judgements(tmp_path / "sessions" / "p01", stimuli)
    bad, good = (row for row in rows if row["trial"] == 11)
    assert (bad["onset_s"], bad["underruns"], bad["rejected"]) == (onset_s, 3, "true")
    assert (good["underruns"], good["rejected"]) == (0, "false")
    assert [row["trial"] for row in rows] == sorted([
        *range(1, 21),
        11,
    ])  # though it came again later


MEASURED = {
    "spectral_match": 0.5,
    "temporal_match": 0.25,
    "level_error_db": -1.5,
    "lag": 300.0,
    "polarity": 1.0,
    "coherence": 0.9,
    "rms_m_s2": 2.0,
    "is_calibrated": 1.0,
    "is_measured": 1.0,
}


@pytest.mark.parametrize(
    ("delivered", "expected"),
    [
        (MEASURED, (0.5, 0.25, "", -1.5, "sensor")),
        (
            {"spectral_match_bounded": 0.75, "level_error_db": 2.0},
            ("", "", 0.75, 2.0, "certificate"),
        ),
        ({}, ("", "", "", "", "")),
    ],
)
def test_a_row_has_what_was_delivered_of_the_playback_that_was_judged(
    present: Present,
    scripted: type,
    stimuli: StimulusSet,
    tmp_path: Path,
    delivered: dict[str, float],
    expected: tuple[Any, ...],
) -> None:
    again = [Feel(0.0), Confirm(0.0, {"test": 50.0}, 1.5)]
    other = {**MEASURED, "spectral_match": 0.125}
    plays = [
        Playback(1.0, 1.0, delivered=other),  # of the reference
        Playback(2.0, 2.5, delivered=other),
        Playback(3.0, 3.5, delivered=other),
        Playback(4.0, 4.5, delivered=delivered),
    ]
    present(scripted(acts={(11, 1): again}, playbacks={(11, 1): plays}))
    (row,) = (
        row for row in read_judgements(tmp_path / "sessions" / "p01", stimuli) if row["trial"] == 11
    )
    first = RATING_COLUMNS.index("spectral_match_delivered")
    assert tuple(row[name] for name in RATING_COLUMNS[first : first + 5]) == expected


def test_a_session_that_was_begun_anew_counts_no_more_and_is_kept(
    present: Present, scripted: type, stimuli: StimulusSet, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    later = datetime(2027, 1, 1, tzinfo=UTC)
    present(scripted(), stale=Stale(policy="restart"), now=lambda: later)
    rows = read_judgements(tmp_path / "sessions" / "p01", stimuli)
    assert [(row["session"], row["trial"]) for row in rows if row["rejected"] == "true"] == [
        (1, 1),
        (1, 2),
        (1, 3),
    ]
    assert [row["trial"] for row in rows if row["rejected"] == "false"] == list(range(1, 21))


@pytest.mark.parametrize(
    ("task", "rating"),
    [
        ("abx", {0.0, 100.0}),
        ("dissimilarity", {50.0}),
        ("mushra", {50.0}),
        ("triplet", {100.0}),
        ("preference", {100.0}),
    ],
)
def test_every_judgement_of_a_trial_is_a_row(
    present: Present,
    scripted: type,
    design: Design,
    stimuli: StimulusSet,
    tmp_path: Path,
    task: str,
    rating: set[Any],
) -> None:
    plan = make_plan(
        replace(design, tasks=(make_task(task),)), stimuli, "p01", number=1, simulated=True
    )
    present(scripted(), plan=plan)
    rows = read_judgements(tmp_path / "sessions" / "p01", stimuli)
    assert len(rows) == sum(len(trial.judgements) for trial in plan.trials)
    assert {row["rating"] for row in rows} == rating
    assert {row["scale"] for row in rows} == {task}
    names = {stimulus.stimulus_id for stimulus in stimuli.stimuli}
    assert {row["stimulus_id"] for row in rows} | {row["reference_id"] for row in rows} <= {
        *names,
        *([None] if task == "preference" else []),
    }
    # An answer of `a` is right exactly where X repeats A: the score is checked against the parts, not against itself.
    if task in {"triplet", "preference"}:
        by_code = list_by_code(stimuli, seed=plan.seed)
        codes = {row.stimulus_id: code for code, row in by_code.items()}
        felt = {t.number: [part.stimulus_id for part in t.parts[-2:]] for t in plan.trials}
        for row in rows:
            named = [codes[row[name]] for name in ("stimulus_id", "other_id")]
            assert named == felt[row["trial"]]
    else:
        assert {row["other_id"] for row in rows} == {None}
    if task == "abx":
        right = {t.number: t.parts[2].stimulus_id == t.parts[0].stimulus_id for t in plan.trials}
        assert [row["rating"] == 100.0 for row in rows] == [right[row["trial"]] for row in rows]


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


@pytest.fixture
def held(present: Present, scripted: type, tmp_path: Path) -> tuple[Path, list[Any]]:
    """The folder of a participant who has finished, and the records."""
    return tmp_path / "sessions" / "p01", present(scripted())


def play_nothing(records: list[Any]) -> None:
    del records[next(place for place, record in enumerate(records) if record.event == "played")]


def show_again(records: list[Any]) -> None:
    place = next(place for place, record in enumerate(records) if record.event == "played")
    records.insert(place + 1, records[place - 1])  # and not played since


def change_last(**change: Any) -> Callable[[list[Any]], None]:
    def spoil(records: list[Any]) -> None:
        last = max(place for place, record in enumerate(records) if record.event == "rated")
        records[last] = replace(records[last], data=records[last].data | change)

    return spoil


ANOTHER_MAKE = r"session-01\.jsonl(, line \d+: is not a|: holds what feel321 does not write)"
NOT_PLAYED = r"session-01\.jsonl, line \d+: trial 1 is rated, but test was not played"


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (play_nothing, NOT_PLAYED),
        (show_again, NOT_PLAYED),
        (change_last(values={}), ANOTHER_MAKE),
        (change_last(values=None), ANOTHER_MAKE),
        (change_last(trial=99), ANOTHER_MAKE),
        (change_last(trial=[]), ANOTHER_MAKE),
    ],
)
def test_a_forged_rating_is_refused_in_words(
    held: tuple[Path, list[Any]], stimuli: StimulusSet, tmp_path: Path, spoil: Any, message: str
) -> None:
    folder, records = held
    spoil(records)
    lines, tip = [], START
    for sequence, record in enumerate(records):
        lines.append(write_line(replace(record, sequence=sequence), tip))
        tip = digest(lines[-1].rstrip(b"\n"))
    (folder / "session-01.jsonl").write_bytes(b"".join(lines))
    with pytest.raises(ValueError, match=message) as caught:
        write_ratings(StudyFolder(tmp_path), stimuli)
    assert "\n" not in str(caught.value)


def test_what_belongs_elsewhere_is_refused(
    held: tuple[Path, list[Any]], design: Design, stimuli: StimulusSet, tmp_path: Path
) -> None:
    folder, _ = held
    study, journal, plan = (
        StudyFolder(tmp_path),
        folder / "session-01.jsonl",
        folder / "plan.json",
    )
    another = "was planned with stimulus set 555555555555, the study holds 666666666666"
    with pytest.raises(ValueError, match=another):
        write_ratings(study, replace(stimuli, sha256="6" * 64))
    for name in ("session-01.old.jsonl", "session-01 (copy).jsonl", "session-01a.jsonl"):
        shutil.copy(journal, folder / name)  # copies under other names do not count
    for name in ("p01 backup", "@eaDir"):  # nor do folders whose names are no participant's
        shutil.copytree(folder, study.sessions / name)
    assert write_ratings(study, stimuli) == 20
    shutil.copytree(folder, study.sessions / "p01-copy")
    with pytest.raises(
        ValueError, match=r"p01-copy/plan\.json: is the plan of 'p01', it was copied here; move"
    ):
        write_ratings(study, stimuli)
    shutil.rmtree(study.sessions / "p01-copy")
    shutil.copy(journal, folder / "session-02.jsonl")
    with pytest.raises(
        ValueError, match=r"session-02\.jsonl: is session 1 of 'p01', it was copied here; move"
    ):
        write_ratings(study, stimuli)
    (folder / "session-02.jsonl").unlink()
    plan.unlink()
    create_plan(plan, make_plan(design, stimuli, "p01", number=2, simulated=True))
    with pytest.raises(
        ValueError, match=r"session-01\.jsonl: was begun with another plan than the one beside it"
    ):
        write_ratings(study, stimuli)
