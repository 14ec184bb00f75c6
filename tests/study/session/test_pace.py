"""The pace of a task: silence before parts, time for an answer, and fixed onsets."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.trial import Flow
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.evidence.replay import audit_steps
from feel321.study.session.plan import Design, Plan, make_plan
from feel321.study.session.ports import Confirm, Playback, TimedOut

MakePlan = Callable[..., Plan]


@pytest.fixture
def make(design: Design, stimuli: StimulusSet) -> MakePlan:
    def plan(name: str = "realism", **options: Any) -> Plan:
        task = make_task(name, **options)
        flow = Flow(max_attempts=2, break_min=None)
        changed = replace(design, tasks=(task,), flow=flow)
        return make_plan(changed, stimuli, "p01", number=1, simulated=True)

    return plan


@pytest.fixture
def timed(scripted: type) -> type:
    """A presenter that takes time limits and onsets, and notes them; its own clock goes as it is asked to."""

    class Timed(scripted):  # type: ignore[misc] - a fixture hands the class over
        def play(
            self,
            part: Any,  # noqa: ARG002 - the port's form
            stimulus: Any,  # noqa: ARG002 - the port's form
            *,
            gap_s: float,
            due_s: float | None = None,
        ) -> Any:
            self.log.append(f"gap {gap_s:g}")
            start_s = max(self.time_s + gap_s, due_s or 0.0)
            self.time_s = start_s + 1.0
            return Playback(start_s, start_s)

        def wait(self, limit_s: float | None = None) -> Any:
            self.log.append(f"limit {limit_s}")
            act = self._waiting.pop(0)
            self.time_s += min(act.response_time_s, limit_s or 1e9)
            is_late = limit_s is not None and act.response_time_s > limit_s
            return TimedOut(self.time_s) if is_late else replace(act, time_s=self.time_s)

    return Timed


def slow(plan: Plan, *keys: tuple[int, int], response_s: float = 9.0) -> dict[Any, Any]:
    part = plan.trials[0].judged[0]
    return {key: [Confirm(0.0, {part: 40.0}, response_s)] for key in keys}


def test_the_gap_is_the_tasks_own(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    for gap_s, wanted in ((0.25, "gap 0.25"), (0.0, "gap 0"), (None, "gap 0.5")):
        presenter = timed()
        plan = replace(make(gap_s=gap_s), participant=f"p{len(wanted)}")
        present(presenter, plan=plan)
        assert {line for line in presenter.log if line.startswith("gap")} == {wanted}


def test_an_answer_that_comes_too_late_is_not_taken_and_the_trial_comes_again(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    plan = make(answer_timeout_s=4.0)
    presenter = timed(acts=slow(plan, (2, 1)))
    records = present(presenter, plan=plan)
    spoiled = [record.data for record in records if record.event == "spoiled"]
    assert [(data["trial"], data["flags"]) for data in spoiled] == [(2, ["timed_out"])]
    place = presenter.log.index("page timed_out 1/10")
    assert presenter.log[place + 1].startswith("show 3")
    told = next(record.data for record in records if record.data.get("key") == "timed_out")
    assert told["stood_s"] == 1.0  # a key that came just too late does not take it away
    shown = [record.data for record in records if record.event == "shown"]
    assert [data["attempt"] for data in shown if data["trial"] == 2] == [1, 2]
    assert "limit 4.0" in presenter.log
    assert records[-1].data == {"trials": 10, "given_up": 0}
    assert list(audit_steps(records, plan)) == []


def test_who_never_answers_in_time_is_given_up_by_the_rules_of_the_session(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    plan = make(answer_timeout_s=4.0)
    records = present(timed(acts=slow(plan, (2, 1), (2, 2))), plan=plan)
    assert records[-1].data == {"trials": 10, "given_up": 1}
    assert list(audit_steps(records, plan)) == []


def test_a_time_out_that_no_task_has_is_found(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    plan = make(answer_timeout_s=4.0)
    records = present(timed(acts=slow(plan, (2, 1))), plan=plan)
    place = next(n for n, record in enumerate(records) if record.event == "spoiled")
    assert next(audit_steps(records, make()), "").startswith(f", line {place + 1}: ")
    forged = [*records]
    forged[place] = replace(records[place], data={**records[place].data, "flags": ["underrun"]})
    assert next(audit_steps(forged, plan), "").startswith(f", line {place + 1}: ")


def test_trials_begin_on_the_schedule(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    """Answers take 1.5 s but for one of 9 s: that trial's follower is late, and the schedule moves with it."""
    plan = make(onset_s=6.0)
    presenter = timed(acts=slow(plan, (3, 1)))
    records = present(presenter, plan=plan)
    onsets = [record.data["onset_s"] for record in records if record.event == "played"]
    half = onsets[:5]  # before the rest
    steps = [round(after - before, 6) for before, after in pairwise(half)]
    assert steps == [6.0, 6.0, 10.5, 6.0]
    scheduled = [r.data for r in records if r.event == "scheduled"]
    due = {data["trial"]: data["due_s"] for data in scheduled}
    numbers = [r.data["trial"] for r in records if r.event == "shown"]
    assert due.keys() == {*numbers} - {numbers[0], numbers[5]}  # each section begins at once
    assert onsets[3] - due[numbers[3]] == pytest.approx(4.5)
    assert list(audit_steps(records, plan)) == []
    assert "holds 'scheduled' where" in next(audit_steps(records, make()), "")


def test_no_page_comes_between_trials_with_fixed_onsets(
    present: Callable[..., list[Any]], timed: type, make: MakePlan
) -> None:
    plan = make(onset_s=6.0, answer_timeout_s=3.0)
    presenter = timed(acts=slow(plan, (2, 1)))
    records = present(presenter, plan=plan)
    assert not any("timed_out" in line for line in presenter.log if line.startswith("page"))
    place = presenter.log.index("refuse timed_out")
    assert presenter.log[place - 1].startswith("show 3.1")
    assert presenter.log.count("refuse timed_out") == 1
    assert list(audit_steps(records, plan)) == []
