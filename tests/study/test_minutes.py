"""How long sessions take: against the clocks of simulated ones, and at a pace that was planted."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.check import build_study, check_study
from feel321.study.folder import StudyFolder, create_study
from feel321.study.minutes import (
    SIMULATED,
    Pace,
    find_durations,
    find_left,
    measure_length,
    observe_pace,
)
from feel321.study.session.journal import utc_now
from feel321.study.session.plan import Plan, read_dossier
from feel321.study.simulate import simulate_study
from feel321.study.status import read_status

TOLERANCE, TOGETHER = 0.1, 0.05
"""Share by which sessions of simulated participants may differ, one and all together: they draw their response times
(of 16, all without a second round of training were within 4 %, with it within 10 %, and their mean within 1 %)."""

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.4
[[recordings]]
scene = "hard_taps"
duration_s = 0.2
[stimuli]
reducers = ["sax321", "mag321", "dft321"]
[session]
protocols = ["similarity", "mushra", "abx"]
repeats = 4
[session.breaks]
every_trials = 7
every_min = 2
break_s = 20
"""
RIG = """
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 50.0
duration_s = 30.0
[keys]
experimenter = "f10"
"""
DURATIONS = {"bumps": 0.25, "taps": 0.25}


def test_sessions_take_as_long_as_was_foreseen(tmp_path: Path) -> None:
    """Also what is left of one that is broken off."""
    folder = create_study(tmp_path / "study")
    folder.settings.write_text(STUDY, encoding="utf-8")
    foreseen = check_study(folder).figures["session"]
    build_study(folder)
    simulate_study(folder, participants=3, seed=1, now=utc_now)
    durations = find_durations(read_stimuli(folder.stimuli))
    ratios = []
    for participant in folder.participants:
        dossier = read_dossier(participant)
        took_s, plan = dossier.records.find_elapsed(), dossier.plan
        own = measure_length([plan], durations, SIMULATED)
        assert own.low_min * 60 == pytest.approx(took_s, rel=TOLERANCE)
        ratios.append(own.low_min * 60 / took_s)
        half = dossier.records[: len(dossier.records) // 2]
        left = find_left(plan, type(dossier.records)(half), durations=durations, pace=SIMULATED)
        gone_s = max(record.data.get("time_s", 0.0) for record in half)
        assert max(left.values()) == pytest.approx(took_s - gone_s, abs=TOLERANCE * took_s)
    assert sum(ratios) / len(ratios) == pytest.approx(1, abs=TOGETHER)
    # Nobody has read a page so far; people will.
    whole = read_status(folder).length
    assert whole is not None
    assert own.low_min < whole.low_min == pytest.approx(foreseen["low_min"], rel=0.01)
    assert (whole.trials, whole.participants) == (foreseen["trials"], 0)


def test_the_pace_of_real_people_is_learnt_from_their_journals(
    present: Callable[..., Any], scripted: type, plan: Plan, tmp_path: Path
) -> None:
    """One second per vibration, page and answer, and 100 ms are due before each vibration."""
    plan = replace(plan, simulated=False, flow=replace(plan.flow, gap_s=0.1, rest_s=1.0))
    present(scripted(), plan=plan)
    dossier = read_dossier(tmp_path / "sessions" / "p01")
    pace = observe_pace([dossier], DURATIONS)
    assert pace.answer_s == pytest.approx({"realism": 2 - 0.35, "similarity": 3 - 0.7})
    assert (pace.page_s, pace.participants) == (0.0, 1)  # the script says how long pages stood
    with_pages = replace(pace, page_s=1.0)
    length = measure_length([plan], DURATIONS, with_pages)
    # The rest is one page whose shortest time counts too.
    assert length.low_min * 60 == pytest.approx(dossier.records.find_elapsed() + 1.0)
    # Somebody who has come no further than practice says nothing.
    rehearsing = replace(plan, trials=tuple(replace(one, phase="practice") for one in plan.trials))
    assert observe_pace([replace(dossier, plan=rehearsing)], DURATIONS) == Pace()
    simulated = replace(dossier, plan=replace(plan, simulated=True))
    assert observe_pace([simulated], DURATIONS) == Pace()


def test_minutes_are_left_to_those_who_go_on(
    present: Callable[..., Any], scripted: type, tmp_path: Path, smallest: StudyFolder
) -> None:
    with suppress(KeyboardInterrupt):
        present(scripted(stop_after=5))
    (entry,) = read_status(StudyFolder(tmp_path)).participants
    assert entry.left_min is None  # there is no stimulus set
    status = read_status(replace(smallest, path=smallest.path))
    assert (status.participants, status.length) == ((), None)
