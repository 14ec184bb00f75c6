"""Thresholds of simulated observers, recovered through real sessions of the engine: `make bench`.

100 observers, each with a threshold and lapses of their own, answer whole threshold blocks by journal, agenda and
engine. Their 95 % intervals should hold 95 of 100 planted thresholds: fewer than 89 come about one time in a hundred.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from figures import Figure

from feel321.protocols.tasks import make_task
from feel321.protocols.threshold import PROCEDURES, USUAL, ThresholdBlock
from feel321.protocols.trial import Flow
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.study.observer.model import ObserverModel
from feel321.study.observer.simulated import SimulatedObserver
from feel321.study.session.engine import run_session
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Stale, create_plan, make_plan
from feel321.study.thresholds import is_usable, read_thresholds

if TYPE_CHECKING:
    from collections.abc import Iterator

OBSERVERS = 100
LEAST_COVERAGE = 0.89
FREQUENCIES_HZ = (40.0, 250.0)


@dataclass(frozen=True)
class Recovery:
    """Planted and estimated thresholds of some observers at all frequencies, in dB; with intervals."""

    planted: np.ndarray
    found: np.ndarray
    low: np.ndarray
    high: np.ndarray
    usable: np.ndarray

    @property
    def coverage(self) -> float:
        """Share of the planted thresholds that lie in their intervals."""
        return float(np.mean((self.low <= self.planted) & (self.planted <= self.high)))

    @property
    def off(self) -> np.ndarray:
        """Errors of the estimates, without those that there are none of."""
        off = self.found - self.planted
        return off[~np.isnan(off)]

    def describe(self) -> str:
        """Write one line of figures."""
        return (
            f"coverage {100 * self.coverage:.0f} %, bias {self.off.mean():+.2f} dB, SD {self.off.std():.2f} dB, "
            f"interval {np.median(self.high - self.low):.1f} dB wide (median), {100 * self.usable.mean():.0f} % usable"
        )


def make_stimulus() -> Stimulus:
    """Make the one stimulus that a study must have, without a file."""
    ones = dict.fromkeys(("peak", "rms_m_s2", "gain", "spectral_match", "temporal_match"), 1.0)
    place = {"file": "", "rate_hz": 48000.0, "n_samples": 48000, "duration_s": 1.0, "clipped": 0}
    names = dict.fromkeys(("sha256", "recording_sha256"), "")
    return Stimulus("r-dft321", "r", "dft321", "as_is", "test", **place, **ones, **names)


def recover(
    folder: Path, procedure: str, *, observers: int, trials: int, lapse_rate: float = 0.04
) -> Recovery:
    """Lead observers through their sessions, and read what their journals give."""
    stimuli = StimulusSet(folder, (make_stimulus(),), "5" * 64)
    block = ThresholdBlock(procedure, FREQUENCIES_HZ, replace(USUAL, trials=trials), practice=1)
    flow = Flow(min_response_s=0.0)
    design = Design(321, "williams", 1, (make_task("realism"),), {}, flow, block)
    model = ObserverModel(lapse_rate=lapse_rate)
    rows = []
    for number in range(1, observers + 1):
        plan = make_plan(design, stimuli, f"sim{number:03d}", number=number, simulated=True)
        observer = SimulatedObserver(model, seed=14, number=number)
        options = {"identity": {}, "now": lambda: datetime.now(UTC), "stale": Stale()}
        (folder / plan.participant).mkdir()
        create_plan(folder / plan.participant / "plan.json", plan)
        with open_session(folder / plan.participant, plan, **options) as (stored, journal):
            run_session(stored, observer, stimuli=stimuli, journal=journal)
            thresholds = read_thresholds(stored, journal.records)
        rows += [
            (
                observer.find_threshold(frequency),
                one.threshold_db,
                one.threshold_low_db,
                one.threshold_high_db,
                is_usable(one),
            )
            for frequency, one in thresholds.items()
        ]
    return Recovery(*np.array(rows).T)


def measure() -> Iterator[Figure]:
    """Share of the planted thresholds that lie in their intervals, by procedure and number of trials."""
    for procedure in PROCEDURES:
        for trials in (40, USUAL.trials):
            with tempfile.TemporaryDirectory() as folder:
                found = recover(Path(folder), procedure, observers=OBSERVERS, trials=trials)
            what = f"{procedure}, {trials} trials"
            print(f"     {what}, {OBSERVERS} observers: {found.describe()}")
            unit = "of thresholds in their intervals"
            yield Figure(what, found.coverage, unit, LEAST_COVERAGE, at_least=True, compared=False)
