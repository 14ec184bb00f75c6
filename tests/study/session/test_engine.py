"""The loop: what a session consists of, how it is broken off, and how it goes on."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.study.evidence.replay import audit_steps
from feel321.study.session.plan import Plan, replay
from feel321.study.session.ports import Abort, Confirm, Pause, Playback
from tests.study.conftest import list_events

Present = Callable[..., list[Any]]


def test_a_session_follows_the_plan_and_its_journal_tells_everything_in_order(
    present: Present, scripted: type
) -> None:
    presenter = scripted()
    records = present(presenter)
    realism, similarity = "shown played rated ", "shown played played rated "
    told = f"begun {'page ' * 4}{realism * 10}{'page ' * 3}{similarity * 10}page finished"
    assert [r.event for r in records] == told.split()
    keys = "welcome consent instructions.realism main rest instructions.similarity main end"
    assert [page["key"] for page in list_events(records, "page")] == keys.split()
    assert [r["trial"] for r in list_events(records, "rated")] == list(range(1, 21))
    assert list_events(records, "rated")[0] == {
        "trial": 1,
        "attempt": 1,
        "values": {"test": 50.0},
        "response_time_s": 1.5,
        "time_s": 6.0,
        "flags": [],
        "rejected": False,
    }
    assert records[-1].data == {"trials": 20, "given_up": 0}
    first = [f"page {key} 0/20" for key in keys.split()[:4]]
    assert presenter.log[:5] == [*first, "show 1.1 realism"]
    shown = [line.split()[1] for line in presenter.log if line.startswith("show")]
    assert shown == [f"{n}.1" for n in range(1, 21)]
    assert [" ".join(line.split()[:2]) for line in presenter.log[-4:]] == [
        "show 20.1",
        "play reference",
        "play test",
        "page end",
    ]


@pytest.mark.parametrize("stop_after", [0, 1, 9, 10, 11, 19])
def test_a_session_broken_off_anywhere_goes_on_where_it_was(
    present: Present, scripted: type, stop_after: int
) -> None:
    broken = scripted(stop_after=stop_after)
    with pytest.raises(KeyboardInterrupt):
        present(broken)
    again = scripted()
    records = present(again)
    shown = [line.split()[1] for line in (*broken.log, *again.log) if line.startswith("show")]
    assert shown == [f"{number}.1" for number in range(1, 21)]
    assert [data["trial"] for data in list_events(records, "rated")] == list(range(1, 21))
    assert [data["reason"] for data in list_events(records, "aborted")] == ["KeyboardInterrupt"]
    assert len(list_events(records, "resumed")) == 1
    assert [line for line in again.log if line.startswith("page welcome")] == []


def test_a_finished_session_is_left_alone(present: Present, scripted: type) -> None:
    first = present(scripted())
    silent = scripted()
    assert present(silent) == first
    assert silent.log == []


@pytest.mark.parametrize("page", ["consent", "rest", "end"])
def test_who_does_not_go_on_ends_the_session_for_today(
    present: Present, scripted: type, page: str
) -> None:
    records = present(scripted(pages={page: [Abort(1.0, "does not agree")]}))
    assert (records[-1].event, records[-1].data) == (
        "aborted",
        {"reason": "does not agree", "time_s": 1.0},
    )
    again = scripted()
    assert present(again)[-1].event == "finished"
    assert again.log[0].startswith(f"page {page} ")


def fail(count: int = 1) -> list[Playback]:
    return [Playback(1.0, 1.0, error="device is gone")] * count


LEAVE = Abort(1.0, "the window was closed")


@pytest.mark.parametrize("stop_after", [0, 1])
def test_a_page_waits_before_the_first_vibration_of_a_resumed_session(
    present: Present, scripted: type, stop_after: int
) -> None:
    """Again after each resume, and not where another page waits anyway."""
    first = scripted(pages={"main": [LEAVE]})
    present(first)
    again = scripted(stop_after=stop_after)
    with pytest.raises(KeyboardInterrupt):
        present(again)
    assert again.log[0] == "page main 0/20"
    for _ in range(2):
        unready = scripted(pages={"ready": [LEAVE]})
        assert present(unready)[-1].event == "aborted"
        assert unready.log == [f"page ready {stop_after}/20"]
    last = scripted()
    records = present(last)
    pages = [line for line in (*first.log, *last.log) if line.startswith("page ready")]
    assert pages == [f"page ready {stop_after}/20"]
    assert records[-1].event == "finished"


def test_a_fault_of_the_presenter_is_recorded_in_its_own_words(
    present: Present, scripted: type
) -> None:
    class Broken(scripted):
        def wait(self) -> Any:
            raise RuntimeError("device HX-1 unplugged")

    with pytest.raises(RuntimeError, match="HX-1"):
        present(Broken())
    (aborted,) = list_events(present(scripted()), "aborted")
    assert aborted["reason"] == "RuntimeError: device HX-1 unplugged"


def test_a_journal_that_tells_of_another_order_is_refused_with_its_line(
    present: Present, scripted: type, plan: Plan
) -> None:
    records = present(scripted())
    rated = [place for place, record in enumerate(records) if record.event == "rated"]
    swapped = [*records[: rated[4]], records[rated[5]]]
    with pytest.raises(ValueError, match=r"line 23: got trial 6, expected trial 5"):
        replay(plan, swapped)


ACTS = st.sampled_from([
    Confirm(1.0, {}),
    Pause(1.0),
    Abort(1.0, "the window was closed"),
    Abort(1.0, "the participant ended it for today"),
])
SITTINGS = st.lists(
    st.fixed_dictionaries({
        "ready": st.lists(ACTS, max_size=3),
        "call_us": st.lists(ACTS, max_size=4),
        "fails": st.sets(st.integers(1, 20), max_size=8),
        "stop_after": st.integers(0, 30),
    }),
    min_size=1,
    max_size=4,
)


@settings(max_examples=15, deadline=None)
@given(sittings=SITTINGS)
def test_no_act_on_them_loses_a_record(
    sittings: list[dict[str, Any]],
    begin_study: Callable[[], Callable[..., list[Any]]],
    scripted: type,
    plan: Plan,
) -> None:
    present = begin_study()
    before: list[Any] = []
    for sitting in [*sittings, {"ready": [], "call_us": [], "fails": (), "stop_after": 10**6}]:
        broken = [Playback(1.0, 1.0, error="gone")]
        presenter = scripted(
            pages={key: list(sitting[key]) for key in ("ready", "call_us")},
            playbacks={(n, k): list(broken) for n in sitting["fails"] for k in (1, 2)},
            stop_after=sitting["stop_after"],
        )
        try:
            records = present(presenter)
        except KeyboardInterrupt:
            continue
        assert [(r.event, r.data) for r in records[: len(before)]] == before
        before = [(record.event, record.data) for record in records]
        assert list(audit_steps(records, plan)) == []
    assert before[-1][0] == "finished"
    rated = Counter(data["trial"] for event, data in before if event == "rated")
    assert rated == dict.fromkeys(range(1, 21), 1)
    assert replay(plan, records).done == 20
    pages = [data["key"] for event, data in before if event == "page"]
    calls = sum(event == "device_failed" for event, _ in before)
    assert pages.count("call_us") <= calls
    assert pages.count("ready") <= sum(event == "resumed" for event, _ in before)
