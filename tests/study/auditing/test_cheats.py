"""Every way to falsify a study that changes data is seen with a remote, as `seen.csv` says."""

from __future__ import annotations

import csv
import random
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing.study import examine
from feel321.study.checkpoints import EVIDENCE
from feel321.study.folder import StudyFolder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

SEEN = Path(__file__).with_name("seen.csv")
LINE, FILE, REMARK, HISTORY, NO = "file and line", "file", "remark", "history", "-"
"""How something is seen: a finding names the line, or the file; a remark; by the history of checkpoints only; not."""

OUT_OF_REACH = {"times of files are changed"}
"""Changes nothing that anything is derived from."""


@dataclass
class Bench:
    """Finished studies, each with a place where it is falsified, and a remote of that place."""

    simulated: StudyFolder
    real: StudyFolder
    home: Path

    def __post_init__(self) -> None:
        self.usual = {}
        for study in (self.simulated, self.real):
            place = self.take(study)
            words = ("seal", str(place.path), "--to", str(place.path.parent / "remote.git"))
            subprocess.run([sys.executable, "-m", "feel321", *words], check=True)
            for name in ("remote.git", f"place/{EVIDENCE}"):
                own = self.home / study.path.name / name
                shutil.rmtree(study.path.parent / study.path.name / EVIDENCE, ignore_errors=True)
                shutil.copytree(own, self.home / "kept" / study.path.name / name)
            found = examine(self.take(study))
            assert found.findings == ()
            self.usual[study.path.name] = {mask(line) for line in found.remarks}

    def take(self, study: StudyFolder) -> StudyFolder:
        """Put a copy of a study into its place, with its evidence and its remote as they were sealed."""
        own, kept = self.home / study.path.name, self.home / "kept" / study.path.name
        shutil.rmtree(own, ignore_errors=True)
        shutil.copytree(study.path, own / "place")
        if kept.is_dir():
            shutil.rmtree(own / "place" / EVIDENCE, ignore_errors=True)
            shutil.copytree(kept, own, dirs_exist_ok=True)
        return StudyFolder(own / "place")

    def find_remote(self, study: StudyFolder) -> list[str]:
        """Find the remote, as a reviewer names it: a cheat need not leave it in the folder."""
        return [str(one) for one in (study.path.parent / "remote.git",) if one.is_dir()]

    def look(self, one: Any, *, before: Callable[..., object], after: Callable[..., object]) -> str:
        """Falsify a study and say how that is seen; before, after: what is done to its evidence, too."""
        base = self.real if one.is_real else self.simulated
        study = self.take(base)
        before(study)
        one.act(study)
        after(study)
        found = examine(study, remotes=self.find_remote(study))
        findings = [text for text in found.findings if EVIDENCE not in text.partition(": ")[0]]
        if findings:
            return LINE if any(re.search(r", lines? \d", text) for text in findings) else FILE
        told = {mask(line) for line in found.remarks} - self.usual[base.path.name]
        seen = [REMARK] * bool(told) + [HISTORY] * bool(found.findings)
        return " and ".join(seen) or NO


def mask(text: str) -> str:
    return re.sub(r"\d{4}-\d\d-\d\dT[\d:.+]+", "TIME", text)


def forget(study: StudyFolder) -> None:
    """Remove evidence and remote, as if there had never been any."""
    shutil.rmtree(study.path / EVIDENCE, ignore_errors=True)
    shutil.rmtree(study.path.parent / "remote.git", ignore_errors=True)


def part(study: StudyFolder) -> None:
    """Leave the evidence without its remote."""
    shutil.rmtree(study.path.parent / "remote.git")
    (study.path / EVIDENCE / "config").write_text("[core]\n\tbare = true\n", encoding="utf-8")


def leave(_study: StudyFolder) -> None:
    """Leave all as it is."""


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory, studies: Any, scripted: type) -> Bench:
    home = tmp_path_factory.mktemp("bench")
    simulated, real = home / "made" / "simulated", home / "made" / "real"
    return Bench(studies.make_simulated(simulated), studies.make_real(real, scripted), home)


def read_seen() -> dict[str, dict[str, str]]:
    with SEEN.open(encoding="utf-8", newline="") as file:
        return {row["cheat"]: row for row in csv.DictReader(file)}


def test_the_table_lists_every_cheat(cheats: Any) -> None:
    rows = read_seen()
    assert list(rows) == list(cheats.CHEATS)
    assert {name for name, row in rows.items() if row["remote"] == NO} == OUT_OF_REACH
    assert {name: row["knows"] for name, row in rows.items()} == {
        name: one.knows for name, one in cheats.CHEATS.items()
    }


def look(bench: Bench, cheats: Any, names: Iterable[str]) -> None:
    """Compare what a remote shows, though the evidence in the folder was made anew, with the table."""
    rows = read_seen()
    seen = {}
    for name in names:
        one = cheats.CHEATS[name]
        after = cheats.begin_anew if one.is_data else leave
        seen[name] = bench.look(one, before=leave, after=after)
    assert seen == {name: rows[name]["remote"] for name in seen}


def test_a_remote_shows_cheats(bench: Bench, cheats: Any) -> None:
    look(bench, cheats, random.SystemRandom().sample(list(cheats.CHEATS), 12))


@pytest.mark.soak
def test_a_remote_shows_every_cheat(bench: Bench, cheats: Any) -> None:
    look(bench, cheats, cheats.CHEATS)


@pytest.mark.soak
@pytest.mark.parametrize(("column", "before"), [("alone", forget), ("folder", part)])
def test_what_is_seen_without_a_remote(
    bench: Bench, cheats: Any, column: str, before: Callable[..., object]
) -> None:
    seen = {
        name: bench.look(one, before=before, after=leave) for name, one in cheats.CHEATS.items()
    }
    assert seen == {name: row[column] for name, row in read_seen().items()}
