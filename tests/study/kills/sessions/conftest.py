"""Sessions of every protocol, led in processes that die: two presenters, and what counts as a loss."""

import csv
import signal
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import Question, read_scales
from feel321.protocols.threshold import USUAL, MatchingBlock, ThresholdBlock
from feel321.protocols.trial import Flow, Page, Part, Scale, Task, Trial
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, read_stimuli
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder
from feel321.study.observer import Casting, ObserverModel, SimulatedObserver
from feel321.study.participants.roster import Station, plan_participants, write_roster
from feel321.study.ratings import write_ratings
from feel321.study.session.journal import Journal, Record, read_journal
from feel321.study.session.plan import Design, Plan, Stale, make_plan, require_plan
from feel321.study.session.ports import (
    Abort,
    Act,
    Confirm,
    Feel,
    Move,
    Pause,
    Place,
    Playback,
    Presenter,
)
from feel321.study.sessions import Room, lead_session
from feel321.study.settings.schema import ObserverTable
from tests.study.conftest import audit_study

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.1
[[recordings]]
scene = "hard_taps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "dft321"]
"""

TASKS: Mapping[str, tuple[Task, ...]] = {
    name: (replace(task, training=2, practice=1),)
    for name, task in {
        "realism": make_task("realism", surface=True),
        "similarity-strict": make_task("similarity", timing="strict", reference="surface"),
        "similarity-replay": make_task("similarity", timing="replay"),
        "dissimilarity": make_task("dissimilarity", scales=["dissimilarity", "roughness"]),
        "mushra": make_task("mushra"),
        "abx": make_task("abx"),
        "triplet": make_task("triplet", reference="surface"),
        "preference": make_task("preference"),
        "blocks": make_task("realism"),
    }.items()
}
"""What each session consists of: every protocol, every timing, surfaces to stroke; several scales and questions in one
of them; thresholds and matches first."""

NO_SETTINGS: Any = None  # the lead needs none
SCALES = read_scales("en") | {"roughness": Scale("roughness", "How rough?", "Smooth", "Rough")}

QUESTIONS = (
    Question("age", "number", "How old?", low=18, high=99, personal=True),
    Question("hand", "choice", "Which hand?", ("left", "right")),
    Question("tired", "likert", "How tired?", ("not", *[""] * 5, "very"), when="between"),
    Question("last", "text", "Anything?", when="after", required=False),
)

BLOCK = ThresholdBlock(
    "bayesian", (40.0, 250.0), replace(USUAL, trials=4, catch_every=2), practice=1
)

FLOW = Flow(break_trials=3, break_min=None, training_rounds=2)

MODEL = ObserverModel(**{**ObserverTable().model_dump(), "lapse_rate": 0.1})

MOODS = ("calm", "dry", "pausing", "rash", "dead", "replaying", "cut", "hasty", "dead")
"""What a scripted participant and device do in an attempt; each trial and attempt has its own."""


class Scripted:
    """Does by trial and attempt all that participants and devices do to a session; answers are drawn likewise."""

    def __init__(self, elapsed_s: float, memory: set[str]) -> None:
        self.time_s, self._memory = elapsed_s, memory

    def show_page(self, page: Page, place: Place) -> Confirm | Abort:  # noqa: ARG002 - the port's form
        if page.key == "break" and self._is_first("tired"):
            return Abort(self._pass(), "tired")
        return Confirm(self._pass(), {}, page.least_s)

    def show_question(self, question: Question, place: Place) -> Confirm:
        rng = np.random.default_rng([len(question.name), place.attempt])
        value = question.low or "a word"
        if question.choices:
            value = question.choices[rng.integers(len(question.choices))]
        return Confirm(self._pass(), {question.name: value}, 1.0)

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        self._mood = MOODS[(trial.number + 2 * place.attempt) % len(MOODS)]
        self._faults = {
            "dry": {"underruns": 2},
            "dead": {"error": "gone"},
            "cut": {"completed": False},
        }.get(self._mood)
        self._acts = self._act(
            trial, self._answer(trial, scale, place), key=f"{trial.number}.{place.attempt}"
        )

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:  # noqa: ARG002 - the port's form
        return self.prompt(part)

    def prompt(self, part: Part) -> Playback:  # noqa: ARG002 - the port's form
        faults, self._faults = self._faults or {}, None
        return Playback(self.time_s, self._pass(), **faults)

    def wait(self) -> Act:
        return replace(next(self._acts), time_s=self._pass())

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        pass

    def _act(self, trial: Trial, answer: Confirm, *, key: str) -> Iterator[Act]:
        if trial.timing == "free":
            yield from (Feel(0.0, part.name) for part in trial.parts)
        yield Move(0.0, trial.judgements[0].part, 12.5)
        if self._mood == "pausing" and self._is_first(key):
            yield Pause(0.0)
        if self._mood == "hasty":
            yield from (replace(answer, values={}), Feel(0.0, "nobody"))
        if self._mood == "replaying":
            yield Feel(0.0, "")
        while True:
            yield answer
            yield Feel(0.0, "")

    def _answer(self, trial: Trial, scale: Scale, place: Place) -> Confirm:
        rng = np.random.default_rng([trial.number, place.attempt])
        draw = partial(rng.choice, scale.choices) if scale.choices else partial(rng.uniform, 0, 100)
        values = {key: draw() for key in trial.judged}
        plain = {
            part: str(value) if scale.choices else round(float(value), 1)
            for part, value in values.items()
        }
        return Confirm(0.0, plain, 0.1 if self._mood == "rash" else 1.5)

    def _is_first(self, key: str) -> bool:
        is_news = key not in self._memory
        self._memory.add(key)
        return is_news

    def _pass(self) -> float:
        self.time_s = round(self.time_s + 0.5, 3)
        return self.time_s


@dataclass(frozen=True)
class Session:
    """One participant's session, from slot to table, as the command line leads it."""

    task: str
    presenter: str
    stimuli: StimulusSet
    policy: str = "continue"

    @property
    def design(self) -> Design:
        repeats = 3 if self.task == "mushra" else 1
        return Design(
            seed=7,
            order="williams",
            repeats=repeats,
            tasks=TASKS[self.task],
            between={},
            flow=FLOW,
            threshold=BLOCK if self.task == "blocks" else None,
            matching=MatchingBlock("as_is") if self.task == "blocks" else None,
            questions=QUESTIONS if self.task == "dissimilarity" else (),
        )

    def make_study(self, path: Path) -> StudyFolder:
        study = StudyFolder(path)
        path.mkdir(parents=True)
        study.settings.write_text(STUDY, encoding="utf-8")
        study.stimuli.symlink_to(self.stimuli.folder)
        return study

    def lead(self, study: StudyFolder, *, later_h: float = 0.0) -> None:
        """Lead it to its end, however often the participant has enough for today."""

        def now() -> datetime:
            return datetime.now(UTC) + timedelta(hours=later_h)

        def make(name: str, number: int) -> Plan:
            return make_plan(self.design, self.stimuli, name, number=number, simulated=True)

        (plan,) = plan_participants(study, ["sim001"], make, simulated=True, station=Station())
        room = Room(study, NO_SETTINGS, self.stimuli, SCALES, Stale(6.0, self.policy), now)
        make_presenter = partial(self._make_presenter, memory=set())
        identity = {"presenter": Casting(MODEL, 3).identity}
        while lead_session(room, plan, identity=identity, make_presenter=make_presenter)[0].stopped:
            pass
        write_roster(study)
        write_ratings(study, self.stimuli)

    @contextmanager
    def _make_presenter(
        self, _plan: Plan, journal: Journal, *, memory: set[str]
    ) -> Iterator[Presenter]:
        elapsed_s = journal.records.find_elapsed()
        if self.presenter == "scripted":
            yield Scripted(elapsed_s, memory)
        else:
            yield SimulatedObserver(MODEL, seed=3, number=1, elapsed_s=elapsed_s)


@dataclass(frozen=True)
class Size:
    """How many calls leave a trace, how many records and bytes there are in a session that comes to its end."""

    calls: int
    records: int
    n_bytes: int


def measure(study: StudyFolder) -> int:
    return sum(path.stat().st_size for path in study.journals)


def read_rated(study: StudyFolder) -> dict[str, list[bytes]]:
    """Read the whole lines of completed ratings, as they are on the disk."""
    return {
        path.name: [
            line for line in path.read_bytes().split(b"\n")[:-1] if b'"event": "rated"' in line
        ]
        for path in study.journals
    }


@dataclass(frozen=True)
class End:
    """What a session left behind."""

    rated: tuple[Any, ...]
    """Trial, attempt, values and flags of each rating of the newest session, in order; of the main phase only
    where the session was warmed up."""
    table: list[dict[str, str]]
    """The accepted rows of ratings.csv, without what a pause changes."""


@dataclass(frozen=True)
class Lab:
    """Leads sessions in processes that die, leads them to their end, and sets them against one that never died."""

    path: Path
    stimuli: StimulusSet
    processes: Any
    ends: dict[tuple[str, str], tuple[End, Size]] = field(default_factory=dict)

    def count(self, task: str, presenter: str) -> Size:
        """Measure a session that is not interrupted."""
        return self._lead_whole(task, presenter)[1]

    def at(self, k: int) -> Any:
        """Choose the kill before the k-th call."""
        return self.processes.Kill(k)

    @staticmethod
    def draw(seed: int, n: int) -> list[float]:
        """Draw shares of a session."""
        return list(np.random.default_rng(seed).uniform(0.02, 0.98, n))

    def place(self, instant: float, *, task: str, presenter: str, j: float | None = None) -> Any:
        """Choose the kill at some share of a session."""
        size = self.count(task, presenter)
        return self.processes.Kill(
            1 + int(instant * ((size.calls if j is None else size.records) - 1)), j
        )

    def make_study(self, path: Path) -> StudyFolder:
        """Make a study for the command line."""
        return Session("realism", "observer", self.stimuli).make_study(path)

    def session(self, task: str, presenter: str) -> Session:
        """Make a session to be led by hand."""
        return Session(task, presenter, self.stimuli)

    def endure(
        self,
        task: str,
        presenter: str,
        kills: Sequence[Any],
        path: Path,
        *,
        policy: str = "continue",
    ) -> StudyFolder:
        """Die so many times, then check that nothing is missing or too much.

        A number instead of a Kill is a share of the journal's length: once that is there, the kill comes from outside.

        With another policy than `continue`, all later ones come back the next day.
        """
        session = Session(task, presenter, self.stimuli, policy)
        study, key = session.make_study(path), (task, presenter)
        told = f"{task} {presenter} {policy} {kills}"
        later_h = 0.0
        seen: list[dict[str, list[bytes]]] = []
        for kill in kills:
            lead = partial(session.lead, study, later_h=later_h)
            if not isinstance(kill, float):
                code = self.processes.fork(lead, kill=kill)
            else:
                n_bytes = kill * self.count(task, presenter).n_bytes
                code = self.processes.fork(
                    lead, until=lambda n_bytes=n_bytes: measure(study) >= n_bytes
                )
            self.processes.toll.kills[key] += code == -signal.SIGKILL
            # From outside, the kill may come too late.
            assert code == -signal.SIGKILL or (code, type(kill)) == (0, float), (
                f"{told}: ended with {code}"
            )
            seen.append(read_rated(study))
            later_h = 0.0 if policy == "continue" else 24.0
        session.lead(study, later_h=later_h)
        now = read_rated(study)
        lost = sum(
            lines != now.get(name, [])[: len(lines)]
            for before in seen
            for name, lines in before.items()
        )
        doubled = sum(count_doubles(study))
        self.processes.toll.lost[key] += lost
        self.processes.toll.doubled[key] += doubled
        assert (lost, doubled) == (0, 0), told
        self.compare(study, task, presenter, policy=policy, told=told)
        return study

    def compare(
        self, study: StudyFolder, task: str, presenter: str, *, policy: str = "continue", told: str
    ) -> None:
        """Check that a study ended as the one that was never interrupted."""
        whole, _ = self._lead_whole(task, presenter)
        end = read_end(study, presenter, policy=policy)
        assert [r.event for r in read_journal(study.journals[-1]).records].count("finished") == 1, (
            told
        )
        if policy == "warm_up":
            whole = replace(
                whole, rated=tuple(entry for entry in whole.rated if entry[0] in list_main(study))
            )
        assert end.rated == whole.rated, told
        assert end.table == (
            strip(whole.table, "onset_s") if policy == "warm_up" else whole.table
        ), told
        assert audit_study(study) == [], told

    def find_whole(self, task: str, presenter: str) -> StudyFolder:
        """Find the study that was never interrupted; not to be touched."""
        self._lead_whole(task, presenter)
        return StudyFolder(self.path / f"{task}-{presenter}")

    def _lead_whole(self, task: str, presenter: str) -> tuple[End, Size]:
        key = (task, presenter)
        if key not in self.ends:
            session = Session(task, presenter, self.stimuli)
            study = session.make_study(self.path / f"{task}-{presenter}")
            counts = self.processes.count_traces(partial(session.lead, study))
            self.ends[key] = (read_end(study, presenter), Size(*counts, measure(study)))
        return self.ends[key]


def list_main(study: StudyFolder) -> set[int]:
    plan = require_plan(study.sessions / "sim001" / "plan.json")
    return {trial.number for trial in plan.trials if trial.phase == "main"}


def count_doubles(study: StudyFolder) -> Iterator[int]:
    """Count ratings of the main phase that were given twice in one session."""
    main = list_main(study)
    for path in study.journals:
        rated = Counter(
            (r.data["trial"], r.data["attempt"]) for r in list_rated(read_journal(path).records)
        )
        accepted = Counter(
            r.data["trial"]
            for r in list_rated(read_journal(path).records)
            if not r.data["rejected"]
        )
        yield sum(n - 1 for (trial, _), n in rated.items() if trial in main)
        yield sum(n - 1 for trial, n in accepted.items() if trial in main)


def list_rated(records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record.event == "rated"]


def read_end(study: StudyFolder, presenter: str, *, policy: str = "continue") -> End:
    main = list_main(study)
    rated = [record.data for record in list_rated(read_journal(study.journals[-1]).records)]
    with study.ratings.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["rejected"] == "false"]
    # The simulated clock stands still while nobody is there; another goes on through a trial that is begun again.
    changed = {
        "session",
        *(() if presenter == "observer" and policy != "warm_up" else ("onset_s",)),
    }
    return End(
        tuple(
            (data["trial"], data["attempt"], data["values"], data["flags"])
            for data in rated
            if policy != "warm_up" or data["trial"] in main
        ),
        strip(rows, *changed),
    )


def strip(rows: list[dict[str, str]], *columns: str) -> list[dict[str, str]]:
    return [{key: value for key, value in row.items() if key not in columns} for row in rows]


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory, processes: Any) -> Lab:
    study = StudyFolder(tmp_path_factory.mktemp("lab"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    return Lab(study.path, read_stimuli(study.stimuli), processes)
