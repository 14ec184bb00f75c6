"""Pages aside from the plan: whatever is done on them, whenever the device fails, nothing is lost."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.study.auditing.replay import audit_steps
from feel321.study.session.plan import replay
from feel321.study.session.ports import Abort, Confirm, Pause, Playback

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.session.plan import Plan

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
