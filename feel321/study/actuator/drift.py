"""Drift of the coils since their certificate: a second of tones on each coil, compared with the response it holds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, signal

from feel321.study.actuator.calibrate import MARGIN, find_allowed
from feel321.study.actuator.certificate import Certificate, CoilCertificate
from feel321.study.actuator.duplex import Session, open_session, require_sensor
from feel321.study.actuator.rig import Rig
from feel321.types import Samples

PERIOD_S = 0.25  # all tones are multiples of its inverse
SETTLING_S, TONES_S = 0.25, 0.85  # until a coil moves steadily; length of the tones
REST_S = (
    0.15  # after them and the latency of the certificate, which may differ from today's by so much
)
CLEAR = 10.0  # least ratio of a tone's amplitude to the noise at its frequency
FEWEST = 3  # tones that must be clear


@dataclass(frozen=True, slots=True)
class Drift:
    """Level of a coil's response today over its certificate's, in dB: median over the clear tones, and largest."""

    coil: str
    median_db: float
    largest_db: float
    n_tones: int

    def find_fault(self, *, allowed_db: float) -> str:
        """Describe why the certificate holds no longer; empty if it does. Single tones may be off by twice as much."""
        if self.n_tones < FEWEST:
            return (
                f"coil {self.coil!r}: got {self.n_tones} tones above the noise, expected {FEWEST} or more; check coil, "
                "cable, amplifier, its channel in rig.toml, and the sensor"
            )
        if abs(self.median_db) <= allowed_db and abs(self.largest_db) <= 2 * allowed_db:
            return ""
        return (
            f"coil {self.coil!r} drifted by {self.median_db:+.1f} dB since its certificate ({self.largest_db:+.1f} dB "
            f"at most), the limit is {allowed_db:g} dB; put gains and mounting back, or run feel321 calibrate"
        )


def measure_drift(rig: Rig, certificate: Certificate) -> list[Drift]:
    """Play tones on each coil of a rig, and compare what the sensor measures with its certificate."""
    late = max(coil.latency for coil in certificate.coils.values())
    n = round((TONES_S + REST_S) * certificate.rate_hz) + late
    with open_session(rig, rate_hz=certificate.rate_hz, n_longest=n) as session:
        return [
            _measure_coil(session, coil, band_hz=certificate.band_hz)
            for coil in certificate.coils.values()
        ]


def find_tones(band_hz: tuple[float, float]) -> Samples:
    """Find frequencies in Hz about a third of an octave apart in a band, all of whole periods."""
    low, high = band_hz
    wanted = low * 2 ** np.arange(0.0, math.log2(high / low), 1 / 3)
    tones: Samples = np.unique(np.maximum(np.ceil(wanted * PERIOD_S), 1)) / PERIOD_S
    return tones[tones <= high]


def make_tones(coil: CoilCertificate, frequency_hz: Samples, *, rate_hz: float) -> Samples:
    """Make the sum of the tones, peak 1, shape (n,), ramped at both ends; what the coil makes weaker is stronger."""
    n_tones = round(TONES_S * rate_hz)
    time_s = np.arange(n_tones) / rate_hz
    size = np.interp(frequency_hz, coil.frequency_hz, np.abs(coil.response))
    turns = (
        np.arange(len(frequency_hz)) ** 2 / len(frequency_hz) / 2
    )  # Schroeder's phases: a low peak
    waves = np.sin(2 * np.pi * (np.outer(frequency_hz, time_s) + turns[:, None]))
    tones = (size**-0.5) @ waves * signal.windows.tukey(n_tones, 0.1)
    rest = round(REST_S * rate_hz) + coil.latency
    return np.concatenate([tones / np.abs(tones).max(), np.zeros(rest)])


def _measure_coil(
    session: Session, coil: CoilCertificate, *, band_hz: tuple[float, float]
) -> Drift:
    rig, rate_hz = session.rig, session.rate_hz
    frequency_hz = find_tones(band_hz)
    tones = make_tones(coil, frequency_hz, rate_hz=rate_hz)
    actuator = next(one for one in rig.actuators if one.name == coil.name)
    motion = float(np.abs(coil.respond(tones, rate_hz=rate_hz)).max())
    safe = MARGIN * min(rig.limits.peak_m_s2, require_sensor(rig).full_scale_m_s2) / motion
    sent = min(rig.calibration.level * find_allowed(rig, actuator), safe) * tones
    recorded = session.play(sent, coil.channel)
    along = coil.direction @ recorded if len(recorded) == len(coil.direction) else recorded[0]
    level_db, clear = compare_tones(
        sent, along, coil=coil, frequency_hz=frequency_hz, rate_hz=rate_hz
    )
    found = level_db[clear]
    if not len(found):
        return Drift(coil.name, math.nan, math.nan, 0)
    return Drift(coil.name, float(np.median(found)), float(max(found, key=abs)), len(found))


def compare_tones(
    sent: Samples, along: Samples, *, coil: CoilCertificate, frequency_hz: Samples, rate_hz: float
) -> tuple[Samples, Sequence[bool]]:
    """Compare each tone with the certificate, in dB, and say which are clear of the noise; shapes (tones,).

    Two periods in which the coil moves steadily: their mean is the tone, their difference the noise.
    """
    n = round(PERIOD_S * rate_hz)
    moved = along - along.mean()
    late = int(np.argmax(np.abs(signal.correlate(moved, sent, method="fft")))) - (len(sent) - 1)
    first = max(late, 0) + round(SETTLING_S * rate_hz)
    bins = np.round(frequency_hz * PERIOD_S).astype(int)

    def transform(samples: Samples, start: int) -> Samples:
        return np.stack([fft.rfft(samples[k : k + n], n)[bins] for k in (start, start + n)])

    found = transform(moved, first)
    asked = np.abs(transform(sent, round(SETTLING_S * rate_hz)).mean(axis=0))
    size = np.abs(found.mean(axis=0))
    noise = np.abs(found[0] - found[1]) / 2
    known = np.interp(frequency_hz, coil.frequency_hz, np.abs(coil.response))
    return 20 * np.log10(np.maximum(size, 1e-12) / (asked * known)), size > CLEAR * noise
