"""The stream on a real audio path: every sample that was to be played is captured, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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
    sounds = {name: make_sound(n, n=n, channels=2) for name, n in lengths.items()}
    order = ["a", "c", "b", "a", "d"]
    with pulse.captured() as capture:
        player = open_player(pulse, make_rig(), sounds)
        assert player.hear()["identity"]["device"] == "stylus"
        deliveries = [player.ask(do="play", sound=name, gap_s=0.0 if name == "b" else 0.05) for name in order]
    assert [delivery["underruns"] for delivery in deliveries] == [0] * len(order)
    assert all(delivery["completed"] and not delivery["error"] for delivery in deliveries)
    played = [np.pad(sounds[name], ((0, 0), (0, pulse.channels - 2))) for name in order]
    places = find_all(capture, played)
    assert not blank(capture, places, played).any()
