"""The hand before a screen that obeys keys as the real one does."""

from dataclasses import dataclass, field, replace

import pytest

from feel321.protocols.texts import Question, read_scales
from feel321.protocols.trial import Judgement, Page, Part, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.observer import ObserverModel, Participant, SimulatedObserver
from feel321.study.screen.input import MOVES, View
from feel321.study.screen.presenter import RETRIES, RETRY_S, PressingHand
from feel321.study.session.ports import Place

SCALES = read_scales()
KINDS = {"realism": "slider", "similarity": "slider", "mushra": "rows", "abx": "choice"}
MODEL = ObserverModel(
    intercept=50.0, spectral=20.0, temporal=20.0, gain_sd=0.1, noise_sd=25.0, noise_spread=0.2
)
FRAME_S = 0.02
NAMES = {"realism": ("test",), "similarity": ("reference", "test"), "abx": ("a", "b", "x")}


def make_stimulus(name: str, match: float) -> Stimulus:
    audio = (f"{name}.wav", 48000.0, 9600, 0.2, 0.5, 1.0, 1.0)
    return Stimulus(name, "oak", name, "as_is", "test", *audio, match, match, 0, "", "")


STIMULI = {f"code{n}": make_stimulus(f"s{n}", n / 10) for n in range(6)}


def make_trial(number: int, protocol: str) -> Trial:
    names = NAMES.get(protocol, ("reference", "1", "2", "3", "4"))
    parts = tuple(Part(name, f"code{(number + place) % 6}") for place, name in enumerate(names))
    judged = parts[1:] if protocol == "mushra" else parts[-1:]
    reference = None if protocol == "realism" else parts[0].stimulus_id
    judgements = tuple(Judgement(part.name, str(part.stimulus_id), reference) for part in judged)
    timing = "free" if protocol == "mushra" else "replay"
    return Trial(number, 1, 1, protocol, protocol, timing, "oak", parts, judgements)


@dataclass
class Screen:
    """Obeys keys."""

    view: View
    pressed: list[str] = field(default_factory=list)
    confirmed: bool = False

    def obey(self, key: str) -> None:
        view = self.view
        if key in {"enter", "f12", "escape"}:
            self.confirmed = True
        elif view.kind == "choice" and view.scale is not None and key != "r":
            self.view = replace(view, chosen=view.scale.choices[{"left": 0, "right": -1}[key]])
        elif key == "r":
            self.view = replace(
                view, felt=frozenset(part.name for part in view.trial.parts if view.trial)
            )
        elif view.kind == "rows" and (key == "tab" or key[0] == "f"):
            self.view = replace(view, felt=view.felt | {"reference" if key == "tab" else key[1:]})
        elif view.kind == "rows" and key in {"up", "down"}:
            rows = [judgement.part for judgement in view.trial.judgements if view.trial]
            place = rows.index(view.selected) + (1 if key == "down" else -1)
            self.view = replace(view, selected=rows[min(max(place, 0), len(rows) - 1)])
        else:
            self.move(key)

    def move(self, key: str) -> None:
        step = MOVES[{"pageup": "more", "pagedown": "less"}.get(key, key)]
        at = self.view.markers.get(self.view.selected, 50.0 - step)
        moved = min(max(at + step, 0.0), 100.0)
        self.view = replace(self.view, markers={**self.view.markers, self.view.selected: moved})


def bring_up(number: int, protocol: str, *, attempt: int = 1) -> View:
    trial = make_trial(number, protocol)
    felt = frozenset() if trial.timing == "free" else frozenset(part.name for part in trial.parts)
    return View(
        kind=KINDS[protocol],
        state="answering",
        screen=10 * number + attempt,
        place=Place(number, 80, attempt),
        trial=trial,
        scale=SCALES[protocol],
        felt=felt,
        selected=trial.judgements[0].part,
    )


class Visit:
    """A hand with its clock."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self.screen = Screen(View("page", "reading", 0, Place(0, 80), page=Page("welcome")))
        mind = Participant(MODEL, seed=3, number=1)
        self.hand = PressingHand(mind, clock=lambda: self.time_s)

    def look(self) -> None:
        """Show a frame: one key at a time is pressed and released at once."""
        done = self.hand.watch(self.screen.view)
        assert [event.kind for event in done] in ([], ["press", "release"])
        for event in done[:1]:
            self.screen.pressed.append(event.key)
            self.screen.obey(event.key)
        self.time_s += FRAME_S

    def meet(self, view: View) -> Screen:
        self.screen = Screen(view)
        if view.trial:
            self.look()
            for part in view.trial.parts:
                self.hand.feel(part, STIMULI[str(part.stimulus_id)])
        for _ in range(2000):
            self.look()
            if self.screen.confirmed:
                return self.screen
        pytest.fail(f"never confirmed; pressed {self.screen.pressed[-20:]}")


def ask_mind_alone(protocols: list[str]) -> list[dict[str, float | str]]:
    observer = SimulatedObserver(MODEL, seed=3, number=1)
    answers = []
    for number, protocol in enumerate(protocols, start=1):
        trial = make_trial(number, protocol)
        observer.show_trial(trial, SCALES[protocol], Place(number, 80, 1))
        for part in trial.parts:
            observer.play(part, STIMULI[str(part.stimulus_id)], gap_s=0.0)
        act = observer.wait()
        while not hasattr(act, "values"):
            act = observer.wait()
        answers.append(dict(act.values))
    return answers


def test_the_hand_gives_the_answers_of_the_mind_in_whole_points() -> None:
    protocols = ["realism", "realism", "mushra", "mushra", "abx", "abx", "similarity", "similarity"]
    visit = Visit()
    for number, (protocol, answer) in enumerate(
        zip(protocols, ask_mind_alone(protocols), strict=True), start=1
    ):
        screen = visit.meet(bring_up(number, protocol))
        if protocol == "abx":
            assert {"x": screen.view.chosen} == answer
        else:
            assert dict(screen.view.markers) == {
                part: round(float(value)) for part, value in answer.items()
            }
        assert screen.view.felt == {part.name for part in make_trial(number, protocol).parts}


@pytest.mark.parametrize(("by", "key"), [("participant", "enter"), ("experimenter", "f12")])
def test_pages_are_left_by_the_key_of_whom_they_are_for(by: str, key: str) -> None:
    view = View("page", "reading", 1, Place(0, 80), page=Page("welcome", by=by))
    visit = Visit()
    visit.screen = Screen(replace(view, left_s=3))
    for _ in range(100):
        visit.look()
    assert visit.screen.pressed == []
    assert visit.meet(view).pressed == [key]


def test_the_real_surface_is_stroked_until_enter() -> None:
    assert Visit().meet(replace(bring_up(1, "realism"), state="stroking")).pressed == ["enter"]


def test_what_was_not_felt_to_its_end_is_felt_again_before_the_answer() -> None:
    view = replace(bring_up(1, "similarity"), felt=frozenset({"reference"}))
    assert Visit().meet(view).pressed[0] == "r"


def test_a_failed_device_is_tried_again_but_not_for_ever() -> None:
    pressed = []
    visit = Visit()
    for number in range(RETRIES + 1):
        page = Page("call_us", by="experimenter")
        visit.screen = Screen(View("page", "reading", number, Place(0, 80), page=page))
        called_s = visit.time_s
        while not visit.screen.pressed:
            visit.look()
            assert visit.time_s - called_s < RETRY_S + 1
        assert visit.time_s - called_s >= RETRY_S
        pressed += visit.screen.pressed
    assert pressed == [*["f12"] * RETRIES, "escape"]


def test_a_number_is_typed_then_confirmed() -> None:
    question = Question("age", "number", "How old?", low=18, high=99)
    view = View("page", "reading", 1, Place(0, 80), page=Page(question.key), question=question)
    visit = Visit()
    visit.hand.watch(view)
    visit.time_s = 1.0
    (typed,) = visit.hand.watch(view)
    assert typed.kind == "text"
    assert 18 <= float(typed.key) <= 99
    assert visit.hand.watch(replace(view, typed=typed.key))[0].key == "enter"
    assert visit.hand.watch(replace(view, typed="x"))[0].key == "backspace"
