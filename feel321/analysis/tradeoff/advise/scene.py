"""Scenes of an advice, the tolerances, and the verdict on each reducer.

People notice a change of vibration intensity of about a fifth; below that, two vibrations are equally strong to them.
Published fractions lie between 0.4 and 2.3 dB. The 22 % are taken here as a share of *energy* (0.86 dB), the cautious
end of that range: "sufficient" is a claim that nothing is felt to be missing, and faults of several bands add up.
Energy is also what the metrics compare, so one number serves all of them:

- *Level* (felt level of the output against the recording's, in dB): ``10 log10(1 + w)``, weaker or stronger.
- *Spectrum* (`spectral_match_energy_weighted`, the share of energy common to both spectra, in bands as wide as people
  confuse frequencies): ``w``. A match that is lower by w means that a further share w of the energy is missing or
  misplaced.
- *Time* (`temporal_match_invariant`; its square is the share of the motion's energy that goes along with the output):
  that share may fall by ``w`` of the best's. The best is the projection on the first principal axis, by theorem.
- *Steadiness* (change of the output, up to its sign, under sensor noise of -60 dB): ``sqrt(1 + w) - 1``, the amplitude
  which in phase with the output changes its energy by w. An output that depends on noise more than that is not
  determined by the scene.

The paper's own metrics are reported, but do not count. Its spectral match weighs a band without energy like any other:
on a shaker with 99.9 % of its energy on one axis, that axis alone scores 0.61, for the sensor noise of the two others.
Its temporal match rewards the sensor's own diagonal and changes with the mounting. Their means over random mountings do
not count either: a scene comes with the mounting it was recorded with, and an axis that carries everything *there* is
enough there. For a reducer whose output turns with the sensor the invariant counterparts are their own rotation means.

References
----------
.. [1] N. Landin et al., EuroHaptics 2010, section 3. doi:10.1007/978-3-642-14075-4_12
.. [2] J. C. Craig, "Difference threshold for intensity of tactile stimuli", Perception & Psychophysics 11, 1972.
   doi:10.3758/BF03210362
.. [3] G. A. Gescheider, S. J. Bolanowski, R. T. Verrillo, D. J. Arpajian, T. F. Ryan, "Vibrotactile intensity
   discrimination measured by three methods", JASA 87(1), 1990. doi:10.1121/1.399300
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.advise.draws import TURNS_ALONG

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from feel321.analysis.tradeoff.advise.measures import Cost, Measures
    from feel321.stimuli.recording import Recording

# How far from the best is still as good: every tolerance follows from one Weber fraction, 22 %.

WEBER_FRACTION = 0.22


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What follows from a Weber fraction of intensity.

    Parameters
    ----------
    weber : float
        Smallest relative change of a vibration's energy that counts as felt.

    Raises
    ------
    ValueError
        If it is not above 0 and below 1.

    Examples
    --------
    >>> round(Tolerance().level_db, 2), round(Tolerance().change, 3)
    (0.86, 0.105)
    """

    weber: float = WEBER_FRACTION

    def __post_init__(self) -> None:
        """Refuse what is no fraction."""
        if not 0 < self.weber < 1:
            raise ValueError(
                f"tolerance: got {self.weber:g}, allowed is above 0 and below 1; 0.22 is people's own"
            )

    @property
    def level_db(self) -> float:
        """Deviation of the felt level in dB."""
        return 10 * math.log10(1 + self.weber)

    @property
    def spectrum(self) -> float:
        """Difference of the spectral match (invariant form)."""
        return self.weber

    @property
    def time(self) -> float:
        """Relative loss of the motion's energy that goes along with the output: of the squared temporal match."""
        return self.weber

    @property
    def change(self) -> float:
        """Relative change of the output under sensor noise."""
        return math.sqrt(1 + self.weber) - 1


# A scene: a recording or a segment of one, and the context in which it is to be felt.

LATENCY_MS = 45.0
"""Shortest delay between sight and touch that people notice, by the paper: the budget where none is named."""

BLOCK_MS = 1000 * 64 / 48_000
"""Time that a block of 64 samples at 48 kHz takes to come together."""

DEVICE_MS = 5.0
"""Assumed delay of converters and drivers where nobody has measured it; a sound card may need ten times as much."""

ANY, RECORDED = "any", "recorded"
"""Mountings of the sensor that advice must hold for: all of them, or the one that was recorded."""

SHORTEST_S = 0.1
"""Shortest segment: two periods of the lowest frequency that the metrics compare."""

ALL_AXES = 3


@dataclass(frozen=True, slots=True)
class Context:
    """Where a reducer is to run.

    Parameters
    ----------
    online : bool
        Whether it runs while the vibration is being made.
    latency_ms : float, optional
        The longest delay online in ms; 45 ms if left out.
    axes : int
        Axes that the actuator can move, 1 to 3.
    tolerance : Tolerance
        What is as good as the best.
    mounting : {"any", "recorded"}
        Whether advice must hold however the sensor is mounted, or for the mounting that was recorded.
    block_ms, device_ms : float
        What a block of samples and the device take of the longest delay.

    Raises
    ------
    ValueError
        If there are other axes or mountings, or a budget that is no time, leaves none or belongs to no online context.

    Examples
    --------
    >>> Context(online=True).budget_ms
    45.0
    """

    online: bool = False
    latency_ms: float | None = None
    axes: int = 1
    tolerance: Tolerance = field(default_factory=Tolerance)
    mounting: str = ANY
    block_ms: float = BLOCK_MS
    device_ms: float = DEVICE_MS

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.mounting not in {ANY, RECORDED}:
            raise ValueError(f"mounting: got {self.mounting!r}, allowed is {ANY} or {RECORDED}")
        if self.axes not in range(1, ALL_AXES + 1):
            raise ValueError(
                f"axes: got {self.axes}, allowed is 1, 2 or 3: what the actuator can move"
            )
        times = {
            "latency-ms": self.latency_ms,
            "block-ms": self.block_ms,
            "device-ms": self.device_ms,
        }
        for name, value in times.items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name}: got {value:g}, allowed is a finite time of 0 ms or more")
        if self.latency_ms is not None and not self.online:
            raise ValueError(
                f"latency-ms: got {self.latency_ms:g} offline, where nobody waits; add --online"
            )
        if self.online and self.room_ms < 0:
            raise ValueError(
                f"latency-ms: got {self.budget_ms:g}, but block ({self.block_ms:.3g} ms) and device "
                f"({self.device_ms:.3g} ms) alone take {self.overhead_ms:.3g} ms; allow more, or lower --block-ms or "
                "--device-ms"
            )

    @property
    def overhead_ms(self) -> float:
        """What block and device take, in ms."""
        return self.block_ms + self.device_ms

    @property
    def room_ms(self) -> float:
        """What is left for the reducer, in ms; infinite offline."""
        return self.budget_ms - self.overhead_ms

    @property
    def budget_ms(self) -> float:
        """The longest delay in ms, of reducer, block and device together; infinite offline."""
        if not self.online:
            return float("inf")
        return LATENCY_MS if self.latency_ms is None else self.latency_ms


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording, or a segment of one."""

    recording: Recording
    source: str
    start_s: float
    stop_s: float
    is_segment: bool

    @property
    def name(self) -> str:
        """How to call it."""
        return (
            f"{self.source} {self.start_s:.2f}-{self.stop_s:.2f} s"
            if self.is_segment
            else self.source
        )


def check_segment(segment_s: float) -> float:
    """Refuse segments in which the lowest frequency has no room."""
    if not (isfinite(segment_s) and segment_s >= SHORTEST_S):
        raise ValueError(f"segment: got {segment_s:g} s, allowed is {SHORTEST_S} s or more")
    return segment_s


def split_recording(recording: Recording, segment_s: float | None = None) -> Iterator[Scene]:
    """Make one scene of a recording, or one of every segment.

    segment_s: what is left at the end is a segment of its own if it is at least half as long, and
    belongs to the one before it otherwise.
    """
    if segment_s is None:
        yield Scene(recording, recording.name, 0.0, recording.duration_s, is_segment=False)
        return
    length = round(check_segment(segment_s) * recording.rate_hz)
    pieces = max(1, int(recording.n_samples / length + 0.5))
    edges = [*(piece * length for piece in range(pieces)), recording.n_samples]
    for start, stop in pairwise(edges):
        part = replace(recording, acceleration=recording.acceleration[:, start:stop], sha256="")
        seconds = start / recording.rate_hz, stop / recording.rate_hz
        yield Scene(part, recording.name, *seconds, is_segment=pieces > 1)


# Is a reducer as good as the best? Shortfalls in units of the tolerance, one per criterion.

SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True)
class Shortfall:
    """How far a reducer stays behind the best one of each criterion; 1 is the tolerance, 0 the best itself."""

    level: float
    spectrum: float
    time: float
    change: float

    @property
    def worst(self) -> float:
        """The largest of them."""
        return max(self.level, self.spectrum, self.time, self.change)

    @property
    def criterion(self) -> str:
        """Where it is largest, the first among equals."""
        return max(
            (field.name for field in fields(self)), key=lambda name: float(getattr(self, name))
        )


@dataclass(frozen=True, slots=True)
class Rated:
    """What the ratings of a scene say of a reducer.

    Parameters
    ----------
    is_best : bool
        Whether it was rated highest.
    best : str
        Which was, on the scale and level where equivalence is shown least.
    p : float
        Of equivalence with that, two one-sided tests; NaN where there is no test, as for the best itself.
    simulated : bool
        Whether simulated participants are among those who said so.
    """

    is_best: bool
    best: str
    p: float
    simulated: bool = False

    @property
    def suffices(self) -> bool:
        """Whether it is the best, or shown to be equivalent to it."""
        return self.is_best or self.p < SIGNIFICANCE


@dataclass(frozen=True, slots=True)
class Verdict:
    """A reducer judged on a scene."""

    cost: Cost
    measures: Measures
    shortfall: Shortfall
    in_budget: bool
    rated: Rated | None = None
    needs_ratings: bool = False
    best_spectrum: float = 1.0
    best_time: float = 1.0
    suits: int = 1
    segments: int = 1

    @property
    def name(self) -> str:
        """The reducer."""
        return self.cost.name

    @property
    def fits(self) -> bool:
        """Whether it is within tolerance of the best on every criterion."""
        return self.shortfall.worst <= 1

    @property
    def is_sufficient(self) -> bool:
        """Whether it fits, and people agree if they were asked."""
        return self.fits and (self.rated.suffices if self.rated else not self.needs_ratings)

    @property
    def suits_partly(self) -> bool:
        """Whether it suffices in some segments and not in others, by no chance of the mounting."""
        return (
            0 < self.suits < self.segments
            and not self.fits
            and self.name.partition("@")[0] in TURNS_ALONG
        )

    @property
    def margin(self) -> float:
        """Share of the tolerance that is left."""
        return 1 - self.shortfall.worst


def compare(
    scores: NDArray[np.float64], gains_db: NDArray[np.float64], tolerance: Tolerance
) -> NDArray[np.float64]:
    """Compare every reducer with the best one of each criterion, draw by draw.

    scores: (n_reducers, n_draws, 4), level in dB, spectrum, time and change; gains_db: (n_reducers,
    1); returns (n_reducers, n_draws, 4), naN as before.
    """
    level_db, spectrum, time, change = np.moveaxis(scores, -1, 0)
    deviation = np.maximum(np.abs(level_db), gains_db - level_db)
    best_time = np.fmax.reduce(time, axis=0)
    shares = np.divide(
        time, best_time, out=np.where(np.isnan(time), np.nan, 1.0), where=best_time > 0
    )
    shortfalls = (
        (deviation - np.fmin.reduce(deviation, axis=0)) / tolerance.level_db,
        (np.fmax.reduce(spectrum, axis=0) - spectrum) / tolerance.spectrum,
        (1 - shares**2) / tolerance.time,
        (change - np.fmin.reduce(change, axis=0)) / tolerance.change,
    )
    return np.stack(shortfalls, axis=-1)
