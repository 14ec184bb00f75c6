"""SIGTERM and a closed terminal end every verb as Ctrl-C does: one line, no process and no unfinished file left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from feel321.study.check import build_study
from feel321.study.folder import StudyFolder

FEEL321 = Path(sys.executable).with_name("feel321")
STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 2.0
[[recordings]]
scene = "hard_taps"
duration_s = 2.0
[stimuli]
reducers = ["sax321", "dft321", "pca321"]
[session]
repeats = 1
"""
VERBS: dict[str, tuple[str, ...]] = {
    "build": ("build", "STUDY", "--workers", "2"),
    "simulate": ("simulate", "STUDY", "--participants", "500"),
    "analyze": ("analyze", "STUDY"),
    "tradeoff": ("tradeoff", "STUDY", "--workers", "2"),
    "power": ("power", "STUDY", "--workers", "2"),
    "export": ("export", "STUDY", "STUDY/r", "--r"),
}


def list_children(parent: int) -> set[int]:
    """The processes that a process has begun, and theirs."""
    found = {parent}
    for _ in range(4):
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) in found and fields[0] != "Z":
                found.add(int(stat.parent.name))
    return found - {parent}


@pytest.fixture(scope="module")
def rated(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = StudyFolder(tmp_path_factory.mktemp("signals"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    command = [FEEL321, "simulate", study.path, "--participants", "6"]
    subprocess.run(command, check=True, capture_output=True)
    return study


def is_busy(name: str, pid: int, study: Path) -> bool:
    """Whether a verb has begun: it has its workers, a session of its own, or what it computes with."""
    if "--workers" in VERBS[name]:
        return len(list_children(pid)) >= 2
    if name == "simulate":
        return len(list(study.glob("sessions/*/*.jsonl"))) > 6
    return "/pandas/" in Path(f"/proc/{pid}/maps").read_text()


def list_unfinished(folder: Path) -> list[Path]:
    names = [*folder.rglob(".*.part"), *folder.rglob("feel321-*")]
    return [one for one in names if "stimuli" not in one.parts or one.suffix == ".part"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc to find processes in")
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "build" else pytest.mark.soak) for name in VERBS],
)
def test_sigterm_ends_a_verb_and_all_that_it_began(
    name: str, rated: StudyFolder, tmp_path: Path
) -> None:
    words = [word.replace("STUDY", str(rated.path)) for word in VERBS[name]]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    if name == "build":  # of a study that has no stimuli yet
        words[1] = str(tmp_path)
        (tmp_path / "study.toml").write_text(STUDY.replace("2.0", "20.0"), encoding="utf-8")
    with subprocess.Popen(
        [FEEL321, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment,
    ) as verb:  # fmt: skip
        while verb.poll() is None and not is_busy(name, verb.pid, rated.path):
            time.sleep(0.02)
        children = list_children(verb.pid)
        verb.send_signal(signal.SIGTERM)
        _, said = verb.communicate(timeout=60)
    lines = said.splitlines()
    assert (verb.returncode, len(lines)) == (143, 1), said
    assert lines[0].startswith("feel321: ended by SIGTERM")
    deadline = time.monotonic() + 20
    while any(Path(f"/proc/{one}").exists() for one in children) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert [one for one in children if Path(f"/proc/{one}").exists()] == []
    assert [*list_unfinished(rated.path), *list_unfinished(tmp_path)] == []
