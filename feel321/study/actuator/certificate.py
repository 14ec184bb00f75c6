"""Certificates of calibration: what each coil makes of the samples sent to it, when it was measured, and how well.

A certificate is a file in the study's folder `calibration`, never overwritten, with a digest of itself as seal.
Quantities are in m/s², responses in m/s² per full scale, frequencies in Hz.
"""

import base64
import hashlib
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
)
from scipy import fft, signal

from feel321.files import create_text, file_named, make_folder, word_fault
from feel321.study.actuator.response import BAND_HZ, Band, Spectrum, find_inside
from feel321.study.actuator.rig import AXES, Rig, SensorTable, digest
from feel321.study.settings.fields import AtLeastOne, Count, Positive, Words
from feel321.types import Samples

FOLDER = "calibration"
MEASURED, MANUAL = "measured", "manual"
FADED_DB = -80.0  # of a filter's energy: what comes after is cut off


def _pack(array: NDArray[Any]) -> str:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return base64.b64encode(buffer.getvalue()).decode()


def _unpack(text: object) -> NDArray[Any]:
    stored = io.BytesIO(base64.b64decode(str(text)))
    read: Any = np.lib.format.read_array  # which raises a ValueError whatever is wrong
    array: NDArray[Any] = read(stored, allow_pickle=False)
    return array


def _check_time(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("must be a time with its zone")
    return text


# JSON holds null where a number was not measured, and arrays as text.
OrNaN = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
Real = Annotated[Samples, PlainValidator(_unpack), PlainSerializer(_pack)]
Complex = Annotated[Spectrum, PlainValidator(_unpack), PlainSerializer(_pack)]
Time = Annotated[str, AfterValidator(_check_time)]
CLOSED = {"extra": "forbid"}  # no fields but these


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoilCertificate:
    """One coil, as measured without its filter, and with it.

    full_scale_m_s2: median response in the band without the filter; target: response everywhere in its band with it.
    latency: samples from sending to the sensor; delay: samples that the filter adds. response (along the unit vector
    `direction`, latency removed), coherence, distortion and equalised (with the filter): at frequency_hz. levels,
    linearity_db: amplitudes of the ladder and deviations from linear there. before_db, largest_db: largest deviation in
    the band, without the filter, and with it. budget: standard uncertainties of the level in dB, by source.
    """

    name: Words
    channel: AtLeastOne
    full_scale_m_s2: Positive
    target: Positive
    band_hz: Band = BAND_HZ
    latency: Count
    delay: Count = 0
    gain_db: OrNaN = 0.0
    before_db: OrNaN = math.nan
    largest_db: OrNaN = math.nan
    least_coherence: OrNaN = math.nan
    crossed_db: OrNaN = math.nan
    noise_m_s2: OrNaN = math.nan
    uncertainty_db: OrNaN = math.nan
    total_distortion: OrNaN = math.nan
    worst_hz: OrNaN = math.nan
    least_coherence_after: OrNaN = math.nan
    budget: Mapping[str, OrNaN] = field(default_factory=dict)
    direction: Real
    frequency_hz: Real
    response: Complex
    coherence: Real = field(default_factory=lambda: np.full(2, np.nan))
    distortion: Real = field(default_factory=lambda: np.full(2, np.nan))
    equalised: Complex = field(default_factory=lambda: np.full(2, np.nan, dtype=np.complex128))
    fir: Real = field(default_factory=lambda: np.ones(1))
    levels: Real = field(default_factory=lambda: np.zeros(0))
    linearity_db: Real = field(default_factory=lambda: np.zeros(0))
    __pydantic_config__ = CLOSED

    def respond(self, drive: Samples, *, rate_hz: float) -> Samples:
        """Predict the motion along `direction` in m/s² for samples sent, shape (n,); latency is left out."""
        # What rings on is less than a second.
        n = fft.next_fast_len(len(drive) + round(rate_hz), real=True)
        grid_hz = fft.rfftfreq(n, 1 / rate_hz)
        response = np.interp(grid_hz, self.frequency_hz, self.response)
        moved: Samples = fft.irfft(fft.rfft(drive, n) * response, n)[: len(drive)]
        return moved

    def find_filter(self, at_hz: Samples, *, rate_hz: float) -> Spectrum:
        """Find the response of the filter at some frequencies, its delay left out."""
        n = fft.next_fast_len(4 * len(self.fir), real=True)
        grid_hz = fft.rfftfreq(n, 1 / rate_hz)
        turned = fft.rfft(self.fir, n) * np.exp(2j * np.pi * grid_hz * self.delay / rate_hz)
        return np.asarray(np.interp(at_hz, grid_hz, turned), dtype=np.complex128)

    def equalise(self, samples: Samples) -> Samples:
        """Filter samples, shape (n,), so that full scale becomes `target` m/s²; shape (n + tail,)."""
        energy = np.cumsum(self.fir[::-1] ** 2)[::-1]
        kept = int(np.count_nonzero(energy > energy[0] * 10 ** (FADED_DB / 10)))
        filtered: Samples = signal.oaconvolve(samples, self.fir[: max(kept, 1)])
        return filtered


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certificate:
    """The calibration of a rig: identity, validity, and its coils by actuator; failures: limits that were not kept."""

    id: Words
    method: Words
    rig_sha256: str
    made_utc: Time
    expires_utc: Time
    rate_hz: Positive
    band_hz: Band
    coils: Annotated[Mapping[str, CoilCertificate], Field(min_length=1)]
    sensor: SensorTable | None = None
    settings: Mapping[str, Any]
    failures: tuple[str, ...] = ()
    sha256: str = ""
    format: Literal["feel321 calibration 1"] = "feel321 calibration 1"
    __pydantic_config__ = CLOSED

    @property
    def identity(self) -> dict[str, str]:
        """What a journal's header says of it."""
        return {"id": self.id, "sha256": self.sha256, "method": self.method}

    @property
    def lead_s(self) -> float:
        """Time by which the filters let samples go out before the vibration that they make."""
        return (self._latest - max(coil.latency for coil in self.coils.values())) / self.rate_hz

    @property
    def _latest(self) -> int:
        return max(coil.latency + coil.delay for coil in self.coils.values())

    def drive(self, name: str, asked_m_s2: Samples) -> Samples:
        """Make the samples to be sent to a coil, shape (n + tail,), for the motion that is asked of it, shape (n,)."""
        coil = self.coils[name]
        waits = np.zeros(self._latest - coil.latency - coil.delay)  # so that all move together
        return np.concatenate([waits, coil.equalise(asked_m_s2 / coil.target)])

    def apply(self, rig: Rig) -> Rig:
        """Give a rig the full scales that were measured, in which the mixer keeps the limits."""
        scales = {name: {"full_scale_m_s2": coil.target} for name, coil in self.coils.items()}
        actuators = tuple(one.model_copy(update=scales[one.name]) for one in rig.actuators)
        return rig.model_copy(update={"actuators": actuators})

    def find_faults(self, rig: Rig, now: datetime, *, rate_hz: float | None = None) -> list[str]:
        """Find why the certificate is not valid for a rig today, one line each."""
        own, again = digest(rig), "run feel321 calibrate"
        channels = {one.name: one.channel for one in rig.actuators}
        is_same = channels == {name: coil.channel for name, coil in self.coils.items()}
        causes = {
            f"is of another rig (digest {self.rig_sha256[:12]}, this rig's is {own[:12]}); put the old rig.toml back, "
            f"or {again}": own != self.rig_sha256 or not is_same,
            f"was measured with another sensor, or another scale of it; put [sensor] back, or {again}": (
                bool(self.sensor and rig.sensor) and rig.sensor != self.sensor
            ),
            f"expired on {self.expires_utc[:10]}; {again}": (
                now >= datetime.fromisoformat(self.expires_utc)
            ),
            f"was measured at {self.rate_hz:g} Hz, the study plays at {rate_hz or 0:g} Hz; {again}": (
                rate_hz not in {None, self.rate_hz}
            ),
        }
        found = [cause for cause, is_so in causes.items() if is_so]
        found += [f"did not pass: {one}; mend that and {again} again" for one in self.failures]
        return [f"certificate {self.id} {cause}" for cause in found]


def begin_certificate(
    rig: Rig, coils: Mapping[str, CoilCertificate], *, method: str, made: datetime, rate_hz: float
) -> Certificate:
    """Give coils an identity, the digest of their rig and a time of validity."""
    rig_sha256, settings = digest(rig), rig.calibration
    expires = made + timedelta(days=settings.valid_days)
    return Certificate(
        id=f"{made:%Y%m%dT%H%M%SZ}-{rig_sha256[:8]}",
        method=method,
        rig_sha256=rig_sha256,
        made_utc=made.isoformat(timespec="seconds"),
        expires_utc=expires.isoformat(timespec="seconds"),
        rate_hz=rate_hz,
        band_hz=settings.band_hz,
        coils=coils,
        sensor=rig.sensor if method == MEASURED else None,
        settings=settings.model_dump(mode="json"),
    )


def make_manual(
    rig: Rig,
    gains: Mapping[str, float],
    *,
    directions: Mapping[str, Samples],
    made: datetime,
    rate_hz: float,
) -> Certificate:
    """Make a certificate of typed gains, in m/s² per full scale by actuator: no filter, nothing measured."""
    names, db = [actuator.name for actuator in rig.actuators], rig.calibration.gain_uncertainty_db
    if wrong := [name for name in (*names, *gains) if (name in gains) != (name in names)]:
        raise ValueError(
            f"manual gains must name each actuator once ({', '.join(map(repr, names))}), not so: "
            f"{', '.join(map(repr, wrong))}"
        )
    if odd := [name for name, gain in gains.items() if not 0 < gain < math.inf]:
        must = "must be positive m/s² per full scale"
        raise ValueError(f"gain of {odd[0]!r} {must}, got {gains[odd[0]]:g}")
    coils = {
        one.name: CoilCertificate(
            name=one.name,
            channel=one.channel,
            full_scale_m_s2=gains[one.name],
            target=gains[one.name],
            latency=0,
            uncertainty_db=db,
            budget={"typed gain": db},
            direction=directions.get(one.name, np.eye(len(AXES))[0]),
            frequency_hz=np.array(rig.calibration.band_hz),
            response=np.full(2, gains[one.name], dtype=np.complex128),
        )
        for one in rig.actuators
    }
    return begin_certificate(rig, coils, method=MANUAL, made=made, rate_hz=rate_hz)


_CERTIFICATE = TypeAdapter(Certificate)


def write_certificate(certificate: Certificate, folder: Path) -> Certificate:
    """Write a certificate into a study's folder, where none of that name may be, and return it with its seal."""
    path = folder / FOLDER / f"{certificate.id}.json"
    make_folder(path.parent)
    if path.exists():
        raise FileExistsError(f"{path}: already exists and is not overwritten; calibrate again")
    entry = _CERTIFICATE.dump_python(certificate, mode="json")
    entry["sha256"] = _seal(entry)
    create_text(path, json.dumps(entry, indent=1, ensure_ascii=False) + "\n")
    return read_certificate(path)


def read_certificate(path: Path) -> Certificate:
    """Read a certificate, or refuse one that was changed since it was written."""
    with file_named(path):
        try:
            entry = json.loads(path.read_text(encoding="utf-8"))
            is_sealed = entry["sha256"] == _seal(entry)
        except (ValueError, KeyError, TypeError, RecursionError):
            raise ValueError("not a certificate of calibrate's; calibrate again") from None
        if not is_sealed:
            raise ValueError("was changed after it was written; restore it, or calibrate again")
        if isinstance(entry.get("sensor"), dict):  # what is not set, an older feel321 wrote as null
            own = entry["sensor"].items()
            entry["sensor"] = {key: value for key, value in own if value is not None}
        try:
            return _CERTIFICATE.validate_python(entry)
        except ValidationError as error:
            raise ValueError(f"{word_fault(error)}; calibrate again") from None


def _seal(entry: Mapping[str, Any]) -> str:
    own = {key: value for key, value in entry.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def list_certificates(folder: Path) -> list[Path]:
    """List the certificates in a study's folder, the newest first."""
    return sorted((folder / FOLDER).glob("[!.]*.json"), reverse=True)


def judge_certificates(
    folder: Path, rig: Rig, *, now: datetime, rate_hz: float | None = None
) -> tuple[Certificate | None, list[str]]:
    """Find the newest valid certificate of a rig; if there is none, the faults of its newest one, else of any."""
    candidates: list[tuple[bool, list[str]]] = []
    for path in list_certificates(folder):
        try:
            certificate = read_certificate(path)
        except (OSError, ValueError) as error:
            candidates.append((False, [f"certificate {error}"]))
            continue
        if not (faults := certificate.find_faults(rig, now, rate_hz=rate_hz)):
            return certificate, []
        candidates.append((certificate.rig_sha256 != digest(rig), faults))
    if not candidates:
        return None, ["no certificate of calibration; run feel321 calibrate"]
    return None, min(candidates, key=lambda candidate: candidate[0])[1]


PANEL_CM = 4.6
FLOOR_DB = -60.0
TICKS_HZ = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)


def draw_certificate(certificate: Certificate, stem: Path) -> None:
    """Draw each coil: its response, its filter, what is left with it, and the limits; save it as SVG."""
    from feel321.analysis import figures

    coils, (low, high) = list(certificate.coils.values()), certificate.band_hz
    most_db = float(certificate.settings["max_deviation_db"])
    with figures.print_style():
        figure = figures.new_canvas(PANEL_CM * len(coils) + 0.5)
        panels = figure.subplots(len(coils), sharex=True, squeeze=False)[:, 0]
        for axes, coil in zip(panels, coils, strict=True):
            at_hz = coil.frequency_hz[find_inside(coil.frequency_hz, band_hz=(low, high))]
            own = np.interp(at_hz, coil.frequency_hz, coil.response) / coil.target
            left = np.interp(at_hz, coil.frequency_hz, coil.equalised) / coil.target
            inverse = coil.find_filter(at_hz, rate_hz=certificate.rate_hz)
            names = ("without filter", "filter", "with filter")
            for name, size, hue in zip(names, (own, inverse, left), (1, 2, 0), strict=True):
                level_db = np.maximum(20 * np.log10(np.maximum(np.abs(size), 1e-9)), FLOOR_DB)
                axes.plot(at_hz, level_db, color=figures.OKABE_ITO[hue], label=name)
            grey = {"color": figures.GREY, "alpha": 0.2, "linewidth": 0}
            axes.fill_between(coil.band_hz, -most_db, most_db, label="limits", **grey)
            axes.set(xscale="log", ylabel="Level (dB)", ylim=(FLOOR_DB - 2, None), xmargin=0)
            scale = f"{coil.target:.3g} m/s² at full scale"
            axes.set_title(f"{coil.name}: {scale}, within {coil.largest_db:.1f} dB")
        panels[-1].set_xlabel("Frequency (Hz)")
        shown = [one for one in TICKS_HZ if low <= one <= high]
        panels[-1].set_xticks(shown, [f"{one:g}" for one in shown])
        panels[-1].set_xticks([], minor=True)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        verdict = "did not pass" if certificate.failures else "passed"
        figures.add_title(figure, f"{certificate.id} ({certificate.method}): {verdict}")
        figures.save_figure(figure, stem)
