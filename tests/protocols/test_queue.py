from __future__ import annotations

import pytest

from protocols.queue import TrialQueue
from protocols.trial import Trial


def make_queue() -> TrialQueue:
    return TrialQueue([Trial(number, 1, 1, "realism", "realism", f"s{number}") for number in (1, 2, 3)])


def test_the_same_trial_is_asked_until_it_is_done() -> None:
    queue = make_queue()
    first = queue.ask()
    assert first is not None
    assert first.number == 1
    assert queue.ask() == first
    queue.tell(1)
    second = queue.ask()
    assert second is not None
    assert second.number == 2


def test_done_trials_are_never_asked_again() -> None:
    queue = make_queue()
    for number in (2, 1, 3):
        queue.tell(number)
    assert queue.ask() is None


@pytest.mark.parametrize("number", [1, 4])
def test_a_trial_is_done_once(number: int) -> None:
    queue = make_queue()
    queue.tell(1)
    with pytest.raises(ValueError, match=f"trial {number}: is unknown or was done before"):
        queue.tell(number)
