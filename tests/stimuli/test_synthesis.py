import numpy as np
import pytest

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.reducers.fourier import dft321_windowed
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene


@pytest.mark.parametrize("name", ["bumps", "texture_drag"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_pattern_of_the_papers_table_1(name: str, seed: int) -> None:
    recording = condition(make_scene(name, rng=seed), Conditioning())
    acceleration, rate = recording.acceleration, recording.rate_hz
    spectral = {
        r: spectral_match(acceleration, f(acceleration, rate), rate) for r, f in REDUCERS.items()
    }
    assert spectral["dft321"] == pytest.approx(1.0, abs=1e-9)
    windowed = [
        spectral_match(acceleration, dft321_windowed(acceleration, rate, window_s=ms / 1000), rate)
        for ms in (25, 30, 35, 40, 45, 50)
    ]
    assert 0.94 < min(windowed) < max(windowed) < 0.975
    assert max(windowed) - min(windowed) < 0.03
    assert spectral["dft321_principal"] == pytest.approx(1.0, abs=1e-9)
    assert 0.93 < spectral["dft321_principal_windowed"] < 0.98
    assert all(spectral[r] < 0.9 for r in REDUCERS if not r.startswith("dft321"))
    assert temporal_match(acceleration, REDUCERS["mag321"](acceleration, rate)) < 0.15


def test_scenes_joined_by_a_plus_follow_one_another_in_equal_shares() -> None:
    joined = make_scene("bumps+texture_drag+hard_taps", duration_s=8.0, rng=3)
    assert joined.acceleration.shape == (3, 80_000)
    assert joined.name == "bumps-texture_drag-hard_taps"
    loud = [np.sqrt((part**2).mean()) for part in np.array_split(joined.acceleration, 3, axis=1)]
    assert loud[1] > max(loud[0], loud[2])  # contacts in rest on both sides of the drag
    ends = np.flatnonzero((joined.acceleration == 0).all(axis=0))
    assert ends.tolist() == [0, 26_666, 26_667, 53_333, 53_334, 79_999]
    with pytest.raises(ValueError, match="did you mean 'hard_taps'"):
        make_scene("bumps+hard_tap")
    with pytest.raises(ValueError, match=r"each of several 0\.1 s"):
        make_scene("bumps+hard_taps", duration_s=0.15)
