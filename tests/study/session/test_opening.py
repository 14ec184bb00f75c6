"""Beginning and resuming: what is refused and what differs, who may write, and what a long absence means."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.session.events import PageRead, SessionReleased, read_event
from feel321.study.session.journal import create_journal, read_journal, require_journal, utc_now
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Design, Plan, Stale, make_plan, require_plan
from tests.study.conftest import list_events

Present = Callable[..., list[Any]]
Now = Callable[[], datetime]


def rated_trials(records: list[Any]) -> list[int]:
    return [data["trial"] for data in list_events(records, "rated")]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "sessions" / "p01"


def test_the_header_says_what_the_session_stands_on(
    present: Present, scripted: type, folder: Path
) -> None:
    header = present(scripted()).find_header()
    assert header is not None
    assert header.plan_sha256 == require_plan(folder / "plan.json").sha256 != ""
    assert (header.participant, header.session, header.seed) == ("p01", 1, 7)
    assert (header.stimuli_sha256, header.identity) == (
        "5" * 64,
        {"presenter": {"simulated": True}},
    )
    assert set(header.versions) == {"python", "feel321", "numpy", "scipy"}
    assert (header.format, header.clock) == (1, {"presenter_s": 0.0})
    assert header.system


def test_a_session_whose_header_was_torn_begins_again_and_resuming_keeps_the_versions(
    present: Present, scripted: type, folder: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=0))
    journal = folder / "session-01.jsonl"
    journal.write_bytes(journal.read_bytes()[:40])
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    records = present(scripted())
    assert [r.event for r in records][:2] == ["recovered", "begun"]
    assert rated_trials(records) == list(range(1, 21))
    (resumed,) = list_events(records, "resumed")
    assert resumed["versions"] == records[1].data["versions"]


def test_another_plan_is_refused_and_the_difference_named(
    present: Present, scripted: type, design: Design, stimuli: StimulusSet
) -> None:
    present(scripted())
    changed = replace(design, repeats=2, flow=replace(design.flow, gap_s=1.0))
    other = make_plan(changed, stimuli, "p01", number=1, simulated=True)
    message = r"plan\.json: the study was changed .*\(repeats 1 -> 2; flow\.gap_s 0\.5 -> 1\.0\); .* or move sessions/"
    with pytest.raises(ValueError, match=message):
        present(scripted(), plan=other)


def test_another_presenter_is_refused_and_the_difference_named(
    present: Present, scripted: type, plan: Plan, folder: Path, now: Now
) -> None:
    present(scripted())
    identity = {"presenter": {"simulated": False}, "rig": None}
    with (
        pytest.raises(ValueError, match=r"begun otherwise \(presenter.simulated True -> False\)"),
        open_session(folder, plan, identity=identity, now=now, stale=Stale()),
    ):
        pytest.fail("the session was opened")


def test_a_later_version_runs_the_stored_plan_and_not_the_order_that_it_would_make(
    present: Present, scripted: type, plan: Plan
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    again = scripted()
    present(again, plan=replace(plan, trials=plan.trials[::-1]))
    assert again.log[:2] == ["page ready 3/20", "show 4.1 realism"]
    assert "show 11.1 similarity" in again.log


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({"seed": 8}, "seed 8 -> 7"),
        ({"stimuli_sha256": "6"}, f"stimuli_sha256 '6' -> '{'5' * 64}'"),
        ({"texts_sha256": "7", "versions": {"feel321": "0.0.1"}}, "other texts for participants"),
    ],
)
def test_a_header_that_does_not_fit_the_plan_is_refused_and_the_difference_named(
    present: Present,
    scripted: type,
    folder: Path,
    now: Now,
    change: dict[str, Any],
    difference: str,
) -> None:
    header = {**present(scripted())[0].data, **change}
    path = folder / "session-01.jsonl"
    path.unlink()
    journal = create_journal(path, now=now)
    journal.write(read_event("begun", header))
    if "versions" in change:  # Before that, other texts do no harm.
        journal.write(PageRead("welcome", 1.0, 1.0))
    use = " or use feel321 0.0.1, which began it" if "versions" in change else ""
    remedy = f"change that back{use}, begin with another participant, or move sessions/ away"
    with pytest.raises(ValueError, match=rf"begun otherwise \({difference}\); {remedy}"):
        present(scripted())


@pytest.fixture
def leave(present: Present, scripted: type, folder: Path) -> Callable[..., list[Any]]:
    """Break off after three trials and come back after some hours; what the session then holds."""

    def go(policy: str, *, hours: float, plan: Plan, after_h: float | None = 6.0) -> list[Any]:
        stale = Stale(after_h=after_h, policy=policy)
        with pytest.raises(KeyboardInterrupt):
            present(scripted(stop_after=3), plan=plan)
        last = datetime.fromisoformat(read_journal(folder / "session-01.jsonl").records[-1].utc)
        later = last + timedelta(hours=hours)
        return present(scripted(), plan=plan, stale=stale, now=lambda: later)

    return go


@pytest.fixture
def practised(design: Design, stimuli: StimulusSet) -> Plan:
    tasks = tuple(replace(task, practice=2) for task in design.tasks)
    return make_plan(replace(design, tasks=tasks), stimuli, "p01", number=1, simulated=True)


def test_who_comes_back_late_warms_up(leave: Callable[..., list[Any]], practised: Plan) -> None:
    records = leave("warm_up", hours=6.1, plan=practised)
    assert [r.event for r in records if r.event in {"resumed", "warm_up"}] == ["resumed", "warm_up"]
    keys = [data["key"] for data in list_events(records, "page")]
    assert keys.count("warm_up") == 1
    practice = [
        trial.number
        for trial in practised.trials
        if trial.phase == "practice" and trial.protocol == "realism"
    ]
    assert rated_trials(records)[:6] == [*practice, 1, *practice, 2]


@pytest.mark.parametrize(
    ("policy", "hours", "after_h"),
    [("warm_up", 5.9, 6.0), ("continue", 99, 6.0), ("restart", 99, None)],
)
def test_who_comes_back_in_time_or_may_go_on_goes_on(
    leave: Callable[..., list[Any]],
    practised: Plan,
    policy: str,
    hours: float,
    after_h: float | None,
) -> None:
    records = leave(policy, hours=hours, plan=practised, after_h=after_h)
    assert [r.event for r in records if r.event in {"warm_up", "superseded"}] == []
    assert len(rated_trials(records)) == 20 + 4


def test_a_restart_is_a_new_session_and_the_old_one_stays(
    leave: Callable[..., Any], practised: Plan, folder: Path
) -> None:
    records = leave("restart", hours=7, plan=practised)
    assert records.find_header() is not None
    assert records[0].data["session"] == 2
    assert len(rated_trials(records)) == 20 + 4
    old = read_journal(folder / "session-01.jsonl").records
    assert (old[-1].event, old[-1].data) == ("superseded", {"by": 2})
    assert len(rated_trials(list(old))) == 3


def test_a_crash_between_the_old_session_and_the_new_one_is_no_third_session(
    leave: Callable[..., list[Any]], present: Present, scripted: type, practised: Plan, folder: Path
) -> None:
    leave("restart", hours=7, plan=practised)
    whole = (folder / "session-02.jsonl").read_bytes()
    (folder / "session-02.jsonl").unlink()
    records = present(scripted(), plan=practised)
    assert rated_trials(records) == rated_trials(list(records))
    assert {path.name for path in folder.glob("*.jsonl")} == {
        "session-01.jsonl",
        "session-02.jsonl",
    }
    assert len((folder / "session-02.jsonl").read_bytes()) == len(whole)
    old = read_journal(folder / "session-01.jsonl").records
    assert [r.event for r in old].count("superseded") == 1


def test_who_was_released_or_withdrawn_does_not_come_back(
    present: Present, scripted: type, folder: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    journal = require_journal(folder / "session-01.jsonl", now=utc_now)
    journal.write(SessionReleased())
    with pytest.raises(ValueError, match="p01 was released, the place in the design is free; take"):
        present(scripted())
    (folder / "withdrawn.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match="p01 was withdrawn; take another code"):
        present(scripted())


HOLD = """
import sys
from pathlib import Path
from feel321.files import hold_lock
with hold_lock(Path(sys.argv[1]), busy="x"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_two_writers_cannot_share_a_session(present: Present, scripted: type, folder: Path) -> None:
    folder.mkdir(parents=True)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, folder / ".lock"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(
            BlockingIOError, match="p01: another session is writing here; let it finish"
        ):
            present(scripted())
        assert {path.name for path in folder.iterdir()} == {".lock", "plan.json"}
        other.kill()
    # The lock of a killed process is free at once.
    assert present(scripted())[-1].event == "finished"
