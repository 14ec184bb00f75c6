"""Scenes of an advice, the tolerances, and the verdicts on each reducer: from the signals, and from ratings.

The model of ratings is the report's (`feel321.analysis.report.reducers`) as far as it goes for one recording: ratings
on reducer, with a spread between participants. The margin is the one that the study fixed beforehand. A reducer passes
if two one-sided tests show its equivalence with the best-rated one on every scale and level; "not significantly
different" passes nobody. Without a margin nothing can be shown, either way.

People notice a change of vibration intensity of about a fifth; below that, two vibrations are equally strong to them.
Published fractions lie between 0.4 and 2.3 dB. The 22 % are taken here as a share of *energy* (0.86 dB), the cautious
end of that range: "sufficient" is a claim that nothing is felt to be missing, and errors in several bands add up.
Energy is also what the metrics compare, so one number serves all of them:

- *Level* (felt level of the output against the recording's, in dB): ``10 log10(1 + w)``, weaker or stronger.
- *Spectrum* (`spectral_match_energy_weighted`, the share of energy common to both spectra, in bands as wide as people
  confuse frequencies): ``w``. A match that is lower by w means that a further share w of the energy is missing or
  misplaced.
- *Time* (`temporal_match_invariant`; its square is the share of the motion's energy that the output carries): that
  share may fall by ``w`` of the best's. The best is the projection on the first principal axis, by theorem.
- *Steadiness* (change of the output, up to its sign, under sensor noise of -60 dB): ``sqrt(1 + w) - 1``, the amplitude
  which in phase with the output changes its energy by w. An output that depends on noise more than that is not
  determined by the scene.
- *Envelope* (`modulation_distance`, the error of the depth of modulation from 2 to 50 Hz): ``sqrt(1 + w) - 1`` again,
  the depth which changes the energy at the crests of the envelope by w. A spectrum taken over the whole scene may be
  right while its energy is spread over time, before a tap too: nothing above sees that, as the motion that the output
  carries is summed over the scene.

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
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.contrasts.compare import equivalence
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.report.parts import split_parts
from feel321.analysis.tradeoff.advise.measures import TURNS_ALONG, Complexity, Scores
from feel321.analysis.tradeoff.results import as_table

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.table.items import Table
    from feel321.stimuli.recording import Recording


SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True)
class Rated:
    """What the ratings of a recording show about a reducer.

    best: the one rated highest, on the scale and level where equivalence with it is shown least; p: of that
    equivalence, by two one-sided tests, NaN where there is no test, as for the best itself; simulated: whether any of
    the ratings come from simulated participants.
    """

    is_best: bool
    best: str
    p: float
    simulated: bool = False

    @property
    def suffices(self) -> bool:
        """Whether it is the best, or shown to be equivalent to it."""
        return self.is_best or self.p < SIGNIFICANCE


def judge_ratings(
    table: Table | DataFrame, *, margin: float | None = None
) -> dict[str, dict[str, Rated]]:
    """Judge the reducers of every recording by its ratings: recording -> reducer -> what they show.

    margin: points that do not matter, fixed beforehand. Recordings of fewer than two rated reducers are left out; empty
    if there is no margin.
    """
    given = as_table(table)
    if margin is None:
        return {}
    if not (isfinite(margin) and margin > 0):
        raise ValueError(f"margin must be a number of points above 0, got {margin:g}")
    judged: dict[str, list[dict[str, Rated]]] = {}
    for part in split_parts(given):
        for name, rows in part.rows.groupby(part.rows["recording"].astype(str), sort=False):
            judged.setdefault(str(name), []).append(_judge(rows, margin=margin))
    found = {name: _join([each for each in parts if each]) for name, parts in judged.items()}
    return {name: ratings for name, ratings in found.items() if ratings}


def _judge(rows: DataFrame, *, margin: float) -> dict[str, Rated]:
    means = rows.groupby(rows["reducer"].astype(str))["rating"].mean()
    if len(means) < 2:  # noqa: PLR2004 - one reducer has no other to be compared with
        return {}
    best, simulated = str(means.idxmax()), bool(rows["simulated"].any())
    tested = _test(rows, best, margin=margin)
    return {
        str(name): Rated(name == best, best, tested.get(str(name), float("nan")), simulated)
        for name in means.index
    }


def _test(rows: DataFrame, best: str, *, margin: float) -> dict[str, float]:
    """Test the equivalence of every reducer with the best; where ratings leave no error to test with, of none."""
    by = ["participant", "reducer"]
    data = rows.astype({"reducer": str}).groupby(by, observed=True)["rating"].mean().reset_index()
    names = sorted(set(data["reducer"]))
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    data["which"] = data["reducer"].map(codes)
    try:
        fit = fit_mixed("rating ~ 0 + which + (1 | participant)", data)
        found = {
            name: contrast(fit, {f"which{codes[name]}": 1, f"which{codes[best]}": -1})
            for name in names
            if name != best
        }
    except ValueError:
        return {}
    return {
        name: equivalence(one.estimate, one.se, one.df, low=-margin, high=margin).p
        for name, one in found.items()
        if 0 < one.se < np.inf
    }


def _join(parts: list[dict[str, Rated]]) -> dict[str, Rated]:
    """Keep of each reducer the scale and level on which least is shown: it must pass on all of them."""

    def order(rated: Rated) -> float:
        return 0.0 if rated.is_best else np.inf if np.isnan(rated.p) else rated.p

    found = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        own = [part[name] for part in parts if name in part]
        found[name] = replace(max(own, key=order), is_best=all(rated.is_best for rated in own))
    return found


WEBER_FRACTION = 0.22

LATENCY_MS = 45.0
"""Shortest delay between sight and touch that people notice, by the paper: the budget where none is named."""

BLOCK_MS = 1000 * 64 / 48_000
"""Duration of a block of 64 samples at 48 kHz."""

DEVICE_MS = 5.0
"""Assumed delay of converters and drivers where nobody has measured it; a sound card may need ten times as much."""

ANY, RECORDED = "any", "recorded"
"""Mountings of the sensor that advice must hold for: all of them, or the one that was recorded."""

SHORTEST_S = 0.1
"""Shortest segment: two periods of the lowest frequency that the metrics compare."""

ALL_AXES = 3


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far from the best is still as good; all follows from one Weber fraction of intensity.

    weber: smallest relative change of a vibration's energy that counts as felt.
    """

    weber: float = WEBER_FRACTION

    def __post_init__(self) -> None:
        """Refuse a number that is not a fraction."""
        if not 0 < self.weber < 1:
            raise ValueError(
                f"weber must be above 0 and below 1, got {self.weber:g}; people's own is {WEBER_FRACTION}"
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
        """Relative loss of the share of the motion's energy that the output carries: of the squared temporal match."""
        return self.weber

    @property
    def change(self) -> float:
        """Relative change of the output under sensor noise."""
        return math.sqrt(1 + self.weber) - 1

    @property
    def envelope(self) -> float:
        """Difference of the depth of modulation of the envelope."""
        return math.sqrt(1 + self.weber) - 1


@dataclass(frozen=True, slots=True)
class Context:
    """Where a reducer is to run: online or not, longest delay in ms (45 if left out), axes of the actuator, mounting.

    block_ms, device_ms: the share of the longest delay that a block of samples and the device take.
    """

    online: bool = False
    latency_ms: float | None = None
    axes: int = 1
    tolerance: Tolerance = field(default_factory=Tolerance)
    mounting: str = ANY
    block_ms: float = BLOCK_MS
    device_ms: float = DEVICE_MS

    def __post_init__(self) -> None:
        """Refuse settings that contradict each other."""
        if self.mounting not in {ANY, RECORDED}:
            raise ValueError(f"mounting must be {ANY} or {RECORDED}, got {self.mounting!r}")
        if self.axes not in range(1, ALL_AXES + 1):
            raise ValueError(
                f"axes must be 1, 2 or 3, got {self.axes}: the number that the actuator can move"
            )
        times = {name: getattr(self, name) for name in ("latency_ms", "block_ms", "device_ms")}
        for name, value in times.items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be a finite time of 0 ms or more, got {value:g}")
        if self.latency_ms is not None and not self.online:
            raise ValueError(
                f"latency_ms must be left out offline, where nobody waits, got {self.latency_ms:g}; set online=True"
            )
        if self.online and self.room_ms < 0:
            raise ValueError(
                f"latency_ms must be at least {self.overhead_ms:.3g}, which block ({self.block_ms:.3g} ms) and device "
                f"({self.device_ms:.3g} ms) alone take, got {self.budget_ms:g}; allow more, or lower block or device"
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
            return inf
        return LATENCY_MS if self.latency_ms is None else self.latency_ms


@dataclass(frozen=True, slots=True)
class AdviceScene:
    """A recording, or a segment of one."""

    recording: Recording
    source: str
    start_s: float
    stop_s: float
    is_segment: bool

    @property
    def name(self) -> str:
        """The recording's name, and the times of a segment."""
        times = f" {self.start_s:.2f}-{self.stop_s:.2f} s" if self.is_segment else ""
        return f"{self.source}{times}"


def check_segment(segment_s: float) -> float:
    """Refuse segments that are too short for the lowest frequency."""
    if not (isfinite(segment_s) and segment_s >= SHORTEST_S):
        raise ValueError(f"segment_s must be {SHORTEST_S} s or more, got {segment_s:g}")
    return segment_s


def split_recording(recording: Recording, segment_s: float | None = None) -> Iterator[AdviceScene]:
    """Make one scene of a recording, or one of every segment.

    What is left at the end is a segment of its own if it is at least half as long, and belongs to the one before it
    otherwise.
    """
    if segment_s is None:
        yield AdviceScene(recording, recording.name, 0.0, recording.duration_s, is_segment=False)
        return
    length = round(check_segment(segment_s) * recording.rate_hz)
    pieces = max(1, int(recording.n_samples / length + 0.5))
    edges = [*(piece * length for piece in range(pieces)), recording.n_samples]
    for start, stop in pairwise(edges):
        part = replace(recording, acceleration=recording.acceleration[:, start:stop], sha256="")
        times = start / recording.rate_hz, stop / recording.rate_hz
        yield AdviceScene(part, recording.name, *times, is_segment=pieces > 1)


@dataclass(frozen=True, slots=True)
class Shortfall:
    """How far a reducer falls short of the best one of each criterion; 1 is the tolerance, 0 the best itself."""

    level: float
    spectrum: float
    time: float
    change: float
    envelope: float = 0.0

    @property
    def worst(self) -> float:
        """The largest of them."""
        return max(self.level, self.spectrum, self.time, self.change, self.envelope)

    @property
    def criterion(self) -> str:
        """Where it is largest, the first among equals."""
        values: dict[str, float] = asdict(self)
        return max(values, key=values.__getitem__)


@dataclass(frozen=True, slots=True)
class Verdict:
    """A reducer judged on a scene; suits: the number of segments in which it is within tolerance."""

    cost: Complexity
    measures: Scores
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
    def passes_ratings(self) -> bool:
        """Whether the ratings, if there are any, show it to feel like the best."""
        return self.rated.suffices if self.rated else not self.needs_ratings

    @property
    def is_sufficient(self) -> bool:
        """Whether it fits, and passes the ratings."""
        return self.fits and self.passes_ratings

    @property
    def suits_partly(self) -> bool:
        """Whether it suffices in some segments and not in others, by no chance of the mounting."""
        turns_along = self.name.partition("@")[0] in TURNS_ALONG
        return 0 < self.suits < self.segments and not self.fits and turns_along

    @property
    def margin(self) -> float:
        """Share of the tolerance that is left."""
        return 1 - self.shortfall.worst


def compare(
    scores: NDArray[np.float64], gains_db: NDArray[np.float64], tolerance: Tolerance
) -> NDArray[np.float64]:
    """Compare every reducer with the best one of each criterion, in units of the tolerance, mounting by mounting.

    scores: (n_reducers, n_mounted, 5), level in dB, spectrum, time, change and envelope, NaN where not tried; gains_db:
    (n_reducers, 1).
    """
    level_db, spectrum, time, change, envelope = np.moveaxis(scores, -1, 0)
    deviation = np.maximum(np.abs(level_db), gains_db - level_db)
    best_time = np.fmax.reduce(time, axis=0)
    nothing = np.where(np.isnan(time), np.nan, 1.0)
    shares = np.divide(time, best_time, out=nothing, where=best_time > 0)
    shortfalls = (
        (deviation - np.fmin.reduce(deviation, axis=0)) / tolerance.level_db,
        (np.fmax.reduce(spectrum, axis=0) - spectrum) / tolerance.spectrum,
        (1 - shares**2) / tolerance.time,
        (change - np.fmin.reduce(change, axis=0)) / tolerance.change,
        (envelope - np.fmin.reduce(envelope, axis=0)) / tolerance.envelope,
    )
    return np.stack(shortfalls, axis=-1)
