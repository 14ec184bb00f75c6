"""Calibration of simulated rigs: what was planted is found, faults are named, and a stop is silent within a block."""

from __future__ import annotations

import io
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feel321.study.actuator import bench as bench_module
from feel321.study.actuator import calibrate as module
from feel321.study.actuator import doctor
from feel321.study.actuator.bench import SweepStopped
from feel321.study.actuator.calibrate import calibrate_rig, find_failures
from feel321.study.actuator.certificate import (
    Certificate,
    judge_certificates,
    list_certificates,
    write_certificate,
)
from feel321.study.actuator.figure import make_figure
from feel321.study.actuator.output import Output
from feel321.study.actuator.response import Sweep, make_sweep, measure_sweep
from feel321.study.actuator.rig import CoilTable, Rig, read_rig
from feel321.study.actuator.simulated import BLOCK_FRAMES, SimulatedCoil, SimulatedStream
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


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return calibrate_rig(read_rig(path), rate_hz=RATE_HZ, made=MADE)


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
    assert left.onto_db["right coil"] == pytest.approx(
        20 * math.log10(0.4 / math.sqrt(1.05 * 1.09)), abs=0.3
    )


def test_the_filters_make_the_coils_flat_and_that_is_verified(certificate: Certificate) -> None:
    assert certificate.failures == ()
    for coil in certificate.coils.values():
        squares = [term.db**2 for term in coil.budget]
        assert coil.uncertainty_db == pytest.approx(math.sqrt(sum(squares)))
        typed = {term.name for term in coil.budget if term.source == "typed"}
        assert typed == {"sensor"}
        assert coil.before_db > 20
        assert coil.largest_db < 1.5
        assert coil.least_coherence_after > 0.95
        inside = (coil.frequency_hz > 25) & (coil.frequency_hz < 800)
        size_db = 20 * np.log10(np.abs(coil.equalised[inside]) / coil.target)
        assert np.abs(size_db).max() < 1


def test_saturation_shows_as_distortion_and_as_bend(certificate: Certificate) -> None:
    left, right = certificate.coils.values()
    assert left.total_distortion < 0.002
    top = right.levels[-1]
    # s tanh(u / s) has a third harmonic of (u / s)² / 12 and a gain of 1 - (u / s)² / 4, for small u.
    assert right.total_distortion == pytest.approx((top / 2) ** 2 / 12, rel=0.35)
    assert right.linearity_db[-1] == pytest.approx(-8.686 * (top / 2) ** 2 / 4, abs=0.08)
    assert abs(left.linearity_db[-1]) < 0.05


def test_no_sweep_passes_limits_or_sensor(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A coil that resonates by 18 dB is driven so much less; what it does is taken from the simulated hardware."""
    highest: list[float] = []
    before = SimulatedStream._serve

    def watch(stream: Any) -> None:
        before(stream)
        if stream._sensed is not None:
            highest.append(float(np.linalg.norm(stream._sensed, axis=1).max()) * 200)

    monkeypatch.setattr(SimulatedStream, "_serve", watch)
    found = calibrate_rig(
        alter(rig, "limits", peak_m_s2=20.0, rms_m_s2=20.0), rate_hz=RATE_HZ, made=MADE
    )
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
        (lambda rig: plant(alter(rig, "calibration", pause_s=0.1), q=60.0), "must exceed latency and ringing"),
        (lambda rig: rig.model_copy(update={"sensor": None}), "has no \\[sensor\\], which calibrate needs"),
    ],
)  # fmt: skip
def test_faults_are_named(rig: Rig, change: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as refusal:
        calibrate_rig(change(rig), rate_hz=RATE_HZ, made=MADE)
    assert "\n" not in str(refusal.value)


def test_limits_that_are_not_kept_are_named(rig: Rig, certificate: Certificate) -> None:
    coil = certificate.coils["left coil"]
    bad = replace(
        coil, largest_db=4.2, worst_hz=33.0, uncertainty_db=2.5, total_distortion=0.3,
        least_coherence=0.9, direction=-coil.direction,
    )  # fmt: skip
    lines = list(find_failures(rig, bad))
    for line, part in zip(
        lines,
        ("4.2 dB off at 33 Hz", "known to 2.50 dB", "distorts by 30%", "coherence of 0.90", "moves 167°"),
        strict=True,
    ):  # fmt: skip
        assert part in line
    assert list(find_failures(rig, coil)) == []


def test_a_stop_is_silent_within_a_block(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[bool, float]] = []
    stopped: list[bool] = []
    serve, stop = SimulatedStream._serve, Output.stop

    def watch(stream: Any) -> None:
        is_stopped, fill = bool(stopped), stream._fill

        def keep(out: Any, *given: Any) -> None:
            fill(out, *given)
            sent.append((is_stopped, float(np.abs(out).max())))

        monkeypatch.setattr(stream, "_fill", keep)
        serve(stream)
        monkeypatch.setattr(stream, "_fill", fill)

    def note(output: Any) -> None:
        stop(output)
        stopped.append(True)
        wait_for_blocks(sent, n=4)

    monkeypatch.setattr(SimulatedStream, "_serve", watch)
    monkeypatch.setattr(Output, "stop", note)
    with pytest.raises(SweepStopped):
        calibrate_rig(
            alter(rig, "simulation", speed=4.0), rate_hz=RATE_HZ, made=MADE,
            is_stopping=lambda: sum(level > 0 for _, level in sent) > 20,
        )  # fmt: skip
    after = [level for is_stopped, level in sent if is_stopped]
    assert len(after) >= 3
    assert not any(after[1:])  # the first one holds the fade


def wait_for_blocks(sent: list[tuple[bool, float]], *, n: int) -> None:
    end_s = monotonic() + 60
    while sum(is_stopped for is_stopped, _ in sent) < n and monotonic() < end_s:
        sleep(0.001)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are of POSIX")
def test_any_key_ends_it_where_stdin_is_a_terminal(tmp_path: Path) -> None:
    import pty

    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "rig.toml").write_text(RIG.replace("speed = 100", "speed = 1"), encoding="utf-8")
    own, theirs = pty.openpty()
    command = [Path(sys.executable).with_name("feel321"), "calibrate", str(tmp_path)]
    process = subprocess.Popen(command, stdin=theirs, stderr=subprocess.PIPE, text=True)
    try:
        while process.poll() is None:
            os.write(own, b"x")
            sleep(0.05)
        assert process.stderr is not None
        assert "feel321: interrupted" in process.stderr.read()
        assert process.returncode == 130
    finally:
        process.kill()
        process.communicate()
        os.close(own)
        os.close(theirs)
    assert list_certificates(tmp_path) == []


def call(study: Path, *arguments: str) -> int:
    return main(["calibrate", str(study), *arguments])


def test_the_verb_stores_a_certificate_and_its_figure(
    rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any,
    certificate: Certificate,
) -> None:  # fmt: skip
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.setattr(module, "calibrate_rig", lambda *_, **__: certificate)
    assert call(tmp_path) == 0
    first, left, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith(f"certificate {certificate.id} (measured): passed; valid until ")
    assert left == "left coil:"
    files = sorted(path.suffix for path in (tmp_path / "calibration").iterdir())
    assert files == [".json", ".npz", ".svg"]
    found = judge_certificates(tmp_path, rig, now=MADE, rate_hz=RATE_HZ)[0]
    assert found is not None
    assert found.id == certificate.id
    failed = replace(certificate, id="20990101T000000Z-f", failures=("coil 'x' distorts",))
    monkeypatch.setattr(module, "calibrate_rig", lambda *_, **__: failed)
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


def test_a_sensor_that_is_turned_over_gets_its_scale(
    tmp_path: Path, rig: Rig, capsys: Any, monkeypatch: Any
) -> None:
    assert rig.sensor is not None
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    # Full scale is said to be 200 m/s² and is 250: 1 g shows as 7.845, beside an offset.
    rests = iter([
        [0.3, 0.5 + 7.84532, 0.1],
        [0.3, 0.5 - 7.84532, 0.1],
        [0.3] * 3,
        [0.4] * 3,
        [0, 0, 9.8],
        [9.8, 0, 0],
    ])
    monkeypatch.setattr(module, "measure_rest", lambda *_, **__: np.array(next(rests)))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert call(tmp_path, "--flip") == 0
    assert capsys.readouterr().out.startswith("full_scale_m_s2 = 250 ")
    assert call(tmp_path, "--flip") == 1
    assert "got a difference of 0.1 m/s², expected about 19.6" in capsys.readouterr().err
    assert call(tmp_path, "--flip") == 1
    assert "exactly half a turn" in capsys.readouterr().err


def test_a_resonance_in_the_ramp_of_a_sweep_counts_against_the_limits(rig: Rig) -> None:
    coil = CoilTable(name="coil", resonance_hz=80.0, q=8.0, full_scale_m_s2=50.0)
    limits = rig.limits.model_copy(update={"peak_m_s2": 20.0})
    own = rig.model_copy(update={"limits": limits})
    sweep = Sweep(rate_hz=RATE_HZ, band_hz=(100.0, 800.0), n_repeats=2, peak=0.01)

    def move(peak: float) -> np.ndarray:
        device = SimulatedCoil(coil, rate_hz=RATE_HZ, rng=np.random.default_rng(1))
        return device.process(make_sweep(replace(sweep, peak=peak)))

    probe = measure_sweep(sweep, move(sweep.peak))
    safe = module.find_safe(own, probe)
    assert 10.0 < np.abs(move(safe)).max() < 20.0


def test_no_drift_is_found_where_there_is_none(rig: Rig, certificate: Certificate) -> None:
    for one in doctor.measure_drift(rig, certificate):
        assert abs(one.median_db) < 0.2  # a coil that saturates is not the same at another level
        assert abs(one.largest_db) < 0.5
        assert one.n_tones > 10
        assert one.find_fault(allowed_db=1.0) == ""


def test_a_long_latency_is_waited_for(rig: Rig, certificate: Certificate) -> None:
    late = {
        name: replace(coil, latency=coil.latency + 5000) for name, coil in certificate.coils.items()
    }
    slow = alter(rig, "simulation", latency=5100)
    for one in doctor.measure_drift(slow, replace(certificate, coils=late)):
        assert one.find_fault(allowed_db=1.0) == ""


@pytest.mark.parametrize(
    ("changes", "median_db", "reason"),
    [
        ({"full_scale_m_s2": 60.0 * 10 ** (-2 / 20)}, -2.0, "'right coil' drifted by -"),
        ({"full_scale_m_s2": 30.0}, -6.0, "'right coil' drifted by -"),  # amplifier half
        ({"direction": (1.0, 0.0, 0.0)}, -10.8, "'right coil' drifted by -1"),  # channels swapped
        ({"resonance_hz": 220.0}, None, "'right coil' drifted by"),  # the mounting changed
        ({"full_scale_m_s2": 1e-6}, None, " tones above the noise, expected 3"),  # coil dead
    ],
)
def test_drift_is_measured_and_named(
    rig: Rig, certificate: Certificate, changes: Any, median_db: float | None, reason: str
) -> None:
    left, right = doctor.measure_drift(plant(rig, 1, **changes), certificate)
    assert left.find_fault(allowed_db=1.0) == ""
    assert reason in right.find_fault(allowed_db=1.0)
    if median_db is not None:
        assert right.median_db == pytest.approx(median_db, abs=0.25)


@pytest.mark.parametrize(
    ("change", "code", "line"),
    [({}, 0, ""), ({"full_scale_m_s2": 31.8}, 1, "coil 'left coil' drifted by -2.")],
)
def test_doctor_compares_with_the_certificate(
    certificate: Certificate,
    tmp_path: Path,
    capsys: Any,
    monkeypatch: Any,
    change: Any,
    code: int,
    line: str,
) -> None:
    monkeypatch.setattr(doctor, "try_stops", lambda *_, **__: [])  # in real time
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    fresh = replace(certificate, expires_utc="2999-01-01T00:00:00+00:00")
    write_certificate(fresh, tmp_path)
    text = RIG if not change else RIG.replace("full_scale_m_s2 = 40.0", "full_scale_m_s2 = 31.8")
    (tmp_path / "rig.toml").write_text(text.replace("speed = 100", "speed = 10"), encoding="utf-8")
    assert main(["doctor", str(tmp_path), "--seconds", "0.01", "--json"]) == code
    printed = capsys.readouterr()
    assert line in printed.err
    assert json.loads(printed.out)["calibration"]["certificate"] == certificate.id
    expired = replace(certificate, id="29990101", expires_utc="2026-03-02T00:00:00+00:00")
    for path in (tmp_path / "calibration").iterdir():
        path.unlink()
    write_certificate(expired, tmp_path)
    assert main(["doctor", str(tmp_path), "--seconds", "0.01"]) == 1
    assert "certificate 29990101 expired on 2026-03-02" in capsys.readouterr().err


def test_sweeps_that_are_out_of_step_are_played_again(rig: Rig) -> None:
    sweep = module.make_main(rig, rate_hz=RATE_HZ, peak=0.5)
    sent = make_sweep(sweep)
    noise = np.random.default_rng(1).standard_normal((3, len(sent)))
    whole = np.outer([1.0, 0.5, 0.0], sent) + 0.01 * noise
    assert bench_module.find_slip(whole, sweep) == 0
    for place in (6000, sweep.period, sweep.period + 9000):  # in each sweep, and between them
        cut = np.concatenate([whole[:, :place], whole[:, place + 37 :], np.zeros((3, 37))], axis=1)
        assert bench_module.find_slip(cut, sweep) == pytest.approx(37, rel=0.3)
    assert bench_module.find_slip(0.01 * noise, sweep) == 0
    played = iter([cut, cut, whole, *[cut] * bench_module.N_TRIES])
    bench: Any = SimpleNamespace(play=lambda *_: next(played))
    bench.insist = partial(bench_module.Bench.insist, bench)
    assert bench_module.Bench.play_sweep(bench, sent, sweep, 1) is whole
    with pytest.raises(OSError, match=r"are \d+ samples out of step, 4 times in a row"):
        bench_module.Bench.play_sweep(bench, sent, sweep, 1)


def test_nothing_in_the_figure_runs_off_its_edges(certificate: Certificate) -> None:
    drawn = make_figure(certificate)
    drawn.draw_without_rendering()
    (legend,) = drawn.legends
    box = legend.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= drawn.bbox.width
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["without filter", "with filter", "harmonics"]
    assert [axes.get_title(loc="left").split(":")[0] for axes in drawn.axes] == list(
        certificate.coils
    )
