"""The table of cheats in `docs/audit.md`: what sees each of them."""

from __future__ import annotations

import csv
import re
import shutil
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing import anchors, sealing
from feel321.study.auditing.checkpoints import CHECKPOINTS, find_chain
from feel321.study.auditing.study import examine
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

PAGE = Path(__file__).parents[3] / "docs" / "audit.md"
BEFORE = Path(__file__).with_name("before.csv")

LINE, FILE, REMARK, CHAIN, NO = "file and line", "file", "remark", "chain", "-"
"""How something is seen: as a finding that names the line, or the file; among the remarks; by the chain only; not."""


@dataclass
class Bench:
    """Finished studies, each with a place where it is falsified, and anchors of that place outside."""

    simulated: StudyFolder
    real: StudyFolder
    home: Path

    def __post_init__(self) -> None:
        self.home.mkdir()
        with configure(self.home / "config"):
            sealing.choose_key()
            anchors.add_rules(folder=self.home / "anchors")
            for study in (self.simulated, self.real):
                sealing.seal_study(self.take(study), now=utc_now)
                shutil.copy(find_chain(self._at(study)), find_chain(study))
        self.usual = {
            study.path.name: self._read_remarks(study) for study in (self.simulated, self.real)
        }

    def take(self, study: StudyFolder) -> StudyFolder:
        """Put a copy of a study into its place."""
        shutil.rmtree(self._at(study).path, ignore_errors=True)
        shutil.copytree(study.path, self._at(study).path)
        return self._at(study)

    def _at(self, study: StudyFolder) -> StudyFolder:
        return StudyFolder(self.home / "place" / study.path.name)

    def _read_remarks(self, study: StudyFolder) -> set[str]:
        with configure(self.home / "config"):
            found = examine(self.take(study))
        assert found.findings == ()
        return {_mask(line) for line in found.remarks}

    def look(self, one: Any, after: Callable[[StudyFolder], None], *, is_anchored: bool) -> str:
        """Falsify a study and say how that is seen; after: what is done to the checkpoints, too."""
        base = self.real if one.is_real else self.simulated
        study = self.take(base)
        one.act(study)
        after(study)
        with configure(self.home / "config") if is_anchored else configure(self.home / "nowhere"):
            found = examine(study)
        findings = [text for text in found.findings if CHECKPOINTS not in text.partition(": ")[0]]
        if findings:
            return LINE if any(re.search(r", line \d", text) for text in findings) else FILE
        told = {_mask(line) for line in found.remarks} - self.usual[base.path.name]
        is_told = bool(told) or "withdrew" in found.sentence or "recorded or" in found.sentence
        seen = [REMARK] * is_told + [CHAIN] * bool(found.findings)
        return " and ".join(seen) or NO


def _mask(text: str) -> str:
    return re.sub(r"\d{4}-\d\d-\d\dT[\d:.+]+", "TIME", text)


@contextmanager
def configure(folder: Path) -> Iterator[None]:
    """Be on the rig that has its configuration in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FEEL321_CONFIG", str(folder))
        yield


def forget(study: StudyFolder) -> None:
    """Remove the checkpoints, as if there had never been any."""
    find_chain(study).unlink(missing_ok=True)


def leave(_study: StudyFolder) -> None:
    """Leave the checkpoints as they are."""


def write_table(rows: Mapping[str, Sequence[str]]) -> str:
    """Write the table: of each cheat, what saw it before, and what sees it now."""
    head = (
        "what was done",
        "knows how to",
        "audit 0.13",
        "kept seal 0.13",
        "audit alone",
        "checkpoints",
        "anchor",
    )
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([
        *lines,
        *("| " + " | ".join([name, *row]) + " |" for name, row in rows.items()),
    ])


def read_table() -> dict[str, tuple[str, ...]]:
    """Read the table from the page."""
    lines = [
        line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")
    ]
    cells = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines]
    return {
        name: tuple(row)
        for name, *row in cells
        if len(row) == 6 and name not in {"what was done", "---"}
    }


def read_before() -> dict[str, tuple[str, str]]:
    """Read what saw each cheat before there were checkpoints; measured with the version before them."""
    with BEFORE.open(encoding="utf-8", newline="") as file:
        return {row["cheat"]: (row["audit"], row["seal"]) for row in csv.DictReader(file)}
