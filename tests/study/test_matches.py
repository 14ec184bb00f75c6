"""Strength matched by participants: planted differences are found, and the second is felt at the level that was set."""

import csv
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from feel321.protocols.tasks import make_task
from feel321.protocols.threshold import ATTENUATION_DB, DB_PER_POINT, MOST_START_DB, MatchingBlock
from feel321.protocols.trial import MATCHING, Flow
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.check import build_study
from feel321.study.evidence.replay import audit_steps
from feel321.study.folder import StudyFolder, create_study
from feel321.study.observer import ObserverModel, Participant
from feel321.study.ratings import MATCHES_FILE, describe_matches
from feel321.study.session.engine import run_session
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Plan, Stale, create_plan, make_plan
from feel321.study.session.ports import Confirm, Feel, Move, Playback, Scaled
from feel321.study.simulate import simulate_study
from tests.study.conftest import audit_study, make_settings

LEVELS = 'levels = ["as_is", "equal_intensity"]\nanchors = false\n'
STUDY = make_settings(
    "bumps",
    "isotropic_rumble",
    duration_s=0.3,
    reducers=("sax321", "dft321", "mag321"),
    stimuli=LEVELS,
)
STUDY += "[observer]\nmatching_sd = 0.2\n[session.matching]\n"


@pytest.fixture(autouse=True, scope="module")
def unsynced() -> Iterator[None]:
    """Nothing here is about power cuts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


def simulate(folder: Path, level: str) -> StudyFolder:
    study = create_study(folder)
    study.settings.write_text(f'{STUDY}level = "{level}"\n', encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=4, seed=5, now=lambda: datetime.now(UTC))
    return study


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StudyFolder]:
    folder = tmp_path_factory.mktemp("matches")
    return {level: simulate(folder / level, level) for level in ("as_is", "equal_intensity")}


@pytest.mark.parametrize("level", ["as_is", "equal_intensity"])
def test_the_difference_in_sensation_level_is_found(
    studies: dict[str, StudyFolder], level: str
) -> None:
    """By the manifest: as-is stimuli are weaker by what they lost, equally intense ones by nothing."""
    study = studies[level]
    assert audit_study(study) == []
    levels = {
        row["stimulus_id"]: float(row["sensation_level_db"]) for row in read_rows(study.manifest)
    }
    reference = {
        row["recording"]: row["stimulus_id"]
        for row in read_rows(study.manifest)
        if (row["role"], row["level"]) == ("reference", level)
    }
    rows = read_rows(study.path / MATCHES_FILE)
    assert len(rows) == 4 * 2 * 4  # participants, recordings, three reducers and the original
    planted = np.array([
        levels[reference[row["recording"]]] - levels[row["stimulus_id"]] for row in rows
    ])
    found = np.array([float(row["offset_db"]) for row in rows])
    assert np.ptp(planted) > 3 if level == "as_is" else np.ptp(planted) < 0.1
    within = abs(planted) < ATTENUATION_DB - 2 * MOST_START_DB  # of the marker, wherever it began
    assert within.sum() >= 16
    np.testing.assert_allclose(found[within], planted[within], atol=5 * 0.2)
    assert abs(np.mean((found - planted)[within])) < 0.15


def test_silence_is_never_strong_enough() -> None:
    mind = Participant(ObserverModel(matching_sd=0.0), seed=1, number=1)
    for second_db, points in ((20.0, 50.0), (23.0, 30.0), (math.nan, 100.0)):
        levels_db = {"first": 20.0, "second": second_db}
        assert mind._match(levels_db, np.random.default_rng(1)) == points


def test_averages_are_those_of_students_t() -> None:
    rng = np.random.default_rng(3)
    drawn = rng.normal(1.0, 2.0, (6, 3))
    rows = [
        {"reducer": "dft321", "participant": f"p{person}", "offset_db": float(value)}
        for person, own in enumerate(drawn)
        for value in own
    ]
    (note,) = describe_matches(rows)
    wanted = ttest_1samp(drawn.mean(axis=1), 0.0).confidence_interval(0.95)
    assert "by 6 participants:" in note
    assert f" dft321 {drawn.mean():+.1f} dB ({wanted.low:+.1f} to {wanted.high:+.1f}). " in note
    assert describe_matches([]) == []
    (note,) = describe_matches(rows[:3])
    assert "1 participant:" in note
    assert "(" not in note.partition(") ")[2]


# The engine, with one who moves the marker.

DESIGN = Design(
    7, "williams", 1, (make_task("realism"),), {}, Flow(rest_s=0.0), matching=MatchingBlock("as_is")
)


@dataclass
class Mover:
    """Moves the marker to some places, once without feeling what that does, and confirms."""

    played: list[tuple[str, Any]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    time_s: float = 0.0

    def show_page(self, page: Any, place: Any) -> Confirm:  # noqa: ARG002 - the port's form
        return Confirm(self._pass(), {}, page.least_s)

    def show_trial(self, trial: Any, scale: Any, place: Any) -> None:  # noqa: ARG002 - the port's form
        plain = Confirm(0.0, {trial.judged[0]: 80.0}, 1.5)
        moves = [Move(0.0, "second", 20.0), Feel(0.0), Move(0.0, "second", 80.0), plain, Feel(0.0)]
        self._acts = iter([*(moves if trial.phase == MATCHING else []), plain])

    def play(self, part: Any, stimulus: Any, *, gap_s: float) -> Playback:  # noqa: ARG002 - the port's form
        self.played.append((part.name, stimulus))
        return Playback(self._pass(), self.time_s)

    def wait(self) -> Any:
        return replace(next(self._acts), time_s=self._pass())

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        self.refused.append(f"{reason} {' '.join(parts)}")

    def _pass(self) -> float:
        self.time_s += 1.0
        return self.time_s


def lead(folder: Path, stimuli: StimulusSet, now: Any) -> tuple[Mover, Plan, list[Any]]:
    plan = make_plan(DESIGN, stimuli, "p01", number=1, simulated=True)
    mover = Mover()
    (folder / "p01").mkdir()
    create_plan(folder / "p01" / "plan.json", plan)
    with open_session(folder / "p01", plan, identity={}, now=now, stale=Stale()) as (
        stored,
        journal,
    ):
        run_session(stored, mover, stimuli=stimuli, journal=journal)
        return mover, stored, list(journal.records)


def test_the_second_is_felt_at_the_level_of_the_marker(
    tmp_path: Path, stimuli: StimulusSet, now: Any
) -> None:
    mover, plan, records = lead(tmp_path, stimuli, now)
    trials = [trial for trial in plan.trials if trial.phase == MATCHING]
    assert len(trials) == 10  # two recordings of four reducers and the original each
    scaled = [(name, one) for name, one in mover.played if isinstance(one, Scaled)]
    assert len(scaled) == 6 * len(trials)
    assert {one.gain_db for name, one in scaled if name == "first"} == {-ATTENUATION_DB}
    gains = [one.gain_db + ATTENUATION_DB for name, one in scaled if name == "second"]
    starts = np.array(gains[::3])
    np.testing.assert_allclose(gains[1::3], starts - 30 * DB_PER_POINT)
    np.testing.assert_allclose(gains[2::3], starts + 30 * DB_PER_POINT)
    assert len(set(starts)) > 5
    assert abs(starts).max() <= MOST_START_DB
    # However far the marker goes, nothing is stronger than in the study.
    assert MOST_START_DB + 50 * DB_PER_POINT - ATTENUATION_DB <= 0
    # What was set and not felt is no answer.
    assert mover.refused == ["not_felt second"] * len(trials)
    assert list(audit_steps(records, plan)) == []


def test_audit_finds_an_answer_that_was_not_felt(
    tmp_path: Path, stimuli: StimulusSet, now: Any
) -> None:
    _, plan, records = lead(tmp_path, stimuli, now)
    number = next(trial.number for trial in plan.trials if trial.phase == MATCHING)
    felt = [n for n, r in enumerate(records) if r.event == "played" and r.data["trial"] == number]
    (found,) = audit_steps([r for n, r in enumerate(records) if n != felt[-1]], plan)
    assert "holds 'rated' where part 'second' is due" in found
