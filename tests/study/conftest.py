import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import Question
from feel321.protocols.trial import Flow, Page, Part, Scale, Trial
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.study.check import build_study
from feel321.study.evidence.audit import examine
from feel321.study.folder import StudyFolder, create_study
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Clock, Records
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Plan, Stale, create_plan, make_plan
from feel321.study.session.ports import Abort, Act, Confirm, Feel, Pause, Place, Playback

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

BARE = 'reference = "none"\nanchors = false\n'


def make_settings(
    *scenes: str,
    duration_s: float = 0.1,
    reducers: tuple[str, ...] = ("sax321", "mag321"),
    stimuli: str = BARE,
    protocol: str = "realism",
    session: str = "",
) -> str:
    """The settings of a small study without rehearsal; stimuli, session: what those tables hold besides."""
    recordings = [f'[[recordings]]\nscene = "{one}"\nduration_s = {duration_s}\n' for one in scenes]
    tables = (
        f"[stimuli]\nreducers = {[*reducers]}\n{stimuli}",
        f'[session]\nprotocols = ["{protocol}"]\n{session}',
        "[session.rehearsal]\ntraining = 0\npractice = 0\n",
    )
    return "".join([*recordings, *tables])


SMALLEST_STUDY = make_settings("bumps")


def audit_study(study: StudyFolder) -> list[str]:
    """What the audit finds."""
    return list(examine(study).findings)


ASK_AGE = """[[session.questions]]
name = "age"
kind = "number"
question = "How old are you?"
low = 5
high = 120
personal = true
required = false
"""

# Spectral and temporal match of the made-up reducers: not collinear, so that planted effects can be told apart.
MATCHES = {"first": (0.9, 0.2), "second": (0.7, 0.6), "third": (0.2, 0.5), "fourth": (-3.0, 0.1)}


def make_stimulus(
    recording: str, reducer: str, role: str, matches: tuple[float, float]
) -> Stimulus:
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
def smallest(tmp_path: Path) -> StudyFolder:
    """A study of two trials, built."""
    study = create_study(tmp_path / "study")
    study.settings.write_text(SMALLEST_STUDY, encoding="utf-8")
    build_study(study)
    return study


@pytest.fixture(scope="session")
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


@pytest.fixture(scope="session")
def design() -> Design:
    """Realism and similarity without rehearsal: ten trials each, a rest in between."""
    tasks = (make_task("realism"), make_task("similarity"))
    return Design(seed=7, order="williams", repeats=1, tasks=tasks, between={}, flow=Flow())


@pytest.fixture(scope="session")
def plan(design: Design, stimuli: StimulusSet) -> Plan:
    return make_plan(design, stimuli, "p01", number=1, simulated=True)


@pytest.fixture
def now() -> Clock:
    """A clock that moves one second per look."""
    return start_ticking()


def list_events(records: list[Any], event: str) -> list[Any]:
    """What the records of a kind hold."""
    return [record.data for record in records if record.event == event]


def start_ticking() -> Clock:
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
    """Does by script what a participant may do, and keeps a log; without a script it answers 50 points, or `a`.

    `acts` and `playbacks` hold what is done, and what becomes of stimuli, in each attempt at a trial; what they do not
    name goes well. Its clock moves one second per call. It pulls the plug when so many trials were shown.
    """

    acts: dict[tuple[int, int], list[Act]] = field(default_factory=dict)
    playbacks: dict[tuple[int, int], list[Playback]] = field(default_factory=dict)
    pages: dict[str, list[Act]] = field(default_factory=dict)
    stop_after: float = float("inf")
    log: list[str] = field(default_factory=list)
    time_s: float = 0.0

    def __post_init__(self) -> None:
        self.shown = 0

    def pass_time(self) -> float:
        self.time_s += 1.0
        return self.time_s

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        self.log.append(f"page {page.key} {place.done}/{place.total}")
        waiting = self.pages.get(page.key)
        return waiting.pop(0) if waiting else Confirm(self.pass_time(), {}, page.least_s)

    def show_question(self, question: Question, place: Place) -> Confirm | Pause | Abort:
        self.log.append(f"ask {question.name} {place.attempt}")
        waiting = self.pages.get(question.key)
        if waiting:
            return waiting.pop(0)
        value = question.choices[0] if question.choices else question.low or "a word"
        return Confirm(self.pass_time(), {question.name: value}, 2.0)

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        if self.shown >= self.stop_after:
            raise KeyboardInterrupt
        self.shown += 1
        self.log.append(f"show {trial.number}.{place.attempt} {scale.name}")
        key = (trial.number, place.attempt)
        usual = Confirm(0.0, dict.fromkeys(trial.judged, "a" if scale.choices else 50.0), 1.5)
        free: list[Act] = [Feel(0.0, "")] if trial.timing == "free" else []
        self._waiting = self.acts.get(key, [*free, usual])
        self._playbacks = self.playbacks.get(key, [])
        self._timing = trial.timing

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        assert (gap_s == 0) == (self._timing == "free")
        self.log.append(f"play {part.name} {stimulus.stimulus_id}")
        time_s = self.pass_time()
        return self._playbacks.pop(0) if self._playbacks else Playback(time_s, time_s + 0.25)

    def prompt(self, part: Part) -> Playback:
        self.log.append(f"prompt {part.name} {part.surface}")
        time_s = self.pass_time()
        return self._playbacks.pop(0) if self._playbacks else Playback(time_s, time_s)

    def wait(self) -> Act:
        return replace(self._waiting.pop(0), time_s=self.pass_time())

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        self.log.append(" ".join(["refuse", reason, *parts]))


@pytest.fixture(scope="session")
def scripted() -> type[ScriptedPresenter]:
    return ScriptedPresenter


@pytest.fixture
def present(
    tmp_path: Path, plan: Plan, stimuli: StimulusSet, now: Clock
) -> Callable[..., list[Any]]:
    """Run or resume a session, p01's, with a presenter; gives the records of the newest journal."""
    return make_present(tmp_path, plan, stimuli, now)


@pytest.fixture(scope="session")
def begin_study(
    tmp_path_factory: pytest.TempPathFactory, plan: Plan, stimuli: StimulusSet
) -> Callable[[], Callable[..., list[Any]]]:
    """Gives what `present` is, in a new study each time."""
    return lambda: make_present(tmp_path_factory.mktemp("present"), plan, stimuli, start_ticking())


@pytest.fixture(scope="session")
def present_once(
    tmp_path_factory: pytest.TempPathFactory, plan: Plan, stimuli: StimulusSet
) -> Callable[..., list[Any]]:
    """The same for records that many tests read, each call in a study of its own."""

    def run(presenter: ScriptedPresenter, **options: Any) -> list[Any]:
        path = tmp_path_factory.mktemp("present")
        return make_present(path, plan, stimuli, start_ticking())(presenter, **options)

    return run


def store_plan(folder: Path, plan: Plan) -> None:
    """Store a plan, unless the participant has one."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "plan.json").exists():
        create_plan(folder / "plan.json", plan)


def make_present(
    path: Path, plan: Plan, stimuli: StimulusSet, now: Clock
) -> Callable[..., list[Any]]:
    def run(
        presenter: ScriptedPresenter,
        *,
        plan: Plan = plan,
        stimuli: StimulusSet = stimuli,
        stale: Stale | None = None,
        now: Clock = now,
        scales: Mapping[str, Scale] | None = None,
        on_step: Callable[[Place], None] = lambda _: None,
    ) -> list[Any]:
        folder = path / "sessions" / plan.participant
        store_plan(folder, plan)
        identity = {"presenter": {"simulated": True}}
        with open_session(folder, plan, identity=identity, now=now, stale=stale or Stale()) as (
            stored,
            journal,
        ):
            presenter.time_s = journal.records.find_elapsed()
            told = {"scales": scales, "on_step": on_step}
            run_session(stored, presenter, stimuli=stimuli, journal=journal, **told)
            return Records(journal.records)

    return run
