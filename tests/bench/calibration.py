"""Evidence for calibrate, through a real audio stack: three coils before, with a plain filter, and after.

`feel321 calibrate` measures three simulated coils (80, 160, 250 Hz; Q 8, 3, 1) through PortAudio, ALSA and PulseAudio:
a null sink is captured, filtered by the coils, and fed back through the monitor of a second one. Beside it, in the same
run and through the same stream: the filter that a plain ratio of two Welch spectra of noise gives.

Run: python tests/bench/calibration.py [repeats]
"""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy import signal

RATE_HZ = 48000
EVIDENCE_HZ = (20.0, 800.0)
COILS = {
    "left coil": (80.0, 8.0, 40.0, (1.0, 0.1, 0.2), 7, math.inf),
    "right coil": (160.0, 3.0, 60.0, (0.3, 1.0, 0.0), 0, 1.0),
    "third coil": (250.0, 1.0, 50.0, (0.0, -0.2, 1.0), 23, math.inf),
}
RIG = """
[device]
name = "stylus"
latency_s = 0.3
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 60.0
duration_s = 30.0
[sensor]
device = "sensor"
channels = [1, 2, 4]
full_scale_m_s2 = 200.0
[calibration]
max_gain_db = 50.0
pause_s = 2.0
[sync]
channel = 4
[simulation]
latency = 0
noise_m_s2 = 0.01
"""
ACTUATOR = '[[actuators]]\nname = "{}"\nchannel = {}\nfull_scale_m_s2 = 50.0\ndirection = {}\n'
COIL = """[[simulation.coils]]
name = "{}"
resonance_hz = {}
q = {}
full_scale_m_s2 = {}
direction = {}
latency = {}
"""


def write_rig(folder: Path) -> Path:
    """Write rig.toml with the coils, the directions of rig.toml being the axes."""
    text = RIG
    for number, (name, coil) in enumerate(COILS.items()):
        resonance_hz, q, full_scale, direction, latency, saturation = coil
        text += ACTUATOR.format(name, number + 1, np.eye(3)[number].tolist())
        text += COIL.format(name, resonance_hz, q, full_scale, list(direction), latency)
        text += "" if math.isinf(saturation) else f"saturation = {saturation}\n"
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    return folder / "rig.toml"


def load_bridge() -> object:
    path = Path(__file__).parents[1] / "study" / "actuator" / "bridge.py"
    spec = importlib.util.spec_from_file_location("bridge", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def measure_plain(folder: Path) -> None:
    """Make plain filters of Welch spectra, play through them, and calibrate; in the environment of the server."""
    from feel321.study.actuator import calibrate, response
    from feel321.study.actuator.bench import open_bench
    from feel321.study.actuator.certificate import write_certificate
    from feel321.study.actuator.rig import read_rig

    rig = read_rig(folder / "rig.toml")
    certificate = calibrate.calibrate_rig(rig, rate_hz=RATE_HZ, made=datetime.now(UTC))
    write_certificate(certificate, folder)
    rows = {}
    sweep = calibrate.make_main(rig, rate_hz=RATE_HZ, peak=1.0)
    n = sweep.period * sweep.n_repeats
    with open_bench(rig, rate_hz=RATE_HZ, n_longest=n) as session:
        for name, coil in certificate.coils.items():
            peak = float(coil.levels.max())
            noise = np.resize(
                calibrate.make_noise(calibrate.make_main(rig, rate_hz=RATE_HZ, peak=peak)), n
            )
            recorded = coil.direction @ session.play(noise, coil.channel)
            frequency_hz, sent = signal.welch(noise, RATE_HZ, nperseg=8192)
            gain = np.sqrt(
                signal.welch(recorded, RATE_HZ, nperseg=8192)[1] / np.maximum(sent, 1e-20)
            )
            inside = (frequency_hz >= 20) & (frequency_hz <= 1000)
            target = float(np.median(gain[inside]))
            fir = signal.firwin2(
                48001, frequency_hz, np.where(inside, target / gain, 1.0), fs=RATE_HZ
            )
            asked = response.make_sweep(calibrate.make_main(rig, rate_hz=RATE_HZ, peak=peak))
            filtered = signal.oaconvolve(asked, fir)[: len(asked)]
            scale = min(peak / np.abs(filtered).max(), 0.9 * 100 / target / peak)
            found = response.measure_sweep(
                sweep, session.play(scale * filtered, coil.channel), sent=scale * asked
            )
            rows[name] = response.verify(found, target=target, band_hz=EVIDENCE_HZ).largest_db
    (folder / "plain.json").write_text(json.dumps(rows), encoding="utf-8")


def report(folder: Path) -> bool:
    """Print what was planted and what was found; whether all is within its promise."""
    from feel321.study.actuator.certificate import list_certificates, read_certificate

    certificate = read_certificate(list_certificates(folder)[0])
    plain = json.loads((folder / "plain.json").read_text(encoding="utf-8"))
    coils = certificate.coils
    first = coils["left coil"].latency - COILS["left coil"][4]
    is_kept = certificate.passed
    for name, (resonance_hz, q, _, direction, latency, saturation) in COILS.items():
        coil = coils[name]
        inside = (coil.frequency_hz >= EVIDENCE_HZ[0]) & (coil.frequency_hz <= EVIDENCE_HZ[1])
        before, after = (
            float(np.abs(20 * np.log10(np.abs(one[inside]) / coil.target)).max())
            for one in (coil.response, coil.equalised)
        )
        cosine = coil.direction @ np.array(direction) / np.linalg.norm(direction)
        turned_deg = math.degrees(math.acos(min(float(cosine), 1.0)))
        late = coil.latency - first - latency
        line = (
            f"{resonance_hz:g} Hz, Q {q:g}: off by {before:.1f} dB, plain Welch ratio {plain[name]:.2f} dB, calibrated "
            f"{after:.2f} dB, coherence {coil.least_coherence_after:.3f}; direction {turned_deg:.2f}° off, latency "
            f"{late:+d} samples off, ± {coil.uncertainty_db:.2f} dB"
        )
        is_kept &= after < 1 and coil.least_coherence_after > 0.95 and turned_deg < 3 and late == 0
        if not math.isinf(saturation):
            share = find_planted(coil.levels.max() / saturation, resonance_hz, q)
            at = float(np.interp(100.0, coil.frequency_hz, coil.distortion))
            line += f"; distortion at 100 Hz {at:.2%}, planted {share:.2%}"
            is_kept &= abs(at / share - 1) < 0.1
        print(line)
    return is_kept


def find_planted(drive: float, resonance_hz: float, q: float) -> float:
    """Find harmonics 3 and 5 of tanh(drive sin) over the fundamental at 100 Hz, behind the coil."""
    from feel321.study.actuator.rig import CoilTable
    from feel321.study.actuator.simulated import discretise

    angle = 2 * np.pi * np.arange(4096) / 4096
    lines = np.abs(np.fft.rfft(np.tanh(drive * np.sin(angle))))
    b, a = discretise(CoilTable(name="coil", resonance_hz=resonance_hz, q=q), rate_hz=RATE_HZ)
    sizes = [lines[n] * abs(signal.freqz(b, a, [100.0 * n], fs=RATE_HZ)[1][0]) for n in (1, 3, 5)]
    return math.hypot(*sizes[1:]) / sizes[0]


def main() -> int:
    bridge = load_bridge()
    for _ in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
        with tempfile.TemporaryDirectory(prefix="feel321-") as name:
            folder = Path(name)
            rig = write_rig(folder)
            with bridge.start_server(folder) as env, bridge.start_bridge(rig, env):
                command = [sys.executable, __file__, "--measure", str(folder)]
                subprocess.run(command, env=env, check=True)
            if not report(folder):
                return 1
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure_plain(Path(sys.argv[2]))
    else:
        sys.exit(main())
