import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Timer
from typing import Any

import pytest
from filelock import FileLock

from feel321.files import hold_lock, is_held
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import StudyFolder
from feel321.study.session.events import SessionReleased
from feel321.study.session.journal import read_journal, require_journal, write_line
from feel321.study.session.plan import Design, Plan, make_plan
from feel321.study.session.ports import Confirm, Playback
from feel321.study.status import describe_balance, read_status
from tests.study.auditing.cheats import chain

Present = Callable[..., list[Any]]


@pytest.fixture
def begun(present: Present, scripted: type, tmp_path: Path) -> StudyFolder:
    """A study in which p01 has finished."""
    present(scripted())
    return StudyFolder(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("plan.json", b"null", "plan.json: not a plan, or changed after it was stored"),
        ("session-01.jsonl", b"{}\n", "session-01.jsonl, line 1: was changed after it was written"),
    ],
)
def test_what_is_broken_hides_nobody_else(
    begun: StudyFolder, name: str, content: bytes, problem: str
) -> None:
    shutil.copytree(begun.sessions / "p01", begun.sessions / "p02")
    (begun.sessions / "p01" / name).write_bytes(content)
    broken, copied = read_status(begun).participants
    assert (broken.participant, broken.done, broken.state) == ("p01", 0, "")
    assert problem in broken.problem
    assert "p02/plan.json: is the plan of 'p01', it was copied here; move it away" in copied.problem
    assert read_status(begun).balance is None  # Nobody is left to count.


def test_a_record_of_another_version_shows_no_rating(begun: StudyFolder) -> None:
    path = begun.sessions / "p01" / "session-01.jsonl"
    records = read_journal(path).records
    rated = next(one for one in records if one.event == "rated")
    data = {name: value for name, value in rated.data.items() if name != "response_time_s"}
    chain(path, [replace(one, data=data) if one is rated else one for one in records])
    (broken,) = read_status(begun).participants
    assert "record as feel321 writes it (response_time_s: Field required);" in broken.problem


def test_states_follow_the_journal(present: Present, scripted: type, tmp_path: Path) -> None:
    study, folder = StudyFolder(tmp_path), tmp_path / "sessions" / "p01"
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    assert [(entry.state, entry.done, entry.left) for entry in read_status(study).participants] == [
        ("aborted", 3, 17)
    ]
    with hold_lock(folder / ".lock", busy=""):
        assert [entry.state for entry in read_status(study).participants] == ["running"]
    with hold_lock(folder / ".lock", busy=""):  # to look took nothing away
        pass
    require_journal(
        folder / "session-01.jsonl", now=lambda: datetime(2027, 1, 1, tzinfo=UTC)
    ).write(SessionReleased())
    assert [entry.state for entry in read_status(study).participants] == ["released"]
    (folder / "session-01.jsonl").unlink()
    assert [entry.state for entry in read_status(study).participants] == ["claimed"]
    (folder / "withdrawn.json").write_text("{}", encoding="utf-8")
    assert [entry.state for entry in read_status(study).participants] == ["withdrawn"]


def test_what_the_study_lead_should_know_is_counted(
    present: Present, scripted: type, tmp_path: Path, stimuli: StimulusSet, design: Design
) -> None:
    tasks = (replace(design.tasks[1], training=2),)
    plan = make_plan(replace(design, tasks=tasks), stimuli, "p01", number=1, simulated=True)
    dry, broken = Playback(1.0, 1.0, underruns=1), Playback(1.0, 1.0, error="gone")
    wrong = Confirm(0.0, {"test": 10.0}, 1.5)
    training = [trial.number for trial in plan.trials if trial.phase == "training"]
    presenter = scripted(
        playbacks={(1, 1): [dry], (3, 1): [broken], (5, 1): [dry]},
        acts={(n, 1): [wrong] for n in training},
    )
    for number in training:
        presenter.acts[number, 1] = [wrong] * 9
    present(presenter, plan=plan)
    journal = tmp_path / "sessions" / "p01" / "session-01.jsonl"
    journal.write_bytes(journal.read_bytes() + b"torn")
    (entry,) = read_status(StudyFolder(tmp_path)).participants
    # The reference against itself got 50 points, twice, for there are two recordings.
    assert entry.warnings == (
        "4 bytes of an unfinished line, moved aside on resuming",
        "2 x underrun",
        "1 x device error",
        "training not passed",
        "2 of 2 catch trials not as expected",
    )


def test_trials_that_were_given_up_are_counted_apart(
    present: Present, scripted: type, plan: Plan, tmp_path: Path
) -> None:
    attempts = range(1, plan.flow.max_attempts + 1)
    hasty = {(n, k): [Confirm(0.0, {"test": 50.0}, 0.1)] for n in (1, 5) for k in attempts}
    present(scripted(acts=hasty))
    (entry,) = read_status(StudyFolder(tmp_path)).participants
    assert (entry.state, entry.answered, entry.given_up, entry.left) == ("finished", 18, 2, 0)


def test_records_of_another_make_are_the_problem_of_their_participant(
    present: Present, scripted: type, design: Design, stimuli: StimulusSet, tmp_path: Path
) -> None:
    for number, name in enumerate(("p01", "p02"), start=1):
        plan = make_plan(design, stimuli, name, number=number, simulated=True)
        with pytest.raises(KeyboardInterrupt):
            present(scripted(stop_after=number), plan=plan)
    path = tmp_path / "sessions" / "p01" / "session-01.jsonl"
    chain = read_journal(path)
    forged = replace(
        chain.records[-1], sequence=len(chain.records), event="rated", data={"trial": 2}
    )
    path.write_bytes(path.read_bytes() + write_line(forged, chain.tip))
    broken, fine = read_status(StudyFolder(tmp_path)).participants
    assert broken.problem.startswith(
        f"{tmp_path / 'sessions' / 'p01' / 'session-01.jsonl'}, line 10: is not a 'rated' record"
    )
    assert (fine.state, fine.done, fine.problem) == ("aborted", 2, "")


def test_status_is_blind(begun: StudyFolder, stimuli: StimulusSet) -> None:
    state = read_status(begun)
    shown = "\n".join([str(state), *describe_balance(state.balance)])
    shown += (begun.sessions / "p01" / "session-01.jsonl").read_text(encoding="utf-8")
    assert not [stimulus.reducer for stimulus in stimuli.stimuli if stimulus.reducer in shown]


Hold = Any
"""Holds sessions by a design of so many participants, and measures their balance."""


@pytest.fixture
def hold(
    present: Present, scripted: type, tmp_path: Path, stimuli: StimulusSet, design: Design
) -> Hold:
    def run(n: int, stimuli: StimulusSet = stimuli, **change: Any) -> Any:
        own = replace(design, **change)
        for number in range(1, n + 1):
            plan = make_plan(own, stimuli, f"n{number:02}", number=number, simulated=True)
            present(scripted(), plan=plan, stimuli=stimuli)
        return read_status(StudyFolder(tmp_path)).balance

    return run


def test_balance_of_one_full_circle_is_perfect_and_a_drop_out_shows(
    hold: Hold, tmp_path: Path
) -> None:
    assert hold(0) is None
    assert describe_balance(None) == ["balance: no trial was run yet"]
    realised = hold(10)  # Two recordings take 2 orders, five stimuli 10.
    assert (realised["participants"], realised["finished"]) == (10, 10)
    assert {(e["task"], e["what"]): e["positions"] for e in realised["evenness"]} == {
        ("realism", "stimuli"): (2, 2),
        ("realism", "recordings"): (5, 5),
        ("similarity", "stimuli"): (2, 2),
        ("similarity", "recordings"): (5, 5),
    }
    shutil.rmtree(tmp_path / "sessions" / "n04")
    lines = describe_balance(read_status(StudyFolder(tmp_path)).balance)
    assert lines[0] == "balance: 9 finished (simulated)"
    assert lines[1].startswith("  realism, stimuli: 1 to 2 at each position, ")


def test_counterbalanced_tasks_have_a_balance_of_their_own(hold: Hold) -> None:
    lines = describe_balance(hold(3, task_order="counterbalanced", order="random"))
    assert lines[1] == "  session, tasks: 1 to 2 at each position, 1 to 2 after each other"


def test_simulated_participants_do_not_fill_the_places_of_real_ones(
    present: Present,
    scripted: type,
    hold: Hold,
    stimuli: StimulusSet,
    design: Design,
    tmp_path: Path,
) -> None:
    hold(2)
    present(scripted(), plan=make_plan(design, stimuli, "real", number=1, simulated=False))
    realised = read_status(StudyFolder(tmp_path)).balance
    assert realised is not None
    assert (realised["simulated"], realised["participants"]) == (False, 1)


def test_a_second_attempt_counts_where_it_was_run_and_the_bad_one_does_not(
    present: Present, scripted: type, tmp_path: Path
) -> None:
    present(
        scripted(
            playbacks={
                (1, 1): [Playback(1.0, 1.0, underruns=1)],
                (5, 1): [Playback(1.0, 1.0, underruns=1)],
            }
        )
    )
    realised = read_status(StudyFolder(tmp_path)).balance
    assert realised is not None
    # Each of five stimuli stands at one place of five, also the one that came again after the other block.
    assert [entry["positions"] for entry in realised["evenness"]] == [(0, 1)] * 4


def test_who_only_looks_refuses_no_session(tmp_path: Path) -> None:
    """A look takes the lock for an instant; here it takes a tenth of a second."""
    path = tmp_path / ".lock"
    assert not is_held(path)
    assert not path.exists()
    looking = FileLock(path, thread_local=False)
    looking.acquire()
    timer = Timer(0.1, looking.release)
    timer.start()
    with hold_lock(path, busy="refused"):
        timer.join()
        assert is_held(path)
    assert not is_held(path)
