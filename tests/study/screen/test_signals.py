from __future__ import annotations

import os
import signal

import pytest

from feel321.study.screen.window import HELD, hold_signals


@pytest.mark.parametrize("is_over", [True, False])
def test_the_first_signal_waits_for_a_frame_and_the_second_does_not(is_over: bool) -> None:
    before = [signal.getsignal(number) for number in HELD]
    with hold_signals() as deliver:
        deliver()
        os.kill(os.getpid(), signal.SIGINT)  # nothing is raised here
        if is_over:
            with pytest.raises(KeyboardInterrupt):
                deliver()
            deliver()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert [signal.getsignal(number) for number in HELD] == before
