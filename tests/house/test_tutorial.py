"""The tutorial: thirteen short chapters whose commands run, one after the other, as they stand there."""

import json
import re
import shlex
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from feel321.study.cli import main

CHAPTERS, LINES = 13, 15
FEW = ["saz321", "soc321", "mag321", "dft321", "dft321_windowed"]
COMMAND = re.compile(r"^(?:.*<<'EOF'\n(?:.*\n)*?EOF|.+)$", re.MULTILINE)
"""A line of a block, or a line with the text that it is given."""


@pytest.fixture(scope="module")
def chapters(root: Path) -> dict[str, str]:
    """Title -> text."""
    text = (root / "docs" / "tutorial.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (\d+\. .*)$", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_there_are_thirteen_short_chapters(chapters: dict[str, str]) -> None:
    numbers = [int(title.partition(".")[0]) for title in chapters]
    assert numbers == list(range(1, CHAPTERS + 1))
    lengths = [sum(map(bool, text.split("\n"))) for text in chapters.values()]
    assert max(lengths) <= LINES


def shorten(path: Path) -> None:
    """Make a study small: half a second of its scenes, the reducers that claims name, few draws."""
    text = path.read_text(encoding="utf-8")
    if "landin2010" in text:
        text = re.sub(r"^reducers = \[\n.*?\]", f"reducers = {FEW}", text, flags=re.M | re.S)
    text = re.sub(r"^duration_s = .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^(scene = .*)$", r"\1\nduration_s = 0.5", text, flags=re.MULTILINE)
    head = "[analysis]\n"
    text = text if head in text else f"{text}\n{head}"
    path.write_text(text.replace(head, f"{head}draws = 100\n"), encoding="utf-8")


def run_block(text: str, folder: Path, *, small: bool) -> None:
    """Run a block of commands: feel321's in this process, all others in a shell."""
    for command in COMMAND.findall(text):
        if not command.startswith("feel321 "):
            subprocess.run(command, shell=True, check=True, cwd=folder)  # noqa: S602 - what a reader would paste
            continue
        words = shlex.split(command)
        assert main(words[1:]) == 0, command
        if small and "--study" in words:
            shorten(folder / words[2] / "study.toml")


@pytest.mark.parametrize("small", [True, pytest.param(False, marks=pytest.mark.soak)])
def test_every_command_runs_and_the_report_answers_the_paper(
    chapters: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, small: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    for title, body in chapters.items():
        for language, text in re.findall(r"^```(\w+)\n(.*?)^```", body, re.MULTILINE | re.DOTALL):
            if language == "python":
                exec(compile(text, title, "exec"), {})  # noqa: S102 - a reader may paste it
            else:
                run_block(text, tmp_path, small=small)
    manifest = pd.read_csv("vinyl/stimuli/manifest.csv")
    assert "my_vinyl" in set(manifest["recording"])
    claims = pd.read_csv("vinyl/report/tables/paper_claims.csv")
    verdicts = claims[claims["quantity"] == "verdict"]
    assert verdicts["note"].isin(["agrees", "differs", "open", "not estimable"]).all()
    assert set(verdicts.loc[verdicts["measure"] == "slope", "note"]) == {"agrees"}
    results = json.loads((tmp_path / "vinyl/report/results.json").read_bytes())
    assert results["simulated"] is True
    assert results["verdicts"]
