from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.cli import main

if TYPE_CHECKING:
    from collections.abc import Callable

    Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Call a verb; gives exit code, stdout and stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return call


@pytest.fixture
def begun(lab: Any) -> Any:
    lab.begin("p01")
    lab.work("p01", 2)
    lab.begin("p02")
    lab.begin("sim001", simulated=True)
    lab.work("sim001")
    return lab


def test_withdraw_wants_to_be_meant(begun: Any, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    code, _, err = say("withdraw", begun.study.path, "--participant", "p01")
    assert (code, err.count("\n")) == (2, 1)
    assert "no terminal to ask for confirmation; add --yes" in err
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    for answer, expected in (("", 1), ("n", 1), ("y", 0)):
        monkeypatch.setattr(sys.stdin, "readline", lambda answer=answer: f"{answer}\n")
        code, out, err = say("withdraw", begun.study.path, "--participant", "p01")
        assert code == expected
        assert (begun.study.sessions / "p01" / "plan.json").exists() == (answer != "y")
        assert ("nothing was removed" in out) == (answer != "y")


def test_withdraw_says_what_was_removed_and_what_is_left_to_do(begun: Any, say: Say) -> None:
    begun.study.report.mkdir()
    code, out, err = say(
        "withdraw", begun.study.path, "--participant", "p01", "--yes", "--reason", "moved away"
    )
    assert code == 0
    assert out == (
        f"{begun.study.path}: removed 2 files of p01; a tombstone keeps the code. "
        "Copies that feel321 did not make must be removed by hand\n"
    )
    assert err.startswith(
        f"feel321: warning: {begun.study.report}: results were removed because they held"
    )
    assert (
        json.loads((begun.study.sessions / "p01" / "withdrawn.json").read_text())["reason"]
        == "moved away"
    )


def test_release_says_which_number_is_free(begun: Any, say: Say) -> None:
    assert say("withdraw", begun.study.path, "--participant", "p02", "--keep-data") == (
        0,
        f"{begun.study.path}: p02 is released, number 2 is free\n",
        "",
    )
    code, _, err = say("withdraw", begun.study.path, "--participant", "p02", "--keep-data")
    assert (code, err) == (1, "feel321: participant p02: was released before; number 2 is free\n")
