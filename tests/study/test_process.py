"""The command line as a real process: start-up, pipes, and sudden death."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from feel321.analysis.report.write import SECTIONS
from feel321.study.check import build_study
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.status import read_status
from tests.study.conftest import audit_study

FEEL321 = Path(sys.executable).with_name("feel321")
HEAVY = {
    "scipy",
    "pandas",
    "matplotlib",
    "statsmodels",
    "joblib",
    "soxr",
    "psychopy",
    "sounddevice",
    "numpy",
    "pydantic",
}
STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.3
[[recordings]]
scene = "hard_taps"
duration_s = 0.3
[stimuli]
reducers = ["sax321", "dft321"]
[session]
repeats = 3
"""


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [FEEL321, *map(str, arguments)], capture_output=True, text=True, check=False, cwd=cwd
    )


def spend(*command: str | Path, cwd: Path) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Run a command that succeeds: the processor's time that it took, in s, and what it said."""
    before = os.times()
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)
    assert done.returncode == 0, done.stderr
    after = os.times()
    return (
        after.children_user + after.children_system - before.children_user - before.children_system,
        done,
    )


@pytest.mark.parametrize("module", ["feel321.study", "feel321.study.cli", "feel321.study.verbs"])
def test_nothing_heavy_is_imported_at_start_up(module: str) -> None:
    code = f"import sys, {module}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "feel321" in done.stdout.split()
    assert HEAVY & set(done.stdout.split()) == set()


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["reduce", "--help"], ["analyze", "--help"]]
)
def test_help_costs_little_more_than_starting_numpy(
    arguments: Sequence[str], tmp_path: Path
) -> None:
    def measure(*command: str | Path) -> float:
        return spend(*command, cwd=tmp_path)[0]

    pairs = [
        (measure(sys.executable, "-c", "import numpy"), measure(FEEL321, *arguments))
        for _ in range(5)
    ]
    numpy_alone, whole = (min(times) for times in zip(*pairs, strict=True))
    # scipy's filters, pandas or matplotlib would each cost several times what numpy does.
    assert whole / numpy_alone < 5


def test_a_reader_who_goes_away_is_no_error(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    command = [FEEL321, "new", tmp_path / "a"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")
    assert (tmp_path / "a" / "study.toml").is_file()


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = StudyFolder(tmp_path_factory.mktemp("uninterrupted"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    assert run("simulate", study.path, "--participants", 3).returncode == 0
    return study


def make_copy(study: StudyFolder, folder: Path) -> StudyFolder:
    copy = StudyFolder(folder)
    folder.mkdir()
    copy.settings.write_text(STUDY, encoding="utf-8")
    copy.stimuli.symlink_to(study.stimuli)
    return copy


def heed_ctrl_c() -> None:
    """Undo what a shell does to what it runs in the background: it ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def stop_when(study: StudyFolder, n_bytes: int, sent: signal.Signals) -> tuple[int, str]:
    """Simulate in a process of its own, send it a signal once its journals hold so many bytes; its code and stderr."""
    command = [FEEL321, "simulate", study.path, "--participants", "3"]
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **streams, text=True, preexec_fn=heed_ctrl_c) as process:  # noqa: PLW1509 - no threads
        while (
            process.poll() is None and sum(path.stat().st_size for path in study.journals) < n_bytes
        ):
            time.sleep(0.0005)
        process.send_signal(sent)
        assert process.stderr is not None
        stderr = process.stderr.read()
    return process.returncode, stderr


def stop_in_time(
    uninterrupted: StudyFolder, path: Path, *, n_bytes: int, sent: signal.Signals
) -> tuple[StudyFolder, tuple[int, str]]:
    """Stop copies until one was not over before: on a busy machine the signal may come late."""
    ended = (0, "")
    for number in range(20):
        study = make_copy(uninterrupted, path / f"stopped{number}")
        if (ended := stop_when(study, n_bytes, sent)) != (0, ""):
            break
    return study, ended


@pytest.mark.parametrize(
    "n_bytes", [9_000, 40_000, *(pytest.param(n, marks=pytest.mark.soak) for n in (1, 75_000))]
)
def test_a_killed_simulation_goes_on_without_loss_or_doubling(
    uninterrupted: StudyFolder, tmp_path: Path, n_bytes: int
) -> None:
    study, ended = stop_in_time(uninterrupted, tmp_path, n_bytes=n_bytes, sent=signal.SIGKILL)
    assert ended == (-signal.SIGKILL, "")
    # A kill between plan and journal, or inside a record, is a state that status can read.
    done = sum(entry.done for entry in read_status(study).participants)
    assert done < 3 * 60
    assert run("simulate", study.path, "--participants", 3).returncode == 0
    assert study.ratings.read_bytes() == uninterrupted.ratings.read_bytes()
    assert audit_study(study) == []


def test_ctrl_c_is_answered_in_one_line_and_the_simulation_goes_on(
    uninterrupted: StudyFolder, tmp_path: Path
) -> None:
    study, ended = stop_in_time(uninterrupted, tmp_path, n_bytes=20_000, sent=signal.SIGINT)
    assert ended == (
        130,
        "feel321: interrupted; what is done is kept, the same command continues\n",
    )
    assert audit_study(study) == []
    assert run("simulate", study.path, "--participants", 3).returncode == 0
    assert study.ratings.read_bytes() == uninterrupted.ratings.read_bytes()


def test_demo_runs_the_whole_chain_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    imports, _ = spend(
        sys.executable, "-c", "import statsmodels.api, matplotlib.pyplot", cwd=tmp_path
    )
    cost, first = spend(FEEL321, "demo", "--out", "demo", cwd=tmp_path)
    # A minute of the processor's time on a calm machine, where these imports take two seconds of it.
    assert cost / imports < 30
    report = tmp_path / first.stdout.splitlines()[-1]
    assert report == tmp_path / "demo" / "report" / "index.html"
    assert "simulated" in report.read_text(encoding="utf-8").lower()
    ratings = (tmp_path / "demo" / "ratings.csv").read_bytes()
    assert ratings.count(b"\n") == 1 + 16 * 144
    monkeypatch.chdir(tmp_path)
    # The second report may be short.
    monkeypatch.setattr("feel321.analysis.report.write.SECTIONS", SECTIONS[2:3])
    assert main(["demo", "--out", "demo"]) == 0
    again = capsys.readouterr()
    assert (again.err, again.out) == (first.stderr, first.stdout)
    assert (tmp_path / "demo" / "ratings.csv").read_bytes() == ratings
