"""A session on the simulated device, without a screen: from stimuli sent to what ratings.csv says of their delivery."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from time import perf_counter, sleep
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.folder import StudyFolder
from feel321.study.ratings import write_ratings
from feel321.study.run import run_participant
from feel321.study.sessions import read_room
from tests.study.conftest import audit_study

RIG = """
[device]
name = "simulated"
[[actuators]]
name = "coil"
channel = 1
full_scale_m_s2 = 500.0
direction = [0, 0, 1]
[limits]
peak_m_s2 = 500.0
rms_m_s2 = 200.0
duration_s = 30.0
[sensor]
channels = [1, 2, 3]
full_scale_m_s2 = 1000.0
[simulation]
speed = 20.0
[[simulation.coils]]
name = "coil"
resonance_hz = 0.5
q = 0.7
full_scale_m_s2 = {full_scale}
"""


@pytest.fixture
def ready(smallest: StudyFolder, scripted: Any, monkeypatch: pytest.MonkeyPatch) -> StudyFolder:
    """A study that is built, and somebody in the place of the screen who feels what the rig plays."""
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("feel321.study.run.find_spec", lambda _: "there")

    @contextmanager
    def open_presenter(plan: Any, *_: object, room: Any) -> Iterator[Any]:
        from feel321.study.run import _open_output

        with _open_output(plan, room=room, clock=perf_counter) as output:
            presenter = scripted()

            def play(_part: Any, stimulus: Any, *, gap_s: float) -> Any:  # noqa: ARG001 - no time for gaps
                output.start(stimulus, gap_s=0.01)
                while output.is_playing:
                    sleep(0.001)
                return output.collect()

            presenter.play = play
            yield presenter

    monkeypatch.setattr("feel321.study.run.open_lab", open_presenter)
    return smallest


def run(study: StudyFolder, participant: str, *, full_scale: float) -> list[dict[str, str]]:
    study.rig.write_text(RIG.format(full_scale=full_scale), encoding="utf-8")
    run_participant(read_room(study, now=lambda: datetime.now(UTC)), participant)
    write_ratings(study, read_stimuli(study.stimuli))
    with study.ratings.open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if row["participant"] == participant]


def test_ratings_say_what_was_delivered_and_files_are_kept_by_their_digests(
    ready: StudyFolder,
) -> None:
    stimuli = read_stimuli(ready.stimuli)
    rows = run(ready, "p01", full_scale=500.0)
    assert len(rows) == len(stimuli)
    for row in rows:
        one = stimuli[row["stimulus_id"]]
        assert row["delivered_by"] == "sensor"
        assert float(row["level_error_db"]) == pytest.approx(0, abs=0.3)
        assert float(row["spectral_match_delivered"]) == pytest.approx(one.spectral_match, abs=0.1)
        bounded = float(row["spectral_match_bounded_delivered"])
        assert bounded == pytest.approx(one.spectral_match_bounded, abs=0.05)
    assert audit_study(ready) == []
    file = ready.sessions / "p01" / "delivered" / "0001.wav"
    file.write_bytes(file.read_bytes()[:-4] + bytes(4))
    (finding,) = audit_study(ready)
    assert finding.endswith(
        "delivered/0001.wav was changed since it was written; restore it from a copy"
    )


def test_a_weaker_rig_is_as_weak_in_ratings(ready: StudyFolder) -> None:
    rows = run(ready, "p01", full_scale=250.0)  # not calibrated: nothing was promised
    assert [float(row["level_error_db"]) for row in rows] == pytest.approx([-6.02] * 2, abs=0.3)
