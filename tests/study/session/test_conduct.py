"""One trial: what is felt, what is refused and why, what makes an attempt a bad one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.protocols.tasks import make_task
from feel321.study.session.plan import Design, Plan, make_plan
from feel321.study.session.ports import Abort, Confirm, Feel, Move, Pause, Playback

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.stimuli.sets.manifest import StimulusSet

    Present = Callable[..., list[Any]]

DONE = Confirm(0.0, {"test": 50.0}, 1.5)


@pytest.fixture
def plan_task(design: Design, stimuli: StimulusSet) -> Callable[..., Plan]:
    """The plan of a session with one task."""

    def make(name: str, **options: Any) -> Plan:
        task = make_task(name, **options)
        return make_plan(replace(design, tasks=(task,)), stimuli, "p01", number=1, simulated=True)

    return make


def tell_first(records: list[Any]) -> list[tuple[str, Any]]:
    """What the journal holds on the first trial, from when it was shown until it was shown again or answered."""
    first = [(r.event, r.data) for r in records if r.data.get("trial") == 1]
    return [
        (event, {k: v for k, v in data.items() if k not in {"trial", "attempt"}})
        for event, data in first
    ]


def list_events(records: list[Any], event: str) -> list[Any]:
    return [record.data for record in records if record.event == event]


def test_a_replay_plays_the_trial_again_and_is_recorded(present: Present, scripted: type) -> None:
    records = present(scripted(acts={(1, 1): [Feel(0.0), Feel(0.0, "test"), DONE]}))
    assert [event for event, _ in tell_first(records)] == [
        "shown",
        "played",
        "replayed",
        "played",
        "replayed",
        "played",
        "rated",
    ]
    assert [data["part"] for data in list_events(records, "replayed")] == ["", "test"]


def test_what_does_not_exist_cannot_be_felt(present: Present, scripted: type) -> None:
    presenter = scripted(acts={(1, 1): [Feel(0.0, "b"), DONE]})
    records = present(presenter)
    assert "refuse unknown_part b" in presenter.log
    assert [(r["reason"], r["parts"]) for r in list_events(records, "refused")] == [
        ("unknown_part", ["b"])
    ]


def test_what_is_strictly_timed_is_felt_once(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    presenter = scripted(acts={(1, 1): [Feel(0.0), DONE]})
    records = present(presenter, plan=plan_task("similarity", timing="strict"))
    assert [event for event, _ in tell_first(records)] == [
        "shown",
        "played",
        "played",
        "refused",
        "rated",
    ]
    assert "refuse no_replay" in presenter.log


def test_an_answer_counts_only_after_everything_was_felt_to_its_end(
    present: Present, scripted: type
) -> None:
    stopped = Playback(1.0, 1.0, completed=False)
    presenter = scripted(acts={(1, 1): [DONE, Feel(0.0), DONE]}, playbacks={(1, 1): [stopped]})
    records = present(presenter)
    assert "refuse not_felt test" in presenter.log
    assert [event for event, _ in tell_first(records)] == [
        "shown",
        "played",
        "refused",
        "played",
        "rated",
    ]
    assert not list_events(records, "rated")[0]["rejected"]


@pytest.mark.parametrize(("underruns", "rejected"), [(0, False), (1, True)])
def test_what_was_felt_to_its_end_stays_felt_though_cut_short_when_felt_again(
    present: Present, scripted: type, underruns: int, rejected: bool
) -> None:
    whole, stopped = Playback(1.0, 1.0, underruns=underruns), Playback(2.0, 2.0, completed=False)
    records = present(
        scripted(acts={(1, 1): [Feel(0.0), DONE]}, playbacks={(1, 1): [whole, stopped]})
    )
    assert [event for event, _ in tell_first(records)][:5] == [
        "shown",
        "played",
        "replayed",
        "played",
        "rated",
    ]
    # Nor does it hide what was wrong with what was felt.
    assert list_events(records, "rated")[0]["rejected"] == rejected


def test_what_is_felt_once_and_cut_short_is_tried_again_later(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    stopped = Playback(1.0, 1.0, completed=False)
    presenter = scripted(playbacks={(1, 1): [stopped]})
    records = present(presenter, plan=plan_task("similarity", timing="strict"))
    # The test was not even begun, for nobody could have judged it.
    events = [event for event, _ in tell_first(records)]
    assert events == ["shown", "played", "spoiled", "shown", "played", "played", "rated"]
    assert list_events(records, "spoiled")[0]["flags"] == ["not_felt"]
    shown = [line.split()[1] for line in presenter.log if line.startswith("show")]
    assert shown[:6] == ["1.1", "2.1", "3.1", "4.1", "5.1", "1.2"]


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"test": None},
        {"test": 101.0},
        {"test": -1},
        {"test": "50"},
        {"other": 50.0},
        {"test": float("nan")},
    ],
)
def test_an_answer_that_is_none_is_refused(
    present: Present, scripted: type, values: dict[str, Any]
) -> None:
    presenter = scripted(acts={(1, 1): [Confirm(0.0, values, 1.0), DONE]})
    records = present(presenter)
    assert "refuse not_answered test" in presenter.log
    assert list_events(records, "rated")[0]["values"] == {"test": 50.0}


def test_a_choice_is_one_of_the_choices(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    presenter = scripted(
        acts={(1, 1): [Confirm(0.0, {"x": 50.0}, 1.0), Confirm(0.0, {"x": "b"}, 1.0)]}
    )
    records = present(presenter, plan=plan_task("abx"))
    assert "refuse not_answered x" in presenter.log
    assert list_events(records, "rated")[0]["values"] == {"x": "b"}


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


def test_every_move_is_recorded(present: Present, scripted: type) -> None:
    records = present(
        scripted(acts={(1, 1): [Move(0.0, "test", 12.5), Move(0.0, "test", 50.0), DONE]})
    )
    assert [(r["part"], r["value"]) for r in list_events(records, "moved")] == [
        ("test", 12.5),
        ("test", 50.0),
    ]


@pytest.mark.parametrize(
    ("playback", "flags", "rejected"),
    [
        (Playback(1.0, 1.0), [], False),
        (Playback(1.0, 1.0, underruns=1), ["underrun"], True),
        (Playback(1.0, 1.0, clipped=3), ["clipped"], False),
        (Playback(1.0, 1.0, underruns=1, clipped=3), ["underrun", "clipped"], True),
    ],
)
def test_what_went_wrong_is_flagged_and_tried_again_by_rule(
    present: Present, scripted: type, playback: Playback, flags: list[str], rejected: bool
) -> None:
    records = present(scripted(playbacks={(1, 1): [playback]}))
    rated = [r for r in list_events(records, "rated") if r["trial"] == 1]
    assert (rated[0]["flags"], rated[0]["rejected"]) == (flags, rejected)
    assert len(rated) == 1 + rejected
    assert not rated[-1]["rejected"]


@pytest.mark.parametrize(("response_time_s", "flags"), [(0.19, ["too_fast"]), (0.2, [])])
def test_who_cannot_have_judged_yet_is_too_fast(
    present: Present, scripted: type, response_time_s: float, flags: list[str]
) -> None:
    records = present(scripted(acts={(1, 1): [replace(DONE, response_time_s=response_time_s)]}))
    assert list_events(records, "rated")[0]["flags"] == flags


def test_the_rule_decides_what_is_tried_again(present: Present, scripted: type, plan: Plan) -> None:
    lenient = replace(plan, flow=replace(plan.flow, reject=()))
    records = present(scripted(playbacks={(1, 1): [Playback(1.0, 1.0, underruns=1)]}), plan=lenient)
    assert list_events(records, "rated")[0]["flags"] == ["underrun"]
    assert not any(r["rejected"] for r in list_events(records, "rated"))


def test_a_trial_that_stays_bad_is_given_up_and_everything_of_it_is_kept(
    present: Present, scripted: type
) -> None:
    dry = [Playback(1.0, 1.0, underruns=1)]
    records = present(scripted(playbacks={(1, attempt): list(dry) for attempt in (1, 2, 3)}))
    assert [r["attempt"] for r in list_events(records, "rated") if r["trial"] == 1] == [1, 2, 3]
    assert records[-1].event == "finished"


def test_after_a_pause_the_trial_begins_anew(present: Present, scripted: type) -> None:
    presenter = scripted(acts={(1, 1): [Pause(0.0)]})
    presenter.acts[1, 1] = [Pause(0.0), DONE]
    records = present(presenter)
    assert [event for event, _ in tell_first(records)] == [
        "shown",
        "played",
        "paused",
        "continued",
        "shown",
        "played",
        "rated",
    ]
    assert "page pause 0/20" in presenter.log


@pytest.mark.parametrize(
    "acts", [[Abort(0.0, "window closed")], [Move(0.0, "test", 3.0), Abort(0.0, "window closed")]]
)
def test_who_leaves_within_a_trial_meets_it_again(
    present: Present, scripted: type, acts: list[Any]
) -> None:
    records = present(scripted(acts={(1, 1): acts}))
    assert records[-1].data["reason"] == "window closed"
    again = scripted()
    records = present(again)
    assert again.log[:2] == ["page ready 0/20", "show 1.1 realism"]
    assert sum(r["trial"] == 1 for r in list_events(records, "rated")) == 1


@pytest.mark.parametrize("timing", ["strict", "replay"])
def test_who_wants_out_while_something_plays_meets_nothing_more(
    present: Present, scripted: type, plan_task: Callable[..., Plan], timing: str
) -> None:
    plan = plan_task("similarity", timing=timing)
    stopped = Playback(1.0, 1.0, completed=False, act=Abort(1.5, "Esc twice"))
    presenter = scripted(playbacks={(1, 1): [stopped]})
    records = present(presenter, plan=plan)
    assert [r.event for r in records[-2:]] == ["played", "aborted"]
    assert records[-1].data == {"reason": "Esc twice", "time_s": 1.5}
    again = scripted()
    records = present(again, plan=plan)
    # No attempt was used up: the same trial comes again, as the first attempt.
    assert again.log[:2] == ["page ready 0/10", "show 1.1 similarity"]
    assert list_events(records, "spoiled") == []


def test_a_pause_while_something_plays_is_a_pause(present: Present, scripted: type) -> None:
    paused = Playback(1.0, 1.0, completed=False, act=Pause(1.5))
    records = present(scripted(playbacks={(1, 1): [paused]}))
    events = [event for event, _ in tell_first(records)]
    assert events == ["shown", "played", "paused", "continued", "shown", "played", "rated"]


def test_a_clean_replay_makes_up_for_an_underrun(
    present: Present, scripted: type, plan_task: Callable[..., Plan]
) -> None:
    plan = plan_task("mushra")
    parts = [part.name for part in plan.trials[0].parts]
    answer = Confirm(0.0, dict.fromkeys(parts[1:], 50.0), 9.0)
    dry = [Playback(1.0, 1.0, underruns=1)] + [Playback(2.0, 2.0)] * len(parts)
    for again, rejected in ((parts[0], False), (parts[1], True)):
        acts = [Feel(0.0), Feel(0.0, again), answer]
        plan = replace(plan, participant=f"felt-{again}")
        records = present(scripted(acts={(1, 1): acts}, playbacks={(1, 1): list(dry)}), plan=plan)
        assert list_events(records, "rated")[0]["rejected"] == rejected


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize(
    ("fault", "flag"), [({"underruns": 1}, "underrun"), ({"clipped": 1}, "clipped")]
)
def test_one_bad_part_flags_the_trial(
    present: Present,
    scripted: type,
    plan_task: Callable[..., Plan],
    place: int,
    fault: dict[str, int],
    flag: str,
) -> None:
    playbacks = [Playback(1.0, 1.0), Playback(2.0, 2.0)]
    playbacks[place] = replace(playbacks[place], **fault)
    records = present(scripted(playbacks={(1, 1): playbacks}), plan=plan_task("similarity"))
    assert list_events(records, "rated")[0]["flags"] == [flag]


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
    records = present(
        scripted(
            playbacks={(1, 1): [odd]},
            acts={(1, 1): [Confirm(0.0, {"test": np.float32(12.5)}, 1.5)]},
        )
    )
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


@pytest.mark.parametrize(
    "move", [Move(0.0, "nonsense", 50.0), Move(0.0, "test", 1e9), Move(0.0, "test", float("nan"))]
)
def test_a_move_that_cannot_be_is_refused(present: Present, scripted: type, move: Move) -> None:
    presenter = scripted(acts={(1, 1): [move, DONE]})
    records = present(presenter)
    assert list_events(records, "moved") == []
    assert f"refuse unknown_part {move.part}" in presenter.log


def test_who_leaves_within_a_pause_goes_on_with_the_trial(present: Present, scripted: type) -> None:
    records = present(
        scripted(acts={(1, 1): [Pause(0.0)]}, pages={"pause": [Pause(0.0), Abort(0.0, "tired")]})
    )
    assert [r.event for r in records[-2:]] == ["paused", "aborted"]
    assert present(scripted())[-1].event == "finished"


@pytest.mark.parametrize("page", ["welcome", "pause"])
def test_a_page_cannot_be_paused(present: Present, scripted: type, page: str) -> None:
    presenter = scripted(pages={page: [Pause(0.0), Pause(0.0)]}, acts={(1, 1): [Pause(0.0)]})
    with pytest.raises(IndexError):  # The script of the trial that is shown again is used up.
        present(presenter)
    assert presenter.log.count(f"page {page} 0/20") == 3


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
    assert [event for event, _ in tell_first(records)] == ["shown", "prompted", "played", "rated"]
    assert presenter.log[5] in {"prompt surface bumps", "prompt surface taps"}
