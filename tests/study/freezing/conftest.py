from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.session.engine import run_session
from feel321.study.session.plan import Stale, make_plan, open_session
from feel321.study.settings.read import make_design, make_identity, read_settings

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock


@pytest.fixture
def rate(scripted: type, now: Clock) -> Callable[..., None]:
    """Let a person, who is not simulated, rate all trials of a study."""

    def run(
        study: StudyFolder, participant: str = "p01", *, number: int = 1, clock: Clock = now
    ) -> None:
        settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
        design = make_design(settings, study.path)
        plan = make_plan(design, stimuli, participant, number=number, simulated=False)
        identity = make_identity(settings, study.path, {"simulated": False})
        folder = study.sessions / participant
        with open_session(folder, plan, identity=identity, now=clock, stale=Stale()) as (
            own,
            journal,
        ):
            run_session(own, scripted(), stimuli=stimuli, journal=journal)

    return run
