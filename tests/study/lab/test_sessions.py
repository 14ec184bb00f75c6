"""Whole sessions in a real window, answered by real keys; no faults."""

import json
import shutil
import signal
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from feel321.stimuli.wav import read_wav
from feel321.study.analyze import analyze_study
from feel321.study.folder import StudyFolder
from feel321.study.participants.answers import write_answers
from feel321.study.session.journal import read_journal
from feel321.study.simulate import simulate_study
from feel321.study.status import read_status
from tests.study.conftest import audit_study

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


THRESHOLD = """
[session.threshold]
frequencies_hz = [160.0]
trials = 5
catch_every = 3
practice = 1
duration_s = 0.1
gap_s = 0.02
"""


def list_tones(study: StudyFolder) -> list[dict[str, Any]]:
    records = read_journal(study.journals[0]).records
    return [record.data for record in records if record.event == "tone"]


def check_files(study: StudyFolder) -> None:
    """The interval that vibrates does so at its level, the other one not at all."""
    for record in read_journal(study.journals[0]).records:
        if record.event == "tone":
            shown = record.data
        if record.event == "played" and record.data["part"] in {"first", "second"}:
            number = round(record.data["measured"]["file_number"])
            samples, _ = read_wav(study.sessions / "sim001" / "delivered" / f"{number:04}.wav")
            is_on = ("first", "second")[shown["interval"] - 1] == record.data["part"]
            level_db = shown["level_db"] if is_on else None
            # Coils without a direction play at weight 1, of 100 m/s² full scale.
            asked = 0.0 if level_db is None else 2**0.5 * 10 ** (level_db / 20) / 100
            assert abs(samples).max() == pytest.approx(asked, rel=1e-3)


@pytest.mark.parametrize(
    ("protocols", "options"),
    [
        (["realism"], {"training": 2, "threshold": THRESHOLD}),
        (["similarity", "dissimilarity", "mushra", "abx"], {}),
    ],
    ids=["a threshold, then realism", "every other protocol"],
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
    assert out == f"sim001: 0 of {total} answered so far\nsim001: {total} of {total} answered\n"
    assert audit_study(study) == []
    assert not study.ratings.exists()
    alone = ask_minds_alone(study, tmp_path / "alone")
    assert list_answers(study) == list_answers(alone)
    assert list_tones(study) == list_tones(alone)
    assert len(list_tones(study)) == (1 + 5 + 1 if "threshold" in options else 0)
    if "threshold" in options:
        check_files(study)


ASKING = """
[tasks.realism]
scales = ["realism", "roughness", "hardness"]
answer_timeout_s = 600.0
[scales.roughness]
question = "How rough did it feel?"
low = "Smooth"
high = "Rough"
[scales.hardness]
question = "How hard did it feel?"
low = "Soft"
high = "Hard"
[[session.questions]]
name = "age"
kind = "number"
question = "How old are you?"
low = -5
high = 99
personal = true
[[session.questions]]
name = "hand"
kind = "choice"
question = "Which hand?"
options = ["right", "left", "either"]
[[session.questions]]
name = "tired"
kind = "likert"
question = "How tired is your hand?"
options = ["not at all", "", "", "", "", "", "very tired"]
when = "between"
[[session.questions]]
name = "words"
kind = "text"
question = "What did you feel?"
when = "after"
"""


def test_scales_questions_and_choices_are_killed_resumed_and_analysed(
    lab: Any, make_study: Callable[..., StudyFolder], tmp_path: Path
) -> None:
    study = make_study("realism", "triplet", "preference", reducers=("sax321", "mag321"))
    with study.settings.open("a", encoding="utf-8") as file:
        file.write(ASKING)
    session = lab.start(study, "sim001", *HAND)
    session.wait_for("rated", 9)
    session.send(signal.SIGKILL)
    session.finish()
    before = session.count_done()
    code, out, err = lab.run(study, "sim001", *HAND)
    assert (code, err) == (0, "")
    # Of each of two recordings three stimuli on scales, three pairs of them, and the pair of reducers beside the first.
    assert out == f"sim001: {before} of 14 answered so far\nsim001: 14 of 14 answered\n"
    assert audit_study(study) == []
    alone = ask_minds_alone(study, tmp_path / "alone")
    answers = list_answers(study)
    assert answers == list_answers(alone)
    scales = {("test", "test:roughness", "test:hardness"), ("a",)}
    assert {tuple(values) for _, values in answers} == scales
    names = ("question", "occasion", "answer", "personal")
    own, others = (
        [[row[name] for name in names] for row in write_answers(one)] for one in (study, alone)
    )
    assert own == others
    assert [row[0] for row in own] == ["age", "hand", "tired", "tired", "words"]
    analyze_study(study)
    rows = pd.read_csv(study.ratings, keep_default_na=False)
    per_scale = {"preference": 6, "triplet": 2, "realism": 6, "roughness": 6, "hardness": 6}
    assert rows["scale"].value_counts().to_dict() == per_scale
    chosen = rows[rows["scale"].isin(["preference", "triplet"])]
    assert set(chosen["rating"]) <= {0.0, 100.0}
    assert (chosen["other_id"] != chosen["stimulus_id"]).all()
    assert (chosen["reference_id"] != "").tolist() == (chosen["scale"] == "triplet").tolist()
    told = json.loads((study.report / "results.json").read_text(encoding="utf-8"))["answers"]
    assert told["choices"][0].startswith("Whether a metric predicts which of two stimuli ")


def test_a_reference_of_three_axes_is_felt_through_the_sound_server(
    rig: Any, make_study: Callable[..., StudyFolder]
) -> None:
    study = make_study("similarity", device="stylus", reference="original")
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
    assert "stylus" in str(device)
