"""What the session engine costs per trial besides the disk: `make bench`.

20 simulated participants work through 500 trials each, one after the other, with every record synced to the disk.
The time inside `os.fsync` is taken off: it is the disk's. What is left, CPU time, is held against the promise.
"""

from __future__ import annotations

import os
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

from figures import Figure

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import read_scales
from feel321.protocols.trial import Flow
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.study.observer.model import ObserverModel
from feel321.study.observer.simulated import SimulatedObserver
from feel321.study.session.engine import run_session
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Stale, create_plan, make_plan

if TYPE_CHECKING:
    from collections.abc import Iterator

PARTICIPANTS, RECORDINGS, REPEATS = 20, 10, 2
LIMIT_MS = 1.0


class Stopwatch:
    """Counts the seconds that pass inside a call."""

    def __init__(self) -> None:
        self.total_s = 0.0
        self._fsync = os.fsync

    def fsync(self, descriptor: int) -> None:
        begun = time.process_time()
        self._fsync(descriptor)
        self.total_s += time.process_time() - begun


def make_stimuli() -> Iterator[Stimulus]:
    """Ten recordings of nine reducers and the original each: 100 stimuli without files."""
    zeros = dict.fromkeys(("peak", "rms_m_s2", "gain"), 1.0)
    for number in range(RECORDINGS):
        for place, reducer in enumerate(("original", *REDUCERS)):
            yield Stimulus(
                stimulus_id=f"r{number}-{reducer}",
                recording=f"r{number}",
                reducer=reducer,
                level="as_is",
                role="test" if place else "reference",
                file="",
                rate_hz=48000.0,
                n_samples=48000,
                duration_s=1.0,
                spectral_match=place / 10,
                temporal_match=1 - place / 10,
                clipped=0,
                sha256="",
                recording_sha256="",
                **zeros,
            )


def run_all(folder: Path) -> int:
    """Lead everybody through the session; the number of trials."""
    stimuli = StimulusSet(folder, tuple(make_stimuli()), "5" * 64)
    design = Design(321, "williams", REPEATS, (make_task("realism"),), {}, Flow())
    model = ObserverModel()
    scales, trials = read_scales(), 0
    for number in range(1, PARTICIPANTS + 1):
        plan = make_plan(design, stimuli, f"sim{number:03d}", number=number, simulated=True)
        options = {
            "identity": {"presenter": {"simulated": True}},
            "now": lambda: datetime.now(UTC),
            "stale": Stale(),
        }
        (folder / plan.participant).mkdir()
        create_plan(folder / plan.participant / "plan.json", plan)
        with open_session(folder / plan.participant, plan, **options) as (stored, journal):
            observer = SimulatedObserver(model, seed=1, number=number)
            trials += run_session(
                stored, observer, stimuli=stimuli, journal=journal, scales=scales
            ).done
    return trials


def measure() -> Iterator[Figure]:
    """Measure once."""
    disk = Stopwatch()
    with tempfile.TemporaryDirectory() as folder, patch.object(os, "fsync", disk.fsync):
        begun = time.process_time()
        trials = run_all(Path(folder))
        spent_s = time.process_time() - begun
    what = f"session engine, {PARTICIPANTS} x {trials // PARTICIPANTS} trials"
    own_ms = (spent_s - disk.total_s) / trials * 1000
    yield Figure(what, own_ms, "ms per trial besides the disk", LIMIT_MS, compared=False)
