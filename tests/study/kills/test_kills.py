"""Sudden death: SIGKILL between and inside the records of every protocol, and again while going on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pathlib import Path

TASKS = ("realism", "similarity-strict", "similarity-replay", "dissimilarity", "mushra", "abx")
PRESENTERS = ("observer", "scripted")


@pytest.mark.parametrize("presenter", PRESENTERS)
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("instant", [0.3, 0.8])
def test_killed_between_two_calls(lab: Any, tmp_path: Path, task: str, presenter: str, instant: float) -> None:
    kill = lab.place(instant, task=task, presenter=presenter)
    lab.endure(task, presenter, [kill], tmp_path / "killed")
