"""What a journal tells is what was on the screen of the real presenter, before a window that keeps every screen."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.agenda import Agenda
from feel321.protocols.questions import Question
from feel321.protocols.tasks import make_task
from feel321.protocols.texts import read_scales, read_texts
from feel321.protocols.trial import Flow
from feel321.study.monitor.script import Cast, make_shots
from feel321.study.observer.participant import ObserverModel, Participant
from feel321.study.screen.input import InputEvent
from feel321.study.screen.layout import compose
from feel321.study.screen.presenter import ScreenPresenter
from feel321.study.screen.robot import PressingHand
from feel321.study.screen.view import make_screen_texts
from feel321.study.screen.window import FrameCounts
from feel321.study.session.codes import list_by_code
from feel321.study.session.engine import run_session
from feel321.study.session.events import PageRead, PartPlayed, TrialRated
from feel321.study.session.journal import Records, create_journal
from feel321.study.session.plan import Design, make_plan
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.screen.drawing import Item

SIZE = (1280, 800)
FRAME_S = 1 / 30


@dataclass
class HeldWindow:
    """A window whose clock moves by a frame each time that something is shown; it keeps what that was."""

    size: tuple[int, int] = SIZE
    time_s: float = 0.0
    frames: FrameCounts = field(default_factory=FrameCounts)
    shown: list[tuple[Item, ...]] = field(default_factory=list)
    events: deque[InputEvent] = field(default_factory=deque)

    def show(self, items: Sequence[Item]) -> list[InputEvent]:
        if not self.shown or self.shown[-1] != tuple(items):
            self.shown.append(tuple(items))
        self.time_s += FRAME_S
        events, self.events = list(self.events), deque()
        return events

    def press(self, key: str) -> None:
        self.events.append(InputEvent("press", self.time_s, key))
        letters = {"minus": "-", "period": "."}.get(key, key)
        if len(letters) == 1 or key == "backspace":
            self.events.append(InputEvent("text", self.time_s, letters))

    def release(self, key: str) -> None:
        self.events.append(InputEvent("release", self.time_s, key))


@dataclass
class SilentOutput:
    """Plays nothing for as long as a stimulus lasts."""

    window: HeldWindow
    began_s: float = 0.0
    ends_s: float = 0.0

    def start(self, stimulus: Any, *, gap_s: float, goes_on: bool = False) -> None:  # noqa: ARG002 - the form of an output
        self.began_s = self.window.time_s + gap_s
        self.ends_s = self.began_s + stimulus.duration_s

    @property
    def is_playing(self) -> bool:
        return self.window.time_s < self.ends_s

    def collect(self) -> Playback:
        return Playback(self.began_s, self.began_s)


@dataclass
class Performance:
    """A session as it was seen, and as its journal tells it."""

    window: HeldWindow
    records: Records
    cast: Cast
    stimuli: StimulusSet

    def make_agenda(self) -> Agenda:
        plan = self.cast.plan
        return Agenda(plan.trials, plan.flow, plan.questions)


@pytest.fixture(scope="module")
def performance(stimuli: StimulusSet, tmp_path_factory: pytest.TempPathFactory) -> Performance:
    names = ("realism", "mushra", "abx")
    questions = (
        Question("age", "before", "number", "How old are you?", low=18, high=99),
        Question("hand", "after", "choice", "Which hand?", ("left", "right")),
    )
    design = Design(
        seed=7, order="williams", repeats=1, tasks=tuple(map(make_task, names)), between={},
        flow=Flow(break_trials=6, break_s=2.0, rest_s=1.5), questions=questions,
    )  # fmt: skip
    plan = make_plan(design, stimuli, "p01", number=1, simulated=True)
    few: dict[str, int] = {}
    trials = []
    for trial in plan.trials:
        few[trial.protocol] = few.get(trial.protocol, 0) + 1
        trials += [trial] if few[trial.protocol] <= 7 else []
    plan = replace(plan, trials=tuple(trials))
    window, texts, by_code = (
        HeldWindow(),
        make_screen_texts(read_texts("en")),
        list_by_code(stimuli, seed=7),
    )
    clock = lambda: window.time_s  # noqa: E731 - as short as it is
    mind = Participant(ObserverModel(), seed=1, number=1, percepts={})
    hand = PressingHand(mind, window, stimuli=by_code, clock=clock)
    presenter = ScreenPresenter(
        window, SilentOutput(window), texts, clock=clock, surfaces={}, hand=hand
    )
    noon = datetime(2026, 1, 1, 12, tzinfo=UTC)
    journal = create_journal(tmp_path_factory.mktemp("seen") / "session-01.jsonl", now=lambda: noon)
    outcome = run_session(plan, presenter, stimuli=stimuli, journal=journal)
    assert outcome.done == outcome.total == len(trials)
    return Performance(window, journal.records, Cast(plan, texts, read_scales(), by_code), stimuli)


def test_every_screen_of_the_replay_was_shown_in_this_order(performance: Performance) -> None:
    shots = make_shots(performance.cast, performance.records, performance.make_agenda())
    replayed: list[tuple[Item, ...]] = []
    for shot in shots:
        items = tuple(compose(shot.view, performance.cast.texts, size=SIZE).items)
        replayed += [items] if not replayed or replayed[-1] != items else []
    seen = iter(performance.window.shown)
    missing = [place for place, items in enumerate(replayed) if items not in seen]
    assert missing == []
    assert len(replayed) > 100


def test_trials_ratings_and_times_are_those_of_the_journal(performance: Performance) -> None:
    shots = make_shots(performance.cast, performance.records, performance.make_agenda())
    last = {(s.view.trial.number, s.view.place.attempt): s.view for s in shots if s.view.trial}
    rated = list(performance.records.find(TrialRated))
    assert list(last) == [(one.trial, one.attempt) for one in rated]
    for one in rated:
        view = last[one.trial, one.attempt]
        chosen = dict.fromkeys(one.values, view.chosen) if view.chosen else dict(view.markers)
        assert chosen == one.values
    heard = [(shot.time_s, shot.heard.stimulus_id) for shot in shots if shot.heard]
    parts = {(t.number, part.name): part for t in performance.cast.plan.trials for part in t.parts}
    names = {code: stimulus.stimulus_id for code, stimulus in performance.cast.stimuli.items()}
    played = list(performance.records.find(PartPlayed))
    assert heard == [(one.onset_s, names[parts[one.trial, one.part].stimulus_id]) for one in played]
    pages = [
        (round(s.time_s, 9), s.view.page.key) for s in shots if s.view.page and not s.view.question
    ]
    read = [(round(p.time_s - p.stood_s, 9), p.key) for p in performance.records.find(PageRead)]
    assert [page for page in pages if page in read] == read
    assert all(before.at_s <= after.at_s for before, after in pairwise(shots))


def test_a_crash_does_not_turn_the_replay_back(performance: Performance) -> None:
    """What was felt after the last answer is on no clock that goes on: the session begins again before it."""
    records = performance.records
    shown = max(place for place, record in enumerate(records) if record.event == "shown")
    done, lost = records[:shown], records[shown : shown + 3]
    assert [record.event for record in lost] == ["shown", "played", "played"]
    opening = {"versions": {}, "system": "", "clock": {}}
    resumed = replace(lost[0], sequence=shown + 3, event="resumed", data=opening)
    again = [replace(record, sequence=shown + 4 + n) for n, record in enumerate(lost[:2])]
    crashed = Records([*done, *lost, resumed, *again])
    shots = make_shots(performance.cast, crashed, performance.make_agenda())
    assert all(before.at_s <= after.at_s for before, after in pairwise(shots))
    begun = next(shot for shot in shots if shot.sequence > shown + 3)
    assert begun.time_s == pytest.approx(Records(done).find_elapsed())
    assert begun.at_s > begun.time_s + 1
