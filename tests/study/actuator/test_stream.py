"""The stream on a real audio path: every sample that was to be played is captured, and nothing else."""

from __future__ import annotations

import time
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from stimuli.wav import read_wav

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


@pytest.mark.parametrize("pulse", [2, 4, 6], indirect=True)
def test_every_sample_arrives_on_its_channel_in_order_and_nothing_else_does(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    lengths = {"a": 4800, "b": 1, "c": 12345, "d": 480}
    sounds = {name: make_sound(n, n=n, channels=pulse.channels) for name, n in lengths.items()}
    order = ["a", "c", "b", "a", "d"]
    with pulse.captured() as capture:
        player = open_player(pulse, make_rig(channels=pulse.channels), sounds)
        assert player.hear()["identity"]["device"] == "stylus"
        deliveries = [player.ask(do="play", sound=name, gap_s=0.0 if name == "b" else 0.05) for name in order]
    assert [delivery["underruns"] for delivery in deliveries] == [0] * len(order)
    assert all(delivery["completed"] and not delivery["error"] for delivery in deliveries)
    played = [sounds[name] for name in order]
    places = find_all(capture, played)
    assert not blank(capture, places, played).any()


MASKING = "[masking]\nchannels = [3, 4]\nrms = 0.05\nramp_s = 0.1\nlead_s = 0.3\nseed = 1"


def test_masking_is_on_its_channels_only_and_ramped_around_the_vibration(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    sound = make_sound(1, n=9600, channels=4)
    with pulse.captured() as capture:
        player = open_player(pulse, make_rig(MASKING), {"a": sound})
        player.hear()
        delivery = player.ask(do="play", sound="a")
    vibration, masking = capture.samples[:, :2], capture.samples[:, 2:]
    onset = int(np.flatnonzero(vibration.any(axis=1))[0])
    assert np.array_equal(vibration[onset : onset + len(sound)], sound[:, :2])
    assert np.count_nonzero(vibration.any(axis=1)) == len(sound)
    heard = np.flatnonzero(masking.any(axis=1))
    lead, ramp = round(0.3 * RATE_HZ), round(0.1 * RATE_HZ)
    assert abs(onset - lead - heard[0]) <= 2
    assert abs(onset + len(sound) + lead - heard[-1]) <= 2
    rms = [np.sqrt(np.mean(masking[first : first + ramp // 4] ** 2)) for first in (heard[0], heard[-1] - ramp // 4)]
    level = np.sqrt(np.mean(masking[onset : onset + len(sound)] ** 2))
    assert max(rms) < level / 3
    assert level == pytest.approx(0.05, rel=0.5)
    # The silence that the masking needs was not asked for, so it is told as a late onset.
    assert delivery["onset_s"] - delivery["requested_s"] > 0.3


def play_many(pulse: Any, player: Any, sounds: dict[str, Sound]) -> tuple[list[Any], list[int]]:
    """Play sounds one after the other with uneven gaps; give what was delivered, and where it was captured."""
    with pulse.captured() as capture:
        deliveries = [
            player.ask(do="play", sound=name, gap_s=0.02 + 0.013 * (number % 7)) for number, name in enumerate(sounds)
        ]
    after, places = 0, []
    for sound in sounds.values():
        places.append(capture.find(sound, after=after))
        after = max(after, places[-1])
    return deliveries, places


@pytest.mark.parametrize("n_trials", [50, pytest.param(500, marks=pytest.mark.soak)])
def test_every_trial_arrives_whole_or_its_underrun_is_flagged_and_onsets_are_true(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, record_testsuite_property: Any, n_trials: int
) -> None:
    sounds = {f"s{n}": make_sound(n, n=2400, channels=4) for n in range(n_trials)}
    player = open_player(pulse, make_rig(channels=4, latency_s=0.1), sounds)  # a machine that tests has much to do
    player.hear()
    deliveries, places = play_many(pulse, player, sounds)
    flagged = np.array([delivery["underruns"] > 0 for delivery in deliveries])
    lost = np.array(places) < 0
    assert not (lost & ~flagged).any()
    # A machine that does other things too may let a few run dry; most of them must not.
    assert np.mean(flagged) < 0.1
    kept = ~(lost | flagged)
    onsets_s = np.array([delivery["onset_s"] for delivery in deliveries])[kept]
    requested_s = np.array([delivery["requested_s"] for delivery in deliveries])[kept]
    captured_s = np.array(places)[kept] / RATE_HZ
    jitter_ms = 1e3 * np.abs(captured_s - onsets_s - np.median(captured_s - onsets_s))
    record_testsuite_property("underruns", int(flagged.sum()))
    record_testsuite_property("lost", int(lost.sum()))
    record_testsuite_property("jitter_ms", [round(float(q), 3) for q in np.percentile(jitter_ms, [50, 99])])
    assert np.median(jitter_ms) < 2
    assert np.percentile(jitter_ms, 99) < 10
    late_s = onsets_s - requested_s
    record_testsuite_property("requested_to_onset_s", np.percentile(late_s, [1, 50, 99]).round(4).tolist())
    assert late_s.min() >= 0
    assert np.median(late_s) < 0.25


def test_a_stop_falls_silent_within_a_block_and_is_not_completed(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    sound = make_sound(1, n=3 * RATE_HZ, channels=4)
    with pulse.captured() as capture:
        player = open_player(pulse, make_rig(channels=4), {"a": sound, "b": make_sound(2, channels=4)})
        player.hear()
        stopped_s = player.ask(do="play", sound="a", after_s=0.8)["stopped_s"]
        delivery = player.hear()
        again = player.ask(do="play", sound="b")
    measured = delivery["measured"]
    vibrating = np.flatnonzero(capture.samples[:, 0])
    onset, n_played = int(vibrating[0]), int(measured["n_samples"])
    assert not delivery["completed"]
    assert not delivery["error"]
    # All but a short fade is the stimulus as it is, and after the last sample there is nothing.
    fade = round(0.005 * RATE_HZ)
    assert np.array_equal(capture.samples[onset : onset + n_played - fade], sound[: n_played - fade])
    assert not capture.samples[onset + n_played + 1 : onset + n_played + 2400].any()
    # What the device holds already (its latency) cannot be taken back; after that one block passes at most.
    last_s = delivery["onset_s"] + n_played / RATE_HZ
    block_s = measured["latency_s"] / 4
    assert measured["stop_s"] == pytest.approx(last_s - stopped_s, abs=0.03)
    assert 0 < measured["stop_s"] < measured["latency_s"] + 2 * block_s + 0.03  # that for a machine with much to do
    assert abs(delivery["over_s"] - last_s) < 0.1
    assert again["completed"]
    assert capture.find(make_sound(2, channels=4)) > onset + n_played


@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0])
def test_a_server_that_stands_still_is_an_underrun_of_that_playback_only(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, seconds: float
) -> None:
    sounds = {name: make_sound(n, n=RATE_HZ // 2, channels=4) for n, name in enumerate("abc")}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()
    with pulse.captured() as capture:
        underruns = []
        for name in sounds:
            player.tell(do="start", sound=name, gap_s=0.1)
            player.ask(do="clock")
            player.tell(do="collect")
            with pulse.halted() if name == "b" else nullcontext():
                time.sleep(seconds)
            delivery = player.hear()
            assert delivery["completed"]
            underruns.append(delivery["underruns"] > 0)
    whole = [capture.find(sound) >= 0 for sound in sounds.values()]
    assert underruns == [False, True, False]
    assert whole[::2] == [True, True]


def test_a_server_that_dies_is_told_and_tried_again_with_the_next_stimulus(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    sounds = {"a": make_sound(1, n=RATE_HZ, channels=4), "b": make_sound(2, channels=4)}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()
    player.tell(do="start", sound="a")
    player.tell(do="collect")
    time.sleep(0.5)
    pulse.kill()
    begin_s = time.monotonic()
    dead = player.hear()
    assert not dead["completed"]
    assert dead["error"].startswith("device 'stylus' stopped")
    gone = player.ask(do="play", sound="b")
    assert gone["onset_s"] is None
    assert gone["error"].startswith("device: got 'stylus'")
    assert time.monotonic() - begin_s < 5
    pulse.start()
    with pulse.captured() as capture:
        back = player.ask(do="play", sound="b")
    assert (back["error"], back["completed"], back["underruns"]) == ("", True, 0)
    assert capture.find(sounds["b"]) >= 0


def test_a_server_that_hangs_for_long_is_dead_without_hanging_the_session(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any
) -> None:
    sounds = {"a": make_sound(1, n=RATE_HZ, channels=4)}
    player = open_player(pulse, make_rig(channels=4), sounds)
    player.hear()
    player.tell(do="start", sound="a")
    player.tell(do="collect")
    with pulse.halted():
        dead = player.hear()
        assert "stands still" in dead["error"]
        begin_s = time.monotonic()
        assert player.ask(do="play", sound="a")["error"]
        assert time.monotonic() - begin_s < 15
    deadline_s = time.monotonic() + 60
    while player.ask(do="play", sound="a")["error"]:
        assert time.monotonic() < deadline_s


@pytest.mark.parametrize(
    ("device", "channels", "rate_hz", "message"),
    [
        ("nowhere", 4, 48000, "got 'nowhere', which is not there; allowed: 'stylus' (ALSA), 'stylus twin' (ALSA)"),
        ("TWIN", 4, 1_000_000, "'stylus twin', which does not play at 1e+06 Hz (Error opening OutputStream: Invalid"),
        ("styl", 4, 48000, "got 'styl', which 2 devices have in their names: 'stylus' (ALSA), 'stylus twin' (ALSA)"),
        ("default", 4, 48000, "got 'default', which may be another one tomorrow"),
        ("stylus", 40, 48000, "got 'stylus' with 32 output channel(s), the rig needs 40"),
    ],
)
def test_what_is_not_exactly_there_is_refused(
    pulse: Any, open_player: Any, make_rig: Any, device: str, channels: int, rate_hz: int, message: str
) -> None:
    player = open_player(pulse, make_rig(device=device, channels=channels), {"a": np.zeros((1, 4))}, rate_hz=rate_hz)
    refused = player.hear()["refused"]
    assert message in refused
    assert "\n" not in refused


# Input channels are counted from 1 up to this one; fewer than the monitor has would be mixed by the server.
SENSOR = "[sensor]\nchannel = 4\nfull_scale_m_s2 = 100.0"


def test_what_the_sensor_measures_is_kept_from_the_onset_on(
    pulse: Any, open_player: Any, make_rig: Any, make_sound: Any, tmp_path: Path
) -> None:
    sounds = {name: make_sound(n, n=RATE_HZ // 2, channels=4) for n, name in enumerate("ab")}
    for sound in sounds.values():
        sound[:, 3] = sound[:, 0]
    player = open_player(pulse, make_rig(SENSOR, channels=4, latency_s=0.15), sounds)
    player.hear()
    lags = []
    for number, (name, sound) in enumerate(sounds.items(), start=1):
        delivery = player.ask(do="play", sound=name, gap_s=0.1)
        assert (delivery["error"], delivery["measured"]["file_number"]) == ("", number)
        samples, rate_hz = read_wav(tmp_path / "delivered" / f"{number:04}.wav")
        assert rate_hz == RATE_HZ
        # The sink's monitor is the sensor: what was played comes back, later by the way there and back.
        lag = int(np.argmax(np.correlate(samples, sound[:, 0].astype(float), mode="valid")))
        assert 0 < lag < 0.45 * RATE_HZ
        lags.append(lag)
        assert samples[lag : lag + len(sound)] == pytest.approx(100 * sound[:, 0], abs=1e-3)
        assert delivery["measured"]["sensor_gaps"] == 0
        assert delivery["measured"]["sensor_onset_sample"] > 0
    assert lags[0] == lags[1]  # to the sample
