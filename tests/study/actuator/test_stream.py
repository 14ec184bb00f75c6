"""The stream on a real audio path: every sample that was to be played is captured, and nothing else."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Sound = NDArray[np.float32]

RATE_HZ = 48000


def has_run_dry(deliveries: Sequence[Any]) -> bool:
    """Whether the output says itself that something was not played as it was to be, which it may on a busy machine."""
    return any(delivery["underruns"] or delivery["error"] for delivery in deliveries)


@pytest.mark.parametrize("pulse", [6], indirect=True)
def test_every_sample_arrives_on_its_channel_in_order_and_nothing_else_does(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any
) -> None:
    lengths = {"a": 4800, "b": 1, "c": 12345, "d": 480}
    sounds = {name: make_sound(n, n=n, channels=pulse.channels) for name, n in lengths.items()}
    order = ["a", "c", "b", "a", "d"]

    def play() -> tuple[list[Any], Any]:
        with pulse.captured() as capture:
            player = open_player(pulse, make_rig(channels=pulse.channels), sounds)
            assert player.hear()["identity"]["device"] == "stylus"
            deliveries = [
                player.ask(do="play", sound=name, gap_s=0.0 if name == "b" else 0.05)
                for name in order
            ]
        player.leave()
        return deliveries, capture

    deliveries, capture = insist(play, is_disturbed=lambda found: has_run_dry(found[0]))
    assert all(told["completed"] and not told["error"] for told in deliveries)
    assert not has_run_dry(deliveries)
    rest, after = capture.samples.copy(), 0
    for sound in (sounds[name] for name in order):
        place = capture.find(sound, after=after)
        assert place >= after
        after = place + len(sound)
        rest[place:after] = 0
    assert not rest.any()


def test_a_stop_falls_silent_within_a_block_and_is_not_completed(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any
) -> None:
    sound = make_sound(1, n=20 * RATE_HZ, channels=4)
    player = open_player(pulse, make_rig(channels=4), {"a": sound, "b": make_sound(2, channels=4)})
    player.hear()

    def stop() -> tuple[Any, Any, Any, Any]:
        with pulse.captured() as capture:
            stopped_s = player.ask(do="play", sound="a", after_s=0.8)["stopped_s"]
            delivery = player.hear()
            again = player.ask(do="play", sound="b")
        return capture, stopped_s, delivery, again

    def is_disturbed(found: tuple[Any, Any, Any, Any]) -> bool:
        _, (before_s, after_s), delivery, again = found
        if has_run_dry([delivery, again]):
            return True
        last_s = delivery["onset_s"] + delivery["measured"]["n_samples"] / RATE_HZ
        # The player's own process stood still.
        return after_s - before_s > 0.03 or delivery["over_s"] - last_s > 0.1

    capture, (before_s, after_s), delivery, again = insist(stop, is_disturbed=is_disturbed)
    measured = delivery["measured"]
    onset = int(np.flatnonzero(capture.samples[:, 0])[0])
    n_played = int(measured["n_samples"])
    assert (delivery["completed"], delivery["error"]) == (False, "")
    # All but a short fade is the stimulus as it is, and after the last sample there is nothing.
    whole = n_played - round(0.005 * RATE_HZ)
    assert np.array_equal(capture.samples[onset : onset + whole], sound[:whole])
    assert not capture.samples[onset + n_played + 1 : onset + n_played + 2400].any()
    # What the device holds already (its latency) cannot be taken back; after that one block passes at most.
    last_s = delivery["onset_s"] + n_played / RATE_HZ
    assert last_s - after_s - 0.03 <= measured["stop_s"] <= last_s - before_s + 0.03
    assert 0 < measured["stop_s"] < 1.5 * measured["latency_s"] + 0.03
    assert again["completed"]
    assert capture.find(make_sound(2, channels=4)) > onset + n_played


def test_a_server_that_dies_is_told_and_tried_again_with_the_next_stimulus(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any
) -> None:
    sounds = {"a": make_sound(1, n=20 * RATE_HZ, channels=4), "b": make_sound(2, channels=4)}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()
    player.tell(do="start", sound="a")
    player.ask(do="clock")
    player.tell(do="collect")
    time.sleep(0.5)
    pulse.kill()
    begin_s = time.monotonic()
    dead = player.hear()
    assert not dead["completed"]
    assert dead["error"].startswith("device 'stylus' stopped")
    gone = player.ask(do="play", sound="b")
    assert gone["onset_s"] is None
    assert gone["error"].startswith("device 'stylus' not found")
    assert time.monotonic() - begin_s < 30  # it does not hang
    pulse.start()

    def come_back() -> tuple[Any, Any]:
        with pulse.captured() as capture:
            return player.ask(do="play", sound="b"), capture

    back, capture = insist(come_back, is_disturbed=lambda found: has_run_dry(found[:1]))
    assert (back["error"], back["completed"], back["underruns"]) == ("", True, 0)
    assert capture.find(sounds["b"]) >= 0


def play_many(pulse: Any, player: Any, sounds: dict[str, Sound]) -> tuple[list[Any], list[int]]:
    """Play sounds one after the other with uneven gaps; give what was delivered, and where it was captured."""
    with pulse.captured() as capture:
        deliveries = [
            player.ask(do="play", sound=name, gap_s=0.02 + 0.013 * (number % 7))
            for number, name in enumerate(sounds)
        ]
    after, places = 0, []
    for sound in sounds.values():
        places.append(capture.find(sound, after=after))
        after = max(after, places[-1])
    return deliveries, places


@dataclass(frozen=True)
class Trials:
    """What became of many: underruns, silent losses, and jitter (median and 99 %) and lateness of what was whole."""

    underrun_share: float
    n_lost: int
    n_lost_in_silence: int
    jitter_ms: tuple[float, float]
    earliest_s: float
    late_s: float

    @property
    def is_punctual(self) -> bool:
        is_steady = self.jitter_ms[0] < 2 and self.jitter_ms[1] < 10
        return is_steady and self.underrun_share < 0.1 and self.late_s < 0.25


def sum_up(deliveries: Sequence[Any], places: Sequence[int]) -> Trials:
    flagged = np.array([bool(one["underruns"] or one["error"]) for one in deliveries])
    lost = np.array(places) < 0
    kept = ~(lost | flagged)
    counts = flagged.mean(), int(lost.sum()), int((lost & ~flagged).sum())
    if not kept.any():
        return Trials(*counts, (np.inf, np.inf), 0.0, np.inf)
    asked_s = np.array([one["requested_s"] for one in deliveries])[kept]
    onsets_s = np.array([one["onset_s"] or np.nan for one in deliveries])[kept]
    late_s, apart_s = onsets_s - asked_s, np.array(places)[kept] / RATE_HZ - onsets_s
    median_ms, high_ms = 1e3 * np.percentile(np.abs(apart_s - np.median(apart_s)), [50, 99])
    return Trials(*counts, (median_ms, high_ms), float(late_s.min()), float(np.median(late_s)))


@pytest.mark.parametrize("n_trials", [25, pytest.param(500, marks=pytest.mark.soak)])
def test_every_trial_arrives_whole_or_its_underrun_is_flagged_and_onsets_are_true(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any, n_trials: int,
    record_testsuite_property: Any,
) -> None:  # fmt: skip
    sounds = {f"s{n}": make_sound(n, n=2400, channels=4) for n in range(n_trials)}
    # A machine that tests has much to do.
    player = open_player(pulse, make_rig(channels=4, latency_s=0.1), sounds)
    player.hear()

    def measure() -> Trials:
        deliveries, places = play_many(pulse, player, sounds)
        trials = sum_up(deliveries, places)
        for name, value in asdict(trials).items():
            record_testsuite_property(name, value)
        assert trials.n_lost_in_silence == 0
        return trials

    # A machine that does other things too may let some run dry, and the server's own idea of its times run off.
    trials = insist(measure, is_disturbed=lambda trials: not trials.is_punctual)
    assert trials.underrun_share < 0.1
    assert trials.jitter_ms[0] < 2
    assert trials.jitter_ms[1] < 10
    assert trials.earliest_s >= 0
    assert trials.late_s < 0.25


@pytest.mark.parametrize("is_gap", [False, True])
def test_a_server_that_stands_still_spoils_the_samples_that_it_meets_and_no_silence(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any, is_gap: bool
) -> None:
    sounds = {name: make_sound(n, n=RATE_HZ, channels=4) for n, name in enumerate("abc")}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()

    def halt() -> tuple[list[int], list[bool], float]:
        with pulse.captured() as capture:
            underruns, n_gaps = [], 0.0
            for name in sounds:
                player.tell(do="start", sound=name, gap_s=2.0 if is_gap else 0.1)
                player.ask(do="clock")
                player.tell(do="collect")
                time.sleep(0.4)
                with pulse.halted() if name == "b" else nullcontext():
                    time.sleep(0.5)
                delivery = player.hear()
                assert delivery["completed"] or delivery["error"]
                underruns.append(delivery["underruns"] + bool(delivery["error"]))
                if name == "b":
                    n_gaps = delivery["measured"].get("gap_underruns", 0.0)
                    assert delivery["measured"].get("underrun_sample", 0) <= RATE_HZ
        whole = [capture.find(sound) >= 0 for sound in sounds.values()]
        assert all(is_whole or n for is_whole, n in zip(whole, underruns, strict=True))
        return underruns, whole, n_gaps

    # On a busy machine others may run dry too, and the server may be stopped when all was played.
    def is_disturbed(found: tuple[list[int], list[bool], float]) -> bool:
        return [bool(n) for n in found[0]] != [False, not is_gap, False]

    underruns, whole, n_gaps = insist(halt, is_disturbed=is_disturbed)
    assert [bool(n) for n in underruns] == [False, not is_gap, False]
    assert whole == [True, is_gap or whole[1], True]
    assert (n_gaps > 0) == is_gap
