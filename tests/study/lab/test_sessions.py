"""Whole sessions in a real window, answered by real keys; no faults."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.audit import audit_study
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal
from feel321.study.simulation import simulate_study
from feel321.study.status import read_status

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HAND = ("--simulate-participant",)


def list_answers(study: StudyFolder) -> list[tuple[int, dict[str, Any]]]:
    """List the answers of the first participant, points rounded as a hand sets them."""
    records = read_journal(study.journals[0]).records
    return [
        (
            record.data["trial"],
            {
                part: value if isinstance(value, str) else round(value)
                for part, value in record.data["values"].items()
            },
        )
        for record in records
        if record.event == "rated"
    ]


def ask_minds_alone(study: StudyFolder, folder: Path) -> StudyFolder:
    """The same participant of the same study without a hand."""
    alone = StudyFolder(folder)
    shutil.copytree(study.path, folder, ignore=shutil.ignore_patterns("sessions"))
    simulate_study(alone, participants=1, seed=None, now=lambda: datetime.now(UTC))
    return alone


@pytest.mark.parametrize(
    ("protocols", "options"),
    [(["realism"], {"training": 2}), (["similarity", "dissimilarity", "mushra", "abx"], {})],
    ids=["realism", "every other protocol"],
)
def test_a_simulated_participant_finishes_by_keys_alone(
    lab: Any,
    make_study: Callable[..., StudyFolder],
    tmp_path: Path,
    protocols: list[str],
    options: dict[str, Any],
) -> None:
    study = make_study(*protocols, **options)
    code, out, err = lab.run(study, "sim001", *HAND)
    assert (code, err) == (0, "")
    total = read_status(study).participants[0].done
    assert out == f"sim001: 0 of {total} done so far\nsim001: all {total} done\n"
    assert audit_study(study) == []
    assert not study.ratings.exists()
    assert list_answers(study) == list_answers(ask_minds_alone(study, tmp_path / "alone"))


def test_a_reference_of_three_axes_is_felt_through_the_sound_server(
    rig: Any, make_study: Callable[..., StudyFolder]
) -> None:
    study = make_study("similarity", device="pulse", reference="original")
    session = rig.start(study, "sim001", *HAND)
    code, _, err = session.finish()
    assert (code, err) == (0, "")
    assert audit_study(study) == []
    played = [record.data for record in session.records if record.event == "played"]
    assert {entry["part"] for entry in played} == {"reference", "test"}
    assert not any(entry["clipped"] for entry in played)
    # A server that stood still is told, and asked again.
    whole = [entry for entry in played if not entry["error"]]
    assert len(whole) >= 2 * read_status(study).participants[0].done
    assert all(entry["completed"] and entry["measured"]["n_samples"] == 7200 for entry in whole)
    device = next(record.data for record in session.records if record.event == "device")
    assert "pulse" in str(device)
