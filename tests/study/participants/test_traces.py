"""Marks planted in a study are nowhere in it once somebody withdrew, and outputs elsewhere are named."""

import gzip
import json
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from feel321.study.check import build_study
from feel321.study.cli import main
from feel321.study.evidence.audit import examine
from feel321.study.folder import StudyFolder
from feel321.study.participants.traces import recording_output
from feel321.study.session import engine
from feel321.study.session.journal import utc_now
from tests.study.conftest import audit_study

WHO, SECRET = "sim002", "Zwiebelturm-4711"

ASKING = """
[[session.questions]]
name = "home"
kind = "text"
question = "Where do you live?"
personal = true
[[session.questions]]
name = "remark"
kind = "text"
question = "Anything else?"
when = "after"
"""


def grep(area: Path, mark: str) -> set[Path]:
    """Find a mark in the names and bytes of all files below a folder, unpacked where they are packed."""
    wanted = mark.encode()
    named = {path for path in area.rglob("*") if mark in path.name and not path.is_dir()}
    files = [path for path in area.rglob("*") if path.is_file() and not path.is_symlink()]
    return named | {
        path for path in files if any(wanted in one for one in unpack(path.read_bytes()))
    }


def unpack(content: bytes) -> Iterator[bytes]:
    yield content
    if content[:2] == b"\x1f\x8b":
        yield from unpack(gzip.decompress(content))
    elif content[:2] == b"PK":
        with zipfile.ZipFile(BytesIO(content)) as archive:
            for name in archive.namelist():
                yield from unpack(archive.read(name))


def say(*arguments: object) -> None:
    assert main([str(one) for one in arguments]) == 0, arguments


class Confiding:
    """A presenter whose participant answers each question with the secret."""

    def __init__(self, presenter: Any) -> None:
        self.presenter = presenter

    def show_question(self, question: Any, place: Any) -> Any:
        act = self.presenter.show_question(question, place)
        return replace(act, values={question.name: SECRET})

    def __getattr__(self, name: str) -> Any:
        return getattr(self.presenter, name)


@pytest.fixture
def planted(smallest: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StudyFolder:
    """Four sessions, of which the second holds the secret in a personal answer and in another one."""
    text = smallest.settings.read_text(encoding="utf-8")
    wider = text.replace('["sax321", "mag321"]', '["sax321", "mag321", "dft321"]')
    smallest.settings.write_text(
        f'{wider}{ASKING}[[recordings]]\nscene = "hard_taps"\nduration_s = 0.1\n[analysis]\ndraws = 200\n',
        encoding="utf-8",
    )  # fmt: skip
    build_study(smallest)
    (tmp_path / "tmp").mkdir()
    (tmp_path / "cwd").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.chdir(tmp_path / "cwd")
    begin = engine.Session.__init__

    def confide(session: Any, plan: Any, presenter: Any, *given: Any, **more: Any) -> None:
        presenter = Confiding(presenter) if plan.participant == WHO else presenter
        begin(session, plan, presenter, *given, **more)

    monkeypatch.setattr(engine.Session, "__init__", confide)
    say("simulate", smallest.path, "--participants", 4, "--seed", 3)
    return smallest


def plant_more(study: StudyFolder) -> None:
    """Plant what crashes, copies and hands leave."""
    folder = study.sessions / WHO
    (folder / "session-01.jsonl.torn1").write_text(f'{{"{SECRET}')
    (folder / ".personal.jsonl.1.ab12.part").write_text(SECRET)
    (folder / "notes.txt").write_text(SECRET)
    shutil.copytree(folder, study.path / "rehearsals" / WHO)
    (study.path / ".ratings.csv.1.ab12.part").write_text(f"participant\n{WHO}\n")
    (study.path / ".answers.csv.4711.part").write_text(SECRET)
    stage = study.path / "feel321-1-dead"
    stage.mkdir()
    (stage / "index.html").write_text(SECRET)
    temporary = study.path.parent / "tmp" / "feel321-1-dead"
    temporary.mkdir()
    (temporary / "order.pickle").write_bytes(SECRET.encode())


def make_report(folder: Path) -> None:
    """Write a report's files, as far as a withdrawal looks at them."""
    (folder / "tables").mkdir(parents=True)
    files = ["results.json", "index.html", "tables/raters.csv"]
    for name in files:
        (folder / name).write_text(f"participant,rating\n{WHO},{SECRET}\n")
    (folder / "results.json").write_text(json.dumps({"files": files, "raters": [WHO, SECRET]}))


def write_everything(study: StudyFolder, out: Path, *, really: bool) -> None:
    """Run the verbs that write something about participants; some take minutes."""
    say("note", study.path, f"said {SECRET}", "--participant", WHO)
    if really:
        say("analyze", study.path)
        say("analyze", study.path, "--out", out / "elsewhere")
        say("tradeoff", study.path, "--out", out / "tradeoff")
        say("tradeoff", study.path)
        say("power", study.path, "--participants", "4,6", "--studies", 0)
        say("export", study.path, out / "bids", "--simulated")
    else:
        make_report(study.report)
        with recording_output(study, "analyze", out / "elsewhere", now=utc_now):
            make_report(out / "elsewhere")
    say("export", study.path, out / "for-r", "--r")
    say("status", study.path, "--notes")


KEPT = {"withdrawn.json", "outputs.jsonl"}
"""Files that may hold the code of somebody who withdrew."""


@pytest.mark.parametrize("really", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_marks_are_gone_once_somebody_withdrew_and_outputs_elsewhere_are_named(
    planted: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, really: bool
) -> None:
    write_everything(planted, out := tmp_path / "out", really=really)
    plant_more(planted)
    assert len(grep(planted.path, SECRET)) > 5
    others = {path: path.read_bytes() for path in (planted.sessions / "sim001").iterdir()}
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    told = capsys.readouterr().err
    outputs = sorted(out.iterdir())
    assert len(outputs) > 1
    for path in outputs:
        assert f"{path}: " in told
    assert {path for path in grep(tmp_path, SECRET) if out not in path.parents} == set()
    left = {path.name for path in grep(tmp_path, WHO) if out not in path.parents}
    assert {"withdrawn.json"} <= left <= KEPT
    assert {path: path.read_bytes() for path in others} == others
    assert audit_study(planted) == []


@pytest.mark.parametrize("keeps_ratings", [True, False])
def test_what_was_written_wide_goes_with_the_person(
    planted: StudyFolder, *, keeps_ratings: bool
) -> None:
    """Of the others it stays, as do recordings in that folder; so too if there is no table to be written anew."""
    wide = planted.path / "data"
    (wide / "recording.csv").write_text("time,x\n0,1\n")
    before = {path.name for path in wide.iterdir()}
    others = (wide / "sim001.csv").read_bytes()
    if not keeps_ratings:
        planted.ratings.unlink()
    kept = (wide / f"{WHO}.csv").read_bytes()
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    assert {path.name for path in wide.iterdir()} == before - {f"{WHO}.csv"}
    assert (wide / "sim001.csv").read_bytes() == others
    (wide / f"{WHO}.csv").write_bytes(kept)  # it comes back with a copy
    assert any(f"{WHO}.csv: is of {WHO}, who withdrew" in line for line in audit_study(planted))
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    assert audit_study(planted) == []


def test_links_go_and_what_they_lead_to_is_named_and_left(
    planted: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_report(planted.report)
    away = tmp_path / "away"
    away.mkdir()
    folder = planted.sessions / WHO
    moved = {
        folder: away / "session",
        planted.ratings: away / "ratings",
        planted.report: away / "report",
    }
    for path, target in moved.items():
        path.rename(target)
        path.symlink_to(target)
    (planted.path / "rehearsals").mkdir()
    (planted.path / "rehearsals" / WHO).symlink_to(away / "session")
    before = {path: path.read_bytes() for path in away.rglob("*") if path.is_file()}
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    assert {path: path.read_bytes() for path in before} == before
    told = capsys.readouterr().err
    for path, target in moved.items():
        assert f"{path}: was a link and is removed; {target} is left" in told
        assert not path.is_symlink()
    assert grep(planted.path, SECRET) == set()
    assert [path.name for path in folder.iterdir()] == ["withdrawn.json"]


def test_what_was_written_elsewhere_before_a_withdrawal_is_named_until_it_is_gone(
    planted: StudyFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, away = tmp_path / "for-r", tmp_path / "away"
    say("export", planted.path, out, "--r")
    assert examine(planted).remarks == ()
    out.rename(away)
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    named = f"{out}: export wrote there before a participant withdrew"
    told = capsys.readouterr().err
    assert named in told
    assert "nothing is there now" in told
    (withdrew,) = examine(planted).remarks
    assert withdrew.startswith(f"{planted.sessions / WHO}: withdrew at the checkpoint of ")
    away.rename(out)
    (remark,) = {*examine(planted).remarks} - {withdrew}
    assert remark.startswith(named)
    shutil.rmtree(out)
    assert examine(planted).remarks == (withdrew,)


def test_audit_names_what_came_back_with_a_copy(planted: StudyFolder, tmp_path: Path) -> None:
    shutil.copytree(planted.path, tmp_path / "copy")
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    shutil.copyfile(tmp_path / "copy" / "ratings.csv", planted.ratings)
    shutil.copytree(tmp_path / "copy" / "sessions" / WHO, planted.path / "rehearsals" / WHO)
    found = "\n".join(audit_study(planted))
    assert f"ratings.csv: holds rows of {WHO}, who withdrew" in found
    assert f"is of a rehearsal of {WHO}" in found
    say("withdraw", planted.path, "--participant", WHO, "--yes")
    assert audit_study(planted) == []
    assert json.loads((planted.sessions / WHO / "withdrawn.json").read_text())["state"] == "removed"
    assert [*(planted.path / "rehearsals").iterdir()] == []
