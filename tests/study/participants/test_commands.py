import sys
from collections.abc import Callable
from typing import Any

import pytest

from feel321.study.cli import main

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
