from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from study.journal import create_journal, read_journal, require_journal
from study.plan import Plan, make_plan, require_plan
from study.session import find_completed, find_elapsed, find_header, is_finished, open_session

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from stimuli.manifest import StimulusSet

    Present = Callable[..., list[Any]]
    Now = Callable[[], datetime]


def test_a_realism_trial_is_shown_played_and_rated(present: Present, scripted: type, plan: Plan) -> None:
    presenter = scripted()
    present(presenter)
    first = plan.trials[0]
    assert presenter.log[:3] == ["show 1 realism", f"play {first.stimulus_id}", "ask realism"]


def test_a_similarity_trial_plays_the_reference_first(present: Present, scripted: type, plan: Plan) -> None:
    presenter = scripted()
    present(presenter)
    last = plan.trials[-1]
    assert presenter.log[-4:] == [
        f"show {last.number} similarity",
        f"play {last.reference_id}",
        f"play {last.stimulus_id}",
        "ask similarity",
    ]


def test_the_journal_tells_everything_in_order(present: Present, scripted: type, tmp_path: Path) -> None:
    records = present(scripted())
    realism, similarity = ["shown", "played", "rated"], ["shown", "played", "played", "rated"]
    assert [r.event for r in records] == ["begun", *realism * 10, *similarity * 10, "finished"]
    header = find_header(records)
    assert header is not None
    assert header["plan_sha256"] == require_plan(tmp_path / "sessions" / "p01" / "plan.json").sha256 != ""
    assert header["stimuli_sha256"] == "5" * 64
    assert header["presenter"] == {"simulated": True}
    assert set(header["versions"]) == {"feel321", "numpy"}
    assert find_completed(records) == list(range(1, 21))
    assert find_elapsed(records) == 200.0
    assert is_finished(records)


def test_what_played_well_is_not_marked(present: Present, scripted: type) -> None:
    assert not any(r.data["rejected"] for r in present(scripted()) if r.event == "rated")


def test_a_replay_plays_the_trial_again_and_is_recorded(present: Present, scripted: type) -> None:
    events = [r.event for r in present(scripted(replays=2))]
    assert events[1:8] == ["shown", "played", "replayed", "played", "replayed", "played", "rated"]


def test_what_ran_dry_is_marked_and_kept(present: Present, scripted: type) -> None:
    rated = [r.data for r in present(scripted(underruns=1)) if r.event == "rated"]
    assert len(rated) == 20
    assert all(entry["rejected"] for entry in rated)


def test_a_trial_that_was_put_back_is_asked_again(present: Present, scripted: type, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    path = tmp_path / "sessions" / "p01" / "session-01.jsonl"
    require_journal(path, now=lambda: datetime(2026, 1, 1, tzinfo=UTC)).write("requeued", {"trial": 2})
    assert find_completed(read_journal(path).records) == [1, 3]
    again = scripted()
    assert sorted(find_completed(present(again))) == list(range(1, 21))
    assert again.log[0] == "show 2 realism"


@pytest.mark.parametrize("stop_after", [0, 1, 9, 10, 11, 19])
def test_a_session_broken_off_anywhere_goes_on_where_it_was(
    present: Present, scripted: type, plan: Plan, stop_after: int
) -> None:
    broken = scripted(stop_after=stop_after)
    with pytest.raises(KeyboardInterrupt):
        present(broken)
    again = scripted()
    records = present(again)
    assert find_completed(records) == [trial.number for trial in plan.trials]
    shown = [line.split()[1] for line in (*broken.log, *again.log) if line.startswith("show")]
    assert shown == [str(trial.number) for trial in plan.trials]


def test_a_finished_session_is_left_alone(present: Present, scripted: type) -> None:
    first = present(scripted())
    silent = scripted()
    assert present(silent) == first
    assert silent.log == []


def test_a_session_whose_header_was_torn_begins_again(present: Present, scripted: type, tmp_path: Path) -> None:
    folder = tmp_path / "sessions" / "p01"
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=0))
    journal = folder / "session-01.jsonl"
    journal.write_bytes(journal.read_bytes()[:40])
    records = present(scripted())
    assert [r.event for r in records][:2] == ["recovered", "begun"]
    assert len(find_completed(records)) == 20


def test_another_plan_is_refused_and_the_difference_named(
    present: Present, scripted: type, stimuli: StimulusSet
) -> None:
    present(scripted())
    other = make_plan(stimuli, "p01", number=1, seed=7, protocols=("realism", "similarity"), repeats=2)
    message = r"plan\.json: the study was changed .*\(repeats 1 -> 2\); .* or move sessions/ away"
    with pytest.raises(ValueError, match=message):
        present(scripted(), plan=other)


def test_another_presenter_is_refused_and_the_difference_named(
    present: Present, scripted: type, plan: Plan, tmp_path: Path, now: Now
) -> None:
    present(scripted())
    message = r"begun otherwise \(presenter.simulated True -> False\)"
    with (
        pytest.raises(ValueError, match=message),
        open_session(tmp_path / "sessions" / "p01", plan, identity={"simulated": False}, now=now),
    ):
        pytest.fail("the session was opened")


def test_a_later_version_runs_the_stored_plan_and_not_the_order_that_it_would_make(
    present: Present, scripted: type, plan: Plan
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    records = present(scripted(), plan=replace(plan, trials=plan.trials[::-1]))
    shown = [r.data["stimulus_id"] for r in records if r.event == "shown"]
    assert shown == [trial.stimulus_id for trial in plan.trials]


def test_resuming_leaves_a_record_with_the_versions(present: Present, scripted: type) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=3))
    records = present(scripted())
    assert [r.data for r in records if r.event == "resumed"] == [{"versions": records[0].data["versions"]}]


@pytest.mark.parametrize(
    ("change", "difference"),
    [({"seed": 8}, "seed 8 -> 7"), ({"stimuli_sha256": "6"}, f"stimuli_sha256 '6' -> '{'5' * 64}'")],
)
def test_a_header_that_does_not_fit_the_plan_is_refused_and_the_difference_named(
    present: Present, scripted: type, tmp_path: Path, now: Now, change: dict[str, Any], difference: str
) -> None:
    header = {**present(scripted())[0].data, **change}
    path = tmp_path / "sessions" / "p01" / "session-01.jsonl"
    path.unlink()
    create_journal(path, now=now).write("begun", header)
    with pytest.raises(ValueError, match=rf"begun otherwise \({difference}\); .* or move sessions/ away"):
        present(scripted())


HOLD = """
import sys
from pathlib import Path
from stimuli.lock import hold_lock
with hold_lock(Path(sys.argv[1]), busy="x"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_two_writers_cannot_share_a_session(present: Present, scripted: type, tmp_path: Path) -> None:
    folder = tmp_path / "sessions" / "p01"
    folder.mkdir(parents=True)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, folder / ".lock"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(BlockingIOError, match="p01: another session is writing here; let it finish"):
            present(scripted())
        assert [path.name for path in folder.iterdir()] == [".lock"]
        other.kill()
    assert present(scripted())[-1].event == "finished"  # the lock of a killed process is free at once
