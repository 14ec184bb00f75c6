from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis import browser
from feel321.doors import announcing
from feel321.stimuli.sets.build import BUILT
from feel321.stimuli.sets.manifest import read_details
from feel321.stimuli.wav import write_wav
from feel321.study import cli
from feel321.study.folder import StudyFolder
from feel321.study.session.plan import compare_plans, create_plan, make_plan, require_plan
from feel321.study.settings.read import make_design, open_recordings, read_settings
from feel321.study.workflow import build_study, check_study

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

CORPUS = """
[[recordings]]
files = "corpus/*.wav"
unit = "m/s^2"
[stimuli]
reducers = ["sax321", "dft321"]
anchors = false
below_threshold = "accept"
[rig]
rate_hz = 2000.0
[session]
protocols = ["realism"]
recordings_per_participant = 3
"""


def write_corpus(folder: Path, count: int) -> None:
    (folder / "corpus").mkdir()
    for number in range(count):
        noise = np.random.default_rng(number).standard_normal((3, 400 + number))
        write_wav(folder / "corpus" / f"tap{number:03d}.wav", noise, 2000)
    (folder / "study.toml").write_text(CORPUS, encoding="utf-8")


@pytest.fixture
def corpus(tmp_path: Path) -> StudyFolder:
    """A study of eight short recordings, named by one pattern."""
    write_corpus(tmp_path, 8)
    return StudyFolder(tmp_path)


@pytest.fixture
def refuse(corpus: StudyFolder) -> Callable[[str, str], str]:
    def read(old: str, new: str) -> str:
        corpus.settings.write_text(CORPUS.replace(old, new), encoding="utf-8")
        with pytest.raises(ValueError, match=r"study\.toml: ") as caught:
            read_settings(corpus.settings)
        return str(caught.value)

    return read


def test_a_pattern_stands_for_a_table_per_file(corpus: StudyFolder) -> None:
    (corpus.path / "corpus" / ".hidden.wav").touch()
    (corpus.path / "corpus" / "folder.wav").mkdir()
    given = read_settings(corpus.settings)
    tables = "".join(
        f'[[recordings]]\nfile = "corpus/tap{number:03d}.wav"\nunit = "m/s^2"\n'
        for number in range(8)
    )
    corpus.settings.write_text(tables + CORPUS.partition('"m/s^2"')[2], encoding="utf-8")
    assert given == read_settings(corpus.settings)
    names = [one.name for one in open_recordings(given, corpus.path)]
    assert names == [f"tap{number:03d}" for number in range(8)]


def test_what_a_pattern_cannot_say_is_refused(
    refuse: Callable[[str, str], str], corpus: StudyFolder
) -> None:
    said = refuse("*.wav", "*.flac")
    assert "recordings[1].files must match at least one file, got 'corpus/*.flac'" in said
    assert "within the study's folder" in refuse("corpus/*", f"{corpus.path}/corpus/*")
    both = 'files = "corpus/*.wav"\nfile = "corpus/tap000.wav"'
    assert "must not have file beside files" in refuse('files = "corpus/*.wav"', both)
    assert "at most the 8 recordings of the study, got 9" in refuse("= 3", "= 9")
    (corpus.path / "corpus" / "tap000.csv").touch()
    assert "recording name 'tap000' is there twice" in refuse("*.wav", "tap*")


def test_each_participant_feels_a_share_and_every_recording_comes_equally_often(
    corpus: StudyFolder,
) -> None:
    _, stimuli = build_study(corpus, page=False)
    design = make_design(read_settings(corpus.settings))
    felt: Counter[str] = Counter()
    for number in range(1, 9):
        plan = make_plan(design, stimuli, f"p{number}", number=number, simulated=True)
        own = {trial.recording for trial in plan.trials}
        assert len(own) == 3
        felt.update(own)
        assert max(felt.values()) - min(felt[f"tap{n:03d}"] for n in range(8)) <= 1
    assert set(felt.values()) == {3}
    assert check_study(corpus).problems == ()


def test_the_share_stands_in_the_plan(corpus: StudyFolder, tmp_path: Path) -> None:
    _, stimuli = build_study(corpus, page=False)
    design = make_design(read_settings(corpus.settings))
    plan = make_plan(design, stimuli, "p1", number=1, simulated=True)
    create_plan(tmp_path / "plan.json", plan)
    stored = require_plan(tmp_path / "plan.json")
    assert (stored.recordings_per_participant, stored) == (3, plan)
    text = CORPUS.replace("recordings_per_participant = 3", "")
    corpus.settings.write_text(text, encoding="utf-8")
    whole = make_plan(
        make_design(read_settings(corpus.settings)), stimuli, "p1", number=1, simulated=True
    )
    assert compare_plans(stored, whole) == ["recordings_per_participant 3 -> None"]
    assert {trial.recording for trial in whole.trials} == {f"tap{n:03d}" for n in range(8)}


KILLED = """
import os, signal, sys
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.workflow import build_study

def kill(done, total):
    if done == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

build_study(StudyFolder(Path(sys.argv[1])), page=False, progress=kill)
"""


def read_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize(("steps", "most"), [(5, 9), (13, 0)])
def test_a_killed_build_goes_on_where_it_was(
    corpus: StudyFolder, tmp_path_factory: pytest.TempPathFactory, steps: int, most: int
) -> None:
    """Of 8 recordings x 3 stimuli, measured in 8 steps and written in 8 more."""
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(corpus.path), str(steps)], check=False
    )
    assert killed.returncode == -signal.SIGKILL
    finished = corpus.stimuli.glob(".parts*/finished/*.wav")
    before = {path.name: path.stat().st_mtime_ns for path in finished}
    assert len(before) >= 3 * (steps - 8)
    rendered: list[str] = []
    with announcing(rendered.append):
        build_study(corpus, page=False)
    assert len(rendered) <= most
    for name, time_ns in before.items():  # moved, not written again
        assert (corpus.stimuli / name).stat().st_mtime_ns == time_ns
    other = StudyFolder(tmp_path_factory.mktemp("whole"))
    write_corpus(other.path, 8)
    build_study(other, page=False)
    assert read_files(corpus.stimuli) == read_files(other.stimuli)
    assert not list(corpus.stimuli.glob(".parts*"))


COUNTING = """
import weakref
import numpy as np
from feel321.stimuli import Recording

OPEN = set()

def read_raw(path):
    samples = np.fromfile(path).reshape(3, -1)
    OPEN.add(id(samples))
    weakref.finalize(samples, OPEN.discard, id(samples))
    with (path.parent / "open.txt").open("a") as file:
        file.write(f"{len(OPEN)}\\n")
    return Recording(samples, 2000.0)
"""


def test_recordings_are_open_only_while_they_are_used(tmp_path: Path) -> None:
    (tmp_path / "methods").mkdir()
    (tmp_path / "corpus").mkdir()
    (tmp_path / "methods" / "raw.py").write_text(COUNTING.replace("\\\\", "\\"), encoding="utf-8")
    for number in range(8):
        np.random.default_rng(number).standard_normal((3, 400)).tofile(
            tmp_path / "corpus" / f"tap{number}.raw"
        )
    text = CORPUS.replace("*.wav", "*.raw").replace('unit = "m/s^2"\n', "")
    study = StudyFolder(tmp_path)
    study.settings.write_text(
        f'{text}[formats]\nraw = "methods/raw.py:read_raw"\n', encoding="utf-8"
    )
    assert check_study(study).problems == ()
    build_study(study, page=False)
    opened = [int(line) for line in (tmp_path / "corpus" / "open.txt").read_text().split()]
    assert len(opened) == 8 + 8  # by check, and by the first round of build
    assert max(opened) <= 2  # threads of one process


@pytest.mark.parametrize("keep", [0, 1, 40, 400, -2])
def test_a_damaged_manifest_json_is_one_line_with_its_name(corpus: StudyFolder, keep: int) -> None:
    build_study(corpus, page=False)
    path = corpus.stimuli / "manifest.json"
    whole = json.loads(path.read_text(encoding="utf-8"))
    assert read_details(corpus.stimuli).recipe == whole["recipe"]
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"^[^\n]*manifest\.json: is missing or damaged [^\n]*$"):
        read_details(corpus.stimuli)


def test_long_lists_of_faults_are_cut(
    corpus: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(60):
        (corpus.path / "corpus" / f"empty{number}.wav").touch()
    assert cli.main(["build", str(corpus.path)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert sum("recording 'empty" in line for line in lines) == 20
    assert lines[-1] == "feel321: and 40 more like these; feel321 check --json lists all of a study"


def test_the_page_of_a_large_set_shows_a_part_and_says_so(
    corpus: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(browser, "MOST_SHOWN", 9)
    build_study(corpus)
    page = (corpus.stimuli / "index.html").read_text(encoding="utf-8")
    assert "This page shows 3 of 8 recordings, spread evenly; manifest.csv lists all" in page
    assert [f"tap{n:03d}__dft321__as_is.wav" in page for n in range(8)] == [
        n in {0, 3, 6} for n in range(8)
    ]


@pytest.mark.soak
def test_a_build_of_a_thousand_that_is_killed_twice_gives_the_same_bytes(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """What was done is not done again, but for the few recordings that were under way."""
    write_corpus(tmp_path, 1000)
    other = StudyFolder(tmp_path_factory.mktemp("whole"))
    write_corpus(other.path, 1000)
    build_study(other, page=False)
    for steps in (500, 1500):
        command = [sys.executable, "-c", KILLED, str(tmp_path), str(steps)]
        assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
        (parts,) = (tmp_path / "stimuli").glob(".parts*")
        lines = (parts / BUILT).read_text(encoding="utf-8").splitlines()
        assert len([line for line in lines if line]) >= min(steps, 1000) * 3
    written = {path.name: path.stat().st_mtime_ns for path in (parts / "finished").glob("*.wav")}
    assert len(written) >= 500 * 3
    rendered: list[str] = []
    with announcing(rendered.append):
        build_study(StudyFolder(tmp_path), page=False)
    assert not rendered
    for name, time_ns in written.items():
        assert (tmp_path / "stimuli" / name).stat().st_mtime_ns == time_ns
    assert read_files(tmp_path / "stimuli") == read_files(other.stimuli)
    assert check_study(StudyFolder(tmp_path)).problems == ()
