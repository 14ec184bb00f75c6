"""Calibration of simulated rigs: what was planted is found, faults are named, and a stop is silent within a block."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feel321.study.actuator import calibrate as module
from feel321.study.actuator import doctor
from feel321.study.actuator import output as output_module
from feel321.study.actuator.calibrate import agree, find_failures, propose_band
from feel321.study.actuator.certificate import (
    Certificate,
    draw_certificate,
    judge_certificates,
    list_certificates,
    write_certificate,
)
from feel321.study.actuator.device import BLOCK_FRAMES, Hardware, SimulatedCoil
from feel321.study.actuator.response import Sweep, find_slip, make_sweep, measure_sweep
from feel321.study.actuator.rig import CoilTable, Rig, advise_latency, read_rig
from feel321.study.cli import main

RATE_HZ = 8000.0
MADE = datetime(2026, 3, 1, 12, tzinfo=UTC)
RIG = """
[device]
name = "simulated"
latency_s = 0.05
[[actuators]]
name = "left coil"
channel = 1
full_scale_m_s2 = 50.0
direction = [1, 0, 0]
[[actuators]]
name = "right coil"
channel = 2
full_scale_m_s2 = 50.0
direction = [0, 1, 0]
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 60.0
duration_s = 30.0
[sensor]
channels = [1, 2, 3]
full_scale_m_s2 = 200.0
[calibration]
max_gain_db = 40.0
sweep_s = 1.5
pause_s = 0.4
repeats = 2
[simulation]
speed = 100.0
latency = 100
[[simulation.coils]]
name = "left coil"
resonance_hz = 80.0
q = 8.0
full_scale_m_s2 = 40.0
direction = [1, 0.1, 0.2]
latency = 7
[[simulation.coils]]
name = "right coil"
resonance_hz = 160.0
q = 2.0
full_scale_m_s2 = 60.0
saturation = 2.0
direction = [0.3, 1, 0]
"""
STUDY = '[[recordings]]\nscene = "bumps"\n[[recordings]]\nscene = "hard_taps"\n[rig]\nrate_hz = 8000.0\n'


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    return read_rig(tmp_path / "rig.toml")


def calibrate(rig: Rig, **choices: Any) -> Certificate:
    return module.calibrate(rig, rate_hz=RATE_HZ, **{"made": MADE, **choices})


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return calibrate(read_rig(path))


def plant(rig: Rig, number: int = 0, **changes: Any) -> Rig:
    """Change a simulated coil."""
    assert rig.simulation is not None
    coils = [
        CoilTable(**{**coil.model_dump(), **changes}) if place == number else coil
        for place, coil in enumerate(rig.simulation.coils)
    ]
    return alter(rig, "simulation", coils=tuple(coils))


def alter(rig: Rig, table: str, **changes: Any) -> Rig:
    return rig.model_copy(update={table: getattr(rig, table).model_copy(update=changes)})


def turn_deg(one: Any, other: Any) -> float:
    lengths = np.linalg.norm(one) * np.linalg.norm(other)
    return math.degrees(math.acos(min(float(np.dot(one, other) / lengths), 1.0)))


def test_what_was_planted_is_found(certificate: Certificate) -> None:
    left, right = certificate.coils.values()
    assert (left.latency, right.latency) == (BLOCK_FRAMES + 107, BLOCK_FRAMES + 100)
    assert turn_deg(left.direction, (1, 0.1, 0.2)) < 0.5
    assert turn_deg(right.direction, (0.3, 1, 0)) < 0.5
    # Far above resonance the response is the coil's full scale; the filter keeps the median of the band.
    size = np.interp(900.0, left.frequency_hz, np.abs(left.response))
    assert size == pytest.approx(40 * 1.008, rel=0.01)
    assert left.noise_m_s2 == pytest.approx(0.01 * math.sqrt(3), rel=0.1)


def test_the_filters_make_the_coils_flat_and_that_is_verified(certificate: Certificate) -> None:
    assert certificate.failures == ()
    for coil in certificate.coils.values():
        squares = [db**2 for db in coil.budget.values()]
        assert coil.uncertainty_db == pytest.approx(math.sqrt(sum(squares)))
        assert coil.before_db > 20
        assert coil.largest_db < 1.5
        assert coil.least_coherence_after > 0.95
        inside = (coil.frequency_hz > 25) & (coil.frequency_hz < 800)
        size_db = 20 * np.log10(np.abs(coil.equalised[inside]) / coil.target)
        assert np.abs(size_db).max() < 1


def test_no_sweep_passes_limits_or_sensor(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A coil that resonates by 18 dB is driven so much less; what it does is taken from the simulated hardware."""
    highest: list[float] = []
    before = Hardware.sense

    def watch(hardware: Hardware, out: Any) -> Any:
        sensed = before(hardware, out)
        highest.append(float(np.linalg.norm(sensed, axis=1).max()) * 200)
        return sensed

    monkeypatch.setattr(Hardware, "sense", watch)
    found = calibrate(alter(rig, "limits", peak_m_s2=20.0, rms_m_s2=20.0))
    assert 15 < max(highest) < 20.2
    assert found.coils["left coil"].levels[-1] < 0.1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rig: plant(rig, 1, full_scale_m_s2=1e-6), "coil 'right coil': got no motion that follows"),
        (
            lambda rig: alter(rig, "sensor", full_scale_m_s2=0.02),
            "the sensor's input is clipped",
        ),
        (lambda rig: alter(rig, "calibration", pause_s=0.05), "must exceed the latency of 77 ms, got 0.05"),
        (lambda rig: rig.model_copy(update={"sensor": None}), "has no \\[sensor\\], which calibrate needs"),
    ],
)  # fmt: skip
def test_faults_are_named(rig: Rig, change: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as refusal:
        calibrate(change(rig))
    assert "\n" not in str(refusal.value)


def test_a_calibration_that_is_stopped_is_silent_within_a_block(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what reaches the coils, in real time: Ctrl-C in the midst of the first sweep."""
    sent: list[float] = []
    stopped: list[int] = []
    sense, wait = Hardware.sense, output_module.sleep

    def watch(hardware: Hardware, out: Any) -> Any:
        sent.append(float(np.abs(out).max()))
        return sense(hardware, out)

    def interrupt(wait_s: float) -> None:
        if sum(level > 0 for level in sent) > 5:
            stopped.append(len(sent))
            raise KeyboardInterrupt
        wait(wait_s)

    monkeypatch.setattr(Hardware, "sense", watch)
    monkeypatch.setattr(output_module, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        calibrate(alter(rig, "simulation", speed=1.0))
    n_sent = len(sent)
    wait(0.3)
    assert len(sent) == n_sent  # the device is closed
    assert n_sent - stopped[0] <= 1


def test_limits_that_are_not_kept_are_named(rig: Rig, certificate: Certificate) -> None:
    coil = certificate.coils["left coil"]
    bad = replace(
        coil, largest_db=4.2, worst_hz=33.0, uncertainty_db=2.5, total_distortion=0.3,
        least_coherence=0.9, direction=-coil.direction, band_hz=(60.0, 1000.0),
    )  # fmt: skip
    told = (
        "4.2 dB off at 33 Hz", "known to 2.50 dB", "distorts by 30%", "coherence of 0.90",
        "flat from 60 to 1000 Hz only, asked was 20 to 1000", "moves 167°",
    )  # fmt: skip
    for line, part in zip(find_failures(rig, bad), told, strict=True):
        assert part in line
    assert list(find_failures(rig, coil)) == []


@pytest.mark.parametrize(("band_hz", "passes"), [((43.0, 1000.0), True), ((44.0, 1000.0), False)])
def test_a_coil_passes_with_four_fifths_of_the_octaves_that_were_asked(
    rig: Rig, certificate: Certificate, band_hz: tuple[float, float], passes: bool
) -> None:
    narrow = replace(certificate.coils["left coil"], band_hz=band_hz)
    assert (list(find_failures(rig, narrow)) == []) is passes


@pytest.mark.parametrize(("latency_s", "names_both"), [(0.05, False), (0.1, True), (0.3, True)])
def test_advice_to_raise_the_latency_names_the_pause_that_it_may_exceed(
    rig: Rig, latency_s: float, names_both: bool
) -> None:
    advice = advise_latency(alter(rig, "device", latency_s=latency_s))
    assert advice.startswith("raise latency_s under [device] in rig.toml")
    assert ("pause_s under [calibration]" in advice) is names_both


def call(study: Path, *arguments: str) -> int:
    return main(["calibrate", str(study), *arguments])


def test_the_verb_stores_a_certificate_and_its_figure(
    rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any,
    certificate: Certificate,
) -> None:  # fmt: skip
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.setattr(module, "calibrate", lambda *_, **__: certificate)
    assert call(tmp_path) == 0
    first, left, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith(f"certificate {certificate.id} (measured): passed; valid until ")
    assert left == "left coil:"
    files = sorted(path.suffix for path in (tmp_path / "calibration").iterdir())
    assert files == [".json", ".png", ".svg"]
    found = judge_certificates(tmp_path, rig, now=MADE, rate_hz=RATE_HZ)[0]
    assert found is not None
    assert found.id == certificate.id
    failed = replace(certificate, id="20990101T000000Z-f", failures=("coil 'x' distorts",))
    monkeypatch.setattr(module, "calibrate", lambda *_, **__: failed)
    assert call(tmp_path, "--json") == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["coils"]["left coil"]["latency"] == BLOCK_FRAMES + 107
    assert printed.err == "feel321: warning: coil 'x' distorts\n"


def test_gains_can_be_typed(tmp_path: Path, rig: Rig, capsys: Any) -> None:
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    gains = [word for name in ("left", "right") for word in ("--manual", f"{name} coil=12.5")]
    assert call(tmp_path, *gains, "--device", "file") == 0
    assert "  target 12.5\n" in capsys.readouterr().out
    (path,) = list_certificates(tmp_path)
    assert json.loads(path.read_text(encoding="utf-8"))["method"] == "manual"
    assert judge_certificates(tmp_path, rig, now=MADE)[0] is None  # of the device "file"
    assert call(tmp_path, "--manual", "left coil") == 2
    assert call(tmp_path, "--device", "file") == 1
    assert "rig.toml plays to files, which no sensor measures" in capsys.readouterr().err


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(doctor, "PROBE_S", 0.6)

    def run(rig: Rig, certificate: Certificate | None) -> dict[str, str]:
        found, hum = doctor.probe_coils(rig, certificate, rate_hz=RATE_HZ)
        assert hum == ""
        return {name: one["fault"] for name, one in found.items()}

    return run


def swap(rig: Rig) -> Rig:
    """Exchange the cables of the coils."""
    assert rig.simulation is not None
    left, right = rig.simulation.coils
    coils = (
        right.model_copy(update={"name": left.name}),
        left.model_copy(update={"name": right.name}),
    )
    return alter(rig, "simulation", coils=coils)


@pytest.mark.parametrize("is_certified", [True, False])
@pytest.mark.parametrize(
    ("change", "certified", "typed"),
    [
        (lambda rig: rig, "", ""),
        (lambda rig: plant(rig, 1, full_scale_m_s2=1e-6), "dead", "dead"),
        (lambda rig: plant(rig, 1, direction=(-0.3, -1, 0)), "inverted", "inverted"),
        (lambda rig: plant(rig, 1, resonance_hz=176.0), "resonance", ""),
        (lambda rig: plant(rig, 1, full_scale_m_s2=47.7), "gain -", ""),
        (lambda rig: plant(rig, 1, full_scale_m_s2=3.0), "dead (-26", "got 3.2"),
        (swap, "left coil and right coil swapped", "right coil and left coil swapped"),
    ],
)
def test_doctor_tries_each_coil_by_name(
    rig: Rig, certificate: Certificate, probe: Any, change: Any, certified: str, typed: str,
    is_certified: bool,
) -> None:  # fmt: skip
    found = probe(change(rig), certificate if is_certified else None)
    told = certified if is_certified else typed
    assert found["right coil"].startswith(told)
    assert bool(found["right coil"]) == bool(told)
    assert bool(found["left coil"]) == (change is swap)


def test_doctor_uses_the_certificate_that_run_would(
    certificate: Certificate, tmp_path: Path, capsys: Any
) -> None:
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "rig.toml").write_text(RIG.replace("speed = 100", "speed = 10"), encoding="utf-8")
    fresh = replace(certificate, expires_utc="2999-01-01T00:00:00+00:00")
    write_certificate(fresh, tmp_path)
    assert main(["doctor", str(tmp_path), "--seconds", "0.01", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)["rig"]
    assert (printed["certificate"], printed["faults"]) == (certificate.id, [])
    for path in (tmp_path / "calibration").glob("*.*"):
        path.unlink()
    write_certificate(
        replace(fresh, id="29990101", expires_utc="2026-03-02T00:00:00+00:00"), tmp_path
    )
    assert main(["doctor", str(tmp_path), "--seconds", "0.01"]) == 1
    assert "certificate 29990101 expired on 2026-03-02" in capsys.readouterr().err


def test_a_coil_that_fails_is_named_and_who_does_not_agree_gets_no_certificate(rig: Rig) -> None:
    with pytest.raises(ValueError, match=r"^coil 'right coil': got no motion"):
        calibrate(plant(rig, 1, full_scale_m_s2=1e-6))
    asked: list[Certificate] = []
    other = alter(rig, "calibration", max_gain_db=20.0)
    with pytest.raises(KeyboardInterrupt):
        calibrate(other, agree=asked.append)
    for coil in asked[0].coils.values():
        assert coil.gain_db <= 20.01
        assert math.isnan(coil.least_coherence_after)
    assert "dB off at 20 Hz with its filter" in asked[0].failures[0]  # with so little gain


@pytest.mark.parametrize(
    ("f0", "q"), [(95.0, 4.0), (130.0, 5.0), (170.0, 3.0), (250.0, 1.0), (70.0, 12.0)]
)
def test_gain_and_band_that_are_proposed_flatten_ordinary_coils(
    rig: Rig, f0: float, q: float
) -> None:
    coil = CoilTable(name="coil", resonance_hz=f0, q=q, full_scale_m_s2=80.0, direction=(1, 0, 0))
    own = alter(rig, "calibration", max_gain_db=None)
    sweep = Sweep(rate_hz=RATE_HZ, n_repeats=2, pause_s=0.4, duration_s=2.0)
    device = SimulatedCoil(coil, rate_hz=RATE_HZ, rng=np.random.default_rng(1))
    moved = device.process(make_sweep(sweep))
    quiet = moved + 1e-3 * np.random.default_rng(2).standard_normal(moved.shape)
    band_hz, gain_db = propose_band(own, measure_sweep(sweep, quiet))
    assert band_hz[0] == pytest.approx(20.0, abs=1.0)
    assert 20 * math.log10((f0 / 20) ** 2) - 4 < gain_db < 50
    noisy = moved + 6.0 * np.random.default_rng(2).standard_normal(moved.shape)
    narrow_hz, less_db = propose_band(own, measure_sweep(sweep, noisy))
    assert narrow_hz[0] > 22
    assert less_db < gain_db
    assert propose_band(alter(own, "calibration", max_gain_db=12.0), measure_sweep(sweep, noisy)) == (
        (20.0, 1000.0), 12.0,
    )  # fmt: skip


def test_what_is_proposed_and_what_it_costs_is_said_before_it_is_written(
    rig: Rig, certificate: Certificate, smallest: Any, capsys: Any
) -> None:
    assert agree(smallest, rig, certificate)
    left, _, strongest, weakest = capsys.readouterr().err.splitlines()
    assert left.startswith("left coil: flat from 20 to 1000 Hz within ")
    assert strongest.startswith("strongest stimulus ")
    assert weakest.endswith(" dB over the threshold of feeling")
    mute = rig.model_copy(
        update={
            "actuators": tuple(one.model_copy(update={"plays": ("z",)}) for one in rig.actuators)
        }
    )
    assert agree(smallest, mute, certificate)
    smallest.manifest.write_text("x\n", encoding="utf-8")
    assert agree(smallest, rig, certificate)
    *_, unplayed, _, _, damaged = capsys.readouterr().err.splitlines()
    unknown = "how strong the stimuli come is not known: "
    assert unplayed.startswith(f"{unknown}rig.toml: ")
    assert damaged == f"{unknown}{smallest.manifest}: holds no stimulus; build the set again"


def test_sweeps_that_are_out_of_step_are_played_again(rig: Rig) -> None:
    sweep, _ = module.make_sweeps(rig, rate_hz=RATE_HZ, peak=0.5)
    sent = make_sweep(sweep)
    noise = np.random.default_rng(1).standard_normal((3, len(sent)))
    whole = np.outer([1.0, 0.5, 0.0], sent) + 0.01 * noise
    assert find_slip(whole, sweep) == 0
    for place in (6000, sweep.period, sweep.period + 9000):  # in each sweep, and between them
        cut = np.concatenate([whole[:, :place], whole[:, place + 37 :], np.zeros((3, 37))], axis=1)
        assert find_slip(cut, sweep) == pytest.approx(37, rel=0.3)
    assert find_slip(0.01 * noise, sweep) == 0
    played = iter([cut, cut, whole, *[cut] * output_module.N_TRIES])
    bench: Any = SimpleNamespace(rig=rig, play=lambda *_, **__: next(played))
    bench.insist = partial(output_module.Bench.insist, bench)
    assert output_module.Bench.play_sweep(bench, sent, sweep, 1) is whole
    with pytest.raises(OSError, match=r"are \d+ samples out of step, 4 times in a row"):
        output_module.Bench.play_sweep(bench, sent, sweep, 1)


def test_the_figure_shows_response_filter_and_what_is_left(
    certificate: Certificate, tmp_path: Path
) -> None:
    draw_certificate(certificate, tmp_path / "drawn")
    drawn = (tmp_path / "drawn.svg").read_text(encoding="utf-8")
    for words in ("without filter", "with filter", "limits", "left coil", "right coil"):
        assert words in drawn
