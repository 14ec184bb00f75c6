"""One stress test of all reducers with few draws, one of a single reducer, and the page of the first."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.face import stress
from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.stimuli.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.analysis.tradeoff.stress.run import Stress


def make_recording(
    acceleration: object, *, rate_hz: float = 1000.0, name: str = "made"
) -> Recording:
    return Recording(np.asarray(acceleration, dtype=float), rate_hz, name)


@pytest.fixture(scope="session")
def made() -> Callable[..., Recording]:
    """Make a recording from any samples."""
    return make_recording


@pytest.fixture(scope="session")
def drag() -> Recording:
    """Make an ordinary drag, half a second."""
    whole = BATTERY["ordinary_drag"].make(11)
    return make_recording(whole.acceleration[:, :2000], rate_hz=whole.rate_hz, name="drag")


@pytest.fixture(scope="session")
def recordings(drag: Recording) -> tuple[Recording, ...]:
    """Gather a harmless recording, one with a planted share of cancelling energy, and silence."""
    rng = np.random.default_rng(5)
    spectrum = np.fft.rfft(rng.standard_normal((3, 4000)))
    low = np.arange(2001) < 600
    u, v, w = (
        np.fft.irfft(np.where(chosen, one, 0))
        for chosen, one in zip((low, ~low, low), spectrum, strict=True)
    )
    half = make_recording([u + v, u - v, 0.3 * w], rate_hz=4000, name="half")
    return drag, half, make_recording(np.zeros((3, 100)), name="nothing")


@pytest.fixture(scope="session")
def result(recordings: tuple[Recording, ...]) -> Stress:
    return stress(recordings, sensor={"drag": recordings[0]}, takes=4, draws=4, rng=3)


@pytest.fixture(scope="session")
def small(drag: Recording) -> Stress:
    """Test one reducer on one harmless recording, quickly."""
    return stress([drag], reducers=["mag321"], takes=2, draws=2)


@pytest.fixture(scope="session")
def folder(result: Stress, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return result.write(tmp_path_factory.mktemp("stress") / "out").parent
