"""The stream on a real audio path: every sample that was to be played is captured, and nothing else."""

from __future__ import annotations

import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.stimuli.wav import read_wav

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Sound = NDArray[np.float32]

RATE_HZ = 48000


def find_all(capture: Any, sounds: Sequence[Sound]) -> list[int]:
    """Find sounds one after the other, each in full."""
    places = []
    after = 0
    for number, sound in enumerate(sounds):
        place = capture.find(sound, after=after)
        assert place >= 0, f"sound {number} is not there, or not whole"
        places.append(place)
        after = place + len(sound)
    return places


def blank(capture: Any, places: Sequence[int], sounds: Sequence[Sound]) -> Sound:
    """Take out what was found; what is left was not to be there."""
    rest: Sound = capture.samples.copy()
    for place, sound in zip(places, sounds, strict=True):
        rest[place : place + len(sound)] = 0
    return rest


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
        find_all(
            capture,
            [
                sounds[name]
                for name, told in zip(order, deliveries, strict=True)
                if not told["underruns"]
            ],
        )
        return deliveries, capture

    deliveries, capture = insist(play, is_disturbed=lambda found: has_run_dry(found[0]))
    assert [delivery["underruns"] for delivery in deliveries] == [0] * len(order)
    assert all(delivery["completed"] and not delivery["error"] for delivery in deliveries)
    played = [sounds[name] for name in order]
    places = find_all(capture, played)
    assert not blank(capture, places, played).any()


MASKING = "[masking]\nchannels = [3, 4]\nrms = 0.05\nramp_s = 0.1\nlead_s = 0.3\nseed = 1"


def test_masking_is_on_its_channels_only_and_ramped_around_the_vibration(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any
) -> None:
    sound = make_sound(1, n=9600, channels=4)

    def play() -> tuple[Any, Any]:
        with pulse.captured() as capture:
            player = open_player(pulse, make_rig(MASKING), {"a": sound})
            player.hear()
            delivery = player.ask(do="play", sound="a")
        player.leave()
        return delivery, capture

    def is_disturbed(found: tuple[Any, Any]) -> bool:
        heard = np.flatnonzero(found[1].samples[:, 2:].any(axis=1))
        # A server that ran dry unseen, after the vibration, puts silence into the noise.
        return has_run_dry(found[:1]) or bool(np.diff(heard).max(initial=0) > RATE_HZ / 1000)

    delivery, capture = insist(play, is_disturbed=is_disturbed)
    vibration, masking = capture.samples[:, :2], capture.samples[:, 2:]
    onset = int(np.flatnonzero(vibration.any(axis=1))[0])
    assert np.array_equal(vibration[onset : onset + len(sound)], sound[:, :2])
    assert np.count_nonzero(vibration.any(axis=1)) == len(sound)
    heard = np.flatnonzero(masking.any(axis=1))
    lead, ramp = round(0.3 * RATE_HZ), round(0.1 * RATE_HZ)
    assert abs(onset - lead - heard[0]) <= 2
    assert abs(onset + len(sound) + lead - heard[-1]) <= 2
    rms = [
        np.sqrt(np.mean(masking[first : first + ramp // 4] ** 2))
        for first in (heard[0], heard[-1] - ramp // 4)
    ]
    level = np.sqrt(np.mean(masking[onset : onset + len(sound)] ** 2))
    assert max(rms) < level / 3
    assert level == pytest.approx(0.05, rel=0.5)
    # The silence that the masking needs was not asked for, so it is told as a late onset.
    assert delivery["onset_s"] - delivery["requested_s"] > 0.3


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
        return (
            self.underrun_share < 0.1
            and self.jitter_ms[0] < 2
            and self.jitter_ms[1] < 10
            and self.late_s < 0.25
        )


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
    pulse: Any,
    open_player: Any,
    make_rig: Any,
    make_sound: Any,
    insist: Any,
    record_testsuite_property: Any,
    n_trials: int,
) -> None:
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
    vibrating = np.flatnonzero(capture.samples[:, 0])
    onset, n_played = int(vibrating[0]), int(measured["n_samples"])
    assert not delivery["completed"]
    assert not delivery["error"]
    # All but a short fade is the stimulus as it is, and after the last sample there is nothing.
    fade = round(0.005 * RATE_HZ)
    assert np.array_equal(
        capture.samples[onset : onset + n_played - fade], sound[: n_played - fade]
    )
    assert not capture.samples[onset + n_played + 1 : onset + n_played + 2400].any()
    # What the device holds already (its latency) cannot be taken back; after that one block passes at most.
    last_s = delivery["onset_s"] + n_played / RATE_HZ
    block_s = measured["latency_s"] / 4
    assert last_s - after_s - 0.03 <= measured["stop_s"] <= last_s - before_s + 0.03
    # That for a machine with much to do.
    assert 0 < measured["stop_s"] < measured["latency_s"] + 2 * block_s + 0.03
    assert abs(delivery["over_s"] - last_s) < 0.1
    assert again["completed"]
    assert capture.find(make_sound(2, channels=4)) > onset + n_played


@pytest.mark.parametrize(
    "seconds", [0.5, *(pytest.param(s, marks=pytest.mark.soak) for s in (0.2, 1.0))]
)
def test_a_server_that_stands_still_is_an_underrun_of_that_playback_only(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any, seconds: float
) -> None:
    sounds = {name: make_sound(n, n=RATE_HZ // 2, channels=4) for n, name in enumerate("abc")}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()

    def halt() -> tuple[list[bool], list[bool]]:
        with pulse.captured() as capture:
            underruns = []
            for name in sounds:
                player.tell(do="start", sound=name, gap_s=0.1)
                player.ask(do="clock")
                player.tell(do="collect")
                with pulse.halted() if name == "b" else nullcontext():
                    time.sleep(seconds)
                delivery = player.hear()
                assert delivery["completed"] or delivery["error"]
                underruns.append(delivery["underruns"] > 0 or bool(delivery["error"]))
        whole = [capture.find(sound) >= 0 for sound in sounds.values()]
        assert all(is_whole or is_told for is_whole, is_told in zip(whole, underruns, strict=True))
        return underruns, whole

    # On a busy machine others may run dry too, and the server may be stopped when all was played.
    underruns, whole = insist(halt, is_disturbed=lambda found: found[0] != [False, True, False])
    assert underruns == [False, True, False]
    assert whole[::2] == [True, True]


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


@pytest.mark.soak
def test_a_server_that_hangs_for_long_is_dead_without_hanging_the_session(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    sounds = {"a": make_sound(1, n=20 * RATE_HZ, channels=4), "b": make_sound(2, channels=4)}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()
    player.tell(do="start", sound="a")
    player.ask(do="clock")
    player.tell(do="collect")
    with pulse.halted():
        dead = player.hear()
        assert "stands still" in dead["error"]
        begin_s = time.monotonic()
        assert player.ask(do="play", sound="b")["error"]
        assert time.monotonic() - begin_s < 30  # it does not hang
    deadline_s = time.monotonic() + 120
    while player.ask(do="play", sound="b")["error"]:
        assert time.monotonic() < deadline_s


@pytest.mark.parametrize(
    ("device", "channels", "rate_hz", "message"),
    [
        ("nowhere", 4, 48000, "device 'nowhere' not found; name one of 'stylus' (ALSA), 'stylus twin'"),
        ("TWIN", 4, 1_000_000, "device 'stylus twin' does not play at 1e+06 Hz (Error opening OutputStream: Inv"),
    ],
)  # fmt: skip
def test_what_is_not_exactly_there_is_refused(
    pulse: Any,
    open_player: Any,
    make_rig: Any,
    device: str,
    channels: int,
    rate_hz: int,
    message: str,
) -> None:
    player = open_player(
        pulse, make_rig(device=device, channels=channels), {"a": np.zeros((1, 4))}, rate_hz=rate_hz
    )
    refused = player.hear()["refused"]
    assert message in refused
    assert "\n" not in refused


# Input channels are counted from 1 up to this one; fewer than the monitor has would be mixed by the server.
SENSOR = "[sensor]\nchannel = 4\nfull_scale_m_s2 = 100.0"


def test_what_the_sensor_measures_is_kept_from_the_onset_on(
    fresh_pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, insist: Any, tmp_path: Path
) -> None:
    sounds = {name: make_sound(n, n=RATE_HZ // 2, channels=4) for n, name in enumerate("ab")}
    for sound in sounds.values():
        sound[:, 3] = sound[:, 0]
    player = open_player(fresh_pulse, make_rig(SENSOR, channels=4, latency_s=0.15), sounds)
    player.hear()

    def play() -> tuple[list[Any], list[int]]:
        deliveries = [player.ask(do="play", sound=name, gap_s=0.1) for name in sounds]
        return deliveries, [
            find_lag(told, sound) for told, sound in zip(deliveries, sounds.values(), strict=True)
        ]

    def find_lag(delivery: Any, sound: Sound) -> int:
        samples, rate_hz = read_wav(
            tmp_path / "delivered" / f"{int(delivery['measured']['file_number']):04}.wav"
        )
        assert rate_hz == RATE_HZ
        # The sink's monitor is the sensor: what was played comes back, later by the way there and back.
        lag = int(np.argmax(np.correlate(samples, sound[:, 0].astype(float), mode="valid")))
        back = samples[lag : lag + len(sound)]
        if not back @ sound[:, 0] > 0.5 * np.linalg.norm(back) * np.linalg.norm(sound[:, 0]):
            return -1  # the way took longer than the file: a busy server has long buffers
        if not (delivery["underruns"] or delivery["measured"]["sensor_gaps"]):
            assert back == pytest.approx(100 * sound[:, 0], abs=1e-3)
        return lag

    def is_disturbed(found: tuple[list[Any], list[int]]) -> bool:
        # Between two playbacks nobody counts underruns; each of them changes the way there and back for good.
        deliveries, (one, other) = found
        has_gaps = any(delivery["measured"]["sensor_gaps"] for delivery in deliveries)
        return has_run_dry(deliveries) or has_gaps or one != other or one < 0

    deliveries, lags = insist(play, is_disturbed=is_disturbed)
    assert [delivery["error"] for delivery in deliveries] == ["", ""]
    assert deliveries[1]["measured"]["file_number"] == deliveries[0]["measured"]["file_number"] + 1
    for delivery in deliveries:
        assert delivery["measured"]["sensor_gaps"] == 0
        assert delivery["measured"]["sensor_onset_sample"] > 0
        assert delivery["dac_source"] == "device"
    assert 0 < lags[0] < 0.45 * RATE_HZ
    assert lags[0] == lags[1]  # to the sample
