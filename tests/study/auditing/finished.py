"""Two finished studies to be falsified: simulated participants with all that a study can have, and one run on a rig."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.actuator.certificate import make_manual, write_certificate
from feel321.study.actuator.rig import read_rig
from feel321.study.analyze import analyze_study
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder, create_study
from feel321.study.participants.roster import write_roster
from feel321.study.ratings import write_ratings
from feel321.study.run import run_participant
from feel321.study.sessions import read_room
from feel321.study.simulate import simulate_study
from tests.study.conftest import SMALLEST_STUDY, make_settings

SETTINGS = """
[study]
name = "finished"
seed = 321
[session.threshold]
frequencies_hz = [160.0]
trials = 10
practice = 0
[[session.questions]]
name = "age"
kind = "number"
question = "How old are you?"
low = 5
high = 120
personal = true
[analysis]
draws = 100
[metrics.strict]
use = "methods/strict.py:strict"
"""
SETTINGS += make_settings(
    "bumps",
    duration_s=0.3,
    reducers=("sax321", "mag321", "dft321"),
    session='repeats = 2\nlanguage = "texts.toml"\n',
)

RULE = '''"""A metric of the lab's own."""


def strict(acceleration, reduced, rate_hz):
    """Measure nothing."""
    return 0.5
'''

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
full_scale_m_s2 = 500.0
"""


def now() -> datetime:
    return datetime.now(UTC)


def make_simulated(path: Path) -> StudyFolder:
    """Three simulated participants with thresholds, questions, own texts and a rule; analysed."""
    study = create_study(path)
    study.settings.write_text(SETTINGS, encoding="utf-8")
    (path / "texts.toml").write_text('# Ours.\nlanguage = "en"\n', encoding="utf-8")
    (path / "methods").mkdir(exist_ok=True)
    (path / "methods" / "strict.py").write_text(RULE, encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=3, seed=None, now=now)
    analyze_study(study)
    return study


def make_real(path: Path, scripted: Any) -> StudyFolder:
    """One participant on a simulated rig with sensor and certificate; scripted: who sits there."""
    study = create_study(path)
    study.settings.write_text(SMALLEST_STUDY, encoding="utf-8")
    study.rig.write_text(RIG, encoding="utf-8")
    build_study(study)
    rig = read_rig(study.rig)
    made = make_manual(rig, {"coil": 500.0}, directions={}, made=now(), rate_hz=48000.0)
    write_certificate(made, study.path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DISPLAY", ":99")
        patch.setattr("feel321.study.run.find_spec", lambda _: "there")
        patch.setattr("feel321.study.run.open_lab", _seat(scripted))
        run_participant(read_room(study, now=now), "p01")
    write_ratings(study, read_stimuli(study.stimuli))
    write_roster(study)
    return study


def _seat(scripted: Any) -> Any:
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

    return open_presenter
