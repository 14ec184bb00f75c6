"""From motion to output on a real audio path: what the null sink captures begins as late as the journal says."""

from __future__ import annotations

from typing import Any

import numpy as np

RATE_HZ = 48000


def test_the_latency_that_is_reported_is_that_of_what_was_captured(
    pulse: Any, open_player: Any, make_rig: Any, insist: Any
) -> None:
    sound = np.zeros((3 * RATE_HZ // 2, 4), dtype=np.float32)
    sound[:, :2] = 0.5
    # The stimulus itself begins and ends without a click.
    ramp = np.linspace(0, 1, 480, dtype=np.float32)[:, None]
    sound[:480] *= ramp
    sound[-480:] *= ramp[::-1]

    def play() -> tuple[dict[str, Any], Any]:
        with pulse.captured() as capture:
            player = open_player(pulse, make_rig(channels=4), {"flat": sound})
            player.hear()
            told = player.ask(do="explore", sound="flat", gap_s=0.05, after_s=0.5)
        player.leave()
        return told, capture

    told, capture = insist(
        play, is_disturbed=lambda found: bool(found[0]["underruns"] or found[0]["error"])
    )
    measured = told["measured"]
    late_ms, most_ms = measured["motion_latency_ms"], measured["motion_latency_ms_max"]
    assert 0 < late_ms <= most_ms
    # The first motion is felt after its report, by the latency, from rest on in one ramp of 20 ms up to the whole.
    moving = np.flatnonzero(np.abs(capture.samples[:, 0]) > 0)
    length_s = (moving[-1] - moving[0]) / RATE_HZ
    first_s = told["onset_s"] + len(sound) / RATE_HZ - length_s
    assert first_s - told["reports_s"][0] > 0
    # Of the first report no speed is known, the second one moves; 8 ms apart at least, more on a busy machine.
    assert first_s - told["reports_s"][1] <= 1e-3 * most_ms + 0.01
    steps = np.abs(np.diff(capture.samples[:, 0]))
    assert steps.max() <= 0.5 / (0.02 * RATE_HZ) + 0.5 / 480 + 1e-6
    assert np.abs(capture.samples[:, 0]).max() <= 0.5 * 2
    assert not np.abs(capture.samples[:, 2:]).any()
