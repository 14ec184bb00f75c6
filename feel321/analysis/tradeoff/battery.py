"""BATTERY: the scenes on which reducers are known to fail, and the signals they are made of.

Every scene is one second at 4 kHz, in m/s², seeded. `failing` lists which reducer must fail by what (a key of
`judge.FAILURES`), and tests check it. The first scene is the control, an ordinary drag: a reducer that fails
there fails everywhere.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from feel321.stimuli.recording import STANDARD_GRAVITY, Recording
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.types import Samples

RATE_HZ = 4000.0
N_SAMPLES = 4000  # One second; a length that is fast to transform

WINDOW = window_samples(DEFAULT_WINDOW_S, RATE_HZ)
TIME_S = np.arange(N_SAMPLES) / RATE_HZ


def make_texture(
    rng: np.random.Generator, axes: int = 1, *, low_hz: float = 40.0, high_hz: float = 400.0
) -> Samples:
    """Make independent noise of standard deviation 1, (axes, 4000), as dragging over a rough surface does."""
    frequency = np.fft.rfftfreq(N_SAMPLES, 1 / RATE_HZ)
    shape = frequency**2 / (frequency**2 + low_hz**2) / (1 + (frequency / high_hz) ** 4)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal((axes, N_SAMPLES))) * shape, N_SAMPLES)
    return np.asarray(noise / noise.std(axis=-1, keepdims=True))


def make_tap(start: int, *, frequency_hz: float = 210.0, decay_s: float = 0.004) -> Samples:
    """Make a tap, (4000,): silence, then a decaying sinusoid."""
    lag = np.maximum(np.arange(N_SAMPLES) - start, 0) / RATE_HZ
    return np.asarray(np.sin(2 * np.pi * frequency_hz * lag) * np.exp(-lag / decay_s))


def whiten(axes: Samples) -> Samples:
    """Make the covariance of axes, (3, n), exactly the identity."""
    centred = axes - axes.mean(axis=-1, keepdims=True)
    factor = np.linalg.cholesky(centred @ centred.T / axes.shape[-1])
    return np.asarray(np.linalg.solve(factor, centred))


ADXL345_STEP = 0.0039 * STANDARD_GRAVITY
"""m/s² per count of the paper's sensor: 3.9 mg in its full-resolution mode."""

GAP = round(0.005 * RATE_HZ)  # Samples lost at a time: 5 ms

LINE = np.array([[0.6], [0.64], [0.48]])
"""Direction of a motion along one line, of unit length, on no axis and not on the diagonal."""


PLANE = ((2 / 3, 1 / 3, 2 / 3), (-2 / 3, 2 / 3, 1 / 3))
"""Two directions at a right angle that every axis of the sensor sees."""


@dataclass(frozen=True, slots=True)
class StressScene:
    """A kind of motion on which some reducer fails.

    maker: makes the motion, (3, n) in m/s²; fault: does to it what a bad sensor or a lost connection does; failing:
    the reducers that must fail there, and by what.
    """

    name: str
    title: str
    reason: str
    maker: Callable[[np.random.Generator], Samples]
    failing: tuple[tuple[str, str], ...] = ()
    fault: Callable[[Samples, np.random.Generator], Samples] | None = None

    def make(self, seed: int) -> Recording:
        """Make a take of the scene."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        samples = self.maker(rng)
        return Recording(self.fault(samples, rng) if self.fault else samples, RATE_HZ, self.name)


def _ordinary(rng: np.random.Generator) -> Samples:
    return 4 * (LINE * make_texture(rng) + 0.15 * make_texture(rng, 3))


def _turning(semi_axes: tuple[float, float]) -> Callable[[np.random.Generator], Samples]:
    def make(rng: np.random.Generator) -> Samples:
        angle = 2 * np.pi * (150 * TIME_S + rng.uniform())
        parts = np.array([semi_axes[0] * np.cos(angle), semi_axes[1] * np.sin(angle)])
        return np.asarray(np.array(PLANE).T @ parts)

    return make


def _silent_axis(rng: np.random.Generator) -> Samples:
    x, y = make_texture(rng, 2)
    return 4 * np.array([x, 0.5 * x + 0.5 * y, np.zeros(N_SAMPLES)])


def _one_axis(rng: np.random.Generator) -> Samples:
    axis = 4 * make_texture(rng)[0]
    return np.array([np.zeros(N_SAMPLES), axis, np.zeros(N_SAMPLES)])


def _drift(rng: np.random.Generator) -> Samples:
    tilt = 0.6 * np.sin(2 * np.pi * (0.8 * TIME_S + rng.uniform()))
    gravity = STANDARD_GRAVITY * np.array([np.sin(tilt), np.zeros(N_SAMPLES), np.cos(tilt)])
    return _ordinary(rng) / 4 + gravity


def _lose(samples: Samples, rng: np.random.Generator) -> Samples:
    kept = np.ones(N_SAMPLES)
    for start in rng.integers(0, N_SAMPLES - GAP, size=12):
        kept[start : start + GAP] = 0.0
    return samples * kept


def _impulse(rng: np.random.Generator) -> Samples:
    # Where one frame ends, the next but one begins, and the one between is at its middle; modes differ by axis.
    start = int(rng.integers(5, 20)) * WINDOW
    modes = ((95.0, 0.0075), (210.0, 0.0045), (340.0, 0.0035))
    return np.asarray(40 * np.array([make_tap(start, frequency_hz=f, decay_s=d) for f, d in modes]))


def _near_silence(rng: np.random.Generator) -> Samples:
    start = int(rng.integers(500, 1000))
    taps = 40 * LINE * make_tap(start)
    return taps + 40e-4 * make_texture(rng, 3, low_hz=1.0, high_hz=1500.0)


_SCENES = (
    StressScene("ordinary_drag", "Ordinary drag (control)",
                "One clear direction: a reducer that fails here fails everywhere.", _ordinary),
    StressScene("anti_phase", "Anti-phase axes", "x cancels y and z everywhere: the sum has no phase of its own.",
                lambda rng: np.array([[4.0], [-2.0], [-2.0]]) * make_texture(rng),
                (("soc321", "level"), ("dft321", "noise"), ("dft321_windowed", "noise"))),
    StressScene("circular", "Circular motion",
                "All directions in the plane of the circle hold the same energy: none leads.", _turning((6.0, 6.0)),
                (("pca321", "noise"), ("pca321_matched", "noise"))),
    StressScene("elliptic", "Elliptic motion", "Rotating motion has another phase on every axis of every mounting.",
                _turning((6.0, 5.7))),
    StressScene("equal_eigenvalues", "Equal eigenvalues",
                "Independent axes of equal energy: the principal axis is arbitrary.",
                lambda rng: 4 * whiten(make_texture(rng, 3)), (("pca321", "noise"), ("pca321_matched", "noise"))),
    StressScene("silent_axis", "One silent axis",
                "z is dead: a reducer that keeps only z is silent, metrics divide by zero.", _silent_axis,
                (("saz321", "level"),)),
    StressScene("one_axis", "One axis only", "All motion on y: two of three single axes are silent.", _one_axis,
                (("sax321", "level"), ("saz321", "level"))),
    StressScene("offset", "Gravity as offset",
                "9.8 m/s² of gravity on a vibration of 1 m/s²: the offset passes for signal.",
                lambda rng: _ordinary(rng) / 4 + STANDARD_GRAVITY * np.array([[0.0], [-0.6], [0.8]])),
    StressScene("gravity_drift", "Drifting gravity",
                "The hand tilts: slow gravity outweighs the vibration on two axes.", _drift),
    StressScene("clipping", "Clipping", "Peaks are cut axis by axis: the direction of motion bends at every peak.",
                lambda rng: _ordinary(rng) + 2 * make_texture(rng, 3), (),
                lambda samples, _: np.clip(samples, *(sign * 0.35 * np.abs(samples).max() for sign in (-1, 1)))),
    StressScene("quantisation", "ADXL345 steps (3.9 mg)",
                "The vibration is weaker than the sensor's step: mostly zeros.",
                lambda rng: 0.6 * ADXL345_STEP * (LINE * make_texture(rng) + 0.5 * make_texture(rng, 3)), (),
                lambda samples, _: ADXL345_STEP * np.round(samples / ADXL345_STEP)),
    StressScene("missing_samples", "Missing samples",
                "A dozen gaps of 5 ms are filled with zeros: edges in all bands.", _ordinary, (), _lose),
    StressScene("impulse_at_edge", "Impulse at a window edge",
                "A tap at a frame's edge: frames spread it before itself.", _impulse),
    StressScene("near_silence", "Near silence", "After one tap only noise, 80 dB below: its direction is arbitrary.",
                _near_silence),
)  # fmt: skip

BATTERY: Mapping[str, StressScene] = MappingProxyType({scene.name: scene for scene in _SCENES})
"""Name -> scene, the control first."""
