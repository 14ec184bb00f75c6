"""What comes next: pages, training, breaks and second attempts, each by hand and by law."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.agenda import Agenda
from feel321.protocols.texts import read_texts
from feel321.protocols.trial import LOST, SPOILED, VALID, Flow, Judgement, Page, Part, Trial

CALM = Flow(break_trials=None, break_min=None)
Answer = tuple[bool, bool | None]


def make_trial(
    number: int, *, protocol: str = "realism", phase: str = "main", block: int = 1
) -> Trial:
    expected = (100.0, 100.0) if phase == "training" else None  # which nobody hits by guessing
    part, judgement = Part("test", f"s{number}"), Judgement("test", f"s{number}", expected=expected)
    at = block if phase == "main" else 0
    return Trial(number, at, 1, protocol, protocol, "replay", "oak", (part,), (judgement,), phase)


def walk(
    agenda: Agenda, answer: Callable[[Trial, int], Answer] = lambda *_: (True, None)
) -> list[str | int]:
    """Go to the end; every step takes ten seconds. Pages by key, trials by number."""
    steps: list[str | int] = []
    time_s = 0.0
    while (step := agenda.ask()) is not None:
        assert len(steps) < 1000
        time_s += 10.0
        if isinstance(step, Page):
            steps.append(step.key)
            agenda.tell_page(step.key, time_s=time_s)
        else:
            steps.append(step.number)
            accepted, as_expected = answer(step, agenda.attempt(step.number))
            outcome = VALID if accepted else SPOILED
            agenda.tell_trial(step.number, outcome, as_expected=as_expected, time_s=time_s)
    return steps


def trials_of(steps: Sequence[str | int]) -> list[int]:
    return [step for step in steps if isinstance(step, int)]


def pass_by(agenda: Agenda, time_s: float = 0.0) -> None:
    """Take the next step as done and good."""
    step = agenda.ask()
    if isinstance(step, Page):
        agenda.tell_page(step.key, time_s=time_s)
    elif step is not None:
        agenda.tell_trial(step.number, VALID, as_expected=None, time_s=time_s)


@pytest.mark.parametrize(
    ("trials", "steps"),
    [
        ([make_trial(n) for n in (1, 2, 3)], ["instructions.realism", "main", 1, 2, "rest", 3]),
        ([make_trial(1), make_trial(2, protocol="similarity"), make_trial(3, phase="training"),
          make_trial(4, phase="practice"), make_trial(5, protocol="similarity", phase="practice")],
         ["instructions.realism", "training", 3, "practice", 4, "main", 1, "rest",
          "instructions.similarity", "practice", 5, "main", 2]),
        ([make_trial(n, protocol="similarity" if n > 2 else "realism") for n in (1, 2, 3, 4)],
         ["instructions.realism", "main", 1, 2, "rest", "instructions.similarity", "main", 3, 4]),
    ],
)  # fmt: skip
def test_tasks_are_introduced_rehearsed_and_have_one_rest_between_or_half_way(
    trials: list[Trial], steps: list[str | int]
) -> None:
    agenda = Agenda(trials, CALM)
    n_main = sum(trial.phase == "main" for trial in trials)
    assert (agenda.done, agenda.total) == (0, n_main)
    assert walk(agenda) == ["welcome", "consent", *steps, "end"]
    assert (agenda.done, agenda.total) == (n_main, n_main)
    keys = {step for step in steps if isinstance(step, str) and "." not in step}
    assert keys <= read_texts()["pages"].keys()


@pytest.mark.parametrize(
    ("understood", "told"),
    [
        (True, ["expected", "training_passed"]),
        (False, ["unexpected", "training_again", 2, "unexpected", "training_failed"]),
        (None, []),
    ],
)
def test_training_tells_right_from_wrong_and_ends_after_its_last_round(
    understood: bool | None, told: list[str | int]
) -> None:
    trials = [make_trial(1), make_trial(2, phase="training")]
    agenda = Agenda(trials, replace(CALM, training_rounds=2))
    steps = walk(agenda, lambda t, _: (True, understood if t.phase == "training" else None))
    assert steps[3:] == ["training", 2, *told, "main", 1, "end"]


@pytest.mark.parametrize(
    ("protocol", "expected", "n", "needed"),
    [
        ("realism", (100.0, 100.0), 4, 3),  # no guess hits a point
        ("realism", (50.0, 100.0), 4, 4),  # half of them hit half of the scale
        ("realism", (50.0, 100.0), 8, 7),
        ("abx", (100.0, 100.0), 4, 4),  # half of them hit one of two
        ("abx", (100.0, 100.0), 8, 7),
    ],
)
@pytest.mark.parametrize("share", [0.75, 0.0])
def test_who_guesses_does_not_pass_training(
    protocol: str, expected: tuple[float, float], n: int, needed: int, share: float
) -> None:
    known = (Judgement("test", "s", expected=expected),)
    training = [make_trial(k, protocol=protocol, phase="training") for k in range(2, n + 2)]
    trials = [replace(one, judgements=known) for one in training]
    trials.append(make_trial(1, protocol=protocol))
    for right in range(n + 1):
        agenda = Agenda(trials, replace(CALM, training_rounds=1, training_pass=share))
        steps = walk(agenda, lambda t, _: (True, t.number < right + 2))  # noqa: B023 - called at once
        assert ("training_passed" in steps) == (right >= needed or share == 0)


@pytest.mark.parametrize(
    ("flow", "n", "steps"),
    [
        (Flow(2, None), 8, [1, 2, "break", 3, 4, "rest", 5, 6, "break", 7, 8]),
        # Ten seconds a step: after three trials half a minute has passed since the page before.
        (Flow(None, 0.5), 10, [1, 2, 3, "break", 4, 5, "rest", 6, 7, 8, "break", 9, 10]),
    ],
)
def test_breaks_come_by_count_or_by_minutes_and_never_beside_another_page(
    flow: Flow, n: int, steps: list[str | int]
) -> None:
    agenda = Agenda([make_trial(k) for k in range(1, n + 1)], flow)
    assert walk(agenda)[3:] == ["main", *steps, "end"]


@pytest.mark.parametrize(
    ("blocks", "bad", "order"),
    [
        ("111222", 1, [1, 2, 3, 1, 4, 5, 6]),  # at the end of its block
        ("111222", 3, [1, 2, 3, 4, 5, 6, 3]),  # of its section, as the last of its block
        ("11a", 2, [1, 2, 2, 3]),  # at once, as the last of all
        ("11a", 3, [1, 2, 3, 3]),
    ],
)
def test_a_bad_trial_comes_again(blocks: str, bad: int, order: list[int]) -> None:
    trials = [
        make_trial(n, block=int(block, 16), protocol="abx" if block == "a" else "realism")
        for n, block in enumerate(blocks, start=1)
    ]
    steps = walk(Agenda(trials, CALM), lambda t, attempt: (t.number != bad or attempt > 1, None))
    assert trials_of(steps) == order


def test_a_trial_that_stays_bad_is_given_up_and_the_session_goes_on() -> None:
    agenda = Agenda([make_trial(1), make_trial(2)], replace(CALM, max_attempts=2))
    assert trials_of(walk(agenda, lambda trial, _: (trial.number != 1, None))) == [1, 2, 1]
    assert (agenda.answered, agenda.given_up, agenda.total) == (1, 1, 2)


def test_a_device_that_fails_spends_no_attempt() -> None:
    trials = [make_trial(1), make_trial(2), make_trial(3, protocol="similarity")]
    agenda = Agenda(trials, replace(CALM, max_attempts=2))
    while not isinstance(agenda.ask(), Trial):
        pass_by(agenda)
    for number in (1, 2) * 3:  # one stimulus after another does not reach the hand
        agenda.tell_trial(number, LOST, as_expected=None, time_s=0.0)
    assert (agenda.done, agenda.attempt(1), agenda.attempt(2)) == (0, 4, 4)
    assert agenda.lost_in_a_row == 6


def test_warming_up_repeats_the_practice_of_the_task_at_hand() -> None:
    trials = [make_trial(n, protocol="similarity" if n > 1 else "realism") for n in (1, 2, 3)]
    trials.append(make_trial(4, phase="practice"))
    trials.append(make_trial(5, protocol="similarity", phase="practice"))
    agenda = Agenda(trials, CALM)
    agenda.warm_up()
    assert agenda.ask() == Page("welcome")  # nobody warms up before practice
    while agenda.ask() != trials[2]:
        pass_by(agenda)
    agenda.warm_up()
    agenda.warm_up()  # Who leaves again before it is over warms up once.
    assert walk(agenda) == ["warm_up", 5, 3, "end"]
    agenda.warm_up()
    assert agenda.ask() is None


def test_a_step_that_was_not_next_is_refused() -> None:
    agenda = Agenda([make_trial(1)], CALM)
    with pytest.raises(ValueError, match="got trial 1, expected page 'welcome'"):
        agenda.tell_trial(1, VALID, as_expected=None, time_s=0)
    walk(agenda)
    with pytest.raises(ValueError, match="got page 'end', expected the end"):
        agenda.tell_page("end", time_s=0)


@given(st.data())
def test_whatever_goes_wrong_everything_is_tried_until_it_is_good_or_given_up(
    data: st.DataObject,
) -> None:
    block = st.tuples(st.sampled_from(["realism", "similarity"]), st.integers(1, 4))
    blocks = sorted(data.draw(st.lists(block, min_size=1, max_size=4)), key=lambda one: one[0])
    trials: list[Trial] = []
    for number, (name, size) in enumerate(blocks, start=1):
        first = len(trials) + 1
        trials += [make_trial(first + n, protocol=name, block=number) for n in range(size)]
    attempts = {trial.number: data.draw(st.integers(1, 4)) for trial in trials}
    agenda = Agenda(trials, replace(CALM, break_trials=data.draw(st.integers(1, 5))))
    steps = walk(agenda, lambda trial, attempt: (attempt >= attempts[trial.number], None))
    assert Counter(trials_of(steps)) == {
        number: min(times, CALM.max_attempts) for number, times in attempts.items()
    }
    assert agenda.done == agenda.total == len(trials)
    # Tasks stay together: each is introduced once, and none of its trials comes before or after its section.
    order = [trials[step - 1].protocol for step in trials_of(steps)]
    assert order == sorted(order)
