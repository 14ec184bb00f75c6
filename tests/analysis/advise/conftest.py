from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.advise.choice import SceneAdvice, advise_scene
from feel321.analysis.tradeoff.advise.scene import Context, split_recording
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from feel321.stimuli.recording import Recording

SHARED = Path(__file__).resolve().parents[4] / "shared" / "recordings"


@pytest.fixture(autouse=True)
def single_thread() -> Iterator[None]:
    """Threads of the linear algebra wait for each other on a busy machine."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture
def real() -> Callable[[str], Recording]:
    """Reads a shared recording, conditioned as in a study."""

    def read(name: str) -> Recording:
        if not SHARED.is_dir():
            pytest.skip(
                f"NO REAL RECORDINGS: {SHARED} is missing, so what real scenes need is not tested"
            )
        return condition(read_recording(SHARED / name), Conditioning())

    return read


@pytest.fixture
def tell() -> Callable[..., SceneAdvice]:
    """Advises on one recording."""

    def advise(
        recording: Recording, context: Context | None = None, **options: object
    ) -> SceneAdvice:
        (scene,) = split_recording(recording)
        return advise_scene(scene, context or Context(), **options)  # type: ignore[arg-type]  # options of a test

    return advise


@pytest.fixture
def wave() -> np.ndarray:
    """Band-limited noise, 1 s at 4 kHz."""
    rng = np.random.default_rng(3)
    spectrum = np.zeros(2001, dtype=complex)
    spectrum[60:400] = rng.standard_normal(340) + 1j * rng.standard_normal(340)
    return np.asarray(np.fft.irfft(spectrum, 4000))
