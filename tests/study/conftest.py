from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from protocols.texts import read_scales
from stimuli.manifest import Stimulus, StimulusSet
from study.folder import StudyFolder
from study.plan import Plan, make_plan
from study.ports import Answer, Playback, Replay
from study.session import Stage, open_session, run_session

if TYPE_CHECKING:
    from collections.abc import Callable

    from protocols.trial import Scale, Trial

SMALL_STUDY = """
[study]
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.5
[[recordings]]
scene = "hard_taps"
duration_s = 0.5
[stimuli]
reducers = ["sax321", "mag321", "dft321"]
[analysis]
draws = 200
"""

# Spectral and temporal match of the made-up reducers: not collinear, so that planted effects can be told apart.
MATCHES = {"first": (0.9, 0.2), "second": (0.7, 0.6), "third": (0.2, 0.5), "fourth": (-3.0, 0.1)}


def make_stimulus(recording: str, reducer: str, role: str, matches: tuple[float, float]) -> Stimulus:
    return Stimulus(
        stimulus_id=f"{recording}-{reducer}",
        recording=recording,
        reducer=reducer,
        level="as_is",
        role=role,
        file=f"{recording}-{reducer}.wav",
        rate_hz=48000.0,
        n_samples=48000,
        duration_s=1.0,
        peak=0.5,
        rms_m_s2=1.0,
        gain=1.0,
        spectral_match=matches[0],
        temporal_match=matches[1],
        clipped=0,
        sha256="",
        recording_sha256="",
    )


@pytest.fixture
def stimuli() -> StimulusSet:
    """Two recordings of four reducers and a reference each, without files."""
    rows = []
    for shift, recording in enumerate(("bumps", "taps")):
        rows += [
            make_stimulus(recording, name, "test", (spectral - shift / 10, temporal + shift / 20))
            for name, (spectral, temporal) in MATCHES.items()
        ]
        rows.append(make_stimulus(recording, "original", "reference", (1.0, 1.0)))
    return StimulusSet(Path("nowhere"), tuple(rows), "5" * 64)


@pytest.fixture
def plan(stimuli: StimulusSet) -> Plan:
    return make_plan(stimuli, "p01", number=1, seed=7, protocols=("realism", "similarity"), repeats=1)


@pytest.fixture
def now() -> Callable[[], datetime]:
    """A clock that moves one second per look."""
    ticks = count()
    return lambda: datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=next(ticks))


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Inodes of the files and folders that were synced, in order."""
    inodes: list[int] = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda d: (fsync(d), inodes.append(os.fstat(d).st_ino))[0])
    return inodes


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    """A study of two short scenes and three reducers, not built."""
    (tmp_path / "study.toml").write_text(SMALL_STUDY, encoding="utf-8")
    return StudyFolder(tmp_path)


@dataclass
class ScriptedPresenter:
    """Answers by script and keeps a log; stops like a participant who pulls the plug."""

    replays: int = 0
    underruns: int = 0
    stop_after: float = float("inf")

    def __post_init__(self) -> None:
        self.log: list[str] = []
        self.rated = 0

    def show(self, trial: Trial, scale: Scale) -> None:
        if self.rated >= self.stop_after:
            raise KeyboardInterrupt
        self.log.append(f"show {trial.number} {scale.name}")

    def play(self, stimulus: Stimulus) -> Playback:
        self.log.append(f"play {stimulus.stimulus_id}")
        return Playback(requested_s=1.0, onset_s=1.0 + len(self.log), underruns=self.underruns)

    def ask(self, scale: Scale) -> Answer | Replay:
        if self.replays:
            self.replays -= 1
            return Replay()
        self.rated += 1
        self.log.append(f"ask {scale.name}")
        return Answer(rating=50.0, response_time_s=2.0, time_s=10.0 * self.rated)


@pytest.fixture
def scripted() -> type[ScriptedPresenter]:
    return ScriptedPresenter


@pytest.fixture
def present(
    tmp_path: Path, plan: Plan, stimuli: StimulusSet, now: Callable[[], datetime]
) -> Callable[..., list[Any]]:
    """Run or resume the session of p01 with a presenter; gives the journal's records."""

    def run(presenter: ScriptedPresenter, *, plan: Plan = plan) -> list[Any]:
        folder = tmp_path / "sessions" / "p01"
        with open_session(folder, plan, identity={"simulated": True}, now=now) as (stored, journal):
            by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
            run_session(stored, Stage(presenter, by_id, read_scales(), journal))
            return list(journal.records)

    return run
