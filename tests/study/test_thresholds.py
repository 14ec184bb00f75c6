"""What becomes of thresholds: planted ones recovered, tables, warnings, and sensation levels of one's own."""

import csv
import os
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.threshold import (
    PROCEDURES,
    USUAL,
    Procedure,
    ThresholdBlock,
    estimate_threshold,
)
from feel321.protocols.trial import Flow
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, read_stimuli
from feel321.stimuli.thresholds import acceleration_threshold, sensation_level_db
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder, create_study
from feel321.study.observer import ObserverModel, SimulatedObserver
from feel321.study.participants.roster import ROSTER_FILE
from feel321.study.ratings import write_ratings
from feel321.study.session.engine import run_session
from feel321.study.session.journal import read_journal
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Stale, create_plan, make_plan, require_plan
from feel321.study.simulate import simulate_study
from feel321.study.status import read_status
from feel321.study.thresholds import (
    LOW_RATE_HZ,
    find_shift,
    find_warnings,
    is_usable,
    read_thresholds,
)
from tests.study.conftest import audit_study

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.3
[stimuli]
reducers = ["sax321", "dft321"]
reference = "none"
anchors = false
[session]
protocols = ["realism"]
[session.rehearsal]
training = 0
practice = 0
[session.threshold]
frequencies_hz = {frequencies}
trials = 40
"""

FEW = {40.0: 3.0, 250.0: -5.0}
"""Frequency -> how far a made-up participant's threshold lies above the curve, in dB."""


def make_study(folder: Path, frequencies: str = "[40.0, 250.0]") -> StudyFolder:
    study = create_study(folder)
    study.settings.write_text(STUDY.format(frequencies=frequencies), encoding="utf-8")
    build_study(study)
    return study


@pytest.fixture(autouse=True, scope="module")
def unsynced() -> Iterator[None]:
    """Nothing here is about power cuts, and thousands of records would wait for the disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study of three participants with thresholds; not to be changed."""
    study = make_study(tmp_path_factory.mktemp("thresholds") / "study")
    simulate_study(study, participants=3, seed=5, now=lambda: datetime.now(UTC))
    return study


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def recover(folder: Path, procedure: str, *, observers: int, trials: int) -> np.ndarray:
    """Lead observers through whole threshold blocks, and read what their journals give.

    Returns planted and estimated thresholds and the ends of their intervals, in dB: (4, observers x frequencies).
    """
    ones = dict.fromkeys(("peak", "rms_m_s2", "gain", "spectral_match", "temporal_match"), 1.0)
    place = {"file": "", "rate_hz": 48000.0, "n_samples": 48000, "duration_s": 1.0, "clipped": 0}
    digests = dict.fromkeys(("sha256", "recording_sha256"), "")
    stimulus = Stimulus("r-dft321", "r", "dft321", "as_is", "test", **place, **ones, **digests)
    stimuli = StimulusSet(folder, (stimulus,), "5" * 64)
    block = ThresholdBlock(procedure, (40.0, 250.0), replace(USUAL, trials=trials), practice=1)
    flow = Flow(min_response_s=0.0)
    design = Design(321, "williams", 1, (make_task("realism"),), {}, flow, block)
    rows = []
    for number in range(1, observers + 1):
        plan = make_plan(design, stimuli, f"sim{number:03d}", number=number, simulated=True)
        observer = SimulatedObserver(ObserverModel(lapse_rate=0.04), seed=14, number=number)
        options = {"identity": {}, "now": lambda: datetime.now(UTC), "stale": Stale()}
        (folder / plan.participant).mkdir()
        create_plan(folder / plan.participant / "plan.json", plan)
        with open_session(folder / plan.participant, plan, **options) as (stored, journal):
            run_session(stored, observer, stimuli=stimuli, journal=journal)
            thresholds = read_thresholds(stored, journal.records)
        rows += [
            (
                observer.find_threshold(at),
                one.threshold_db,
                one.threshold_low_db,
                one.threshold_high_db,
            )
            for at, one in thresholds.items()
        ]
    return np.array(rows).T


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_planted_thresholds_lie_in_their_intervals(tmp_path: Path, procedure: str) -> None:
    """Through the engine; 8 of 12 or fewer come about twice in a thousand."""
    planted, found, low, high = recover(tmp_path, procedure, observers=6, trials=40)
    assert np.sum((low <= planted) & (planted <= high)) >= 9
    assert abs(np.nanmean(found - planted)) < 2
    assert np.ptp(planted) > 5  # they do differ
    assert np.median(high - low) < 12


def test_thresholds_stand_in_the_roster_as_in_the_journal(simulated: StudyFolder) -> None:
    assert audit_study(simulated) == []
    rows = read_rows(simulated.path / ROSTER_FILE)
    assert len(rows) == 3
    for row in rows:
        folder = simulated.sessions / row["participant"]
        plan = require_plan(folder / "plan.json")
        records = read_journal(folder / "session-01.jsonl").records
        thresholds = read_thresholds(plan, records)
        assert list(thresholds) == [40.0, 250.0]
        for frequency, found in thresholds.items():
            at = f"{frequency:g}hz"
            assert float(row[f"threshold_db_{at}"]) == pytest.approx(found.threshold_db, abs=1e-3)
            assert float(row[f"threshold_low_db_{at}"]) <= float(row[f"threshold_high_db_{at}"])
            assert float(row[f"threshold_slope_{at}"]) == pytest.approx(found.slope, abs=1e-3)
            # Counted by hand from the journal.
            answers = [
                (tone.data["interval"], after.data["values"]["test"])
                for tone, after in _pair_up(records, frequency)
                if tone.data["level_db"] is None
            ]
            right = sum(("first", "second")[n - 1] == answer for n, answer in answers)
            assert row[f"threshold_catch_trials_{at}"] == str(len(answers)) == "4"
            assert row[f"threshold_catch_correct_{at}"] == str(right)


def _pair_up(records: list[Any], frequency_hz: float) -> list[tuple[Any, Any]]:
    practice = 3
    tones = [record for record in records if record.event == "tone"][practice:]
    rated = {r.data["trial"]: r for r in records if r.event == "rated"}
    return [
        (tone, rated[tone.data["trial"]])
        for tone in tones
        if tone.data["frequency_hz"] == frequency_hz
    ]


def test_one_frequency_shifts_the_level_of_every_stimulus_alike(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", "[160.0]")
    simulate_study(study, participants=1, seed=5, now=lambda: datetime.now(UTC))
    (row,) = read_rows(study.path / ROSTER_FILE)
    curve_db = 20 * np.log10(float(acceleration_threshold(160.0)) / np.sqrt(2))
    above_db = float(row["threshold_db_160hz"]) - curve_db
    general = {r["stimulus_id"]: float(r["sensation_level_db"]) for r in read_rows(study.manifest)}
    ratings = read_rows(study.ratings)
    assert ratings
    for rating in ratings:
        own = float(rating["sensation_level_db"])
        assert own == pytest.approx(general[rating["stimulus_id"]] - above_db, abs=0.02)
    before = study.ratings.read_bytes()
    write_ratings(study, read_stimuli(study.stimuli))
    assert study.ratings.read_bytes() == before


def make_estimate(threshold_db: float, **changes: Any) -> Any:
    """An estimate, narrow, of a participant who guessed in half of the catch trials."""
    plain = estimate_threshold(Procedure("bayesian", USUAL))
    usual = {
        "threshold_db": threshold_db,
        "threshold_low_db": threshold_db - 3,
        "threshold_high_db": threshold_db + 3,
        "catch_trials": 4,
        "catch_correct": 2,
        "is_beyond": False,
        "notes": (),
    }
    return replace(plain, **{**usual, **changes})


def make_estimates(**changes: Any) -> dict[float, Any]:
    rms_db = {f: 20 * np.log10(float(acceleration_threshold(f)) / np.sqrt(2)) for f in FEW}
    return {f: make_estimate(rms_db[f] + above, **changes) for f, above in FEW.items()}


def test_between_frequencies_the_shift_is_a_line_over_their_logarithm() -> None:
    shift = find_shift(make_estimates(), curve="contactor")
    assert shift is not None
    hz = np.array([20.0, 40.0, 100.0, 250.0, 900.0])
    wanted = [3.0, 3.0, -1.0, -5.0, -5.0]  # 100 Hz is half way from 40 to 250 Hz
    np.testing.assert_allclose(shift(hz), wanted, atol=1e-6)


@pytest.mark.parametrize("frequency_hz", [40.0, 100.0, 250.0])
def test_a_tone_at_the_own_threshold_has_level_zero(frequency_hz: float) -> None:
    """By the definition of the sensation level, through the code that computes it for stimuli."""
    from feel321.stimuli.thresholds import loudest_levels, to_db

    shift = find_shift(make_estimates(), curve="contactor")
    assert shift is not None
    time_s = np.arange(8000) / LOW_RATE_HZ
    own = float(acceleration_threshold(frequency_hz)) * 10 ** (
        float(shift(np.array(frequency_hz))) / 20
    )
    tone = own * np.sin(2 * np.pi * frequency_hz * time_s)
    level = to_db(loudest_levels(tone, LOW_RATE_HZ, shift_db=shift)["contactor"])
    assert level == pytest.approx(0, abs=0.15)
    assert sensation_level_db(tone, LOW_RATE_HZ) == pytest.approx(
        float(shift(np.array(frequency_hz))), abs=0.15
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"threshold_low_db": -99.0}, "too wide to be used"),
        ({"threshold_db": np.nan}, "too wide to be used"),
        ({"is_beyond": True, "notes": ("the interval reaches beyond",)}, "reaches beyond"),
    ],
)
def test_what_is_not_usable_is_reported_and_used_for_nothing(
    changes: dict[str, Any], words: str
) -> None:
    good = make_estimates()
    assert list(find_warnings(good)) == []
    bad = {40.0: replace(good[40.0], **changes), 250.0: good[250.0]}
    assert [is_usable(one) for one in bad.values()] == [False, True]
    (warning,) = find_warnings(bad)
    assert "40 Hz" in warning
    assert words in warning
    shift = find_shift(bad, curve="contactor")
    assert shift is not None
    np.testing.assert_allclose(shift(np.array([40.0, 250.0])), [-5.0, -5.0], atol=1e-6)
    assert find_shift({40.0: bad[40.0]}, curve="contactor") is None


def test_a_participant_who_guesses_has_no_sensation_levels(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study")
    with study.settings.open("a", encoding="utf-8") as file:
        file.write("[observer]\nrandom_clickers = 1.0\n")
    simulate_study(study, participants=1, seed=5, now=lambda: datetime.now(UTC))
    (entry,) = read_status(study).participants
    assert {w.partition(":")[0] for w in entry.warnings} >= {
        "threshold at 40 Hz",
        "threshold at 250 Hz",
    }
    assert {row["sensation_level_db"] for row in read_rows(study.ratings)} == {""}
