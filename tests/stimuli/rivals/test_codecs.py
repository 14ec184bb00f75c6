"""ST-SIM and SPQI against loops, and against the numbers of the code that their authors published."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from feel321.stimuli.metrics import METRICS

TIME = np.arange(4096) / 8000
REFERENCE = np.sin(2 * np.pi * 150 * TIME) + 0.5 * np.sin(2 * np.pi * 320 * TIME) * np.cos(
    2 * np.pi * 5 * TIME
)

# VibroMAF 0.0.8 with its option `compute_block_dft`: unit, distorted signal, ST-SIM, SPQI.
PUBLISHED = [
    (1.0, 0.5 * REFERENCE, 0.98882, 0.037314),
    (1.0, 0.9 * REFERENCE, 0.99850, 0.581146),
    (1.0, np.sin(2 * np.pi * 150 * TIME), 0.95775, 0.403940),
    (1.0, REFERENCE + 0.2 * np.sin(2 * np.pi * 60 * TIME), 0.98857, 0.997936),
    (1.0, np.roll(REFERENCE, 5), 0.84061, 0.968601),
    (1e-3, 0.5 * REFERENCE, 0.93962, 0.037314),
    (1e-3, 0.9 * REFERENCE, 0.99209, 0.581146),
    (1e-3, np.sin(2 * np.pi * 150 * TIME), 0.90424, 0.403940),
    (1e-3, np.roll(REFERENCE, 5), 0.83908, 0.968601),
]


def on_one_axis(signal: np.ndarray) -> np.ndarray:
    return np.stack([signal, 0 * signal, 0 * signal])


@pytest.mark.parametrize(("unit", "distorted", "similarity", "quality"), PUBLISHED)
def test_published_code_agrees(
    unit: float, distorted: np.ndarray, similarity: float, quality: float
) -> None:
    """Within what its grid of frequencies is off by (a part in 1023) and its bound above 1 adds."""
    recording, reduced = on_one_axis(unit * REFERENCE), unit * distorted
    assert METRICS["st_sim"](recording, reduced, 8000.0) == pytest.approx(similarity, abs=4e-3)
    assert METRICS["spqi"](recording, reduced, 8000.0) == pytest.approx(quality, abs=4e-3)


def threshold_db(frequency_hz: float) -> float:
    ratio = math.log10(frequency_hz / 550 + 6 / 11) / math.log10(6 / 11)
    return min(62 * ratio**2 - 77, 0)


def brute(acceleration: np.ndarray, reduced: np.ndarray, rate: float) -> tuple[float, float]:
    """Both metrics block by block and frequency by frequency."""
    length = round(0.064 * rate)
    felt = NormalDist(sigma=12).cdf
    temporal, spectral, quality = [], [], []
    for start in range(0, reduced.size - length + 1, length):
        block = acceleration[:, start : start + length]
        other = reduced[start : start + length]
        p, q, first, second = [], [], [], []
        for k in range(length):
            frequency = k * rate / (2 * length)
            if frequency >= 4000:
                break
            turns = np.exp(-1j * np.pi * k * np.arange(length) / length)
            energies = [sum(abs(axis @ turns) ** 2 for axis in block), abs(other @ turns) ** 2]
            levels = [10 * math.log10(e * 512 / length**2) for e in energies]
            p.append(felt(levels[0] - threshold_db(frequency)))
            q.append(felt(levels[1] - threshold_db(frequency)))
            first.append(energies[0] * 10 ** (-threshold_db(frequency) / 10))
            second.append(energies[1] * 10 ** (-threshold_db(frequency) / 10))
        spectral.append(np.dot(p, q) / max(np.dot(p, p), np.dot(q, q)))
        error = 10 * math.log10(sum(abs(np.subtract(first, second))) / sum(first))
        quality.append((1 - math.tanh(0.3 * error + 2)) / 2)
        centred = block - block.mean(axis=1, keepdims=True)
        along = [axis @ (other - other.mean()) for axis in centred]
        size = math.sqrt(np.sum(centred**2) * np.sum((other - other.mean()) ** 2))
        temporal.append(math.sqrt(sum(np.square(along))) / size)
    similarity = np.mean(temporal) ** (2 / 3) * np.mean(spectral) ** (1 / 3)
    return float(similarity), float(np.mean(quality))


@pytest.mark.parametrize("rate", [1000.0, 1777.0, 8000.0, 10_240.0])
def test_against_loops_at_any_rate(rate: float) -> None:
    rng = np.random.default_rng(int(rate))
    n = round(0.15 * rate)
    acceleration = rng.standard_normal((3, n)) * [[1e-2], [2e-2], [0.3e-2]]
    reduced = acceleration.sum(axis=0) + 1e-2 * rng.standard_normal(n)
    similarity, quality = brute(acceleration, reduced, rate)
    assert METRICS["st_sim"](acceleration, reduced, rate) == pytest.approx(similarity, rel=1e-9)
    assert METRICS["spqi"](acceleration, reduced, rate) == pytest.approx(quality, rel=1e-9)


@pytest.mark.parametrize("name", ["st_sim", "spqi"])
def test_pauses_and_polarity_cost_nothing(name: str) -> None:
    """Where the published code halves ST-SIM for a half that is silent, and turns complex in anti-phase."""
    paused = np.where(np.arange(4096) < 2048, REFERENCE, 0.0)
    recording = on_one_axis(paused)
    assert METRICS[name](recording, paused, 8000.0) == pytest.approx(1.0, abs=1e-9)
    assert METRICS[name](recording, -paused, 8000.0) == pytest.approx(1.0, abs=1e-9)
    noisy = paused + 0.1 * np.random.default_rng(0).standard_normal(4096)
    assert METRICS[name](recording, noisy, 8000.0) < 0.9
