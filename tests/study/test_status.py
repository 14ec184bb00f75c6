from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import pytest

from study.folder import StudyFolder
from study.status import Progress, describe_balance, read_status

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Present = Callable[..., list[Any]]


@pytest.fixture
def begun(present: Present, scripted: type, tmp_path: Path) -> StudyFolder:
    """A study in which p01 has finished."""
    present(scripted())
    return StudyFolder(tmp_path)


def test_a_participant_who_finished_is_shown_with_the_cycle_of_the_design(begun: StudyFolder) -> None:
    (entry,) = read_status(begun)
    assert (entry.participant, entry.done, entry.left, entry.finished, entry.problem) == ("p01", 20, 0, True, "")
    assert entry.cycle == 10  # Two recordings take 2 orders, five stimuli 10.


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("plan.json", b"null", "plan.json: got no plan, or one that was changed after it was stored"),
        ("session-01.jsonl", b"{}\n", "session-01.jsonl, line 1: was changed after it was written"),
    ],
)
def test_what_is_broken_hides_nobody_else(begun: StudyFolder, name: str, content: bytes, problem: str) -> None:
    shutil.copytree(begun.sessions / "p01", begun.sessions / "p02")
    (begun.sessions / "p01" / name).write_bytes(content)
    broken, copied = read_status(begun)
    assert (broken.participant, broken.done, broken.finished) == ("p01", 0, False)
    assert problem in broken.problem
    assert "p02/plan.json: is the plan of 'p01', it was copied here; move it away" in copied.problem


def test_a_journal_without_its_plan_is_a_problem(begun: StudyFolder) -> None:
    (begun.sessions / "p01" / "plan.json").unlink()
    assert "plan.json" in read_status(begun)[0].problem


def test_a_folder_that_holds_only_a_lock_was_not_begun(begun: StudyFolder) -> None:
    (begun.sessions / "p02").mkdir()
    (begun.sessions / "p02" / ".lock").touch()
    assert [entry.participant for entry in read_status(begun)] == ["p01"]


@pytest.mark.parametrize(
    ("finished", "left_over", "line"),
    [
        (0, 2, "balance: 0 finished; orders balance over 6 participants or a multiple, 6 to go"),
        (4, 3, "balance: 4 finished; orders balance over 6 participants or a multiple, 2 to go"),
        (12, 0, "balance: 12 finished; orders balance over 6 participants or a multiple, 0 to go"),
        (7, 0, "balance: 7 finished; orders balance over 6 participants or a multiple, 5 to go"),
        (0, 0, "balance: nobody has begun"),
    ],
)
def test_balance_says_how_many_complete_the_design(finished: int, left_over: int, line: str) -> None:
    entries = [Progress("done", finished=True, cycle=6)] * finished + [Progress("under way", cycle=6)] * left_over
    assert describe_balance([*entries, Progress("broken", problem="x")]) == line
