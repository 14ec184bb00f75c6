"""One trial: what is felt, what is refused and why, what makes an attempt a bad one."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feel321.protocols.tasks import make_task
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.session.plan import Design, Plan, make_plan
from feel321.study.session.ports import Abort, Confirm, Feel, Move, Pause, Playback
from tests.study.conftest import list_events

Present = Callable[..., list[Any]]

DONE = Confirm(0.0, {"test": 50.0}, 1.5)
WHOLE, CUT = Playback(1.0, 1.0), Playback(1.0, 1.0, completed=False)
DRY = Playback(1.0, 1.0, underruns=1)
LEFT = Abort(1.5, "Esc twice")


@pytest.fixture
def plan_task(design: Design, stimuli: StimulusSet) -> Callable[..., Plan]:
    """The plan of a session with one task, such as `similarity-strict`; nothing for that of the usual two."""

    def make(name: str, **options: Any) -> Plan:
        name, _, timing = name.partition("-")
        task = make_task(name, **options, **({"timing": timing} if timing else {}))
        return make_plan(replace(design, tasks=(task,)), stimuli, "p01", number=1, simulated=True)

    return make


TRIALS: tuple[tuple[str, list[Any], list[Playback], str, list[str]], ...] = (
    ("realism", [Feel(0.0), Feel(0.0, "test"), DONE], [],
     "shown played replayed played replayed played rated", []),
    ("realism", [Feel(0.0, "b"), DONE], [], "shown played refused rated", ["unknown_part b"]),
    ("similarity-strict", [Feel(0.0), DONE], [], "shown played played refused rated", ["no_replay"]),
    # An answer counts only once everything was felt to its end, which it then stays.
    ("realism", [DONE, Feel(0.0), DONE], [CUT], "shown played refused played rated", ["not_felt test"]),
    ("realism", [Feel(0.0), DONE], [WHOLE, CUT], "shown played replayed played rated", []),
    # What is felt once and cut short is tried again; what comes after it is not even begun.
    ("similarity-strict", [], [CUT], "shown played spoiled shown played played rated", []),
    ("realism", [Move(0.0, "test", 12.5), Move(0.0, "test", 50.0), DONE], [],
     "shown played moved moved rated", []),
    *(("realism", [move, DONE], [], "shown played refused rated", [f"unknown_part {move.part}"])
      for move in (Move(0.0, "x", 50.0), Move(0.0, "test", 1e9), Move(0.0, "test", float("nan")))),
    *(("realism", [Confirm(0.0, values, 1.0), DONE], [], "shown played refused rated", ["not_answered test"])
      for values in ({}, {"test": None}, {"test": 101.0}, {"test": -1}, {"test": "50"}, {"other": 50.0},
                     {"test": float("nan")})),
    ("abx", [Confirm(0.0, {"x": 50.0}, 1.0), Confirm(0.0, {"x": "b"}, 1.0)], [],
     "shown played played played refused rated", ["not_answered x"]),
    # After a pause, also one while something plays, the trial begins anew.
    ("realism", [], [replace(CUT, act=Pause(1.5))], "shown played paused continued shown played rated", []),
)  # fmt: skip
"""Task, what is done in the first trial, how it is played: the events of that trial, and what is refused."""


@pytest.mark.parametrize(("task", "acts", "playbacks", "events", "refused"), TRIALS)
def test_what_is_done_in_a_trial_and_what_is_refused_there(
    present: Present,
    scripted: type,
    plan_task: Callable[..., Plan],
    task: str,
    acts: list[Any],
    playbacks: list[Playback],
    events: str,
    refused: list[str],
) -> None:
    script = {(1, 1): list(acts)} if acts else {}
    presenter = scripted(acts=script, playbacks={(1, 1): list(playbacks)})
    records = present(presenter, plan=plan_task(task))
    assert [r.event for r in records if r.data.get("trial") == 1] == events.split()
    said = [line for line in presenter.log if line.startswith("refuse")]
    assert said == [f"refuse {why}" for why in refused]
    assert records[-1].event == "finished"


def test_on_a_page_of_sliders_everything_is_felt_and_moved(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    plan = plan_task("mushra")
    parts = [part.name for part in plan.trials[0].parts]
    half: dict[str, float | str] = dict.fromkeys(parts[1:3], 10.0)
    whole: dict[str, float | str] = {name: 10.0 * place for place, name in enumerate(parts[1:])}
    felt = [Feel(0.0, name) for name in parts[:0:-1]]
    answer, half_answer = Confirm(0.0, whole, 9.0), Confirm(0.0, half, 9.0)
    presenter = scripted(
        acts={(1, 1): [*felt, answer, Feel(0.0, "reference"), half_answer, answer]}
    )
    records = present(presenter, plan=plan)
    assert "refuse not_felt reference" in presenter.log
    assert f"refuse not_answered {' '.join(parts[3:])}" in presenter.log
    # To feel something for the first time is no replay.
    assert list_events(records, "replayed") == []
    assert list_events(records, "rated")[0]["values"] == whole


@pytest.mark.parametrize(
    ("playbacks", "response_time_s", "flags", "rejected"),
    [
        ([WHOLE], 1.5, [], False),
        ([DRY], 1.5, ["underrun"], True),
        ([replace(WHOLE, clipped=3)], 1.5, ["clipped"], False),
        ([replace(DRY, clipped=3)], 1.5, ["underrun", "clipped"], True),
        ([WHOLE], 0.19, ["too_fast"], True),
        ([WHOLE], 0.2, [], False),
        # To feel it again and cut it short does not hide what was wrong with what was felt.
        ([DRY, CUT], 1.5, ["underrun"], True),
    ],
)
def test_what_went_wrong_is_flagged_and_tried_again_by_the_rules(
    present: Present,
    scripted: type,
    plan: Plan,
    playbacks: list[Playback],
    response_time_s: float,
    flags: list[str],
    rejected: bool,
) -> None:
    again = [Feel(0.0)] * (len(playbacks) - 1)
    acts = [*again, replace(DONE, response_time_s=response_time_s)]

    def rate(plan: Plan) -> list[Any]:
        presenter = scripted(acts={(1, 1): list(acts)}, playbacks={(1, 1): list(playbacks)})
        rated = list_events(present(presenter, plan=plan), "rated")
        return [r for r in rated if r["trial"] == 1]

    rated = rate(plan)
    assert (rated[0]["flags"], rated[0]["rejected"]) == (flags, rejected)
    assert len(rated) == 1 + rejected
    assert not rated[-1]["rejected"]
    lenient = replace(plan, participant="p02", flow=replace(plan.flow, reject=()))
    assert [(r["flags"], r["rejected"]) for r in rate(lenient)] == [(flags, False)]


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("realism", {"acts": {(1, 1): [LEFT]}}),
        ("realism", {"acts": {(1, 1): [Move(0.0, "test", 3.0), LEFT]}}),
        ("similarity-strict", {"playbacks": {(1, 1): [replace(CUT, act=LEFT)]}}),
        ("similarity-replay", {"playbacks": {(1, 1): [replace(CUT, act=LEFT)]}}),
        ("realism", {"acts": {(1, 1): [Pause(0.0)]}, "pages": {"pause": [Pause(0.0), LEFT]}}),
    ],
)
def test_who_leaves_within_a_trial_meets_it_again_and_no_attempt_is_used_up(
    present: Present,
    scripted: type,
    plan_task: Callable[..., Plan],
    task: str,
    options: dict[str, Any],
) -> None:
    plan = plan_task(task)
    records = present(scripted(**options), plan=plan)
    assert (records[-1].event, records[-1].data["reason"]) == ("aborted", "Esc twice")
    again = scripted()
    records = present(again, plan=plan)
    assert again.log[:2] == ["page ready 0/10", f"show 1.1 {plan.tasks[0].protocol}"]
    assert sum(r["trial"] == 1 for r in list_events(records, "rated")) == 1
    assert list_events(records, "spoiled") == []


def test_numbers_of_devices_and_screens_are_taken_as_what_they_are(
    present: Present, scripted: type
) -> None:
    odd = Playback(
        np.float32(1.0),
        float("nan"),
        underruns=np.int64(0),
        clipped=np.int64(2),
        measured={"onset_s": np.float32(0.5), "delay_s": float("nan"), "level_db": -float("inf")},
    )
    answer = Confirm(0.0, {"test": np.float32(12.5)}, 1.5)
    records = present(scripted(playbacks={(1, 1): [odd]}, acts={(1, 1): [answer]}))
    assert list_events(records, "played")[0] == {
        "trial": 1,
        "attempt": 1,
        "part": "test",
        "requested_s": 1.0,
        "onset_s": None,
        "underruns": 0,
        "clipped": 2,
        "completed": True,
        "error": "",
        "measured": {"onset_s": 0.5},
    }
    assert list_events(records, "rated")[0]["values"] == {"test": 12.5}


def test_a_rest_stands_as_long_as_it_must(present: Present, scripted: type) -> None:
    presenter = scripted(pages={"rest": [Confirm(1.0, {}, 59.9), Confirm(2.0, {}, 60.0)]})
    records = present(presenter)
    assert "refuse too_early" in presenter.log
    (rest,) = (page for page in list_events(records, "page") if page["key"] == "rest")
    assert rest == {"key": "rest", "time_s": 2.0, "stood_s": 60.0}


def test_the_real_surface_is_stroked_and_not_played(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    presenter = scripted()
    records = present(presenter, plan=plan_task("realism", surface=True))
    first = [r.event for r in records if r.data.get("trial") == 1]
    assert first == ["shown", "prompted", "played", "rated"]
    assert presenter.log[5] in {"prompt surface bumps", "prompt surface taps"}
