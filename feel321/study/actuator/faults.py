"""What is wrong with a rig, by coil, from what was sent and what a three-axis sensor measured of it.

The certificate says how each coil responds and in which direction it moves, so its motion can be separated from that of
the others and compared with what was sent to it. A cause is named only where it explains what was measured; what
nothing explains is "unknown", with the figures. Coils in one direction cannot be separated, and are judged together.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import fft, optimize

from feel321.study.actuator.certificate import Certificate, CoilCertificate
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.response import DB, Spectrum, find_inside
from feel321.study.actuator.rig import Rig, require_sensor
from feel321.types import Samples

MAINS_HZ = (50.0, 60.0)
RATES = (44100 / 48000, 48000 / 44100, 0.5, 2.0)  # of the converter over that of the samples
CLIPPED = 0.999  # of the sensor's full scale
FLAT = 6  # equal samples at a sensor's largest value may be a crest that was cut off
LEAST_STEPS = 300  # different values of a signal that is not flat for want of resolution
MOST_JUMP, MOST_CUT = 2.5, 5.0  # steps from a crest to its neighbour, and to where it would go on
CLEAR = 5.0  # least ratio of the motion asked of a coil to the noise, for it to be judged
PARALLEL = 0.9  # cosine between coils that a sensor cannot separate
FOLLOWS = 0.5  # share of a coil's motion that must follow what was sent to it
CLOSELY = 0.9  # less may be a resonance that rings at any rate: other rates are tried
DEAD_DB = -20.0
MOVED, DAMPED = 0.03, 0.3  # changes of a resonance and of its damping that count
BETTER = 0.5  # a better cause leaves less than this share of what another leaves unexplained
LEAST_SWAPPED = 0.05  # of two coils' motion that does not follow what is sent to them
LEAST_LEFT = 2e-4  # of a motion's energy: less is no reason to look for a cause
DISTORTS = 0.02  # of the motion, beyond twice what the certificate knows
LATE_S = 0.004  # change of a delay that counts
BLOCKS = 4  # of which the latency of a stream consists, at most
N_HUMS = 2
HUM_SHARE, HUM_LINE = 0.01, 4.0  # a hum's RMS over that of the motion, and over its surroundings
SURE = 3.0  # standard errors
MIN_QUIET_S = 0.02  # of silence in which noise can be measured
COARSE_HZ = 8000.0  # rate at which lags are found
RINGING_S = 0.2  # after the samples
KNOTS = 6  # per octave, of the smooth response that is no distortion
TINY = 1e-30


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How a coil, or several in one direction, answered: gain, sign, resonance and damping against the certificate.

    asked: its motion by the certificate, with that resonance and damping, which are factors. lag: samples since the
    onset was sent, the coil's own apart. left: share of the motion's energy that is not explained. error_db: standard
    error of gain_db. noise: energy. distortion: what no linear response explains, over the motion; level_db: of all
    its motion over what was asked.
    """

    name: str
    asked: Spectrum
    gain_db: float
    sign: int
    lag: float
    left: float
    error_db: float
    resonance: float
    damping: float
    noise: float
    distortion: float
    level_db: float
    is_asked: bool
    is_moving: bool


def energy(spectra: Spectrum) -> Samples:
    """Sum the squares of spectra, shape (..., k)."""
    return np.asarray(np.sum(np.abs(spectra) ** 2, axis=-1))


def group_coils(certificate: Certificate) -> list[list[CoilCertificate]]:
    """Group the coils that move in about one direction."""
    groups: list[list[CoilCertificate]] = []
    for coil in certificate.coils.values():
        near = (g for g in groups if abs(g[0].direction @ coil.direction) > PARALLEL)
        if group := next(near, None):
            group.append(coil)
        else:
            groups.append([coil])
    return groups


def find_resonance(coil: CoilCertificate) -> tuple[float, float]:
    """Find resonance in Hz and Q of the second-order coil that comes nearest to a response."""
    inside = (coil.frequency_hz > 0) & (np.abs(coil.response) > 0)
    at_hz, size = coil.frequency_hz[inside], np.log(np.abs(coil.response[inside]))

    def miss(x: Samples) -> Samples:
        level = 2 * np.log(at_hz) - np.log(np.abs(_swing(at_hz, *np.exp(x[:2]))))
        return np.asarray((size - x[2] - level) / np.sqrt(at_hz))

    starts = ([math.log(hz), 0.5, np.median(size)] for hz in (at_hz[np.argmax(size)], 80.0, 160.0))
    found = [optimize.least_squares(miss, x, loss="soft_l1", f_scale=0.02) for x in starts]
    resonance_hz, q = np.exp(min(found, key=lambda one: float(one.cost)).x[:2])
    return float(resonance_hz), float(q)


def _swing(at_hz: Samples, resonance_hz: float, q: float) -> Spectrum:
    return np.asarray(resonance_hz**2 - at_hz**2 + 1j * at_hz * resonance_hz / q)


class Scene:
    """One playback, taken apart by group of coils; all spectra are those of the band, shape (k,).

    actual: motion by group; asked: motion by group, by the samples of each group. lag: common to all, in samples;
    follows: share of all motion that follows any coil's samples there.
    """

    def __init__(
        self, certificate: Certificate, sent: Frames, measured: Samples, *, rate: float = 1.0
    ) -> None:
        self.given, self.rate_hz = (sent, measured), certificate.rate_hz
        self._n = max(len(sent), measured.shape[1])
        coarse = max(int(self.rate_hz / COARSE_HZ), 1)
        n_coarse = fft.next_fast_len(round(self._n / coarse + RINGING_S * COARSE_HZ), real=True)
        self._n_grid = coarse * n_coarse
        grid_hz = fft.rfftfreq(self._n_grid, 1 / self.rate_hz)
        band_hz = (max(20.0, certificate.band_hz[0]), min(1000.0, certificate.band_hz[1]))
        self._inside = np.flatnonzero(find_inside(grid_hz, band_hz=band_hz))
        self._at_hz, self.groups = grid_hz[self._inside], group_coils(certificate)
        self._directions: Samples = np.stack([own[0].direction for own in self.groups], axis=1)
        self._moved = np.linalg.pinv(self._directions) @ measured
        self.actual = self._transform(self._moved)
        frames = np.asarray(sent, dtype=np.float64)
        if rate != 1:
            place, given = np.arange(self._n) * rate, np.arange(len(sent))
            frames = np.stack([np.interp(place, given, one, right=0.0) for one in frames.T], axis=1)
        self.sent = {one.name: frames[:, one.channel - 1] for one in certificate.coils.values()}
        self._first = min(one.latency for one in certificate.coils.values())
        samples = [{one.name: self.sent[one.name] for one in coils} for coils in self.groups]
        n = len(self.groups)
        asked = np.stack([[self.expect(own, other) for other in samples] for own in range(n)])
        size, cross = energy(asked), np.zeros((n, n, n_coarse // 2 + 1), dtype=np.complex128)
        cross[..., self._inside] = self.actual[:, None] * asked.conj()
        found = np.square(fft.irfft(cross, n_coarse) * n_coarse / 2)
        explained = found / np.maximum(size, TINY)[..., None] * (size > TINY)[..., None]
        total = explained.max(axis=1).sum(axis=0)
        self.lag = int(np.argmax(total)) * coarse
        whole = max(float(energy(self.actual).sum()), TINY)
        self.follows, self.asked = float(total.max() / whole), self.shift(asked, self.lag)

    def _transform(self, samples: Samples) -> Spectrum:
        """Transform samples to the spectrum in the band, shape (..., k)."""
        return np.asarray(fft.rfft(samples, self._n_grid)[..., self._inside])

    def shift(self, asked: Spectrum, n_samples: float) -> Spectrum:
        """Delay what is asked of a coil."""
        return np.asarray(asked * np.exp(-2j * np.pi * self._at_hz * n_samples / self.rate_hz))

    def expect(self, place: int, sent: Mapping[str, Samples]) -> Spectrum:
        """Expect the motion of a group along its direction; samples of another coil are taken as its own."""
        own, moved = self.groups[place], np.zeros(len(self._at_hz), dtype=np.complex128)
        for name, samples in sent.items():
            if samples.any():
                coil = next((one for one in own if one.name == name), own[0])
                response = np.interp(self._at_hz, coil.frequency_hz, coil.response)
                response *= float(coil.direction @ own[0].direction)
                moved += self.shift(response * self._transform(samples), coil.latency - self._first)
        return moved

    def find_left(self, measured: Samples, lines_hz: Sequence[float]) -> tuple[Samples, Samples]:
        """Find what of the measured axes, (3, n), no linear response explains, and the lines beside it."""
        n = measured.shape[1]
        turns = 2 * np.pi * np.outer(lines_hz, np.arange(n) / self.rate_hz)
        columns = self._transform(np.cos(turns).reshape(-1, n))
        follow = np.zeros((len(self.groups), self._n_grid // 2 + 1), dtype=np.complex128)
        lines = np.zeros((len(self.groups), n))
        for row, asked in enumerate(np.diagonal(self.asked).T):
            follow[row, self._inside], size = self._follow(self.actual[row], asked, columns)
            lines[row] = size.real @ np.cos(turns) - size.imag @ np.sin(turns)
        moved = self._directions @ fft.irfft(follow, self._n_grid)[:, :n]
        return measured - moved, self._directions @ lines

    def _follow(
        self, actual: Spectrum, asked: Spectrum, lines: Spectrum
    ) -> tuple[Spectrum, Spectrum]:
        """Fit a response that is smooth over frequency, and lines, to a motion: what follows, and the lines' sizes."""
        octaves = np.log2(self._at_hz)
        knots = np.linspace(octaves[0], octaves[-1], round(KNOTS * (octaves[-1] - octaves[0])) + 2)
        hats = np.maximum(1 - np.abs(octaves[:, None] - knots) / (knots[1] - knots[0]), 0)
        columns = np.concatenate([hats * asked[:, None], lines.T], axis=1)
        weights = np.linalg.lstsq(columns, actual, rcond=1e-6)[0]
        n = len(knots)
        return np.asarray(columns[:, :n] @ weights[:n]), np.asarray(weights[n:])

    def fit(self, place: int, asked: Spectrum, *, swings: tuple[float, float]) -> Fit:
        """Fit gain, sign and lag of a group to its motion and, where that helps, changes of its resonance and Q."""
        actual, moved = self.actual[place], float(energy(self.actual[place]))
        # Its noise is that before the onset, or the certificate's.
        n_quiet = max(min(self.lag, self._first) - round(0.005 * self.rate_hz), 0)
        certified = self.groups[place][0].noise_m_s2
        power = float(certified) ** 2 / 3 * 2 * len(self._at_hz) / self._n_grid
        if n_quiet > MIN_QUIET_S * self.rate_hz:
            quiet = float(energy(self._transform(self._moved[place, :n_quiet])))
            power = max(power, 2 * quiet / self._n_grid / n_quiet)
        noise = float(np.nan_to_num(power) * self._n * self._n_grid / 2)
        start = complex(np.vdot(asked, actual)) / max(float(energy(asked)), TINY)
        sign = -1 if start.real < 0 else 1

        def reshape(x: Samples) -> Spectrum:
            if len(x) == len(simple):
                return asked
            own = _swing(self._at_hz, swings[0] * math.exp(x[2]), swings[1] * math.exp(-x[3]))
            return np.asarray(asked * _swing(self._at_hz, *swings) / own)

        def miss(x: Samples) -> Samples:
            turned = sign * np.exp(x[0] - 2j * np.pi * self._at_hz * x[1] / 1e3)
            missing = (actual - turned * reshape(x)) / math.sqrt(max(moved, TINY))
            return np.asarray(missing).view(np.float64)

        # Log gain, lag in ms, log resonance, log damping: first guess, bounds, scale.
        gain = min(max(math.log(max(abs(start), TINY)), -11.9), 4.9)
        free = np.array([
            [gain, 0.0, 0.0, 0.0], [-12.0, -2.0, -1.0, -2.0], [5.0, 2.0, 1.0, 2.0], [0.1, 0.1, 0.05, 0.2],
        ])  # fmt: skip
        simple, low, high, scale = free[:, :2]
        found = optimize.least_squares(miss, simple, bounds=(low, high), x_scale=scale)
        if max(LEAST_LEFT, 2 * noise / max(moved, TINY)) < 2 * found.cost < FOLLOWS:
            guess, low, high, scale = free
            full = optimize.least_squares(miss, guess, bounds=(low, high), x_scale=scale)
            found = full if full.cost < BETTER * found.cost else found
        jacobian = np.asarray(found.jac)
        spread = np.linalg.pinv(jacobian.T @ jacobian) * 2 * found.cost / len(self._at_hz)
        x, shaped = np.array([*found.x, 0.0, 0.0]), reshape(found.x)
        no_lines = np.empty((0, len(asked)), dtype=np.complex128)
        rest = actual - self._follow(actual, shaped, no_lines)[0]
        return Fit(
            name=" and ".join(coil.name for coil in self.groups[place]),
            asked=shaped,
            gain_db=DB * float(x[0]),
            sign=sign,
            lag=self.lag + float(x[1]) * self.rate_hz / 1e3,
            left=float(2 * found.cost),
            error_db=DB * math.sqrt(max(float(spread[0, 0]), 0.0)),
            resonance=math.exp(x[2]),
            damping=math.exp(x[3]),
            noise=noise,
            distortion=math.sqrt(max(float(energy(rest)) - noise, 0.0) / max(moved, TINY)),
            level_db=DB / 2 * math.log(max(moved - noise, TINY) / max(float(energy(asked)), TINY)),
            is_asked=float(energy(asked)) > CLEAR**2 * noise,
            is_moving=moved > CLEAR**2 * noise,
        )


class Diagnosis:
    """Judges the playbacks of a rig with a measured certificate and a sensor.

    lag: of the last playback, in samples. is_grave: whether a fault of it may have been felt: not if each coil did what
    was sent to it, within tolerance_db (None for any) and the rig's own `max_distortion`.
    """

    def __init__(
        self, certificate: Certificate, rig: Rig, *, tolerance_db: float | None = None
    ) -> None:
        self._certificate, self._settings, self.is_grave = certificate, rig.calibration, False
        self._tolerance_db = math.inf if tolerance_db is None else tolerance_db
        self._full_scale, groups = require_sensor(rig).full_scale_m_s2, group_coils(certificate)
        self._resonances = [find_resonance(group[0]) for group in groups]
        known = [[float(np.nan_to_num(one.total_distortion)) for one in group] for group in groups]
        self._distorts = [DISTORTS + 2 * max(own) for own in known]
        self.lag: float | None = float(min(one.latency for one in certificate.coils.values()))
        # A stream that was opened anew, or interrupted, holds more or less than before, in whole blocks.
        self._most_s = rig.device.latency_s / BLOCKS

    def judge(self, sent: Frames, measured: Samples) -> str:
        """Name what is wrong by frames sent, (n, channels), and what was measured since, (3, m) in m/s²; or nothing."""
        self.is_grave = True
        if fault := find_sensor_fault(measured, full_scale_m_s2=self._full_scale):
            return fault
        measured = measured - measured.mean(axis=1, keepdims=True)
        scene = Scene(self._certificate, sent, measured)
        left, hum = scene.find_left(measured, [])
        # Harmonics of what was asked at 25 or 30 Hz are no hum.
        least = max(HUM_SHARE, *self._distorts)
        hum_hz, _ = find_hum(left, rate_hz=scene.rate_hz, size=_rms(measured) * least / HUM_SHARE)
        for _ in range(N_HUMS if hum_hz else 0):  # a strong one hides what it is to be told from
            more = scene.find_left(measured, [k * hum_hz for k in range(1, 6)])[1]
            measured, hum = measured - more, hum + more
            scene = Scene(self._certificate, sent, measured)
        asked = np.diagonal(scene.asked).T
        places = enumerate(zip(asked, self._resonances, strict=True))
        motions = [scene.fit(place, own, swings=swings) for place, (own, swings) in places]
        found = list(self._find_causes(scene, motions))
        is_swapped = any("swapped" in one for one in found)
        is_within = all(
            not one.is_asked
            or (
                (one.is_moving and one.sign > 0 and one.left < FOLLOWS)
                and max(abs(one.gain_db), abs(one.level_db)) <= self._tolerance_db
                and one.distortion <= self._settings.max_distortion
            )
            for one in motions
        )
        self.is_grave = bool(found) and (is_swapped or not is_within)
        if hum_hz and scene.follows > FOLLOWS and not is_swapped:
            found.append(describe_hum(hum_hz, _rms(hum)))
        return "; ".join(found)

    def _find_causes(self, scene: Scene, motions: Sequence[Fit]) -> Iterator[str]:
        asked = [one for one in motions if one.is_asked]
        if not asked:
            return
        if not any(one.is_moving for one in motions):
            # Of one coil alone nothing is known of the others, which may well move.
            where = "cable, amplifier, and its channel, which the sink may lack"
            if len(asked) == len(motions):
                where = "amplifier, coils, and how the sensor is held"
            names = " and ".join(one.name for one in asked)
            yield f"{names}: dead: the sensor shows noise only; check {where}"
            return
        if whole := self._find_rate(scene, motions) or self._find_swap(scene, motions):
            yield whole
            return
        listed = [self._list_causes(scene, place, one) for place, one in enumerate(motions)]
        pairs = zip(motions, listed, strict=True)
        causes = {one.name: next(own, "") for one, own in pairs if one.is_asked}
        told = {name: cause for name, cause in causes.items() if cause}
        gains = [one.gain_db for one in asked]
        is_common = max(gains) - min(gains) < self._settings.max_drift_db
        is_common &= all(cause.startswith("gain") for cause in causes.values())
        if is_common and len(told) > 1:
            told = {"all coils": f"gain {np.mean(gains):+.1f} dB: the amplifier's or the sensor's"}
        yield from (f"{name}: {cause}" for name, cause in told.items())
        if not told:
            before, self.lag = self.lag, float(np.median([one.lag for one in asked]))
            moved_s = 0.0 if before is None else (self.lag - before) / scene.rate_hz
            if LATE_S < abs(moved_s) < self._most_s:
                yield (
                    f"delay moved by {1e3 * moved_s:+.1f} ms: something between output and coils holds more or less "
                    "than before"
                )

    def _find_rate(self, scene: Scene, motions: Sequence[Fit]) -> str:
        """Name a converter that runs at another rate; else what is known, or nothing if most follows."""
        if scene.follows >= CLOSELY:
            return ""
        own, given = self._certificate, scene.given
        others = {rate: Scene(own, *given, rate=rate).follows for rate in RATES}
        rate = max(others, key=others.__getitem__)
        if others[rate] > FOLLOWS and 1 - others[rate] < BETTER * (1 - scene.follows):
            return name_rate(rate, scene.rate_hz)
        return _describe_unknown(motions) if scene.follows < FOLLOWS else ""

    def _find_swap(self, scene: Scene, motions: Sequence[Fit]) -> str:
        """Name the pair of coils that do what is sent to the other."""
        moved = energy(scene.actual)
        straight = np.array([one.left for one in motions]) * moved

        def leave(pair: tuple[int, int]) -> float:
            left = straight.copy()
            for own, other in (pair, pair[::-1]):
                asked, swings = scene.asked[own, other], self._resonances[own]
                is_asked = energy(asked) > TINY
                share = scene.fit(own, asked, swings=swings).left if is_asked else 1.0
                left[own] = moved[own] * share
            return float(left.sum())

        before, pairs = float(straight.sum()), list(combinations(range(len(motions)), 2))
        if not pairs or before < LEAST_SWAPPED * moved.sum():
            return ""
        best = min(pairs, key=leave)
        if leave(best) > BETTER * before:
            return ""
        names = " and ".join(motions[place].name for place in best)
        return f"{names} swapped: each moves by what is sent to the other; exchange their cables"

    def _list_causes(self, scene: Scene, place: int, motion: Fit) -> Iterator[str]:
        """Name what may be wrong with one coil, the likeliest first."""
        gain = f"gain {motion.gain_db:+.1f} dB"
        if max(motion.gain_db, motion.level_db) < DEAD_DB or not motion.is_moving:
            yield f"dead ({motion.gain_db:.0f} dB); check its cable, its amplifier and its channel"
        if motion.sign < 0 and motion.left < FOLLOWS:
            yield "inverted: its wires were exchanged since the calibration"
        noise = math.sqrt(0.3 * motion.noise / max(float(energy(scene.actual[place])), TINY))
        if motion.distortion > math.hypot(self._distorts[place], noise):
            yield _find_bend(scene, place, motion)
        is_off = abs(motion.gain_db) > self._settings.max_drift_db + SURE * motion.error_db
        before_hz, damping = self._resonances[place][0], motion.damping
        now = f"resonance {before_hz:.0f} -> {before_hz * motion.resonance:.0f} Hz, damping x {damping:.2f}"
        if abs(motion.resonance - 1) > MOVED or abs(math.log(damping)) > DAMPED:
            yield (
                f"loose mount: {now}, {gain}; fasten it, then calibrate again"
                if is_off
                else f"{now}, gain as it was: heat, or a suspension that wears; let it rest, or calibrate again"
            )
        if is_off:
            yield f"{gain}: its amplifier's knob, or its mounting"


def _find_bend(scene: Scene, place: int, motion: Fit) -> str:
    """Name what bends a motion: an amplifier that clips what is sent, or anything else that rattles."""
    told, actual = f"distortion of {motion.distortion:.0%}", scene.actual[place]
    samples = {one.name: scene.sent[one.name] for one in scene.groups[place]}
    peak = max(float(np.abs(one).max()) for one in samples.values())

    def leave(share: float) -> float:
        cut = {k: np.clip(one, -share * peak, share * peak) for k, one in samples.items()}
        asked = scene.shift(scene.expect(place, cut), motion.lag)
        along = abs(np.vdot(asked, actual)) ** 2 / np.maximum(energy(asked), TINY)
        return 1 - float(along / np.maximum(energy(actual), TINY))

    best = min(np.geomspace(0.05, 0.97, 40), key=leave)
    if leave(best) < BETTER * motion.distortion**2:
        return f"clipping at {best * peak:.0%} of full scale, {told}; lower the level, or turn the amplifier up"
    if motion.left > FOLLOWS:
        return _describe_unknown([motion])
    return f"rattle, {told}: something touches or is loose; fasten it"


def _describe_unknown(motions: Iterable[Fit]) -> str:
    figures = (
        f"{one.name} gain {one.gain_db:+.1f} dB, resonance x {one.resonance:.2f}, damping x "
        f"{one.damping:.2f}, distortion {one.distortion:.0%}, {one.left:.0%} of the motion unexplained"
        for one in motions
    )
    return f"unknown cause, and the figures are: {', '.join(figures)}"


def name_rate(rate: float, rate_hz: float) -> str:
    """Name the rate of a converter over that of the samples."""
    rates = f"{rate * rate_hz:.0f} Hz instead of {rate_hz:.0f} Hz"
    return f"wrong rate: played at {rates}; set the device"


def describe_hum(hum_hz: float, rms: float) -> str:
    """Name a hum and where it comes from."""
    return f"hum of {hum_hz:.0f} Hz, {rms:.2g} m/s²: a ground loop, or cables beside the mains"


def _rms(motion: Samples) -> float:
    return float(np.sqrt(np.mean(np.square(motion).sum(axis=0))))


def find_sensor_fault(measured: Samples, *, full_scale_m_s2: float) -> str:
    """Name a sensor that is silent, or that was driven beyond its range; shape (axes, n)."""
    silent = [axis for axis, own in zip("xyz", measured, strict=False) if not np.ptp(own)]
    if len(silent) == len(measured):
        return "sensor dead: every sample is the same; check its cable, its supply and its channels"
    if silent:
        return f"sensor dead on {' and '.join(silent)}: every sample is the same; check its cable and channel"
    for own in measured:
        peak = float(np.abs(own).max())
        if _is_cut(np.abs(own), peak) or peak >= CLIPPED * full_scale_m_s2:
            return f"sensor saturated at {peak:.3g} m/s²: lower the gain of its input, and its full_scale_m_s2 with it"
    return ""


def _is_cut(size: Samples, peak: float) -> bool:
    """Say whether the crests of a signal are cut off, and not flat by curvature and resolution alone.

    A parabola that falls by d within k samples beyond both ends of a flat top of n samples rises d n / 4k above it; of
    a smooth crest that is two steps of the resolution at most.
    """
    is_top = np.concatenate([[False], size >= peak * (1 - 1e-6), [False]])
    begins, ends = np.flatnonzero(np.diff(is_top)).reshape(-1, 2).T
    steps, n_flat, last = np.unique(size), ends - begins, len(size) - 1

    def fall(n_beside: Samples) -> tuple[Samples, Samples]:
        before, after = np.maximum(begins - n_beside, 0), np.minimum(ends - 1 + n_beside, last)
        return peak - size[before], peak - size[after]

    step = float(np.diff(steps).min(initial=peak))
    is_steep = np.maximum(*fall(np.ones_like(begins))) > MOST_JUMP * step
    n_beside = np.maximum(n_flat // 4, 1)
    is_bent = np.add(*fall(n_beside)) / 2 * n_flat / (4 * n_beside) > MOST_CUT * step
    return bool((n_flat >= FLAT) @ (is_steep | is_bent)) and len(steps) > LEAST_STEPS


def find_hum(left: Samples, *, rate_hz: float, size: float) -> tuple[float, float]:
    """Find the mains in what no coil explains, (3, n): its frequency in Hz, near 50 or 60, or 0; and its RMS."""
    n = left.shape[1]
    time_s = np.arange(n) / rate_hz

    def measure(at_hz: float) -> float:
        wave = np.exp(-2j * np.pi * at_hz * time_s)
        return float(math.sqrt(2) * np.linalg.norm(left @ wave) / n)

    width_hz = max(3.0, 2 * rate_hz / n)
    best_hz, best = 0.0, HUM_SHARE * size
    for mains_hz in MAINS_HZ:
        near = {hz: measure(hz) for hz in mains_hz + np.linspace(-0.3, 0.3, 7)}
        at_hz = max(near, key=near.__getitem__)
        around = np.median([measure(mains_hz + k * width_hz) for k in (-2, -1, 1, 2)])
        if near[at_hz] > max(best, HUM_LINE * float(around)):
            best_hz, best = float(at_hz), near[at_hz]
    return best_hz, best
