"""SCENES: synthetic recordings of typical tool contacts, for demonstrations and tests.

Each scene is a few lines of physics: contacts push the tool, the tool rings in its own modes, and every mode moves the
sensor along a direction of its own. Amplitudes are those of light tool use (peaks of 5 to 60 m/s²). Seeded: the same
name, seed, rate and duration give the same samples. They are stand-ins, not measurements; studies name real recordings.

The first three stand for the parts of the paper's Figure 2 (bumps, a drag over textured vinyl, taps on hard plastic),
the fourth for its Figure 4 (a constrained texture drag). The isotropic rumble and the circular motion are the cases in
which the choice of one axis must fail.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, EuroHaptics 2010, Figures 2 to 4.
   doi:10.1007/978-3-642-14075-4_12
.. [2] A. M. Okamura, M. R. Cutkosky, J. T. Dennerlein, "Reality-based models for vibration feedback in virtual
   environments", IEEE/ASME Transactions on Mechatronics 6(3), 2001 (decaying sinusoids for taps).
   doi:10.1109/3516.951362
"""

from collections.abc import Callable

import numpy as np

from feel321.arguments import Registry, as_rng, check_name, check_rate
from feel321.stimuli.recording import Recording
from feel321.types import Rng, Samples

# Modes of a stylus held in the hand: frequency in Hz, decay time in s, direction of the motion at the sensor.
_TOOL_MODES = (
    (95.0, 0.0075, (0.9, 0.3, 0.3)),
    (210.0, 0.0045, (0.25, 0.85, -0.45)),
    (340.0, 0.0035, (-0.4, 0.3, 0.85)),
    (620.0, 0.0025, (0.5, -0.6, 0.6)),
)


def make_scene(
    name: str, *, rng: Rng = 0, rate_hz: float = 10000.0, duration_s: float = 4.0
) -> Recording:
    """Make a synthetic recording.

    Parameters
    ----------
    name : str
        One of `SCENES`; or several joined by ``+``, one after the other in equal shares of the duration.
    rng : int or numpy.random.Generator
        Seed or source of the scene's random parts; with the same seed, scenes of different names differ.
    rate_hz : float
        Sampling rate in Hz, at least 4000 so that the tool's modes are represented.
    duration_s : float
        Duration in s, at least 0.1.

    Returns
    -------
    Recording
        Acceleration in m/s², named after the scene.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.make_scene("bumps", duration_s=1)
    Recording('bumps', 10000 samples at 10000 Hz, 1 s)

    Figure 2 of the paper: over small surface features, across textured vinyl, taps on a hard piece of plastic.

    >>> stimuli.make_scene("bumps+texture_drag+hard_taps", duration_s=8)
    Recording('bumps-texture_drag-hard_taps', 80000 samples at 10000 Hz, 8 s)
    """
    parts = tuple(check_name(part, SCENES, "scene") for part in str(name).split("+"))
    if check_rate(rate_hz) < 4000 or not 0.1 * len(parts) <= duration_s <= 3600:  # noqa: PLR2004 - limits named in the message
        must = "have 4000 Hz or more and last 0.1 s to 3600 s (each of several 0.1 s)"
        raise ValueError(f"a scene must {must}, got {rate_hz} Hz and {duration_s} s")
    if not isinstance(rng, np.random.Generator):
        as_rng(rng)
        rng = np.random.default_rng([rng, *name.encode()])
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    if len(parts) == 1:  # one alone has no joints
        samples = SCENES[parts[0]](time_s, rng)
    else:
        made = []
        for part, own in zip(parts, np.array_split(time_s, len(parts)), strict=True):
            n, joint = len(own), round(JOINT_S / (own[1] - own[0]))
            rise = np.minimum(1.0, np.arange(n) / min(joint, n // 2))
            ends = 0.25 * (1 - np.cos(np.pi * rise)) * (1 - np.cos(np.pi * rise[::-1]))
            made.append(SCENES[part](own - own[0], rng) * ends)
        samples = np.concatenate(made, axis=1)
    return Recording(samples, rate_hz, "-".join(parts))


JOINT_S = 0.01  # Rise and fall of each of several scenes that follow one another


def bumps(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Ride over small ridges with the tip: a push sideways and up at each, and the tool rings."""
    at = np.arange(0.15, time_s[-1], 0.22)
    at = at + rng.uniform(-0.04, 0.04, len(at))
    width_s, strength = rng.uniform(0.0006, 0.0015, len(at)), rng.uniform(0.5, 1.5, len(at))
    up, aside = np.zeros_like(time_s), np.zeros_like(time_s)
    for when, width, size in zip(at, width_s, strength, strict=True):
        # The tip is thrown up by the ridge's slope and held back by the ridge itself, a little later.
        up += size * _ridge_slope(time_s - when, width)
        aside += size * _ridge_slope(time_s - when - width, 0.6 * width)
    scraped = _scrape(time_s, np.full_like(time_s, 0.15), rng)
    return _ring(up, time_s, size=9.0) + _ring(aside, time_s, size=5.0)[[1, 2, 0]] + scraped


def texture_drag(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Free drag over textured vinyl: spatial roughness, played faster and louder where the hand is faster."""
    speed = _strokes(time_s, rng)
    normal, friction, lateral = (_roughness(time_s, speed, rng) for _ in range(3))
    forces = (normal, 0.4 * normal + 0.5 * friction, 0.3 * lateral)
    turned = ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    moved = np.sum(
        [
            _ring(force, time_s, size=3.0)[order]
            for force, order in zip(forces, turned, strict=True)
        ],
        axis=0,
    )
    return np.asarray(moved) + _scrape(time_s, 2.0 * speed / speed.max(), rng)


def hard_taps(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Taps on hard plastic: a contact shorter than a millisecond excites every mode of the tool."""
    at = np.arange(0.2, time_s[-1], 0.35)
    at = at + rng.uniform(-0.05, 0.05, len(at))
    moved = np.zeros((3, len(time_s)))
    for when, size in zip(at, rng.uniform(0.4, 1.0, len(at)), strict=True):
        push = size * np.exp(-0.5 * ((time_s - when) / 0.0004) ** 2)
        # The hand does not hold the tool alike at every tap, so modes take part by different amounts.
        moved += _ring(push, time_s, size=60.0, shares=rng.uniform(0.3, 1.0, len(_TOOL_MODES)))
    return moved + _scrape(time_s, np.full_like(time_s, 0.1), rng)


def constrained_drag(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Drag in a guide that lets the tool move along one line only."""
    # Micro-contacts fill the band above the grain's own frequencies, as in the free drag.
    along = _roughness(time_s, _strokes(time_s, rng), rng)
    along = along + 0.3 * _coloured(time_s, rng, low_hz=30.0, high_hz=1500.0)
    across = np.array([_roughness(time_s, _strokes(time_s, rng), rng) for _ in range(3)])
    line = np.array([0.5, 0.7, 0.51])
    return (
        8.0 * line[:, None] / np.linalg.norm(line) * along
        + 0.4 * across
        + _sensor_noise(time_s, rng)
    )


def isotropic_rumble(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Feel a vibrating machine through a soft grip: the same spectrum on every axis, independent of each other."""
    axes = [_coloured(time_s, rng, low_hz=40.0, high_hz=400.0) for _ in range(3)]
    return 4.0 * np.array(axes) + _sensor_noise(time_s, rng)


def circular_motion(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Unbalanced rotor: x and y a quarter of a turn apart, with a slowly drifting speed."""
    turns = 150.0 * time_s + 4.0 * np.sin(2 * np.pi * 0.5 * time_s)
    wobble = 0.2 * _coloured(time_s, rng, low_hz=100.0, high_hz=300.0)
    angle = 2 * np.pi * turns
    return 6.0 * np.array([np.cos(angle), np.sin(angle), wobble]) + _sensor_noise(time_s, rng)


SCENES: Registry[Callable[[Samples, np.random.Generator], Samples]] = Registry(
    "scene",
    {
        scene.__name__: scene
        for scene in (
            bumps,
            texture_drag,
            hard_taps,
            constrained_drag,
            isotropic_rumble,
            circular_motion,
        )
    },
)
"""Name -> scene: acceleration in m/s², (3, n), at times in s, (n,); the only list of names."""


def _ring(push: Samples, time_s: Samples, *, size: float, shares: Samples | None = None) -> Samples:
    """Response of the tool's modes to a push: decaying sinusoids, each along its own direction; peak near `size`."""
    from scipy.signal import fftconvolve

    shares = np.ones(len(_TOOL_MODES)) if shares is None else shares
    moved = np.zeros((3, len(time_s)))
    for (frequency, decay, direction), share in zip(_TOOL_MODES, shares, strict=True):
        lag = time_s[time_s < 8 * decay]
        impulse = np.sin(2 * np.pi * frequency * lag) * np.exp(-lag / decay)
        answer = fftconvolve(push, impulse / np.linalg.norm(impulse))[: len(time_s)]
        moved += share * np.outer(direction, answer)
    return np.asarray(size / np.sqrt(len(_TOOL_MODES)) * moved)


def _ridge_slope(time_s: Samples, width_s: float) -> Samples:
    """Slope of a Gaussian ridge ridden over at time 0, peak near 1; its mean is 0."""
    at = time_s / width_s
    return np.asarray(-at * np.exp(0.5 - 0.5 * at**2))


def _scrape(time_s: Samples, size: Samples, rng: np.random.Generator) -> Samples:
    """Micro-contacts at the tip over the whole felt range: one force through the tool, and the sensor's noise."""
    force = _coloured(time_s, rng, low_hz=30.0, high_hz=1500.0)
    direct = np.outer((0.5, 0.6, 0.6), force)
    return np.asarray(size * (_ring(force, time_s, size=1.0) + direct) + _sensor_noise(time_s, rng))


def _strokes(time_s: Samples, rng: np.random.Generator) -> Samples:
    """Speed of a hand that strokes to and fro about once a second, in m/s."""
    phase = 2 * np.pi * (0.9 * time_s + rng.uniform())
    return np.asarray(0.12 * np.abs(np.sin(phase)) + 0.01)


def _roughness(time_s: Samples, speed: Samples, rng: np.random.Generator) -> Samples:
    """Vibration of a rough surface (grain near 0.4 mm) met at a varying speed, standard deviation near 1."""
    step_m = 5e-6
    path = np.cumsum(speed) * (time_s[1] - time_s[0])
    n_grains = int(path[-1] / step_m) + 2
    wave_number = np.fft.rfftfreq(n_grains, step_m)
    shape = np.exp(-0.5 * ((wave_number - 2500.0) / 1500.0) ** 2)
    profile = np.fft.irfft(np.fft.rfft(rng.standard_normal(n_grains)) * shape, n_grains)
    felt = np.interp(path, np.arange(n_grains) * step_m, profile) * speed
    return np.asarray(felt / felt.std())


def _coloured(
    time_s: Samples, rng: np.random.Generator, *, low_hz: float, high_hz: float
) -> Samples:
    """Gaussian noise between two frequencies with smooth edges, standard deviation 1."""
    n = len(time_s)
    frequency = np.fft.rfftfreq(n, time_s[1] - time_s[0])
    shape = frequency**2 / (frequency**2 + low_hz**2) / (1 + (frequency / high_hz) ** 4)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * shape, n)
    return np.asarray(noise / noise.std())


def _sensor_noise(time_s: Samples, rng: np.random.Generator) -> Samples:
    """White noise of 0.1 m/s² RMS on every axis: 10 mg, as of the MEMS accelerometers that fit on a stylus."""
    return 0.1 * rng.standard_normal((3, len(time_s)))
