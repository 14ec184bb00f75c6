"""What comes next: pages, training, breaks and second attempts, each by hand and by law."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.agenda import Agenda
from feel321.protocols.trial import PAGES, Flow, Judgement, Page, Part, Trial

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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
            agenda.tell_trial(
                step.number, accepted=accepted, as_expected=as_expected, time_s=time_s
            )
    return steps


def trials_of(steps: Sequence[str | int]) -> list[int]:
    return [step for step in steps if isinstance(step, int)]


def test_a_plain_session_has_a_rest_half_way() -> None:
    assert walk(Agenda([make_trial(n) for n in (1, 2, 3)], CALM)) == [
        "welcome",
        "consent",
        "instructions.realism",
        "main",
        1,
        2,
        "rest",
        3,
        "end",
    ]


def test_tasks_are_introduced_rehearsed_and_kept_apart_by_a_rest() -> None:
    trials = [make_trial(1), make_trial(2, protocol="similarity"), make_trial(3, phase="training")]
    trials += [
        make_trial(4, phase="practice"),
        make_trial(5, protocol="similarity", phase="practice"),
    ]
    agenda = Agenda(trials, CALM)
    assert (agenda.done, agenda.total) == (0, 2)
    assert walk(agenda) == [
        "welcome",
        "consent",
        "instructions.realism",
        "training",
        3,
        "practice",
        4,
        "main",
        1,
        "rest",
        "instructions.similarity",
        "practice",
        5,
        "main",
        2,
        "end",
    ]
    assert (agenda.done, agenda.total) == (2, 2)


def test_the_rest_between_two_tasks_is_the_only_one() -> None:
    trials = [make_trial(n, protocol="similarity" if n > 2 else "realism") for n in (1, 2, 3, 4)]
    steps = walk(Agenda(trials, CALM))
    assert steps.count("rest") == 1
    assert steps[steps.index("rest") - 1] == 2


def test_a_trial_of_another_round_has_all_its_attempts_again() -> None:
    agenda = Agenda(
        [make_trial(1), make_trial(2, phase="training"), make_trial(3, phase="training")],
        replace(CALM, max_attempts=3, training_rounds=2),
    )
    attempts: list[tuple[int, int]] = []

    def answer(trial: Trial, attempt: int) -> Answer:
        if trial.phase == "main":
            return True, None
        attempts.append((trial.number, attempt))
        return trial.number == 3 or attempt == 3, False

    walk(agenda, answer)
    one_round = [(2, 1), (3, 1), (2, 2), (2, 3)]
    assert attempts == one_round * 2


def test_every_page_has_a_text_to_be_found() -> None:
    known = {*PAGES} - {"instructions"}
    trials = [
        make_trial(1),
        make_trial(2),
        make_trial(3, phase="training"),
        make_trial(4, phase="practice"),
    ]
    seen = set(
        walk(
            Agenda(trials, replace(CALM, break_trials=1)),
            lambda t, _: (True, t.phase != "training"),
        )
    )
    assert {
        key for key in seen if isinstance(key, str) and not key.startswith("instructions.")
    } <= known


@pytest.mark.parametrize(("understood", "told"), [(True, "expected"), (False, "unexpected")])
def test_training_tells_right_from_wrong(understood: bool, told: str) -> None:
    agenda = Agenda(
        [make_trial(1), make_trial(2, phase="training")], replace(CALM, training_rounds=1)
    )
    steps = walk(agenda, lambda trial, _: (True, understood if trial.phase == "training" else None))
    verdict = "training_passed" if understood else "training_failed"
    assert steps[3:7] == ["training", 2, told, verdict]


def test_training_is_repeated_until_it_is_passed() -> None:
    trials = [make_trial(1), *(make_trial(n, phase="training") for n in (2, 3, 4, 5))]
    answers = iter([True, False, False, True, True, True, True, False])
    steps = walk(
        Agenda(trials, CALM), lambda t, _: (True, next(answers) if t.phase == "training" else None)
    )
    assert [step for step in steps if step not in {"expected", "unexpected"}][3:] == [
        "training",
        2,
        3,
        4,
        5,
        "training_again",
        2,
        3,
        4,
        5,
        "training_passed",
        "main",
        1,
        "end",
    ]


def test_training_ends_after_its_last_round_whatever_the_answers() -> None:
    trials = [make_trial(1), make_trial(2, phase="training")]
    steps = walk(
        Agenda(trials, CALM), lambda t, _: (True, False if t.phase == "training" else None)
    )
    assert trials_of(steps) == [2, 2, 2, 1]
    assert [steps.count(f"training_{key}") for key in ("again", "failed", "passed")] == [2, 1, 0]


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
def test_who_guesses_does_not_pass_training(
    protocol: str, expected: tuple[float, float], n: int, needed: int
) -> None:
    known = (Judgement("test", "s", expected=expected),)
    training = [
        replace(make_trial(k, protocol=protocol, phase="training"), judgements=known)
        for k in range(2, n + 2)
    ]
    trials = [make_trial(1, protocol=protocol), *training]
    for right in range(n + 1):
        agenda = Agenda(trials, replace(CALM, training_rounds=1))
        steps = walk(
            agenda,
            lambda t, _, right=right: (
                True,
                t.number < right + 2 if t.phase == "training" else None,
            ),
        )
        assert ("training_passed" in steps) == (right >= needed)


def test_a_share_of_nothing_lets_everybody_pass() -> None:
    known = (Judgement("x", "s", expected=(100.0, 100.0)),)
    training = [
        replace(make_trial(k, protocol="abx", phase="training"), judgements=known) for k in (2, 3)
    ]
    agenda = Agenda([make_trial(1, protocol="abx"), *training], replace(CALM, training_pass=0.0))
    assert "training_passed" in walk(
        agenda, lambda t, _: (True, False if t.phase == "training" else None)
    )


def test_training_in_which_nothing_is_right_or_wrong_is_neither_passed_nor_failed() -> None:
    steps = walk(Agenda([make_trial(1), make_trial(2, phase="training")], CALM))
    assert not {"expected", "unexpected", "training_passed", "training_failed"} & set(steps)


def test_breaks_come_by_count_and_never_beside_another_page() -> None:
    steps = walk(Agenda([make_trial(n) for n in range(1, 9)], replace(CALM, break_trials=2)))
    assert steps[3:] == ["main", 1, 2, "break", 3, 4, "rest", 5, 6, "break", 7, 8, "end"]


def test_breaks_come_by_minutes_since_the_hand_last_rested() -> None:
    # Ten seconds a step: after three trials half a minute has passed since the page before.
    steps = walk(Agenda([make_trial(n) for n in range(1, 11)], replace(CALM, break_min=0.5)))
    assert steps[3:] == ["main", 1, 2, 3, "break", 4, 5, "rest", 6, 7, 8, "break", 9, 10, "end"]


def test_a_break_stands_as_long_as_the_flow_says() -> None:
    agenda = Agenda(
        [make_trial(1), make_trial(2), make_trial(3)],
        replace(CALM, break_trials=1, break_s=7, rest_s=9),
    )
    pages: dict[str, float] = {}
    while (step := agenda.ask()) is not None:
        if isinstance(step, Page):
            pages[step.key] = step.least_s
            agenda.tell_page(step.key, time_s=0)
        else:
            agenda.tell_trial(step.number, accepted=True, as_expected=None, time_s=0)
    assert (pages["break"], pages["rest"], pages["welcome"]) == (7, 9, 0)


def fail_once(number: int) -> Callable[[Trial, int], Answer]:
    return lambda trial, attempt: (trial.number != number or attempt > 1, None)


def test_a_bad_trial_comes_again_at_the_end_of_its_block() -> None:
    trials = [make_trial(n, block=(n + 2) // 3) for n in range(1, 7)]
    assert trials_of(walk(Agenda(trials, CALM), fail_once(1))) == [1, 2, 3, 1, 4, 5, 6]


def test_the_last_trial_of_a_block_comes_again_at_the_end_of_its_section() -> None:
    trials = [make_trial(n, block=(n + 2) // 3) for n in range(1, 7)]
    assert trials_of(walk(Agenda(trials, CALM), fail_once(3))) == [1, 2, 3, 4, 5, 6, 3]


def test_the_last_trial_of_all_comes_again_at_once() -> None:
    trials = [make_trial(n, protocol="realism" if n < 3 else "abx", block=n) for n in (1, 2, 3)]
    assert trials_of(walk(Agenda(trials, CALM), fail_once(2))) == [1, 2, 2, 3]
    assert trials_of(walk(Agenda(trials, CALM), fail_once(3))) == [1, 2, 3, 3]


def test_a_trial_that_stays_bad_is_given_up_and_the_session_goes_on() -> None:
    agenda = Agenda([make_trial(1), make_trial(2)], replace(CALM, max_attempts=2))
    assert trials_of(walk(agenda, lambda trial, _: (trial.number != 1, None))) == [1, 2, 1]
    assert agenda.done == agenda.total


def test_warming_up_repeats_the_practice_of_the_task_at_hand() -> None:
    trials = [
        make_trial(1),
        make_trial(2, protocol="similarity"),
        make_trial(3, protocol="similarity"),
    ]
    trials += [
        make_trial(4, phase="practice"),
        make_trial(5, protocol="similarity", phase="practice"),
    ]
    agenda = Agenda(trials, CALM)
    steps: list[Any] = []
    while (step := agenda.ask()) is not None and step != trials[2]:
        steps.append(step)
        if isinstance(step, Page):
            agenda.tell_page(step.key, time_s=0)
        else:
            agenda.tell_trial(step.number, accepted=True, as_expected=None, time_s=0)
    agenda.warm_up()
    agenda.warm_up()  # Who leaves again before it is over warms up once.
    assert walk(agenda) == ["warm_up", 5, 3, "end"]


def test_nobody_warms_up_before_or_during_practice_or_for_nothing() -> None:
    agenda = Agenda([make_trial(1), make_trial(2, phase="practice")], CALM)
    agenda.warm_up()
    assert walk(agenda)[0] == "welcome"
    agenda.warm_up()
    assert agenda.ask() is None


def test_who_has_no_practice_to_repeat_is_not_asked_to_warm_up() -> None:
    agenda = Agenda(
        [make_trial(1), make_trial(2, protocol="similarity"), make_trial(3, phase="practice")], CALM
    )
    while agenda.ask() != make_trial(2, protocol="similarity"):
        step = agenda.ask()
        if isinstance(step, Page):
            agenda.tell_page(step.key, time_s=0)
        else:
            agenda.tell_trial(step.number if step else 0, accepted=True, as_expected=None, time_s=0)
    agenda.warm_up()
    assert walk(agenda) == [2, "end"]


def test_the_time_to_the_next_break_starts_anew_after_warming_up() -> None:
    trials = [make_trial(n) for n in range(1, 7)] + [make_trial(7, phase="practice")]
    agenda = Agenda(trials, replace(CALM, break_min=1.0))
    for key in ("welcome", "consent", "instructions.realism", "practice"):
        agenda.tell_page(key, time_s=0)
    agenda.tell_trial(7, accepted=True, as_expected=None, time_s=0)
    agenda.tell_page("main", time_s=0)
    agenda.tell_trial(1, accepted=True, as_expected=None, time_s=10)
    agenda.warm_up()
    agenda.tell_page("warm_up", time_s=3600)
    agenda.tell_trial(7, accepted=True, as_expected=None, time_s=3610)
    agenda.tell_trial(2, accepted=True, as_expected=None, time_s=3620)
    assert agenda.ask() == trials[2]


def test_a_step_that_was_not_next_is_refused() -> None:
    agenda = Agenda([make_trial(1)], CALM)
    with pytest.raises(ValueError, match="got trial 1, expected page 'welcome'"):
        agenda.tell_trial(1, accepted=True, as_expected=None, time_s=0)
    walk(agenda)
    with pytest.raises(ValueError, match="got page 'end', expected the end"):
        agenda.tell_page("end", time_s=0)


@given(st.data())
def test_whatever_goes_wrong_everything_is_tried_until_it_is_good_or_given_up(
    data: st.DataObject,
) -> None:
    blocks = data.draw(st.lists(st.integers(1, 4), min_size=1, max_size=4))
    names = [data.draw(st.sampled_from(["realism", "similarity"])) for _ in blocks]
    trials: list[Trial] = []
    for block, (size, name) in enumerate(
        sorted(zip(blocks, names, strict=True), key=lambda b: b[1]), start=1
    ):
        trials += [make_trial(len(trials) + 1 + n, protocol=name, block=block) for n in range(size)]
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
