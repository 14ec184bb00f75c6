"""A study whose sessions are written by hand, and studies that are made once and copied for each test."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

import pytest

from feel321.protocols.trial import SPOILED, VALID, Page
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder, create_study
from feel321.study.participants.roster import Station, plan_participants
from feel321.study.session.events import PageRead, SessionBegun, SessionFinished, TrialRated
from feel321.study.session.journal import (
    create_journal,
    list_journals,
    name_journal,
    require_journal,
    utc_now,
)
from feel321.study.session.plan import PLAN_FILE, replay, require_plan
from feel321.study.simulate import simulate_study
from tests.study.conftest import ASK_AGE, SMALLEST_STUDY
from tests.study.participants.planned import TRIALS, make_small_plan


def tell_time() -> datetime:
    return datetime(2026, 1, 1, 12, tzinfo=UTC)


@dataclass(frozen=True)
class Lab:
    """A study whose sessions are written as the engine writes them, trial by trial."""

    study: StudyFolder

    def claim(self, participant: str, *, simulated: bool = False) -> int:
        (plan,) = plan_participants(
            self.study,
            [participant],
            lambda name, number: make_small_plan(name, number=number, simulated=simulated),
            simulated=simulated,
            station=Station(),
        )
        return plan.number

    def begin(self, participant: str, *, simulated: bool = False, session: int = 1) -> Path:
        self.claim(participant, simulated=simulated)
        folder = self.study.sessions / participant
        journal = create_journal(folder / name_journal(session), now=tell_time)
        sha256 = require_plan(folder / PLAN_FILE).sha256
        identity = {"presenter": {"simulated": simulated}}
        header = (1, participant, sha256, "5" * 64, 7, identity, session, {}, "", {})
        journal.write(SessionBegun(*header))
        return folder

    def work(self, participant: str, trials: int = TRIALS, *, rejected: bool = False) -> Path:
        """Rate so many trials, and finish after the last; gives the journal."""
        plan = require_plan(self.study.sessions / participant / PLAN_FILE)
        # As the engine does; who was released gets no further.
        self.claim(participant, simulated=plan.simulated)
        journal = require_journal(
            list_journals(self.study.sessions / participant)[-1], now=tell_time
        )
        agenda = replay(plan, journal.records)
        for _ in range(trials):
            while isinstance(step := agenda.ask(), Page):
                journal.write(PageRead(step.key, 1.0, step.least_s))
                agenda.tell_page(step.key, time_s=1.0)
            if step is None:
                break
            attempt = agenda.attempt(step.number)
            rated = (step.number, attempt, {"test": 50.0}, 1.5, 1.0, [], rejected)
            journal.write(TrialRated(*rated))
            outcome = SPOILED if rejected else VALID
            agenda.tell_trial(step.number, outcome, as_expected=None, time_s=1.0)
        if agenda.done == TRIALS and not journal.records.has(SessionFinished):
            journal.write(SessionFinished(TRIALS, 0))
        return journal.path


@pytest.fixture
def make_lab(tmp_path: Path) -> Callable[[], Lab]:
    """Begin studies beside one another."""
    numbers = count()

    def make() -> Lab:
        folder = tmp_path / f"study{next(numbers)}"
        folder.mkdir()
        (folder / "study.toml").touch()
        return Lab(StudyFolder(folder))

    return make


@pytest.fixture
def lab(make_lab: Callable[[], Lab]) -> Lab:
    return make_lab()


@pytest.fixture
def now() -> Callable[[], datetime]:
    return tell_time


ASKING = f"""{ASK_AGE}[[session.questions]]
name = "hand"
kind = "choice"
question = "Which hand?"
options = ["left", "right"]
personal = true
"""


def copy_study(made: StudyFolder, folder: Path) -> StudyFolder:
    shutil.copytree(made.path, folder)
    return StudyFolder(folder)


@pytest.fixture(scope="session")
def made_asking(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = create_study(tmp_path_factory.mktemp("made") / "study")
    study.settings.write_text(SMALLEST_STUDY + ASKING, encoding="utf-8")
    build_study(study)
    return study


@pytest.fixture(scope="session")
def made_held(made_asking: StudyFolder, tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = copy_study(made_asking, tmp_path_factory.mktemp("held") / "study")
    simulate_study(study, participants=2, seed=3, now=utc_now)
    return study
