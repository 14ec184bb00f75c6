"""Where results go: what may not go there is refused before minutes are spent."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.study.cli import main

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Analyze, with its arguments but for its target; it may read nothing and compute nothing."""
    monkeypatch.setattr("feel321.analysis.report.write.read_table", lambda *_, **__: 1 / 0)
    monkeypatch.chdir(tmp_path)
    for table in ("r.csv", "m.csv"):
        (tmp_path / table).write_text("")
    return ["analyze", "--ratings", "r.csv", "--manifest", "m.csv", "--out"]


@pytest.mark.parametrize("taken", ["index.html", "results.json"])
def test_a_page_that_is_not_ours_is_refused_at_once(
    verb: list[str], taken: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / taken).write_text("mine")
    assert main([*verb, "mine"]) == 1
    why = "exists and is not of a former report; move it away or choose another folder"
    assert capsys.readouterr() == ("", f"feel321: mine/{taken}: {why}\n")
    assert (tmp_path / "mine" / taken).read_text() == "mine"


def test_a_file_is_no_folder(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").write_text("mine")
    assert main([*verb, "mine"]) == 1
    told = "feel321: mine: must be a folder, got a file; choose another name\n"
    assert capsys.readouterr() == ("", told)
    assert (tmp_path / "mine").read_text() == "mine"
