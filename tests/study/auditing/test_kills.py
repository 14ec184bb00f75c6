"""SIGKILL at random moments of every verb that writes: the same command finishes, nothing is lost or doubled."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from feel321.study.folder import StudyFolder, create_study
from feel321.study.participants.roster import read_holders
from feel321.study.session.journal import read_journal
from tests.study.conftest import audit_study, make_settings

SETTINGS = make_settings("bumps", reducers=("sax321", "mag321", "dft321"), session="repeats = 2\n")
SETTINGS += "[analysis]\ndraws = 100\n"

STATION = str(Path(__file__).parents[1] / "watch" / "station.py")
"""A session with the engine, in real time: what `run` does behind its screen."""

FEEL321 = ("-m", "feel321")

VERBS: dict[str, Sequence[str]] = {
    "build": (*FEEL321, "build", "{main}", "-q"),
    "simulate": (*FEEL321, "simulate", "{main}", "--participants", "6", "--seed", "3", "-q"),
    "run": (STATION, "{other}", "p01", "3", "0.05"),
    "collect": (*FEEL321, "collect", "{other}", "--into", "{main}", "-q"),
    "analyze": (*FEEL321, "analyze", "{main}", "-q"),
    "withdraw": (*FEEL321, "withdraw", "{main}", "--participant", "sim002", "--yes", "-q"),
}
"""The commands, in the order of a study."""

KILLS = 120


def call(words: Sequence[str], *, until_s: float | None = None) -> tuple[int, float]:
    """Run a verb, killed after some seconds if it is still at work; its exit code, and how long it took."""
    begun = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        process.communicate(timeout=until_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    return process.returncode, time.monotonic() - begun


def read_lines(studies: Sequence[StudyFolder]) -> dict[Path, bytes]:
    """Read the whole lines of all journals: each was acknowledged."""
    contents = {path: path.read_bytes() for one in studies for path in one.journals}
    return {path: one[: one.rfind(b"\n") + 1] for path, one in contents.items()}


def check(study: StudyFolder) -> None:
    """Nothing is lost or doubled, and what is there is whole."""
    assert audit_study(study) == []
    numbers = Counter(one.number for one in read_holders(study) if one.state == "planned")
    assert set(numbers.values()) <= {1}
    for path in study.journals:
        rated = [one.data for one in read_journal(path).records if one.event == "rated"]
        assert len({(one["trial"], one["attempt"]) for one in rated}) == len(rated)


def kill(verb: str, words: Sequence[str], studies: Sequence[StudyFolder], times: int) -> int:
    """Kill a verb at random moments, at first from where it began, then on from where it was killed."""
    rng, kept, killed = random.SystemRandom(), studies[0].path.parent.with_name("kept"), 0
    shutil.copytree(studies[0].path.parent, kept)
    code, whole_s = call(words)
    assert code == 0, verb
    for number in range(times):
        if number % 4 == 0:
            shutil.rmtree(studies[0].path.parent)
            shutil.copytree(kept, studies[0].path.parent)
        before = read_lines(studies)
        killed += call(words, until_s=rng.uniform(0.3, 1.0) * whole_s)[0] == -signal.SIGKILL
        for path, content in before.items():
            assert verb == "withdraw" or path.read_bytes().startswith(content), path
    code, _ = call(words)
    assert code == 0 or verb == "withdraw", "the same command finishes"
    shutil.rmtree(kept)
    return killed


@pytest.mark.soak
def test_120_random_kills_lose_and_double_nothing(tmp_path: Path) -> None:
    root, killed = tmp_path / "studies", dict[str, int]()
    main, other = studies = [StudyFolder(root / name) for name in ("main", "other")]
    for station, study in enumerate(studies, start=1):
        create_study(study.path)
        share = f"[stations]\nthis = {station}\nof = 2\n"
        study.settings.write_text(SETTINGS + share, encoding="utf-8")
    for verb, template in VERBS.items():
        words = [word.format(main=main.path, other=other.path) for word in template]
        if verb == "run":
            shutil.copytree(main.stimuli, other.stimuli)
        killed[verb] = kill(verb, words, studies, KILLS // len(VERBS))
        for study in (one for one in studies if one.participants):
            check(study)
    sys.stderr.write(f"killed: {killed}\n")
    states = {one.participant: one.state for one in read_holders(main)}
    assert states == dict.fromkeys(("p01", *(f"sim00{n}" for n in (1, 3, 4, 5, 6))), "planned") | {
        "sim002": "withdrawn"
    }
    assert min(killed.values()) > KILLS / len(VERBS) / 3
