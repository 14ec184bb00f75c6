"""Each fault of other coils than the product's is named, with the coil, or honestly unknown; healthy coils are not."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from feel321.study.actuator.certificate import Certificate
from feel321.study.actuator.faults import Diagnosis, find_resonance, find_sensor_fault
from feel321.study.actuator.response import Sweep, make_sweep
from tests.study.actuator.outside import (
    DIRECTIONS,
    MADE,
    NAMES,
    RATE_HZ,
    Loop,
    certify,
    make_rig,
    make_track,
    play,
    predict,
    send,
)

LOOPS = {
    "ordinary": Loop(),
    "sharp": Loop(resonances_hz=(72.0, 240.0, 118.0), q=(12.0, 8.0, 6.0), noise=0.05),
    "dull": Loop(resonances_hz=(210.0, 90.0, 160.0), q=(1.0, 1.5, 2.5), full_scales=(40.0, 120.0, 60.0)),
}  # fmt: skip


@cache
def certified(name: str) -> Certificate:
    return certify(LOOPS[name])


def diagnose(name: str, sent: np.ndarray, **faults: Any) -> str:
    found = Diagnosis(certified(name), make_rig())
    return found.judge(sent, play(LOOPS[name].but(**faults), sent))


FAULTS = {
    "sensor dead": ({"sensor": (0, 0, 0)}, "sensor dead:"),
    "axis dead": ({"sensor": (1, 0, 1)}, "sensor dead on y"),
    "sensor saturated": ({"saturated": 2.0}, "sensor saturated at 2 m/s²"),
    "coil dead": ({"gains": (1, 0, 1)}, "right: dead"),
    "all dead": ({"gains": (0, 0, 0)}, "left and right and third: dead"),
    "inverted": ({"gains": (-1, 1, 1)}, "left: inverted"),
    "swapped": ({"order": (1, 0, 2)}, "left and right swapped"),
    "others swapped": ({"order": (0, 2, 1)}, "right and third swapped"),
    "stronger": ({"gains": (1, 1.26, 1)}, "right: gain +2.0 dB"),
    "weaker": ({"gains": (1, 1, 0.794)}, "third: gain -2.0 dB"),
    "all weaker": ({"gains": (0.794,) * 3}, "all coils: gain -2.0 dB"),
    "loose": ({"gains": (0.7, 1, 1), "f0": (0.85, 1, 1)}, "left: loose mount: resonance"),
    "heat": ({"f0": (1, 0.95, 1)}, "right: resonance"),
    "damped": ({"damped": (1, 1, 2)}, "third: resonance"),
    "rattle": ({"rattle": (0, 4.0, 0)}, "right: rattle"),
    "clipping": ({"clip": (0.06, 9, 9)}, "left: clipping at"),
    "hum": ({"hum": 1.0}, "hum of 50 Hz"),
    "hum of 60": ({"hum": 0.5, "hum_hz": 60.05}, "hum of 60 Hz"),
    "slow": ({"rate": 0.91875}, "wrong rate: played at 44100 Hz"),
    "fast": ({"rate": 48 / 44.1}, "wrong rate: played at 52245 Hz"),
    "late": ({"late": 144 + 480}, "delay moved by +10.0 ms"),
}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_with_its_coil_and_nothing_else(loop: str, name: str) -> None:
    faults, told = FAULTS[name]
    tracks = [make_track(seed, peak=peak) for seed, peak in ((1, 8.0), (2, 6.0), (3, 4.0))]
    found = diagnose(loop, send(certified(loop), *tracks), **faults)
    assert found.startswith(told)
    assert found.count(";") <= 1


@pytest.mark.parametrize(
    "name", ["coil dead", "inverted", "swapped", "stronger", "loose", "heat", "slow"]
)
def test_coils_that_get_the_same_are_told_apart(name: str) -> None:
    faults, told = FAULTS[name]
    track = make_track(4, peak=6.0)
    found = diagnose("ordinary", send(certified("ordinary"), track, track, 0 * track), **faults)
    assert found.startswith(told)


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("coil", range(3))
def test_a_sweep_on_one_coil_shows_a_wrong_rate_and_what_may_be_dead(loop: str, coil: int) -> None:
    """A resonance that rings at any rate is no inverted coil; one coil says nothing of the others."""
    sweep = Sweep(rate_hz=RATE_HZ, duration_s=1.0, pause_s=0.4, n_repeats=2, peak=0.2)
    sent = np.zeros((sweep.period, 3), dtype=np.float32)
    sent[:, coil] = make_sweep(sweep)[: sweep.period]
    found = Diagnosis(certified(loop), make_rig())
    slow = found.judge(sent, play(LOOPS[loop].but(rate=0.91875), sent))
    assert slow.startswith("wrong rate: played at 44100 Hz")
    gains = [float(place != coil) for place in range(3)]
    found = Diagnosis(certified(loop), make_rig())
    dead = found.judge(sent, play(LOOPS[loop].but(gains=gains), sent))
    assert dead.startswith(f"{NAMES[coil]}: dead")
    assert "which the sink may lack" in dead
    assert "the sink" not in diagnose(
        loop, send(certified(loop), *(make_track(1, peak=6.0),) * 3), gains=(0, 0, 0)
    )


MILD = {"rattle", "stronger", "weaker", "all weaker", "heat", "damped", "hum", "hum of 60", "late"}
"""Faults with which each coil is within 3 dB of what was asked, and distorts less than a certificate may."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_grave_where_a_coil_is_beyond_its_tolerance(name: str) -> None:
    sent = send(certified("ordinary"), *(make_track(seed, peak=6.0) for seed in (1, 2, 3)))
    measured = play(LOOPS["ordinary"].but(**FAULTS[name][0]), sent)
    found = {db: Diagnosis(certified("ordinary"), make_rig(), tolerance_db=db) for db in (1.5, 3.0)}
    assert all(one.judge(sent, measured) for one in found.values())
    assert found[3.0].is_grave is (name not in MILD)
    assert found[1.5].is_grave >= found[3.0].is_grave
    if name in {"stronger", "weaker", "all weaker"}:  # by 2 dB
        assert found[1.5].is_grave


@pytest.mark.parametrize("n", [24, pytest.param(500, marks=pytest.mark.soak)])
def test_healthy_coils_raise_nothing(n: int) -> None:
    """Strong and weak stimuli, short and long, on one coil or all."""
    rng = np.random.default_rng(5)
    found = {name: Diagnosis(certified(name), make_rig()) for name in LOOPS}
    for number in range(n):
        name = list(LOOPS)[number % len(LOOPS)]
        peaks = np.exp(rng.uniform(np.log(0.02), np.log(8), 3)) * (rng.random(3) < 0.7)
        seconds = rng.uniform(0.1, 1.5)
        tracks = [
            make_track(3 * number + k, peak=peak, seconds=seconds) for k, peak in enumerate(peaks)
        ]
        sent = send(certified(name), *tracks)
        assert found[name].judge(sent, play(LOOPS[name], sent)) == "", (name, peaks, seconds)


def test_what_nothing_explains_is_unknown_with_the_figures() -> None:
    track = make_track(1, peak=6.0)
    sent = send(certified("ordinary"), track, track, track)
    other = send(certified("ordinary"), *(make_track(seed, peak=6.0) for seed in (7, 8, 9)))
    found = Diagnosis(certified("ordinary"), make_rig()).judge(sent, play(LOOPS["ordinary"], other))
    assert found.startswith("unknown cause, and the figures are: left gain ")


def test_a_coil_that_is_late_by_itself_is_not_called_dead() -> None:
    sent = send(certified("ordinary"), *(make_track(seed, peak=6.0) for seed in (1, 2, 3)))
    late = np.pad(sent, ((0, 960), (0, 0)))
    late[:, 1] = np.roll(late[:, 1], 960)
    found = Diagnosis(certified("ordinary"), make_rig())
    told = found.judge(sent, play(LOOPS["ordinary"], late))
    assert told.startswith("right: unknown cause, and the figures are: right gain ")


def test_a_delay_counts_only_where_nothing_else_may_have_moved_it() -> None:
    track = make_track(1, peak=6.0)
    sent = send(certified("ordinary"), track, track, track)
    found = Diagnosis(certified("ordinary"), make_rig())
    found.lag = None  # the device ran dry
    late = LOOPS["ordinary"].but(late=624)
    assert [found.judge(sent, play(late, sent)) for _ in range(2)] == ["", ""]
    assert found.judge(sent, play(LOOPS["ordinary"], sent)).startswith("delay moved by -10.0 ms")


def test_resonance_and_q_are_found_from_a_response() -> None:
    for name, loop in LOOPS.items():
        for coil, f0, q in zip(
            certified(name).coils.values(), loop.resonances_hz, loop.q, strict=True
        ):
            assert find_resonance(coil) == pytest.approx((f0, q), rel=0.03)


def test_coils_in_one_direction_are_judged_together() -> None:
    rig = make_rig()
    alike = tuple(one.model_copy(update={"direction": DIRECTIONS[0]}) for one in rig.actuators)
    own = certified("ordinary")
    coils = dict(own.coils)
    coils["right"] = replace(coils["right"], direction=coils["left"].direction)
    joined = replace(own, coils=coils)
    track = make_track(1, peak=6.0)
    sent = send(joined, track, track, track)
    motion = predict(joined, np.vstack([sent, np.zeros((4800, 3))]))
    noise = 0.01 * np.random.default_rng(1).standard_normal(motion.shape)
    found = Diagnosis(joined, rig.model_copy(update={"actuators": alike}))
    found.lag = None
    assert found.judge(sent, motion + noise) == ""
    assert found.judge(sent, 0.7 * motion + noise).startswith("all coils: gain -3.1 dB")


@pytest.mark.parametrize("frequency_hz", [20.3, 35.7, 61.1, 120.9])
@pytest.mark.parametrize("peak", [3.0, 20.0, 90.0])
@pytest.mark.parametrize("cut", [0.5, 0.9, 0.99, 1.1])
def test_slow_waves_that_are_cut_are_saturated_and_their_own_flat_crests_are_not(
    frequency_hz: float, peak: float, cut: float
) -> None:
    """As a clean input of 16 bits and 100 m/s² gives it: many equal samples at the top."""
    step = 100 / 2**15
    wave = peak * np.sin(2 * np.pi * frequency_hz * np.arange(RATE_HZ) / RATE_HZ)
    noise = np.random.default_rng(2).uniform(-0.2, 0.2, (3, RATE_HZ)) * step
    seen = np.clip(np.round((wave + noise) / step) * step, -cut * peak, cut * peak)
    found = find_sensor_fault(seen, full_scale_m_s2=100.0)
    assert found.startswith(f"sensor saturated at {cut * peak:.3g} m/s²" if cut < 1 else "")
    assert bool(found) == (cut < 1)


@pytest.mark.parametrize("bits", [12, 16, 24])
def test_healthy_playbacks_of_any_strength_and_resolution_are_not_saturated(bits: int) -> None:
    rng, step = np.random.default_rng(0), 200 / 2 ** (bits - 1)
    for seed in range(40):
        track = make_track(seed, peak=np.exp(rng.uniform(-4, 3)), seconds=rng.uniform(0.1, 1.0))
        seen = track + rng.normal(0, rng.choice([0, 0.3, 3]) * step, (3, len(track))) + 9.81
        assert "saturated" not in find_sensor_fault(
            np.round(seen / step) * step, full_scale_m_s2=200
        )


def test_a_certificate_is_not_valid_with_another_scale_of_the_sensor_but_without_a_sensor() -> None:
    certificate, rig = certified("ordinary"), make_rig()
    assert certificate.find_faults(rig, MADE) == []
    assert certificate.find_faults(make_rig(sensor=None), MADE) == []
    other = make_rig(sensor=rig.sensor.model_copy(update={"full_scale_m_s2": 100.0}))
    (found,) = certificate.find_faults(other, MADE)
    assert "another sensor, or another scale of it" in found
