import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.wav import write_wav
from feel321.study import cli
from feel321.study.check import build_study, check_study
from feel321.study.folder import StudyFolder
from feel321.study.session.plan import make_plan
from feel321.study.settings.read import make_design, open_recordings, read_settings

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
    assert "must have one of scene, file, files, got file and files" in refuse(
        'files = "corpus/*.wav"', both
    )
    assert "at most the 8 recordings of the study, got 9" in refuse("= 3", "= 9")
    (corpus.path / "corpus" / "tap000.csv").touch()
    assert "recording name 'tap000' is there twice" in refuse("*.wav", "tap*")


def test_each_participant_feels_a_share_and_every_recording_comes_equally_often(
    corpus: StudyFolder,
) -> None:
    _, stimuli = build_study(corpus)
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


KILLED = """
import os, signal, sys
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.check import build_study

def kill(done, total):
    if done == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

build_study(StudyFolder(Path(sys.argv[1])), progress=kill)
"""


def read_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("steps", [5, 13])
def test_a_killed_build_is_done_again(
    corpus: StudyFolder, tmp_path_factory: pytest.TempPathFactory, steps: int
) -> None:
    """Of 8 recordings x 3 stimuli, measured in 8 steps and written in 8 more."""
    command = [sys.executable, "-c", KILLED, str(corpus.path), str(steps)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    build_study(corpus)
    other = StudyFolder(tmp_path_factory.mktemp("whole"))
    write_corpus(other.path, 8)
    build_study(other)
    assert read_files(corpus.stimuli) == read_files(other.stimuli)
    assert not list(corpus.stimuli.glob(".parts*"))


def test_long_lists_of_faults_are_cut(
    corpus: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(60):
        (corpus.path / "corpus" / f"empty{number}.wav").touch()
    assert cli.main(["build", str(corpus.path)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert sum("recording 'empty" in line for line in lines) == 20
    assert lines[-1] == "feel321: and 40 more like these; feel321 check --json lists all of a study"
