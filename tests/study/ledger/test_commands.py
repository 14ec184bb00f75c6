from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.cli import main
from feel321.study.ledger.slots import find_lost

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


def test_ledger_shows_numbers_states_and_progress(begun: Any, say: Say) -> None:
    code, out, err = say("ledger", begun.study.path)
    assert (code, err) == (0, "")
    assert [line.split() for line in out.splitlines()] == [
        ["number", "participant", "state", "done", "of"],
        ["1", "p01", "running", "2", "4"],
        ["2", "p02", "running", "0", "4"],
        ["1", "sim001", "finished", "4", "4", "(simulated)"],
    ]


def test_ledger_as_json_holds_the_anchors(begun: Any, say: Say) -> None:
    code, out, _ = say("ledger", begun.study.path, "--json")
    first = json.loads(out)[0]
    assert code == 0
    assert (first["participant"], first["number"], first["state"], first["done"]) == (
        "p01",
        1,
        "running",
        2,
    )
    assert [(anchor["journal"], anchor["lines"]) for anchor in first["anchors"]] == [
        ("session-01.jsonl", 7)
    ]


def test_ledger_of_a_study_without_participants_has_no_rows(lab: Any, say: Say) -> None:
    for arguments in (["--rebuild"], []):
        code, out, err = say("ledger", lab.study.path, *arguments)
        assert (code, len(out.splitlines()), err) == (0, 1, "")


def test_a_missing_ledger_is_told_and_nothing_is_written(begun: Any, say: Say) -> None:
    begun.study.ledger.unlink()
    code, out, err = say("ledger", begun.study.path)
    assert (code, out) == (1, "")
    assert err == (
        f"feel321: {begun.study.ledger}: is missing, so losses cannot be detected; rebuild it: "
        f"feel321 ledger {begun.study.path} --rebuild\n"
    )
    assert say("status", begun.study.path)[0] == 0
    assert say("audit", begun.study.path)[0] == 1
    assert list(begun.study.sessions.glob("ledger*")) == []


def test_a_rebuild_tells_what_it_forgets(begun: Any, say: Say) -> None:
    (begun.study.sessions / "p02" / "session-01.jsonl").unlink()
    code, out, err = say("ledger", begun.study.path, "--rebuild")
    assert code == 0
    assert "p02             claimed" in out
    assert err.endswith("sessions/p02/session-01.jsonl: is gone, 1 lines of it were seen\n")
    (trace,) = find_lost(begun.study)
    assert trace.startswith(f"{begun.study.ledger}: was rebuilt at 2")
    assert trace.endswith("sessions/p02/session-01.jsonl: is gone, 1 lines of it were seen")


def test_a_damaged_ledger_is_one_line(begun: Any, say: Say) -> None:
    path = begun.study.ledger
    path.write_bytes(b"x" * 1000)
    for arguments in (
        ["ledger"],
        ["ledger", "--rebuild"],
        ["withdraw", "--keep-data", "--participant", "p01"],
    ):
        code, out, err = say(*arguments, begun.study.path)
        assert (code, out) == (1, "")
        assert err == (
            f"feel321: {path}: got a damaged file (file is not a database); move it away, then rebuild it from the "
            "journals: feel321 ledger --rebuild\n"
        )
    path.unlink()
    assert say("ledger", "--rebuild", begun.study.path)[0] == 0


def test_withdraw_wants_to_be_meant(begun: Any, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    code, _, err = say("withdraw", begun.study.path, "--participant", "p01")
    assert (code, err.count("\n")) == (2, 1)
    assert "no terminal to ask for confirmation; add --yes" in err
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    for answer, expected in (("n", 1), ("y", 0)):
        monkeypatch.setattr(
            "click.termui.visible_prompt_func", lambda _prompt, answer=answer: answer
        )
        code, out, err = say("withdraw", begun.study.path, "--participant", "p01")
        assert code == expected
        assert (begun.study.sessions / "p01" / "plan.json").exists() == (answer == "n")
        assert ("nothing was removed" in out) == (answer == "n")


def test_withdraw_says_what_was_removed_and_what_is_left_to_do(begun: Any, say: Say) -> None:
    begun.study.report.mkdir()
    code, out, err = say(
        "withdraw", begun.study.path, "--participant", "p01", "--yes", "--reason", "moved away"
    )
    assert code == 0
    assert out == (
        f"{begun.study.sessions / 'p01'}: removed 2 files; a tombstone keeps the code. "
        "Copies that feel321 did not make must be removed by hand\n"
    )
    assert err.startswith(f"feel321: warning: {begun.study.report}: was removed because it held")
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
