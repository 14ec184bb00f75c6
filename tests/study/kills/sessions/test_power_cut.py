"""Power cuts: a journal that ends at any byte."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal

TAIL = 4096
"""So many bytes at the end of a journal may be gone."""


def cut(
    whole: StudyFolder, study: StudyFolder, *, n_bytes: int, tail: bytes = b""
) -> tuple[Path, bytes]:
    """Copy a participant whose journal lost so many bytes at its end; gives the journal and what is left of a line."""
    shutil.rmtree(study.sessions, ignore_errors=True)
    shutil.copytree(whole.sessions / "sim001", study.sessions / "sim001")
    (journal,) = study.journals
    content = journal.read_bytes()[:-n_bytes] + tail
    journal.write_bytes(content)
    return journal, content.rpartition(b"\n")[2]


def check_cut(
    lab: Any, study: StudyFolder, presenter: str, *, n_bytes: int, tail: bytes = b""
) -> None:
    whole = lab.find_whole("abx", presenter)
    journal, torn = cut(whole, study, n_bytes=n_bytes, tail=tail)
    kept = journal.read_bytes().removesuffix(torn)
    lab.session("abx", presenter).lead(study)
    assert journal.read_bytes().startswith(kept), n_bytes
    recovered = [
        record.data for record in read_journal(journal).records if record.event == "recovered"
    ]
    moved = [path.read_bytes() for path in journal.parent.glob("*.torn*")]
    assert moved == ([torn] if torn else []), n_bytes
    assert recovered == (
        [{"torn_bytes": len(torn), "moved_to": f"{journal.name}.torn1"}] if torn else []
    ), n_bytes
    lab.compare(study, "abx", presenter, told=f"{presenter}, {n_bytes} bytes cut off")


@pytest.mark.parametrize("presenter", ["observer", "scripted"])
def test_a_journal_that_ends_anywhere(lab: Any, presenter: str, tmp_path: Path) -> None:
    study = lab.make_study(tmp_path / "study")
    for n_bytes in range(1, TAIL + 1, 193):
        check_cut(lab, study, presenter, n_bytes=n_bytes)


@pytest.mark.soak
@pytest.mark.parametrize("first", range(1, TAIL + 1, 256))
@pytest.mark.parametrize("presenter", ["observer", "scripted"])
def test_a_journal_that_ends_at_any_byte(
    lab: Any, presenter: str, first: int, tmp_path: Path
) -> None:
    study = lab.make_study(tmp_path / "study")
    for n_bytes in range(first, first + 256):
        check_cut(lab, study, presenter, n_bytes=n_bytes)


def test_a_line_whose_end_the_disk_filled_with_zeros(lab: Any, tmp_path: Path) -> None:
    """Some file systems keep the length of what was never written."""
    study = lab.make_study(tmp_path / "study")
    for n_bytes in (30, 700, 1500):
        check_cut(lab, study, "scripted", n_bytes=n_bytes, tail=bytes(64))
