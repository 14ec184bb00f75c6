"""A study that ends in an export: real people with something to hide, one who withdrew, and a program."""

from collections.abc import Callable
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.check import build_study
from feel321.study.export import export_bids
from feel321.study.folder import StudyFolder, create_study
from feel321.study.session.events import NoteTaken
from feel321.study.session.journal import require_journal
from feel321.study.session.ports import Confirm
from feel321.study.sessions import lead_session, open_room, plan_sessions
from feel321.study.settings.read import read_settings
from feel321.study.simulate import simulate_study
from feel321.study.withdrawal import withdraw_participant
from tests.study.conftest import ASK_AGE

STUDY = f"""
[study]
name = "Taps"
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.2
[[recordings]]
scene = "hard_taps"
duration_s = 0.2
[stimuli]
reducers = ["sax321", "mag321", "dft321"]
below_threshold = "accept"
[between]
glove = ["none", "thin"]
[session.rehearsal]
training = 0
practice = 0
{ASK_AGE}[[session.questions]]
name = "tired"
kind = "likert"
question = "How tired is your hand?"
options = ["not at all", "", "very tired"]
when = "after"
[[session.questions]]
name = "remarks"
kind = "text"
question = "What else?"
when = "after"
[analysis]
draws = 100
[publication]
title = "Taps on a stylus"
description = "Ratings of vibrations."
released = "2026-11-23"
licence = "CC-BY-4.0"
institution = "Example University"
department = "Psychology"
address = "1 Example Street"
ethics = ["Board 2026-17"]
funding = ["none"]
acknowledgements = "Cite the paper."
keywords = ["haptics"]
doi = "10.5281/zenodo.123456"
[[publication.authors]]
given = "Ada"
family = "Example"
orcid = "0000-0002-1825-0097"
affiliation = "Example University"
"""

PLANTED = {
    "code": "zorro7", "other code": "quux9", "answer": "Xylophonist", "note": "Klabautermann", "device": "Hifiberry9",
    "host": "labpc-3-4711", "withdrawn": "wicked5", "day": "2026-01-01", "year": "T12:", "person": "Ms Grabowski",
}  # fmt: skip
"""What must not be in an export, each in a place of its own."""

Present = type[Any]


def begin(path: Path) -> StudyFolder:
    """Make and build the study, with the name of a machine in the rig."""
    study = create_study(path)
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    return study


def make_presenter(scripted: Present, place: int) -> Any:
    """Make somebody who answers questions and moves the slider differently from the others."""
    typed = Confirm(0.0, {"remarks": PLANTED["answer"]}, 2.0)

    class Somebody(scripted):  # type: ignore[misc]  # a fixture gives it
        def show_trial(self, trial: Any, scale: Any, where: Any) -> None:
            super().show_trial(trial, scale, where)
            points = 20.0 + 7.3 * place + (17 * trial.number) % 53 / 3
            values = dict.fromkeys(trial.judged, points)
            self._waiting = [*self._waiting[:-1], Confirm(0.0, values, 1.5)]

    return Somebody(pages={"question.remarks": [typed]})


def hold_sessions(study: StudyFolder, names: list[str], scripted: Present, now: Any) -> None:
    """Hold sessions of real people, on a rig and at a station whose names tell something."""
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    room = open_room(study, settings, stimuli, now=now)
    identity = {
        "presenter": {"simulated": False, "rig": {"device": {"name": PLANTED["device"]}}},
        "calibration": {
            "id": f"20260101T120000Z-{PLANTED['host']}",
            "sha256": "5",
            "method": "manual",
        },
        "experimenter": PLANTED["person"],
    }
    for place, plan in enumerate(plan_sessions(room, names, simulated=False)):
        own = make_presenter(scripted, place)
        lead_session(
            room, plan, identity=identity, make_presenter=lambda *_, own=own: nullcontext(own)
        )
        journal = require_journal(study.sessions / plan.participant / "session-01.jsonl", now=now)
        journal.write(NoteTaken(PLANTED["note"]))


def start_clock() -> Callable[[], datetime]:
    ticks = count()
    return lambda: datetime(2026, 1, 1, 12, tzinfo=UTC) + timedelta(seconds=next(ticks))


@pytest.fixture(scope="session")
def studied(tmp_path_factory: pytest.TempPathFactory, scripted: Present) -> StudyFolder:
    """Two real people, one who withdrew, one program."""
    study, now = begin(tmp_path_factory.mktemp("studied") / "study"), start_clock()
    names = [PLANTED[one] for one in ("code", "other code", "withdrawn")]
    hold_sessions(study, names, scripted, now)
    withdraw_participant(study, PLANTED["withdrawn"], now=now)
    simulate_study(study, participants=1, seed=1, now=now)
    return study


@pytest.fixture(scope="session")
def export(studied: StudyFolder, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Export the study into a new folder."""

    def run(**choices: bool) -> Path:
        folder = tmp_path_factory.mktemp("export") / "dataset"
        export_bids(studied, folder, **choices)
        return folder

    return run


@pytest.fixture(scope="session")
def dataset(export: Callable[..., Path]) -> Path:
    """The study as it is exported without options."""
    return export()
