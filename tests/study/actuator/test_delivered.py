from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pytest

from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.study.actuator.delivered import (
    Baseline,
    DeliveryCheck,
    compare,
    find_moves,
    reduce_stimuli,
)
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, Rig
from feel321.types import Samples

RATE = 48000.0
FULL_SCALE = 100.0
MATCHES = ("spectral_match", "temporal_match", "spectral_match_bounded")
RIG = Rig(
    limits=LimitsTable(peak_m_s2=100, rms_m_s2=50, duration_s=30),
    actuators=(
        ActuatorTable(name="a", channel=1, plays=("reduced", "x"), direction=(1, 0, 0)),
        ActuatorTable(name="b", channel=2, plays=("reduced", "y"), direction=(0, 1, 0)),
        ActuatorTable(name="c", channel=3, plays=("z",), direction=(0, 0, 1)),
    ),
)
LAG = 2345


def certify(rig: Rig, turn: Samples | None = None, method: str = "measured") -> Any:
    """A certificate that found a rig's coils to move as they should, or turned."""
    turn = np.eye(3) if turn is None else turn
    coils = {
        one.name: SimpleNamespace(direction=turn @ np.array(one.direction)) for one in rig.actuators
    }
    return SimpleNamespace(method=method, coils=coils)


Built: TypeAlias = "tuple[StimulusSet, dict[str, Baseline]]"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Two scenes at both levels, with the offset that mag321 makes, anchors and the three axes."""
    recordings = [
        make_scene(name, duration_s=1.0, rate_hz=rate)
        for name, rate in (("bumps", 10000.0), ("isotropic_rumble", 4444.4))
    ]
    recipe = Recipe(reducers=("sax321", "mag321", "dft321"), levels=("as_is", "equal_intensity"))
    stimuli = build_stimuli(recordings, tmp_path_factory.mktemp("set"), recipe)
    return stimuli, reduce_stimuli(stimuli, recordings, recipe)


def make_check(built: Built, **choices: Any) -> DeliveryCheck:
    stimuli, reduced = built
    own = {"full_scale_m_s2": FULL_SCALE, "reduced": reduced, **choices}
    return DeliveryCheck(stimuli, RIG, **own)


def read_motion(stimuli: StimulusSet, one: Stimulus) -> Samples:
    samples, _ = stimuli.read(one.stimulus_id)
    tracks = np.atleast_2d(samples) * FULL_SCALE
    return find_moves(RIG, len(tracks), {}) @ tracks


def delay(motion: Samples, lag: int = LAG, *, tail: int = 3000) -> Samples:
    return np.pad(motion, ((0, 0), (lag, tail)))


def make_noise(seed: int, n: int = 48000, axes: int = 1, rms: float = 1.0) -> Samples:
    return np.random.default_rng(seed).normal(0, rms, (axes, n))


@pytest.mark.parametrize("gain", [1.0, 0.5, -2.0])
@pytest.mark.parametrize("lag", [0, 1, LAG])
def test_a_delayed_and_scaled_copy_has_its_lag_its_level_and_full_coherence(
    lag: int, gain: float
) -> None:
    asked = make_noise(1)
    found = compare(asked, gain * delay(asked, lag) + 9.81, rate_hz=RATE)
    assert (found.lag, found.polarity) == (lag, np.sign(gain))
    assert found.level_error_db == pytest.approx(20 * np.log10(abs(gain)), abs=1e-3)
    assert found.coherence == pytest.approx(1, abs=1e-3)


def test_noise_lowers_coherence_by_its_share_and_leaves_the_level() -> None:
    asked = make_noise(2, 4 * 48000)
    for rms in (0.25, 0.5, 1.0):
        noisy = delay(asked, tail=0) + make_noise(3, 4 * 48000 + LAG, rms=rms)
        found = compare(asked, noisy, rate_hz=RATE)
        # Besides the share, chance adds the inverse of the number of independent segments, about 50.
        assert found.coherence == pytest.approx(1 / (1 + rms**2), abs=0.03)
        assert found.level_error_db == pytest.approx(0, abs=0.3)
        assert found.lag == LAG


def test_what_is_asked_delivers_the_metrics_of_the_manifest(built: Built) -> None:
    stimuli, check = built[0], make_check(built)
    for one in stimuli:
        found = check.describe(one.stimulus_id, delay(read_motion(stimuli, one)))
        assert (found["lag"], found["polarity"]) == (LAG, 1), one.stimulus_id
        assert abs(found["level_error_db"]) < 1e-6
        expected = {name: getattr(one, name) for name in MATCHES}
        assert {name: found[name] for name in MATCHES} == pytest.approx(expected, abs=1e-6)


def test_swapped_axes_are_no_longer_coherent(built: Built) -> None:
    stimuli = built[0]
    one = stimuli["isotropic_rumble__reference__as_is"]
    motion = read_motion(stimuli, one)
    right = make_check(built).describe(one.stimulus_id, delay(motion))
    wrong = make_check(built).describe(one.stimulus_id, delay(motion[[1, 2, 0]]))
    assert right["coherence"] == pytest.approx(1, abs=1e-6)
    assert wrong["coherence"] < 0.8
    assert wrong["temporal_match"] < right["temporal_match"] - 0.2


@pytest.mark.parametrize(
    ("method", "is_calibrated", "is_measured"), [(None, 0, 0), ("manual", 1, 0), ("measured", 1, 1)]
)
def test_directions_are_those_that_were_seen_if_any_were(
    built: Built, method: str | None, is_calibrated: float, is_measured: float
) -> None:
    """A turned sensor sees turned coils; only a measured certificate knows that."""
    stimuli = built[0]
    one = stimuli["bumps__sax321__as_is"]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    certificate = certify(RIG, turn, method) if method else None
    check = make_check(built, certificate=certificate)
    found = check.describe(one.stimulus_id, delay(turn @ read_motion(stimuli, one)))
    assert (found["is_calibrated"], found["is_measured"]) == (is_calibrated, is_measured)
    assert (abs(found["level_error_db"]) < 1e-6) == bool(is_measured)
    assert check.describe(one.stimulus_id, None) == {}
    assert check.describe("tone 100 Hz", delay(read_motion(stimuli, one))) == {}
