from __future__ import annotations

import os
import signal
import threading

import pytest

from feel321.study.screen.input import HELD, hold_signals


def test_the_first_signal_waits_and_the_second_does_not() -> None:
    with hold_signals() as heed:
        heed()
        os.kill(os.getpid(), signal.SIGINT)  # nothing is raised here
        with pytest.raises(KeyboardInterrupt):
            heed()
        heed()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_who_presses_twice_does_not_wait_for_a_frame() -> None:
    with hold_signals():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_handlers_are_as_they_were_afterwards() -> None:
    before = [signal.getsignal(number) for number in HELD]
    with hold_signals():
        pass
    assert [signal.getsignal(number) for number in HELD] == before


def test_other_threads_hold_nothing() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def enter() -> None:
        with hold_signals() as heed:
            heed()
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [before]
